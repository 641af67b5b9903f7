"""What `explore` prints of a cloud."""

from pathlib import Path
from typing import TYPE_CHECKING

from probedesign.cli.explored_files import FILES
from probedesign.cli.output import counted, print_json

if TYPE_CHECKING:
    from probedesign.mapping.contact_map import ContactMap


def print_cloud(cloud: "ContactMap", out: Path | None, as_json: bool) -> None:
    """One JSON document, or a line a point and a summary.

    Args:
        cloud: what was found.
        out: the folder that it was written to, if it was.
        as_json: print the document.
    """
    from probedesign.mapping.map_files import map_document, map_lines

    if as_json:
        print_json(map_document(cloud))
        return
    print("\n".join(map_lines(cloud)) or "no touch")
    print(summary(cloud) + (f"; wrote {out}/{', '.join(FILES)}" if out is not None else ""))


def summary(cloud: "ContactMap") -> str:
    """How many points by how many touches, and the stiffness by them."""
    located, lost = sum(len(point.touches) for point in cloud.points), len(cloud.unlocated)
    by = f"{located}{f' of {located + lost}' if lost else ''} touch{'' if located + lost == 1 else 'es'}"
    told = f"{counted(len(cloud.points), 'point')} by {by}"
    return f"{told}; E by them {cloud.stiffness:.3f} ± {cloud.std_stiffness:.3f} of the bundle's"
