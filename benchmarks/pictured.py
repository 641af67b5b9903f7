"""Campaigns with markers from two cameras: effect of their calibration, and errors of markers and dots.

The errors of a calibration are common to all markers of a campaign. The stated errors of dots are compared with the
actual ones in synthetic photographs.
"""

import math
import os
import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.error_statistics import CHI2_95
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
CLICK_PX, DOT_PX = 0.5, 0.2  #: Standard deviations of a clicked control point and of a dot, as in docs/stereo.md.
_EXACT = 1e-9  # [m]; the errors of the cameras are drawn in this module
STEREO = Kind("stereo", "two cameras, 20 control points clicked to 0.5 px, dots to 0.2 px",
              ((0.4, 0.2), (0.55, 0.1), (0.7, 0.06), (0.85, 0.04)),
              ("+x", "-x", "+y", "-y", "+x", "-x", "+y", "-y"), (), 4, _EXACT, _EXACT, 1.0 * MM)  # fmt: skip
#: Control points of the paper's box [m]. It has 20 points; their positions are assumed. Its x is the probe's z.
BOX = np.array([(x, y, z) for x in np.linspace(0, 0.2, 5) for y in (-0.06, 0.06) for z in (-0.06, 0.06)])
TRUE_CAMERAS = tuple(
    Camera.looking(name, (x, -0.55, 0.25), (0.1, 0.0, 0.0), 3000.0, (1920, 1080))
    for name, x in (("left", -0.15), ("right", 0.35))
)
R_BOX_WORLD = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])

PHOTO_SEED, PHOTO_TEST = 3, 2  #: Seed of the campaign and index of the test in the photographs.
STYLES = tuple(RenderStyle(blur_px=blur, noise=noise, seed=5) for blur, noise in ((0.8, 1.5), (0.8, 5.0), (1.4, 1.5)))


def report() -> None:
    """Print the tables."""
    rows = []
    with ProcessPoolExecutor(os.cpu_count()) as workers:
        for common in (True, False):
            found = np.array(list(workers.map(_campaign, [common] * DRAWS, range(DRAWS))))
            errors, stated = found[np.isfinite(found).all(axis=1)].T
            rows.append([
                "one calibration for all tests" if common else "independent errors of all places", str(len(errors)),
                f"{np.sqrt(np.mean(errors**2)):.3%}", f"{np.mean(errors):.3%}", f"{np.sqrt(np.mean(stated**2)):.3%}",
                f"{np.mean(np.abs(errors) <= 1.959964 * stated):.1%}",
            ])  # fmt: skip
    head = ["calibration", "identified", "RMS error of E", "mean error", "stated std", "in 95 %"]
    print_table(f"{DRAWS} campaigns each, {STEREO.words}; dimensions as designed", head, rows)
    _report_calibrations()
    _report_dots()


def _report_calibrations() -> None:
    """Print actual and stated marker errors by the method of calibration."""
    rows = []
    with ProcessPoolExecutor(os.cpu_count()) as workers:
        for kind in ("box", "files"):
            squared, stated, inside = np.array(list(workers.map(_calibrated, [kind] * DRAWS, range(DRAWS)))).T
            rows.append([kind, f"{1e3 * np.sqrt(np.mean(squared)):.3f} mm", f"{1e3 * np.sqrt(np.mean(stated)):.3f} mm",
                         f"{np.mean(inside):.1%}"])  # fmt: skip
    head = ["calibration", "RMS error of a marker", "stated RMS", "in the 95 % ellipsoid"]
    print_table(f"{DRAWS} campaigns of the large probe each, dots clicked to 0.7 px", head, rows)


def _calibrated(kind: CalibrationKind, seed: int) -> tuple[float, float, float]:
    """Return mean squared error of the markers of a simulated campaign, stated one [m²], and share in the ellipsoid."""
    model, plan = paper_models()["large"], CampaignPlan(seed=seed, calibration=kind)
    with tempfile.TemporaryDirectory() as folder:
        make_campaign(model, Path(folder) / "data", plan)
        campaign = read_campaign(Path(folder) / "data")
    truth = GroundTruth.draw(model, plan, np.random.default_rng(seed))
    rig, squared, stated, nees = StereoRig(truth), [], [], []
    for measured, test in zip(campaign.tests, truth.tests(), strict=True):
        assert measured.markers is not None
        error, cov = measured.markers.p_world - rig.markers(test), measured.markers.cov_world
        squared.append(np.sum(error**2, axis=1))
        stated.append(np.trace(cov, axis1=1, axis2=2))
        nees.append(np.einsum("ni,nij,nj->n", error, np.linalg.inv(cov), error))
    return (float(np.mean(squared)), float(np.mean(stated)), float(np.mean(np.concatenate(nees) < CHI2_95)))


def _report_dots() -> None:
    """Print actual and stated errors of the dots found in synthetic photographs."""
    rows = []
    for name, model in paper_models().items():
        for style in STYLES:
            error, std = _dots(model, style)
            rms, stated = np.sqrt(np.mean(error**2)), np.sqrt(np.mean(std**2))
            rows.append([name, f"{style.blur_px:g} px", f"{style.noise:g}", f"{len(std)}", f"{rms:.3f} px",
                         f"{stated:.3f} px", f"{stated / rms:.2f}"])  # fmt: skip
    head = ["probe", "blur", "noise", "dots", "RMS error per axis", "stated std", "stated / RMS error"]
    print_table("Dots in synthetic photographs, both cameras", head, rows)


def _dots(model: ProbeModel, style: RenderStyle) -> tuple[Array, Array]:
    """Return errors (n, 2) and stated standard deviations (n,) of the dots of a bent probe in two photographs [px]."""
    truth = GroundTruth.draw(model, CampaignPlan(seed=PHOTO_SEED), np.random.default_rng(PHOTO_SEED))
    rig, state = StereoRig(truth), truth.tests()[PHOTO_TEST]
    tube, dots = rig.tube(state), rig.dots(state)
    errors, stds = [], []
    with tempfile.TemporaryDirectory() as folder:
        for camera in rig.cameras:
            path = Path(folder) / f"{camera.name}.png"
            write_png(path, render(camera, tube, dots, SIZE_PX, style))
            found = find_markers(path, dots.s, camera.project(tube.p_world[:1])[0], True)
            errors.append(found.pixels - camera.project(tube.dot_positions(dots)))
            stds.append(found.std_px)
    return np.concatenate(errors), np.concatenate(stds)


def _campaign(common: bool, seed: int) -> tuple[float, float]:
    """Return the error of log E in one campaign and its stated standard deviation."""
    data, truth = draw(paper_models()["large"], STEREO, 3000 + seed)
    found = identify(pictured(data, 7000 + seed, common=common), ("E",))
    E = found.of("E")
    if found.result != "ok" or E is None or E.std is None:
        return math.nan, math.nan
    return math.log(1e6 * E.value / truth.rod.youngs_modulus), E.std / E.value


def pictured(data: IdentificationData, seed: int, *, common: bool = True) -> IdentificationData:
    """Return a campaign with markers and touched places measured by the cameras.

    Args:
        data: campaign with exact markers and touched places.
        seed: seed of clicks and dots.
        common: whether all tests have one calibration; otherwise the error of each marker is drawn independently from
            the stated covariance, as identification assumes.
    """
    rng = np.random.default_rng(seed)
    cameras = [calibrate(c.name, BOX, c.project(BOX) + CLICK_PX * rng.normal(size=(20, 2))) for c in TRUE_CAMERAS]
    return replace(data, tests=tuple(_measured(test, cameras, common, rng) for test in data.tests))


def _measured(test: MeasuredTest, cameras: list[Camera], common: bool, rng: np.random.Generator) -> MeasuredTest:
    points, cov = _triangulated(test.p_markers_world, cameras, common, rng)
    test = replace(test, p_markers_world=points, cov_markers=cov)
    if test.p_touch_world is None:
        return test
    touch, cov = _triangulated(test.p_touch_world[None], cameras, common, rng)
    return replace(test, p_touch_world=touch[0], std_touch=float(np.sqrt(np.trace(cov[0]) / 3)))


def _triangulated(p_world: Array, cameras: list[Camera], common: bool, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return points triangulated by the cameras and their stated covariances."""
    points = p_world @ R_BOX_WORLD.T
    pixels = np.array([c.project(points) + DOT_PX * rng.normal(size=(len(points), 2)) for c in TRUE_CAMERAS])
    found = triangulate(cameras, pixels, DOT_PX)
    cov = R_BOX_WORLD.T @ found.cov_world @ R_BOX_WORLD
    if common:
        return found.p_world @ R_BOX_WORLD, cov
    errors = np.einsum("nij,nj->ni", np.linalg.cholesky(cov), rng.normal(size=points.shape))
    return p_world + errors, cov
