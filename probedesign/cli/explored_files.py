"""What `explore` writes of a cloud: a table, points, a page and a picture."""

from pathlib import Path
from typing import TYPE_CHECKING

from probedesign.errors import InputError

if TYPE_CHECKING:
    from probedesign.reports.map_picture import MapScene

FILES = ("points.csv", "points.ply", "points.html", "points.svg")


def check_out(out: Path, force: bool) -> None:
    """That the files can be written to a folder.

    Raises:
        InputError: they cannot, or stand there already.
    """
    from probedesign.files import check_room

    if out.exists() and not out.is_dir():
        raise InputError(f"--out {out}: is a file; name a folder")
    check_room(out / FILES[0])
    standing = [name for name in FILES if (out / name).exists()]
    if standing and not force:
        raise InputError(f"{out}/{standing[0]}: exists; say --force to replace it, or name another folder")


def write_cloud(out: Path, scene: "MapScene", probe: str, about: list[str]) -> None:
    """Write all files.

    Args:
        out: the folder.
        scene: what was found, and the truth if a simulation tells it.
        probe: its name and fingerprint.
        about: lines that say what it was found from.
    """
    from probedesign.files import write_atomically
    from probedesign.mapping.map_files import map_csv, map_ply
    from probedesign.reports.map_page import map_page
    from probedesign.reports.map_picture import map_svg

    about = [*about, "Ellipsoids hold the true point in 95 of 100 cases, as far as stiffness, base, robot and bias are "
             "known as well as said; ± is the RMS distance."]  # fmt: skip
    contents = (map_csv(scene.contact_map), map_ply(scene.contact_map, f"probedesign explore, probe {probe}"),
                map_page(scene, "Points touched", about), map_svg(scene))  # fmt: skip
    for name, content in zip(FILES, contents, strict=True):
        write_atomically(out / name, content)
