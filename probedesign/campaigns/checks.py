"""Checks of a campaign before anything is fitted to it: its probe, the order of its markers, and plausible values.

A column in a wrong unit is off by a thousand. Known forces that are wrong throughout would be outliers of a fit, which
accepts as many; they are compared with the readings. Each refusal is one line that names file, test, value and remedy.
Other values that contradict each other are found by `identify`.
"""

import math
from typing import NoReturn

import numpy as np

from probedesign.campaigns.campaign import TESTS, WRENCHES, Campaign, Markers, Test
from probedesign.campaigns.manifest import FILE as MANIFEST
from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.core.units import GRAM, MM, N_MM
from probedesign.estimation.model import ProbeModel, Tolerances

#: Margin for errors of the reference, noise and drift of the sensor, in standard deviations: exceeded by one valid pair
#: in 3 million.
DEVIATIONS = 5.0
#: Relative elongation of a probe: it stretches by a percent or two under its own weight, and markers are set by hand
#: (assumed).
STRETCH = 0.05
#: On the surface a bent probe is longer than on its axis, and the base's centre is a radius away [m]: those of the
#: paper's large probe.
SURFACE_STRETCH, SURFACE_OFFSET = 0.10, 6.0 * MM
SETTING_ERROR = 1.0 * MM  #: Of a marker on the probe [m]: assumed.
UNIT_FACTOR = 100.0  #: Factor that no error of measurement makes, and a wrong unit exceeds tenfold (assumed).
#: Factor between a print's sag and the design's: published moduli of one resin differ by two (assumed).
SAG_FACTOR = 5.0
#: Distance from the base, in lengths of the probe, at which a contact force may seem to act, even if part of it is
#: lifted by another (assumed).
MAX_LEVER = 3.0
#: Fraction of a load by which a reading may differ: gains and slopes stay far below, wrong units and weights do not
#: (assumed).
HALF = 0.5
TINY = 1e-12  #: A force that no sensor distinguishes from zero [N].


def check_probe(campaign: Campaign, model: ProbeModel) -> None:
    """Refuse a campaign of another probe, or with values that this probe cannot produce.

    Raises:
        InputError: the fingerprints or the names differ; a place is beyond the tip; or values are not plausible.
    """
    _check_identity(campaign, model)
    longest = model.rod.length * (1.0 + 1e-9)
    for number, s in enumerate(campaign.marker_s, 1):
        if s > longest:
            raise InputError(f"{campaign.folder / MANIFEST}: marker {number} at s = {s / MM:g} mm {_beyond(model)}; "
                             "correct markers.s_mm in campaign.toml")  # fmt: skip
    mass = model.mass if campaign.weighing is None else campaign.weighing.mass
    if not model.mass / UNIT_FACTOR < mass < model.mass * UNIT_FACTOR:  # a whole print weighs a few times as much
        raise InputError(
            f"{campaign.folder}/{MANIFEST}: weighing: mass_g = {mass / GRAM:.4g}, of a probe whose flexible part "
            f"weighs {model.mass / GRAM:.4g} g as designed; grams?"
        )
    for test in campaign.tests:
        if problem := _implausible(test, campaign, model):
            _refuse(campaign, TESTS, test, problem)
    _check_metres(campaign, model)
    _check_range(campaign, model)
    _check_lever(campaign, model)
    _check_loads(campaign, model)


def _check_identity(campaign: Campaign, model: ProbeModel) -> None:
    where = f"{campaign.folder}: these data are of another probe"
    fingerprint, name = campaign.fingerprint, model.name
    if fingerprint is not None and fingerprint != model.fingerprint:
        raise InputError(f"{where}: fingerprint {fingerprint}, not {model.fingerprint} of {name}")
    if campaign.name != name and fingerprint is None:
        raise InputError(f"{where}: {campaign.name!r}, not {name!r}; if it is the same, correct probe in campaign.toml")
    if campaign.name != name:
        both = f"probe = {campaign.name!r}, and fingerprint {fingerprint} is that of {name!r}"
        raise InputError(f"{campaign.folder / MANIFEST}: {both}; correct the one that is wrong")


def _refuse(campaign: Campaign, file: str, test: Test, problem: str) -> NoReturn:
    raise InputError(f"{campaign.folder / file}: test {test.name}: {problem}")


def _length(model: ProbeModel) -> str:
    return f"{model.name} is {model.rod.length / MM:g} mm long"


def _beyond(model: ProbeModel) -> str:
    return f"is beyond the tip of {model.name} at {model.rod.length / MM:g} mm"


# order of the markers


def check_marker_order(
    where: str, markers: Markers, marker_s: Array, marker_side: float | None, p_base: Array, std_base: float
) -> None:
    """Refuse markers that cannot be on one probe with this base: no two are farther apart than the probe between them.

    Args:
        where: names the test in errors.
        markers: of the test.
        marker_s: arclength of each of the campaign's markers [m].
        marker_side: as the campaign has it; on the surface a pair may be farther apart than along the axis.
        p_base: stated position of the base [m], (3,).
        std_base: standard deviation of p_base on each axis [m].

    Raises:
        InputError: two markers are too far apart; their numbers are in another order, or their unit is another.
    """
    s = np.concatenate([[0.0], marker_s[markers.numbers]])
    p = np.vstack([p_base, markers.p_world])
    variance = np.concatenate([[std_base**2], np.linalg.eigvalsh(markers.cov_world)[:, -1]])
    distance = np.linalg.norm(p[:, None] - p[None], axis=2)
    arc = np.abs(s[:, None] - s[None])
    stretch = STRETCH if marker_side is None else SURFACE_STRETCH
    margin = DEVIATIONS * np.sqrt(variance[:, None] + variance[None]) + stretch * arc + SETTING_ERROR
    margin[0] += 0.0 if marker_side is None else SURFACE_OFFSET
    excess = np.where(np.triu(np.ones_like(arc), 1) > 0, distance - arc - margin, -np.inf)
    if len(s) >= 3:
        spacing = float(np.median(np.linalg.norm(np.diff(p[1:], axis=0), axis=1)))
        on_probe = float(np.median(np.diff(s[1:])))
        if not 0.05 < spacing / on_probe < 20.0:
            raise InputError(f"{where}: markers lie {spacing / MM:.4g} mm apart, on the probe {on_probe / MM:.4g}; "
                             "metres in a column of millimetres, or the other way round?")  # fmt: skip
    if excess.max() <= 0.0:
        return
    reverse = np.concatenate([[0], np.arange(len(s) - 1, 0, -1)])
    if len(s) > 2 and (distance[np.ix_(reverse, reverse)] <= arc + margin).all():
        raise InputError(f"{where}: markers out of order: they count from the tip; marker 1 is nearest to the base")
    i, j = np.unravel_index(int(np.argmax(excess)), excess.shape)
    first = "the base" if i == 0 else f"marker {markers.numbers[i - 1] + 1}"
    lie = f"{distance[i, j] / MM:.4g} mm apart, on the probe {arc[i, j] / MM:.4g}"
    base_wrong = bool(i == 0 and (excess > 0)[0, 1:].all())
    why = "is the pose of the base right?" if base_wrong else "markers out of order, or one of them wrong"
    raise InputError(f"{where}: {first} and marker {markers.numbers[j - 1] + 1} lie {lie}; {why}")


# plausible values


def _implausible(test: Test, campaign: Campaign, model: ProbeModel) -> str:
    """Return which value of a row of `tests.csv` this probe cannot have, and what may be wrong; empty if none."""
    length, from_base = model.rod.length, 0.0
    if test.p_contact_world is not None:
        from_base = float(np.linalg.norm(test.p_contact_world - test.T_world_base[:3, 3]))
    farthest = (1.0 + SURFACE_STRETCH) * length + float(model.rod.radius.max())
    known = 0.0 if test.force_world is None else float(np.linalg.norm(test.force_world))
    if test.s_contact > length * (1.0 + 1e-9):
        return f"s_contact_mm = {test.s_contact / MM:g} {_beyond(model)}; a wrong unit, or another probe?"
    if from_base > farthest + DEVIATIONS * (test.std_contact + campaign.std_base):
        return (f"contact is {from_base / MM:.4g} mm from the base, {_length(model)}; a wrong unit, or another pose of "
                "the base?")  # fmt: skip
    if known > model.wrench_range[:3].max():
        return f"known force of {known:.4g} N exceeds the sensor's range; millinewtons in a column of newtons?"
    if np.isnan(test.tip_sag):
        return ""
    sag, margin, designed = test.tip_sag, DEVIATIONS * test.std_sag, 0.0
    value, gravity = f"tip_sag_mm = {sag / MM:.4g}", test.gravity_base
    if test.free and gravity.any() and (free := model.rod.solve(gravity)).ok:
        displacement = free.p_at(length) - model.rod.sag_origin
        designed = float(displacement @ gravity / np.linalg.norm(gravity))
    if abs(sag) > length * (1.0 + SURFACE_STRETCH) + margin:
        return f"{value}, {_length(model)}; a wrong unit?"
    if sag < -margin:
        return f"{value}: a tip hangs below its undeformed place, which is positive"
    if not designed / SAG_FACTOR - margin < sag < designed * SAG_FACTOR + margin and designed > margin:
        return (f"{value}, of a probe with a sag of {designed / MM:.3g} mm as designed; centimetres, or another pose "
                "of the base?")  # fmt: skip
    return ""


def _check_metres(campaign: Campaign, model: ProbeModel) -> None:
    """Refuse places of one kind that are all within a hundredth of the probe from its base; `check_marker_order`
    refuses markers that are too far."""

    def farthest_from_base(test: Test, p_world: Array) -> float:
        return float(np.linalg.norm(p_world - test.T_world_base[:3, 3], axis=-1).max())

    kinds: list[tuple[str, list[tuple[Test, str, float]]]] = [
        ("s_contact_mm = {} is the largest",
         [(test, TESTS, test.s_contact) for test in campaign.tests if not np.isnan(test.s_contact)]),
        ("contact is {} mm from the base, the farthest",
         [(test, TESTS, farthest_from_base(test, test.p_contact_world)) for test in campaign.tests
          if test.p_contact_world is not None]),
        ("a marker is {} mm from the base, the farthest",
         [(test, test.markers.file, farthest_from_base(test, test.markers.p_world)) for test in campaign.tests
          if test.markers is not None]),
    ]  # fmt: skip
    for words, distances in kinds:
        test, file, farthest = max(distances, key=lambda place: place[2], default=(None, "", math.inf))
        if test is not None and farthest < model.rod.length / UNIT_FACTOR:
            problem = words.format(f"{farthest / MM:.4g}")
            _refuse(campaign, file, test, f"{problem}, {_length(model)}; metres in a column of millimetres?")


def _check_range(campaign: Campaign, model: ProbeModel) -> None:
    """Refuse readings of which most loaded tests exceed the sensor's range: then the unit is another.

    Single readings beyond the range pass: the estimate of their test has the result `out_of_range`.
    """
    read = [test for test in campaign.tests if len(test.wrenches)]
    loaded = [test for test in read if not test.free] or read
    ratios = [(test, np.abs(test.mean_wrench_sensor(model)) / model.wrench_range) for test in loaded]
    beyond = [(test, ratio) for test, ratio in ratios if ratio.max() > 1.0]
    if 2 * len(beyond) > len(loaded):
        test, ratio = max(beyond, key=lambda pair: float(pair[1].max()))
        axis = int(np.argmax(ratio))
        value, unit, wrong = (ratio[axis] * model.wrench_range[axis], *(("N", "mN") if axis < 3 else ("N·m", "N·mm")))
        _refuse(campaign, WRENCHES, test,
                f"|{'FM'[axis // 3]}{'xyz'[axis % 3]}| = {value:.4g} {unit} exceeds the sensor's range, as in "
                f"{len(beyond)} of {len(loaded)} tests; {wrong} in a column of {unit}?")  # fmt: skip


def _check_lever(campaign: Campaign, model: ProbeModel) -> None:
    """Refuse moments of most tests that no force on this probe makes. In one test weight and touch may cancel out."""
    read = [test for test in campaign.tests if len(test.wrenches)]
    # the drift is as large as the noise of a reading
    noise = DEVIATIONS * float(np.sqrt(3.0 * model.averaging_samples)) * model.noise.moment
    over = []
    for test in read:
        arm = 0.0 if test.frame == "base" else float(np.linalg.norm(model.T_sensor_base[:3, 3]))
        force, moment = (float(np.linalg.norm(part)) for part in (test.mean_wrench[:3], test.mean_wrench[3:]))
        if moment > MAX_LEVER * (model.rod.length + arm) * force + noise:
            over.append((test, force, moment))
    if 2 * len(over) > len(read):
        test, force, moment = over[0]
        lever = moment / max(force, TINY)
        _refuse(campaign, WRENCHES, test,
                f"{force:.4g} N with {moment / N_MM:.4g} N·mm act {lever / MM:.4g} mm away, {_length(model)}; are "
                "forces and moments in the units of their columns?")  # fmt: skip


def _check_loads(campaign: Campaign, model: ProbeModel) -> None:
    """Refuse known forces most of which differ from what the sensor read, less the weight or the free probe."""
    read = {test.name: test.mean_wrench_base(model)[:3] - model.mass * test.gravity_base
            for test in campaign.tests if len(test.wrenches)}  # fmt: skip
    free = [read[test.name] for test in campaign.tests if test.free and test.name in read]
    zero = np.mean(free, axis=0) if free else np.zeros(3)
    # Without a free test, a tare may have removed the whole weight.
    weight = 0.0 if free else model.mass * float(np.linalg.norm(campaign.gravity_world))
    drift = Tolerances.of(model).drift_steps ** 2 * model.averaging_samples
    wrong, loads = list[tuple[float, Test, str]](), 0
    for test in campaign.tests:
        if test.name not in read or test.free or (known := test.force_base) is None:
            continue
        margin = weight + DEVIATIONS * model.noise.force * math.sqrt(2.0 * (1.0 / len(test.wrenches) + drift))
        measured = read[test.name] - zero
        size, known_size = float(np.linalg.norm(measured)), float(np.linalg.norm(known))
        if max(size, known_size) <= 2.0 * margin:
            continue
        loads += 1
        if np.linalg.norm(measured - known) > HALF * known_size + margin:
            wrong.append((known_size, test, _comparison(measured, known)))
    if 2 * len(wrong) > loads:
        size, test, comparison = max(wrong, key=lambda load: load[0])
        _refuse(campaign, TESTS, test,
                f"known force of {size:.4g} N is {comparison} (in {len(wrong)} of {loads} tests)")  # fmt: skip


def _comparison(measured: Array, known: Array) -> str:
    """Return the relation of a known force to the measured one, and what may be wrong."""
    size, known_size = float(np.linalg.norm(measured)), float(np.linalg.norm(known))
    cosine = float(measured @ known) / max(size * known_size, TINY)
    times = f"{known_size / max(size, TINY):.4g} times what the sensor read"
    if UNIT_FACTOR * size < known_size:
        return f"{times}; millinewtons in a column of newtons?"
    if size >= HALF * known_size and cosine < -HALF:
        return ("the opposite of what the sensor read; known forces act on the probe, and readings are what it does to "
                "its mount: change the sign of one")  # fmt: skip
    if size >= HALF * known_size and cosine < HALF:
        return "in another direction than was read; check the base's rotation in campaign.toml, and the columns"
    return f"{times}; is it the right weight, and are both in newtons?"
