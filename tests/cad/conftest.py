"""One CAD model and one export, made once for all tests of the parts."""

import fcntl
import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from probedesign.core.files import write_atomically
from probedesign.design import Design, parse_design
from probedesign.mount import Mount
from probedesign.mount.engraving import NOTHING_CUT

LARGE = "length_mm = 150.0\nbase_d_mm = 12.0\ntip_d_mm = 2.0"


def design_of(probe: str = LARGE, robot_flange: str = "iso-9409-1-50-4-m6", name: str = "large") -> Design:
    mount = f'[mount]\nrobot_flange = "{robot_flange}"\n'
    return parse_design(f'schema = 1\nname = "{name}"\n[probe]\n{probe}\n{mount}')


@pytest.fixture(scope="session")
def large() -> Any:
    """The 150 × 12→2 mm cone, drawn."""
    from probedesign.cad.model import build_cad

    return build_cad(design_of())


def with_probe(large: Any, design: Design) -> Any:
    """The drawn parts with the probe of another design instead, for what looks at the probe alone."""
    from probedesign.cad.solids import probe_solid

    mount = Mount.of(design)
    probe = replace(large.parts["probe"], shape=probe_solid(mount.geometry, mount.sensor_adapter))
    return replace(large, design=design, geometry=mount.geometry, adapter=mount.sensor_adapter,
                   parts={**large.parts, "probe": probe}, fingerprints=mount.fingerprints)  # fmt: skip


def without_engraving(model: Any) -> Any:
    """The same model, with rigid parts that the kernel cuts, measures and projects in a fraction of the time."""
    from probedesign.cad.solids import clamp_ring_solid, flange_adapter_solid, sensor_adapter_solid

    a = replace(model.adapter, on_wall=NOTHING_CUT, on_ring=NOTHING_CUT)
    plate = flange_adapter_solid(replace(model.plate, on_plate=NOTHING_CUT))
    shapes = {"sensor_adapter": sensor_adapter_solid(a), "clamp_ring": clamp_ring_solid(a), "flange_adapter": plate}
    plain = {name: replace(model.parts[name], shape=shape) for name, shape in shapes.items()}
    return replace(model, parts={**model.parts, **plain})


OTHERS = {
    "hollow": LARGE + '\nsection = "hollow"\nbore_ratio = 0.5',
    "elliptic": LARGE + '\nsection = "elliptic"\nflatness = 0.6',
}


def files_of(large: Any, probe: str) -> dict[str, bytes]:
    """The files of the probe of another section, by their ending."""
    import cadquery as cq

    from probedesign.cad.exchange import step_bytes
    from probedesign.cad.inspection import probe_sheet
    from probedesign.cad.mesh import part_stl, tessellate

    model = with_probe(large, design_of(probe))
    part = model.parts["probe"]
    step = step_bytes(cq.Assembly(part.shape, name="probe"), "probe.step", "", None)
    stl = part_stl(model.design, "probe", tessellate(part.shape), "0")
    return {"stl": stl, "step": step, "svg": bytes(probe_sheet(model, part))}


def write_exports(folder: str) -> None:
    """Export the large probe into exports/large of a folder, and write the files of other sections beside exports."""
    from probedesign.cad.export import export_parts
    from probedesign.cad.model import build_cad

    base = Path(folder)
    manifest = export_parts(design_of(), base / "exports/large", lambda step: print(step, file=sys.stderr))
    for name, probe in OTHERS.items():
        for kind, content in files_of(build_cad(design_of()), probe).items():
            (base / f"{name}.{kind}").write_bytes(content)
    write_atomically(base / "large.json", json.dumps(manifest).encode())


@pytest.fixture(scope="session")
def exported(tmp_path_factory: pytest.TempPathFactory, worker_id: str) -> tuple[Path, dict[str, Any]]:
    """The same probe, exported by a process with its own seed of Python's hashes, once for all workers.

    Returns its folder and the manifest as returned. Nothing is printed on stdout, which is reserved for `--json`: the
    kernel would print there.
    """
    base = tmp_path_factory.getbasetemp()
    base = base if worker_id == "master" else base.parent
    with (base / "large.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (base / "large.json").exists():
            code = "import sys; from tests.cad.conftest import write_exports; write_exports(sys.argv[1])"
            made = subprocess.run(
                [sys.executable, "-c", code, str(base)], env={**os.environ, "PYTHONHASHSEED": "12345"},
                cwd=Path(__file__).parents[2], check=True, capture_output=True, text=True,
            )  # fmt: skip
            assert made.stdout == "" and made.stderr.splitlines().count("meshing") == 1
    return base / "exports/large", json.loads((base / "large.json").read_text("utf-8"))
