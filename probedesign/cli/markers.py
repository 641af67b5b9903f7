"""`probedesign markers`: detect the markers of a probe in photographs."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from probedesign.cli.console import plural, print_json, print_table, show_progress

if TYPE_CHECKING:
    from probedesign.campaigns.photographs import PhotographedTest


def markers(
    data: Path,
    /,
    *,
    base_side: Literal["left", "right", "top", "bottom"] | None = None,
    dots: Literal["dark", "light", "either"] = "either",
    overlays: Annotated[bool, Parameter(negative="--no-overlays")] = True,
    skip: bool = False,
    force: bool = False,
    as_json: Annotated[bool, Parameter(name="--json")] = False,
) -> None:
    """Detect the markers of a probe in the photographs of a campaign, and write DATA/pixels.csv.

    The photographs are DATA/images/TEST-CAMERA.png or .jpg. Copies in DATA/overlays show the detected markers outlined
    and numbered, for visual inspection. See docs/stereo.md.

    Args:
        data: the folder of the campaign.
        base_side: side of the photographs where the base is. Default: determined from the calibrated cameras.
        dots: markers are darker or lighter than the probe.
        overlays: write the copies for visual inspection.
        skip: leave out tests whose photographs are rejected, with a note.
        force: replace an existing pixels.csv.
        as_json: print one JSON document.
    """
    from probedesign import vision

    vision.require()
    from probedesign.campaigns.photographs import check_free, find_all, write_pixels

    check_free(data, force)
    with show_progress() as on_progress:
        tests, notes = find_all(data, base_side, {"dark": True, "light": False}.get(dots), skip, on_progress)
        folder = _write_overlays(data, tests) if overlays else None
    path = write_pixels(data, tests, force)
    if as_json:
        print_json(
            {"file": path, "overlays": folder, "notes": notes, "tests": [_record(test) for test in tests]}
        )
        return
    for note in notes:
        print(note)
    print_table({test.test: _line(test) for test in tests})
    used = sum(len(test.found) for test in tests)
    print(
        f"wrote {path}: {plural(used, 'photograph')}; "
        f"{f'inspect the overlays in {folder}' if folder else 'no overlays were written'}"
    )


def _write_overlays(data: Path, tests: "list[PhotographedTest]") -> Path:
    """Write the photographs with their markers outlined, and return the folder."""
    from probedesign.vision.markers import overlay, read_grey, write_png

    folder = data / "overlays"
    for test in tests:
        for photograph, found in zip(test.photographs, test.found, strict=bool(test.found)):
            drawn = overlay(read_grey(photograph.path), found)
            write_png(folder / f"{photograph.path.stem}.png", drawn)
    return folder


def _record(test: "PhotographedTest") -> dict[str, object]:
    return {
        "test": test.test,
        "photographs": [photograph.path for photograph in test.photographs],
        "markers": len(test.found[0].pixels) if test.found else 0,
        "largest_std_px": max((float(found.std_px.max()) for found in test.found), default=None),
        "residual_px": test.residual_px,
        "problem": test.problem or None,
    }


def _line(test: "PhotographedTest") -> str:
    if test.problem:
        return f"left out: {test.problem}"
    count, shade = len(test.found[0].pixels), "dark" if test.found[0].dark else "light"
    max_std = max(float(found.std_px.max()) for found in test.found)
    reprojection = (
        "" if math.isnan(test.residual_px) else f", reprojection residual {test.residual_px:.2f} px"
    )
    return (
        f"{plural(count, f'{shade} marker')} in {plural(len(test.found), 'photograph')}, "
        f"largest standard deviation {max_std:.2f} px{reprojection}"
    )
