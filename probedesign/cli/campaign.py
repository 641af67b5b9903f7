"""`probedesign campaign` and `probedesign markers`: simulated measurements, and the markers in photographs."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from probedesign.cli.console import plural, print_json, print_table, show_progress
from probedesign.cli.options import DesignFile, JsonOutput
from probedesign.core.units import MM, MPA

if TYPE_CHECKING:
    from probedesign.campaigns.photographs import PhotographedTest


def campaign(
    design: DesignFile,
    out: Path,
    /,
    *,
    seed: int = 0,
    stage: bool = False,
    images: bool = False,
    calibration: Literal["box", "files"] = "box",
    youngs_modulus_mpa: float | None = None,
    shear_modulus_mpa: float | None = None,
    marker_noise_mm: float | None = None,
    readings: int = 5,
    exact: bool = False,
    friction: float | None = None,
    friction_spread: float = 0.2,
    hold_out: Annotated[bool, Parameter(negative="--no-hold-out")] = True,
    flaws: Annotated[bool, Parameter(negative="--no-flaws")] = True,
    force: bool = False,
    as_json: JsonOutput = False,
) -> None:
    """Simulate a measurement campaign of a print: tests, wrenches, markers and two calibrated cameras.

    The simulated print differs from the design by errors drawn from the design's tolerances. OUT/truth.json holds the
    true values; no command reads it. See docs/measurements.md.

    Args:
        design: the design file, or its name.
        out: output folder.
        seed: seed of all drawn values.
        stage: touches at positions known to 0.05 mm, without cameras.
        images: render photographs as well.
        calibration: of the cameras: a box of control points, or calibration files of OpenCV.
        youngs_modulus_mpa: Young's modulus of the true print [MPa]. Default: drawn around the design's.
        shear_modulus_mpa: shear modulus of the true print [MPa]. Default: drawn around the design's.
        marker_noise_mm: standard deviation of the markers on each axis [mm], from a reference other than cameras.
        readings: number of sensor readings per test.
        exact: the print and its mount are exactly as designed; only the readings are noisy.
        friction: median friction coefficient of the touching objects. The tangential force has any direction within
            the friction cone. 0 is without friction. Default: [contact] friction of the design.
        friction_spread: standard deviation of the friction coefficient's logarithm from test to test.
        hold_out: every second touch is for validate, and identify leaves it out (use in tests.csv).
        flaws: the bench has the flaws of the design's tolerances: friction, gain and drift of the sensor, root, creep
            and scatter of the stiffness.
        force: replace an existing simulated campaign.
        as_json: print one JSON document.
    """
    from probedesign import pipeline
    from probedesign.simulation.campaign_folder import make_campaign
    from probedesign.simulation.ground_truth import CampaignPlan

    def si(value: float | None, unit: float) -> float | None:
        return None if value is None else value * unit

    plan = CampaignPlan("stage" if stage else "cameras", seed, si(youngs_modulus_mpa, MPA), si(shear_modulus_mpa, MPA),
                si(marker_noise_mm, MM), readings, exact, images, calibration,
                friction, friction_spread, hold_out, flaws)  # fmt: skip
    with show_progress() as on_progress:
        made = make_campaign(pipeline.load_probe(design).model, out, plan, force, on_progress)
    if as_json:
        print_json({"folder": made.folder, "files": made.files, "tests": made.tests})
    else:
        print(f"wrote {made.folder}: {plural(made.tests, 'test')}, {plural(len(made.files), 'file')}; "
              "true values in truth.json")  # fmt: skip


def markers(
    data: Path,
    /,
    *,
    base_side: Literal["left", "right", "top", "bottom"] | None = None,
    dots: Literal["dark", "light", "either"] = "either",
    overlays: Annotated[bool, Parameter(negative="--no-overlays")] = True,
    skip: bool = False,
    force: bool = False,
    as_json: JsonOutput = False,
) -> None:
    """Detect the markers of a probe in the photographs of a campaign, and write DATA/pixels.csv.

    The photographs are DATA/images/TEST-CAMERA.png or .jpg. Copies in DATA/overlays show what was detected, for visual
    inspection. See docs/stereo.md.

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

    vision.require_opencv()
    from probedesign.campaigns.photographs import check_free, find_all, write_pixels

    check_free(data, force)
    folder = data / "overlays" if overlays else None
    with show_progress() as on_progress:
        tests, notes = find_all(data, base_side, {"dark": True, "light": False}.get(dots), skip, on_progress)
        if folder is not None:
            from probedesign.vision.markers import overlay, read_grey, write_png

            for test in tests:
                for photograph, markers in zip(test.photographs, test.found, strict=bool(test.found)):
                    write_png(folder / f"{photograph.path.stem}.png", overlay(read_grey(photograph.path), markers))
    path = write_pixels(data, tests, force)
    if as_json:
        records = [
            {
                "test": test.test,
                "photographs": [photograph.path for photograph in test.photographs],
                "markers": len(test.found[0].pixels) if test.found else 0,
                "largest_std_px": max((float(markers.std_px.max()) for markers in test.found), default=None),
                "residual_px": test.residual_px,
                "problem": test.problem or None,
            }
            for test in tests
        ]
        print_json({"file": path, "overlays": folder, "notes": notes, "tests": records})
        return
    for note in notes:
        print(note)
    print_table({test.test: _line(test) for test in tests})
    used = sum(len(test.found) for test in tests)
    inspect = f"inspect the overlays in {folder}" if folder else "no overlays were written"
    print(f"wrote {path}: {plural(used, 'photograph')}; {inspect}")


def _line(test: "PhotographedTest") -> str:
    if test.problem:
        return f"left out: {test.problem}"
    count, shade = len(test.found[0].pixels), "dark" if test.found[0].dark else "light"
    max_std = max(float(found.std_px.max()) for found in test.found)
    reprojection = "" if math.isnan(test.residual_px) else f", reprojection residual {test.residual_px:.2f} px"
    return (
        f"{plural(count, f'{shade} marker')} in {plural(len(test.found), 'photograph')}, "
        f"largest standard deviation {max_std:.2f} px{reprojection}"
    )
