"""`probedesign campaign`: simulate a measurement campaign."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from probedesign.cli.console import plural, print_json, show_progress


def campaign(
    design: Path,
    out: Path,
    /,
    *,
    seed: int = 0,
    stage: bool = False,
    images: bool = False,
    youngs_modulus_mpa: float | None = None,
    shear_modulus_mpa: float | None = None,
    marker_noise_mm: float | None = None,
    readings: int = 5,
    exact: bool = False,
    friction: float = 0.0,
    friction_spread: float = 0.2,
    force: bool = False,
    as_json: Annotated[bool, Parameter(name="--json")] = False,
) -> None:
    """Simulate a measurement campaign of a print: tests, wrenches, markers and two calibrated cameras.

    The simulated print differs from the design by errors drawn from the design's tolerances. OUT/truth.json holds the
    true values; no command reads it. See docs/measurements.md.

    Args:
        design: the design file.
        out: output folder.
        seed: seed of all drawn values.
        stage: touches at positions known to 0.05 mm, without cameras.
        images: render photographs as well.
        youngs_modulus_mpa: Young's modulus of the true print [MPa]. Default: drawn around the design's.
        shear_modulus_mpa: shear modulus of the true print [MPa]. Default: drawn around the design's.
        marker_noise_mm: standard deviation of the markers on each axis [mm], from a reference other than cameras.
        readings: number of sensor readings per test.
        exact: the print and its mount are exactly as designed; only the readings are noisy.
        friction: median friction coefficient of the touching objects. The tangential force has any direction within
            the friction cone. 0 is without friction.
        friction_spread: standard deviation of the friction coefficient's logarithm from test to test.
        force: replace an existing simulated campaign.
        as_json: print one JSON document.
    """
    from probedesign import pipeline
    from probedesign.core.units import MM, MPA
    from probedesign.simulation.campaign_folder import make_campaign
    from probedesign.simulation.ground_truth import CampaignPlan

    def si(value: float | None, unit: float) -> float | None:
        return None if value is None else value * unit

    plan = CampaignPlan("stage" if stage else "cameras", seed, si(youngs_modulus_mpa, MPA), si(shear_modulus_mpa, MPA),
                si(marker_noise_mm, MM), readings, exact, images,
                friction, friction_spread)  # fmt: skip
    with show_progress() as on_progress:
        made = make_campaign(pipeline.load_probe(design).model, out, plan, force, on_progress)
    if as_json:
        print_json({"folder": made.folder, "files": made.files, "tests": made.tests})
    else:
        print(f"wrote {made.folder}: {plural(made.tests, 'test')}, {plural(len(made.files), 'file')}; "
              "true values in truth.json")  # fmt: skip
