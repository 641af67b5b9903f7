"""Campaigns seen through cameras that were calibrated once: what their calibration errs by is common to all markers.

And photographs: do the dots' stated errors come true?"""

import math
import os
import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.stats import chi2

from benchmarks.laboratory import Kind, draw
from benchmarks.timing import print_table
from benchmarks.touches import paper_models
from probedesign.campaigns import read_campaign
from probedesign.core.frames import Array
from probedesign.core.units import MM
from probedesign.estimation.model import ProbeModel
from probedesign.identification.identify import IdentificationData, identify
from probedesign.identification.residuals import MeasuredTest
from probedesign.simulation.campaign_folder import make_campaign
from probedesign.simulation.ground_truth import CalibrationKind, CampaignPlan, GroundTruth
from probedesign.simulation.stereo_rig import SIZE_PX, RenderStyle, StereoRig, render
from probedesign.vision.calibrate import calibrate
from probedesign.vision.camera import Camera
from probedesign.vision.markers import find_markers, write_png
from probedesign.vision.triangulate import triangulate

DRAWS = 40
CLICK_PX, DOT_PX = 0.5, 0.2
"""Standard deviation of a clicked control point and of a dot, as docs/stereo.md has them."""
_EXACT = 1e-9  # m: what the cameras then see is drawn here
STEREO = Kind("stereo", "two cameras, 20 control points clicked to 0.5 px, dots to 0.2 px",
              ((0.4, 0.2), (0.55, 0.1), (0.7, 0.06), (0.85, 0.04)),
              ("+x", "-x", "+y", "-y", "+x", "-x", "+y", "-y"), 4, _EXACT, _EXACT, 1.0 * MM)  # fmt: skip
BOX = np.array([(x, y, z) for x in np.linspace(0, 0.2, 5) for y in (-0.06, 0.06) for z in (-0.06, 0.06)])
"""The paper's box has 20 points; their places are assumed [m]. Its x is the probe's z."""
TRUE = tuple(
    Camera.looking(name, (x, -0.55, 0.25), (0.1, 0.0, 0.0), 3000.0, (1920, 1080))
    for name, x in (("left", -0.15), ("right", 0.35))
)
TURN = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # from the world to the box

BENT, STATE = 3, 2
"""Which campaign, and which of its tests, the photographs are of."""
LOOKS = tuple(
    RenderStyle(blur_px=blur, noise=noise, seed=5) for blur, noise in ((0.8, 1.5), (0.8, 5.0), (1.4, 1.5))
)


def report() -> None:
    """Print the table."""
    rows = []
    with ProcessPoolExecutor(os.cpu_count()) as workers:
        for common in (True, False):
            found = np.array(list(workers.map(_campaign, [common] * DRAWS, range(DRAWS))))
            off, stated = found[np.isfinite(found).all(axis=1)].T
            rows.append([
                "one calibration for all tests" if common else "each place's error its own", str(len(off)),
                f"{np.sqrt(np.mean(off**2)):.3%}", f"{np.mean(off):.3%}", f"{np.sqrt(np.mean(stated**2)):.3%}",
                f"{np.mean(np.abs(off) <= 1.959964 * stated):.1%}",
            ])  # fmt: skip
    head = ["calibration", "identified", "E off, RMS", "mean", "stated", "within stated 95 %"]
    print_table(f"{DRAWS} campaigns each, {STEREO.words}; dimensions as designed", head, rows)
    _report_calibrations()
    _report_dots()


def _report_calibrations() -> None:
    """Print how far markers are from the true ones by each way of calibrating, and how far they say."""
    rows = []
    with ProcessPoolExecutor(os.cpu_count()) as workers:
        for kind in ("box", "board", "files"):
            off, own, inside = np.array(list(workers.map(_calibrated, [kind] * DRAWS, range(DRAWS)))).T
            rows.append([kind, f"{1e3 * np.sqrt(np.mean(off)):.3f} mm", f"{1e3 * np.sqrt(np.mean(own)):.3f} mm",
                         f"{np.mean(inside):.1%}"])  # fmt: skip
    head = ["calibration", "marker off, RMS distance", "stated", "inside stated 95 % ellipsoid"]
    print_table(f"{DRAWS} campaigns of the large probe each, dots clicked to 0.7 px", head, rows)


def _calibrated(kind: CalibrationKind, seed: int) -> tuple[float, float, float]:
    """Of the markers of one simulated campaign: mean squared distance, stated one [m²], fraction in the ellipsoid."""
    model, plan = paper_models()["large"], CampaignPlan(seed=seed, calibration=kind)
    with tempfile.TemporaryDirectory() as folder:
        make_campaign(model, Path(folder) / "data", plan)
        campaign = read_campaign(Path(folder) / "data")
    world = GroundTruth.draw(model, plan, np.random.default_rng(seed))
    rig, off, own, square = StereoRig(world), [], [], []
    for measured, test in zip(campaign.tests, world.tests(), strict=True):
        assert measured.markers is not None
        error, cov = measured.markers.p_world - rig.markers(test), measured.markers.cov_world
        off.append(np.sum(error**2, axis=1))
        own.append(np.trace(cov, axis1=1, axis2=2))
        square.append(np.einsum("ni,nij,nj->n", error, np.linalg.inv(cov), error))
    return (
        float(np.mean(off)),
        float(np.mean(own)),
        float(np.mean(np.concatenate(square) < chi2.isf(0.05, 3))),
    )


def _report_dots() -> None:
    """Print how far found dots are from the painted ones, and how far they say."""
    rows = []
    for name, model in paper_models().items():
        for look in LOOKS:
            error, std = _dots(model, look)
            off, stated = np.sqrt(np.mean(error**2)), np.sqrt(np.mean(std**2))
            rows.append([name, f"{look.blur_px:g} px", f"{look.noise:g}", f"{len(std)}", f"{off:.3f} px",
                         f"{stated:.3f} px", f"{stated / off:.2f}"])  # fmt: skip
    head = ["probe", "blur", "noise", "dots", "off, RMS an axis", "stated", "stated over true"]
    print_table("Dots in synthetic photographs, both cameras", head, rows)


def _dots(model: ProbeModel, look: RenderStyle) -> tuple[Array, Array]:
    """Of the dots of one bent probe in two photographs: errors (n, 2) and what is stated (n,) [px]."""
    world = GroundTruth.draw(model, CampaignPlan(seed=BENT), np.random.default_rng(BENT))
    sight, state = StereoRig(world), world.tests()[STATE]
    tube, dots = sight.tube(state), sight.dots(state)
    errors, stds = [], []
    with tempfile.TemporaryDirectory() as folder:
        for camera in sight.cameras:
            path = Path(folder) / f"{camera.name}.png"
            write_png(path, render(camera, tube, dots, SIZE_PX, look))
            found = find_markers(path, dots.s, camera.project(tube.p_world[:1])[0], True)
            errors.append(found.pixels - camera.project(tube.dot_positions(dots)))
            stds.append(found.std_px)
    return np.concatenate(errors), np.concatenate(stds)


def _campaign(common: bool, seed: int) -> tuple[float, float]:
    """Of one campaign: log error of E and its stated deviation."""
    data, truth = draw(paper_models()["large"], STEREO, 3000 + seed)
    found = identify(pictured(data, 7000 + seed, common=common), ("E",))
    E = found.of("E")
    if found.result != "ok" or E is None or E.std is None:
        return math.nan, math.nan
    return math.log(1e6 * E.value / truth.rod.youngs_modulus), E.std / E.value


def pictured(data: IdentificationData, seed: int, *, common: bool = True) -> IdentificationData:
    """A campaign of exact places as cameras have it.

    Args:
        data: its markers and touched places without errors.
        seed: of clicks and dots.
        common: whether one calibration holds for all tests; else each marker's error is drawn on its own from the
            covariance that is stated, which is what identification assumes.
    """
    rng = np.random.default_rng(seed)
    cameras = [calibrate(c.name, BOX, c.project(BOX) + CLICK_PX * rng.normal(size=(20, 2))) for c in TRUE]
    return replace(data, tests=tuple(_seen(trial, cameras, common, rng) for trial in data.tests))


def _seen(trial: MeasuredTest, cameras: list[Camera], common: bool, rng: np.random.Generator) -> MeasuredTest:
    points, cov = _placed(trial.p_markers_world, cameras, common, rng)
    trial = replace(trial, p_markers_world=points, cov_markers=cov)
    if trial.p_touch_world is None:
        return trial
    touch, cov = _placed(trial.p_touch_world[None], cameras, common, rng)
    return replace(trial, p_touch_world=touch[0], std_touch=float(np.sqrt(np.trace(cov[0]) / 3)))


def _placed(
    p_world: Array, cameras: list[Camera], common: bool, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Places as the cameras have them, and their stated covariances."""
    points = p_world @ TURN.T
    pixels = np.array([c.project(points) + DOT_PX * rng.normal(size=(len(points), 2)) for c in TRUE])
    found = triangulate(cameras, pixels, DOT_PX)
    cov = TURN.T @ found.cov_world @ TURN
    if common:
        return found.p_world @ TURN, cov
    errors = np.einsum("nij,nj->ni", np.linalg.cholesky(cov), rng.normal(size=points.shape))
    return p_world + errors, cov
