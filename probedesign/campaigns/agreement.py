"""Whether readings, known loads and markers can be of the same tests: a sign, a factor or a count that is wrong
throughout is seen before anything is fitted to it."""

import math
from dataclasses import dataclass

import numpy as np

from probedesign.campaigns.campaign import Campaign, Test
from probedesign.campaigns.means import TINY, base_wrench, gravity_base, refuse
from probedesign.campaigns.tables import FILE as TESTS
from probedesign.campaigns.tables import WAYS
from probedesign.campaigns.wrenches_table import FILE as WRENCHES
from probedesign.estimation.model import ProbeModel
from probedesign.estimation.tolerances import Tolerances
from probedesign.frames import Array
from probedesign.units import MM

DEVIATIONS = 5.0
"""Room for errors of the reference, noise and drift of the sensor, in standard deviations."""
HALF = 0.5
"""Share of a load, or of the way from marker to marker, by which a reading may differ: gains, slopes and markers set
by hand stay far below, wrong units and counts do not (assumed)."""
FAR = 100.0
"""A factor that no wrong weight makes, from which a wrong unit is named (assumed)."""
NEAR_BASE = 0.3
"""Of the length: so far a probe is thick, and hardly bent. The first two markers count anyhow: bent by a right angle
up to the second, the way to it is shorter by a fifth of one from marker to marker."""


@dataclass(frozen=True)
class Push:
    """What a test's readings say of its load.

    Attributes:
        test: which.
        read: force on the probe by the sensor, less its weight and what it reads where nothing touches, base axes [N].
        room: that it may differ by noise and drift [N].
    """

    test: Test
    read: Array
    room: float

    def differs(self, force: Array) -> bool:
        """Whether it cannot be that force [N], (3,)."""
        return bool(np.linalg.norm(self.read - force) > HALF * np.linalg.norm(force) + self.room)


def check_agreement(campaign: Campaign, model: ProbeModel) -> None:
    """Refuse a campaign most of whose tests contradict themselves.

    Args:
        campaign: the data.
        model: of the probe.

    Raises:
        InputError: known loads are not what was read, pushes were read the other way round, or markers are numbered
            too high; one line that names file, test, value and remedy.
    """
    pushes = _pushes(campaign, model)
    _check_loads(campaign, pushes)
    _check_directions(campaign, pushes)
    _check_numbering(campaign, model)


def _pushes(campaign: Campaign, model: ProbeModel) -> list[Push]:
    """Of every loaded test with readings."""
    off = {test.name: base_wrench(campaign, test, model)[:3] - model.mass * gravity_base(campaign, test)
           for test in campaign.tests if len(test.wrenches)}  # fmt: skip
    free = [off[test.name] for test in campaign.tests if test.free and test.name in off]
    still = np.mean(free, axis=0) if free else np.zeros(3)
    # Where no test hangs free, a tare may have taken the whole weight away.
    unsure = 0.0 if free else model.mass * float(np.linalg.norm(campaign.gravity_world))
    drift = Tolerances.of(model).drift_steps ** 2 * model.averaging_samples
    found = []
    for test in campaign.tests:
        if test.name in off and not test.free:
            std = model.noise.force * math.sqrt(2.0 * (1.0 / len(test.wrenches) + drift))
            found.append(Push(test, off[test.name] - still, DEVIATIONS * std + unsure))
    return found


def _check_loads(campaign: Campaign, pushes: list[Push]) -> None:
    """Whether known loads are what was read."""
    loads = [
        (push, force)
        for push in pushes
        if (force := _known(push.test)) is not None
        and max(np.linalg.norm(force), np.linalg.norm(push.read)) > 2.0 * push.room
    ]
    wrong = [(push, force) for push, force in loads if push.differs(force)]
    if 2 * len(wrong) > len(loads):
        push, force = max(wrong, key=lambda pair: float(pair[1] @ pair[1]))
        says = f"known force of {float(np.linalg.norm(force)):.4g} N is {_compared(push.read, force)}"
        refuse(campaign, TESTS, push.test.name, f"{says} ({len(wrong)} of {len(loads)} tests are so)")


def _compared(read: Array, force: Array) -> str:
    """Known against read, and what may be wrong."""
    size, known = float(np.linalg.norm(read)), float(np.linalg.norm(force))
    along = float(read @ force) / max(size * known, TINY)
    if size < HALF * known:
        unit = (
            "millinewtons in a column of newtons?"
            if FAR * size < known
            else "is it the right weight, and are both in newtons?"
        )
        return f"{known / max(size, TINY):.4g} times what the sensor read; {unit}"
    if along < -HALF:
        return (
            "the opposite of what the sensor read; known forces act on the probe, and readings are what it does to "
            "its mount: turn the sign of one"
        )
    if along < HALF:
        return "in another direction than was read; look at the base's rotation in campaign.toml, and at the columns"
    return f"{known / size:.4g} times what the sensor read; are both in newtons?"


def _check_directions(campaign: Campaign, pushes: list[Push]) -> None:
    """Whether touches were read the way that they pushed."""
    told = [
        (push, float(push.read @ np.array(WAYS[push.test.direction])))
        for push in pushes
        if push.test.direction in WAYS and np.linalg.norm(push.read) > 2.0 * push.room
    ]
    turned = [(push, along) for push, along in told if along < -HALF * np.linalg.norm(push.read)]
    if 2 * len(turned) > len(told):
        push, along = min(turned, key=lambda pair: pair[1])
        way = push.test.direction
        says = f"pushed towards {way}, the sensor read {along:.4g} N along {way}"
        says += f", and the opposite in {len(turned)} of {len(told)} tests"
        refuse(campaign, WRENCHES, push.test.name, f"{says}; turn the sign of the columns, or of direction")


def _check_numbering(campaign: Campaign, model: ProbeModel) -> None:
    """Whether markers near the base lie as far from it as their numbers say."""
    short, variance, first = [], [], None
    for test in campaign.tests:
        if test.markers is None:
            continue
        s = campaign.marker_s[test.markers.numbers]
        near = (s < NEAR_BASE * model.rod.length) | (test.markers.numbers < 2)
        start = test.T_world_base @ np.append(_start(campaign, model), 1.0)
        short += list(s[near] - np.linalg.norm(test.markers.p_world[near] - start[:3], axis=1))
        variance += list(np.linalg.eigvalsh(test.markers.cov_world[near])[:, -1])
        first = test if first is None and near.any() else first
    if first is None or first.markers is None or len(campaign.marker_s) < 2:
        return
    step, gap = float(np.median(np.diff(campaign.marker_s))), float(np.mean(short))
    std = math.sqrt(float(np.mean(variance)) / len(short) + campaign.std_base**2)
    if gap > HALF * step + DEVIATIONS * std:
        says = f"markers lie {gap / MM:.3g} mm nearer to the base than their numbers say, here and on the average"
        remedy = f"are they numbered {max(round(gap / step), 1)} too high, or s_mm told from elsewhere?"
        refuse(campaign, first.markers.file, first.name, f"{says}; {remedy}")


def _start(campaign: Campaign, model: ProbeModel) -> Array:
    """Where the line of markers starts, in base axes [m], (3,)."""
    if campaign.marker_side is None:
        return np.zeros(3)
    side = campaign.marker_side
    radius = float(model.rod.radius[0]) * model.cross_section.reach(side)
    return np.array([radius * math.cos(side), radius * math.sin(side), 0.0])


def _known(test: Test) -> Array | None:
    """Force on the probe that is known, in base axes [N], (3,)."""
    return None if test.force_world is None else np.asarray(test.T_world_base[:3, :3].T @ test.force_world)
