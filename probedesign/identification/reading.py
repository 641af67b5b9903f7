"""From a campaign's tables to what the fit sees, and which tests it can use."""

from dataclasses import replace

import numpy as np

from probedesign.campaign import Campaign, Test
from probedesign.frames import Array
from probedesign.identification.parameters import Shared
from probedesign.identification.trial import Trial
from probedesign.identification.weighed import Weighed

FEWEST_ROWS = 8
"""Readings of one test from which on their own scatter is taken where it is more than the sensor's noise."""


def trials_of(campaign: Campaign, shared: Shared) -> tuple[list[Trial], list[str]]:
    """Tests that can be used, and a line for each that cannot."""
    trials, unused = [], []
    for test in campaign.tests:
        trial = _trial(test, campaign, shared)
        why = _useless(trial)
        if why:
            unused.append(f"{test.name}: not used: {why}")
        else:
            trials.append(trial)
    return trials, unused


def weighed_of(campaign: Campaign, flange_volume: float) -> Weighed | None:
    """The weighing, if there was one; `flange_volume` [m³] as printed with the flexible part."""
    weighing = campaign.weighing
    if weighing is None:
        return None
    return Weighed(weighing.mass, weighing.std, flange_volume if weighing.of == "probe" else 0.0)


def _useless(trial: Trial) -> str:
    """Why a test tells nothing; empty if it does."""
    placed = np.isfinite(trial.s_contact) or trial.p_touch_world is not None
    if trial.touched and trial.wrench_base is None:
        return "neither force nor wrench is told"
    if not trial.free and not placed and not len(trial.marker_s):
        return "neither the place of the load nor markers are told"
    if not trial.touched and not placed and not trial.free and trial.wrench_base is None:
        return "where the known force acts is not told"
    if (
        trial.wrench_base is None
        and not len(trial.marker_s)
        and not np.isfinite(trial.sag)
        and (trial.free or trial.p_touch_world is None)
    ):
        return "nothing was measured"
    return ""


def _trial(test: Test, campaign: Campaign, shared: Shared) -> Trial:
    trial = Trial(
        test.name, test.T_world_base, campaign.gravity_world, test.force_world, test.s_contact,
        0.0 if np.isnan(test.std_s) else test.std_s, test.p_contact_world, test.std_contact,
        sag=test.tip_sag, std_sag=test.std_sag,
    )  # fmt: skip
    if len(test.wrenches):
        wrench, cov = _reading(test, trial.gravity_base, shared)
        trial = replace(trial, wrench_base=wrench, cov_wrench=cov)
    if test.markers is None or not len(test.markers):
        return trial
    markers = test.markers
    return replace(
        trial, marker_s=campaign.marker_s[markers.numbers], p_markers_world=markers.p_world,
        cov_markers=markers.cov_world, marker_numbers=tuple(int(i) + 1 for i in markers.numbers),
        marker_side=campaign.marker_side,
    )  # fmt: skip


def _reading(test: Test, gravity_base: Array, shared: Shared) -> tuple[Array, Array]:
    """Mean of a test's readings at the base, and its covariance with what the bias wanders."""
    model, n = shared.model, len(test.wrenches)
    wrenches = model.to_base(test.wrenches, gravity_base) if test.frame == "sensor" else test.wrenches
    noise = model.noise_base()
    if n >= FEWEST_ROWS:
        scatter = np.var(wrenches, axis=0, ddof=1)
        more = np.sqrt(np.maximum(scatter / np.diag(noise), 1.0))
        noise = noise * np.outer(more, more)
    return np.asarray(wrenches.mean(axis=0)), noise / n + shared.drift
