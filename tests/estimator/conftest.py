"""The paper's three probes, built once."""

from pathlib import Path

import numpy as np
import pytest

from probedesign.design import load_design
from probedesign.probe import build_probe

DESIGNS = Path(__file__).parents[2] / "designs"


@pytest.fixture(scope="session")
def probes():
    """The probes by name."""
    return {name: build_probe(load_design(DESIGNS / f"{name}.toml")) for name in ("large", "medium", "small")}


@pytest.fixture(scope="session")
def large(probes):
    """The large one."""
    return probes["large"]


@pytest.fixture(scope="session")
def gravity():
    """The paper's horizontal mount [m/s²]."""
    return np.array([9.81, 0.0, 0.0])
