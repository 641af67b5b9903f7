"""What `explore` prints of a cloud."""

from pathlib import Path
from typing import TYPE_CHECKING

from probedesign.cli.console import counted, print_json
from probedesign.cli.explored_files import FILES

if TYPE_CHECKING:
    from probedesign.exploring.cloud import Cloud


def print_cloud(cloud: "Cloud", out: Path | None, as_json: bool) -> None:
    """One JSON document, or a line a point and a summary.

    Args:
        cloud: what was found.
        out: the folder that it was written to, if it was.
        as_json: print the document.
    """
    from probedesign.exploring.table import document_of, lines_of

    if as_json:
        print_json(document_of(cloud))
        return
    print("\n".join(lines_of(cloud)) or "no touch")
    print(summary(cloud) + (f"; wrote {out}/{', '.join(FILES)}" if out is not None else ""))


def summary(cloud: "Cloud") -> str:
    """How many points by how many touches, and the stiffness by them."""
    located, lost = sum(len(point.touches) for point in cloud.points), len(cloud.unlocated)
    by = f"{located}{f' of {located + lost}' if lost else ''} touch{'' if located + lost == 1 else 'es'}"
    told = f"{counted(len(cloud.points), 'point')} by {by}"
    return f"{told}; E by them {cloud.stiffness:.3f} ± {cloud.std_stiffness:.3f} of the bundle's"
