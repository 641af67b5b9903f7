"""What the sensor read in one test, on the average, in the frame that is asked for."""

from typing import NoReturn

import numpy as np

from probedesign.campaigns.campaign import Campaign, Test
from probedesign.errors import InputError
from probedesign.estimation.model import ProbeModel
from probedesign.frames import Array, inverse
from probedesign.units import MM

TINY = 1e-12
"""Nothing that a sensor tells from zero [N]."""


def base_wrench(campaign: Campaign, test: Test, model: ProbeModel) -> Array:
    """Mean of a test's readings, of the flexible part about its base [N, N·m], (6,)."""
    mean = np.asarray(test.wrenches.mean(axis=0))
    return mean if test.frame == "base" else model.to_base(mean, gravity_base(campaign, test))


def sensor_wrench(campaign: Campaign, test: Test, model: ProbeModel) -> Array:
    """The same as the sensor reads it [N, N·m], (6,)."""
    mean = np.asarray(test.wrenches.mean(axis=0))
    return mean if test.frame == "sensor" else model.to_sensor(mean, gravity_base(campaign, test))


def gravity_base(campaign: Campaign, test: Test) -> Array:
    """Gravity in base axes as the test's pose has it [m/s²], (3,)."""
    return np.asarray(inverse(test.T_world_base)[:3, :3] @ campaign.gravity_world)


def on_probe(model: ProbeModel) -> str:
    """How long the probe is, for messages."""
    return f"{model.name} is {model.rod.length / MM:g} mm long"


def refuse(campaign: Campaign, file: str, test: str, says: str) -> NoReturn:
    """End with one line that names file and test.

    Raises:
        InputError: always.
    """
    raise InputError(f"{campaign.folder / file}: test {test}: {says}")
