"""A simulated run of two points of the card house, one of them touched twice, as files."""

from dataclasses import replace

import numpy as np
import pytest

from probedesign.frozen_probe import load_estimator, write_frozen
from probedesign.simulation import simulated_run
from probedesign.simulation.scenes import touch_targets
from probedesign.simulation.simulated_run import RunErrors, simulate_run, write_run
from tests.live.conftest import bundle as bundle  # the paper's large probe
from tests.live.conftest import estimator as estimator


@pytest.fixture(scope="session")
def probe(tmp_path_factory, estimator):
    """The large probe with E known to 1 %, as a frozen file."""
    path = tmp_path_factory.mktemp("explore") / "large.probe.json"
    rigid = replace(estimator.priors, object_compliance=0.0)  # as the simulated cards
    write_frozen(replace(estimator.model, stiffness_spread=0.01, tolerances=rigid), path)
    return path


@pytest.fixture(scope="session")
def house(probe, tmp_path_factory):
    """Return a simulated run and its folder: the third touch is of the first point, from another depth.

    A quarter of the samples of a Net F/T box take a quarter of the time.
    """
    model, rng = load_estimator(probe).model, np.random.default_rng(7)
    one, two = touch_targets()[9], touch_targets()[6]
    simulated = simulate_run(
        model, (one, two, replace(one, fraction=0.93, repeated=True)), rng, RunErrors(friction=0.0)
    )
    folder = tmp_path_factory.mktemp("house")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(simulated_run, "SAMPLE_RATE", 875.0)
        write_run(simulated, model, folder, rng)
    return simulated, folder
