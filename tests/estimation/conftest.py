"""The paper's three probes, built once, and readings of their touches."""

from pathlib import Path

import numpy as np
import pytest

from probedesign.design import load_design
from probedesign.estimation.estimator import Estimator
from probedesign.probe import build_probe
from tests.estimation.true_touches import EXACT, settle, sources_of

DESIGNS = Path(__file__).parents[2] / "designs"


@pytest.fixture(scope="session")
def probes():
    """The probes by name."""
    return {name: build_probe(load_design(DESIGNS / f"{name}.toml")) for name in ("large", "medium", "small")}


@pytest.fixture(scope="session")
def large(probes):
    """The large probe."""
    return probes["large"]


@pytest.fixture(scope="session")
def exact(large):
    """An estimator of the large probe with sensor noise as its only error source."""
    return Estimator(large.model, EXACT)


@pytest.fixture(scope="session")
def gravity():
    """The paper's horizontal mount [m/s²]."""
    return np.array([9.81, 0.0, 0.0])


@pytest.fixture(scope="session")
def exact_sources(large, gravity):
    """`ErrorSources` of the large probe with all tolerances zero."""
    return sources_of(large.model, gravity)


@pytest.fixture(scope="session")
def touched(exact_sources):
    """Base wrench of the large probe touched with a normal force [N] and friction ratios."""

    def touched(s, normal, phi=-np.pi / 2, around=0.0, along=0.0):
        touch = settle(exact_sources, np.array([s, phi, normal, around, along]))
        assert touch is not None
        return touch.wrench

    return touched
