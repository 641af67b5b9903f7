"""`probedesign board`: a ChArUco board to print, for the calibration of cameras."""

from pathlib import Path

from probedesign.cli.console import print_json
from probedesign.cli.options import JsonOutput
from probedesign.core.errors import InputError
from probedesign.core.units import MM


def board(
    out: Path,
    /,
    *,
    squares: tuple[int, int] = (9, 7),
    square_mm: float = 20.0,
    marker_mm: float = 15.0,
    dictionary: str = "DICT_5X5_100",
    force: bool = False,
    as_json: JsonOutput = False,
) -> None:
    """Write a ChArUco board of exact size for the calibration of cameras: OUT is a .pdf or a .png.

    Print it without scaling, measure the squares, and glue it on a plane plate. See docs/stereo.md.

    Args:
        out: the file to write.
        squares: number of columns and rows.
        square_mm: side of a square [mm].
        marker_mm: side of a marker [mm].
        dictionary: of the markers, as OpenCV names it.
        force: replace an existing file.
        as_json: print one JSON document.
    """
    from probedesign.core.files import check_overwrite, write_atomically
    from probedesign.vision.boards import MARGIN, Board, board_pdf, board_png

    writers = {".pdf": board_pdf, ".png": board_png}
    writer = writers.get(out.suffix.lower())
    if writer is None:
        raise InputError(f"{out}: a board is written as .pdf or .png; choose one of these endings")
    if not 1.0 <= square_mm <= 500.0:
        raise InputError(f"--square-mm {square_mm:g} must lie in 1 ... 500")
    made = Board(squares, square_mm * MM, marker_mm * MM, dictionary)
    check_overwrite(out, force)
    write_atomically(out, writer(made))
    width, height = ((length + 2 * MARGIN) / MM for length in made.size)
    table = {"squares": list(squares), "square_mm": square_mm, "marker_mm": marker_mm, "dictionary": dictionary}
    if as_json:
        print_json({"file": out, "width_mm": made.size[0] / MM, "height_mm": made.size[1] / MM, **table})
        return
    print(
        f"wrote {out}: {squares[0]} x {squares[1]} squares, {width:g} x {height:g} mm with margin; for campaign.toml:"
    )
    print(
        f"\n[cameras.board]\nsquares = {list(squares)}\nsquare_mm = {square_mm:g}\nmarker_mm = {marker_mm:g}\n"
        f'dictionary = "{dictionary}"'
    )
