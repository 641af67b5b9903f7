"""The paper's large probe, frozen, as every live test meets it."""

from pathlib import Path

import pytest

from probedesign.design import load_design
from probedesign.estimation.estimator import Estimator
from probedesign.frozen_probe import load_estimator, write_frozen
from probedesign.probe import build_probe

LARGE = Path(__file__).parents[2] / "designs" / "large.toml"


@pytest.fixture(scope="session")
def bundle(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("bundle") / "large.probe.json"
    write_frozen(build_probe(load_design(LARGE)).model, path)
    return path


@pytest.fixture(scope="session")
def estimator(bundle) -> Estimator:
    return load_estimator(bundle)


@pytest.fixture(scope="session")
def model(estimator):
    return estimator.model
