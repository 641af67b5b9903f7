"""`probedesign markers`: the dots of a probe found in photographs."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from probedesign.cli.console import counted, print_json, print_table, telling

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
    """Find the dots of a probe in the photographs of a campaign, and write DATA/pixels.csv.

    Photographs stand in DATA/images as TEST-CAMERA.png or .jpg. For a check by eye each comes back in DATA/overlays
    with the dots outlined and numbered. See docs/stereo.md.

    Args:
        data: the folder of the campaign.
        base_side: side of the pictures where the base is; by default the calibrated cameras tell.
        dots: whether they are darker or lighter than the probe.
        overlays: write the pictures for a check by eye.
        skip: leave out tests whose photographs are refused, and say why.
        force: replace a pixels.csv that stands there.
        as_json: print one JSON document.
    """
    from probedesign import vision

    vision.require()
    from probedesign.campaigns.photographs import check_free, find_all, write_pixels

    check_free(data, force)
    with telling() as tell:
        seen, notes = find_all(data, base_side, {"dark": True, "light": False}.get(dots), skip, tell)
        pictures = _write_overlays(data, seen) if overlays else None
    path = write_pixels(data, seen, force)
    if as_json:
        print_json({"file": path, "overlays": pictures, "notes": notes, "tests": [_row(one) for one in seen]})
        return
    for note in notes:
        print(note)
    print_table({one.test: _words(one) for one in seen})
    used = sum(len(one.found) for one in seen)
    print(
        f"wrote {path}: {counted(used, 'photograph')}; {'check ' + str(pictures) if pictures else 'no overlays'}"
    )


def _write_overlays(data: Path, seen: "list[PhotographedTest]") -> Path:
    """Draw what was found."""
    from probedesign.vision.images import overlay, read_grey, write_png

    folder = data / "overlays"
    for one in seen:
        for photograph, found in zip(one.photographs, one.found, strict=bool(one.found)):
            drawn = overlay(read_grey(photograph.path), found)
            write_png(folder / f"{photograph.path.stem}.png", drawn)
    return folder


def _row(one: "PhotographedTest") -> dict[str, object]:
    return {
        "test": one.test,
        "photographs": [photograph.path for photograph in one.photographs],
        "markers": len(one.found[0].pixels) if one.found else 0,
        "largest_std_px": max((float(found.std_px.max()) for found in one.found), default=None),
        "residual_px": one.residual_px,
        "problem": one.problem or None,
    }


def _words(one: "PhotographedTest") -> str:
    if one.problem:
        return f"left out: {one.problem}"
    dots, shade = counted(len(one.found[0].pixels), "dot"), "dark" if one.found[0].dark else "light"
    text = f"{shade} {dots} in {counted(len(one.found), 'photograph')}"
    known = max(float(found.std_px.max()) for found in one.found)
    agreed = f", cameras agree to {one.residual_px:.2f} px" if one.residual_px == one.residual_px else ""
    return f"{text}, known to {known:.2f} px{agreed}"
