"""`probedesign twin`: a probe for simulators."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from probedesign.cli.console import print_json, show_progress, write_files
from probedesign.cli.options import DesignFile, JsonOutput
from probedesign.core.errors import InputError
from probedesign.core.files import check_folder, exports_of


def twin(
    design: DesignFile,
    /,
    *,
    formats: Annotated[str, Parameter(name="--format")] = "mjcf,sdf,urdf",
    out: Path | None = None,
    links: int | None = None,
    as_json: JsonOutput = False,
) -> None:
    """Write a probe for simulators: an elastic chain as MJCF (MuJoCo) and USD, a rigid body as SDF and URDF.

    Args:
        design: the design file, or its name.
        formats: out of mjcf, sdf, urdf and usd, separated by commas. usd needs usd-core.
        out: output folder. Default: exports/NAME/twin.
        links: number of links of the chain, even. Default: 10, or 14 of a curved probe.
        as_json: print one JSON document.
    """
    from probedesign import pipeline
    from probedesign.simulation.twin import FORMATS, twin_files
    from probedesign.web.home import refresh_home

    chosen = formats.split(",")
    for name in chosen:
        if name not in FORMATS:
            raise InputError(f"--format {formats}: {name!r} is not a format; choose out of {', '.join(FORMATS)}")
    with show_progress("writing the twin"):
        probe = pipeline.load_probe(design)
        folder = exports_of(design) / probe.design.name / "twin" if out is None else out
        check_folder(folder)
        files = write_files(folder, twin_files(probe.model, chosen, links).items())
        if out is None:
            refresh_home(probe.model, design)
    if as_json:
        print_json({"files": files})
        return
    print("wrote", ", ".join(map(str, files)))
