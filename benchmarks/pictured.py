"""Stated and actual errors of markers by the calibration of two cameras, and of dots in synthetic photographs."""

import os
import tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np

from benchmarks.error_statistics import CHI2_95
from benchmarks.timing import print_table
from benchmarks.touches import paper_models
from probedesign.campaigns import read_campaign
from probedesign.core.frames import Array
from probedesign.estimation.model import ProbeModel
from probedesign.simulation.campaign_folder import make_campaign
from probedesign.simulation.ground_truth import CampaignPlan, GroundTruth
from probedesign.simulation.stereo_rig import SIZE_PX, StereoRig
from probedesign.vision.markers import find_markers, write_png
from tests.vision.rendering import RenderStyle, dots_of, render, tube_of
from tests.vision.scene import calibrate_by_files

DRAWS = 40
PHOTO_SEED, PHOTO_TEST = 3, 2  #: Seed of the campaign and index of the test in the photographs.
STYLES = tuple(RenderStyle(blur_px=blur, noise=noise, seed=5) for blur, noise in ((0.8, 1.5), (0.8, 5.0), (1.4, 1.5)))


def report() -> None:
    """Print the tables."""
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


def _calibrated(kind: str, seed: int) -> tuple[float, float, float]:
    """Return mean squared error of the markers of a simulated campaign, stated one [m²], and share in the ellipsoid."""
    model, plan = paper_models()["large"], CampaignPlan(seed=seed)
    truth = GroundTruth.draw(model, plan, np.random.default_rng(seed))
    rig, squared, stated, nees = StereoRig(truth), [], [], []
    with tempfile.TemporaryDirectory() as folder:
        made = make_campaign(model, Path(folder) / "data", plan).folder
        if kind == "files":
            calibrate_by_files(made, rig, seed)
        campaign = read_campaign(made)
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
    tube, dots = tube_of(rig, state), dots_of(rig, state)
    errors, stds = [], []
    with tempfile.TemporaryDirectory() as folder:
        for camera in rig.cameras:
            path = Path(folder) / f"{camera.name}.png"
            write_png(path, render(camera, tube, dots, SIZE_PX, style))
            found = find_markers(path, dots.s, camera.project(tube.p_world[:1])[0], True)
            errors.append(found.pixels - camera.project(tube.dot_positions(dots)))
            stds.append(found.std_px)
    return np.concatenate(errors), np.concatenate(stds)
