"""The paper's three probes, built once."""

from pathlib import Path

import numpy as np
import pytest

from probedesign.design import load_design
from probedesign.probe import build_probe
from probedesign.rod.contact import solve_frictionless

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


@pytest.fixture(scope="session")
def touched(large, gravity):
    """Base wrench of the large probe touched without friction."""

    def touched(s, force, angle=np.pi / 2):
        touch = solve_frictionless(large.rod, gravity, s, angle, force, "reference")
        assert touch.result == "ok"
        return touch.equilibrium.wrench_base.copy()

    return touched
