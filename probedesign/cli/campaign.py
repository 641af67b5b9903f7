"""`probedesign campaign`: a synthetic campaign, as example, tutorial and test."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from probedesign.cli.console import counted, print_json, telling


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
    """Make up what a laboratory would measure of a design's print: tests, wrenches, markers, a box with two cameras.

    The print differs from the design as its tolerances have it. What was true stands in OUT/truth.json, which no
    command reads. See docs/measurements.md.

    Args:
        design: the design file.
        out: folder to write.
        seed: of all that is drawn.
        stage: touches at places known to 0.05 mm, and no cameras.
        images: photographs too.
        youngs_modulus_mpa: of the true print [MPa]; by default drawn about the design's.
        shear_modulus_mpa: likewise.
        marker_noise_mm: markers from another reference than cameras, with this standard deviation on each axis.
        readings: of the sensor in each test.
        exact: the print is as designed and stands where it is said to; only readings are noisy.
        friction: median friction coefficient of what touches; the tangential force has any direction inside the
            cone. 0 is without friction.
        friction_spread: standard deviation of its logarithm from test to test.
        force: replace a synthetic campaign that stands there.
        as_json: print one JSON document.
    """
    from probedesign import pipeline
    from probedesign.simulation.ground_truth import CampaignPlan
    from probedesign.units import MM, MPA

    def si(value: float | None, unit: float) -> float | None:
        return None if value is None else value * unit

    plan = CampaignPlan("stage" if stage else "cameras", seed, si(youngs_modulus_mpa, MPA), si(shear_modulus_mpa, MPA),
                si(marker_noise_mm, MM), readings, exact, images,
                friction, friction_spread)  # fmt: skip
    with telling() as tell:
        made = pipeline.campaign(design, out, plan, force, tell)
    if as_json:
        print_json({"folder": made.folder, "files": made.files, "tests": made.tests})
    else:
        print(f"wrote {made.folder}: {counted(made.tests, 'test')}, {counted(len(made.files), 'file')}; "
              "what was true stands in truth.json")  # fmt: skip
