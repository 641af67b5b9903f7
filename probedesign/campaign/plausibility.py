"""Whether what was measured can be of this probe: a column in a wrong unit is off by a thousand."""

from typing import NoReturn

import numpy as np

from probedesign.campaign.campaign import Campaign, Test
from probedesign.campaign.manifest import FILE as MANIFEST
from probedesign.campaign.tests_table import FILE as TESTS
from probedesign.campaign.wrenches_table import FILE as WRENCHES
from probedesign.errors import InputError
from probedesign.estimator.model import ProbeModel
from probedesign.frames import Array, inverse
from probedesign.units import GRAM, MM, N_MM

DEVIATIONS = 5.0
"""Room for errors of the reference and noise of the sensor, in standard deviations."""
STRETCH = 0.10
"""So much longer than drawn a bent probe may be along its surface (assumed, as for markers)."""
FAR = 100.0
"""A factor that no error of measurement makes, and a wrong unit exceeds tenfold (assumed)."""
LEVER = 3.0
"""So many lengths of the probe from its base no contact force acts, even if part of it is lifted by another
(assumed)."""
TINY = 1e-12
"""Nothing that a sensor tells from zero [N]."""
METRES = "metres in a column of millimetres?"


def check_plausible(campaign: Campaign, model: ProbeModel) -> None:
    """Refuse what cannot have been measured of a probe of that length on its sensor.

    Single readings beyond the sensor pass: the estimate of their test says `out_of_range`.

    Args:
        campaign: the data.
        model: of the probe.

    Raises:
        InputError: places, a sag, forces or moments cannot be; one line that names file, test, value and remedy.
    """
    _check_mass(campaign, model)
    _check_arclengths(campaign, model)
    _check_sag(campaign, model)
    _check_contacts(campaign, model)
    _check_markers(campaign, model)
    _check_known_forces(campaign, model)
    _check_range(campaign, model)
    _check_lever(campaign, model)


def _check_mass(campaign: Campaign, model: ProbeModel) -> None:
    """A weighing far off what the flexible part weighs as designed; a whole print weighs a few times as much."""
    if campaign.weighing is None:
        return
    mass = campaign.weighing.mass
    if not model.mass / FAR < mass < model.mass * FAR:
        raise InputError(
            f"{campaign.folder}/{MANIFEST}: weighing: mass_g = {mass / GRAM:.4g}, of a probe whose flexible part "
            f"weighs {model.mass / GRAM:.4g} g as designed; grams?"
        )


def _check_arclengths(campaign: Campaign, model: ProbeModel) -> None:
    s = {test.name: test.s_contact for test in campaign.tests if not np.isnan(test.s_contact)}
    if s and max(s.values()) < model.rod.length / FAR:
        name = max(s, key=lambda test: s[test])
        _fail(
            campaign, TESTS, name, f"s_contact_mm = {s[name] / MM:.4g} is the largest, {_on(model)}; {METRES}"
        )


def _check_sag(campaign: Campaign, model: ProbeModel) -> None:
    for test in campaign.tests:
        if abs(test.tip_sag) > model.rod.length * (1.0 + STRETCH) + DEVIATIONS * test.std_sag:
            says = f"tip_sag_mm = {test.tip_sag / MM:.4g}, {_on(model)}; a wrong unit?"
            _fail(campaign, TESTS, test.name, says)


def _check_contacts(campaign: Campaign, model: ProbeModel) -> None:
    """Of the touched points none is beyond the probe, and not all are at its base."""
    away: dict[str, float] = {}
    for test in campaign.tests:
        if test.p_contact_world is None:
            continue
        away[test.name] = float(np.linalg.norm(test.p_contact_world - test.T_world_base[:3, 3]))
        room = STRETCH * model.rod.length + float(model.rod.radius.max())
        if away[test.name] > model.rod.length + room + DEVIATIONS * (test.std_contact + campaign.std_base):
            says = f"contact is {away[test.name] / MM:.4g} mm from the base, {_on(model)}"
            _fail(campaign, TESTS, test.name, f"{says}; a wrong unit, or another pose of the base?")
    if away and max(away.values()) < model.rod.length / FAR:
        name = max(away, key=lambda test: away[test])
        says = f"contact is {away[name] / MM:.4g} mm from the base, the farthest, {_on(model)}"
        _fail(campaign, TESTS, name, f"{says}; {METRES}")


def _check_markers(campaign: Campaign, model: ProbeModel) -> None:
    """Not all at the base; that none is beyond the probe was seen when they were read."""
    seen = [(test, test.markers) for test in campaign.tests if test.markers is not None]
    away = [float(np.linalg.norm(m.p_world - t.T_world_base[:3, 3], axis=1).max()) for t, m in seen]
    if seen and max(away) < model.rod.length / FAR:
        test, markers = seen[int(np.argmax(away))]
        says = f"a marker is {max(away) / MM:.4g} mm from the base, the farthest, {_on(model)}"
        _fail(campaign, markers.file, test.name, f"{says}; {METRES}")


def _check_known_forces(campaign: Campaign, model: ProbeModel) -> None:
    """None is beyond the sensor, and not all are far more than was read."""
    ratios: dict[str, float] = {}
    for test in campaign.tests:
        if test.force_world is None or test.free:
            continue
        known = float(np.linalg.norm(test.force_world))
        if known > model.wrench_range[:3].max():
            says = f"known force of {known:.4g} N is more than the sensor reads"
            _fail(campaign, TESTS, test.name, f"{says}; millinewtons in a column of newtons?")
        if len(test.wrenches):
            read = _base(campaign, test, model)[:3] - model.mass * _gravity(campaign, test)
            ratios[test.name] = known / max(float(np.linalg.norm(read)), TINY)
    if ratios and min(ratios.values()) > FAR:
        name = min(ratios, key=lambda test: ratios[test])
        says = f"known force is {ratios[name]:.4g} times what the sensor read"
        _fail(campaign, TESTS, name, f"{says}; millinewtons in a column of newtons?")


def _check_range(campaign: Campaign, model: ProbeModel) -> None:
    """Where most loaded tests are beyond the sensor, no touch was too strong: the unit is another."""
    read = [test for test in campaign.tests if len(test.wrenches)]
    loaded = [test for test in read if not test.free] or read
    over = {test.name: np.abs(_sensor(campaign, test, model)) / model.wrench_range for test in loaded}
    beyond = [name for name, share in over.items() if share.max() > 1.0]
    if 2 * len(beyond) > len(loaded):
        name = max(beyond, key=lambda test: float(over[test].max()))
        axis = int(np.argmax(over[name]))
        value, unit = over[name][axis] * model.wrench_range[axis], "N" if axis < 3 else "N·m"
        says = f"|{'FM'[axis // 3]}{'xyz'[axis % 3]}| = {value:.4g} {unit}, beyond the sensor"
        many = f"{len(beyond)} of {len(loaded)} tests are"
        _fail(
            campaign,
            WRENCHES,
            name,
            f"{says}, and {many}; {'mN' if axis < 3 else 'N·mm'} in a column of {unit}?",
        )


def _check_lever(campaign: Campaign, model: ProbeModel) -> None:
    """Moments of most tests that no force on this probe makes. In one test weight and touch may cancel out."""
    read = [test for test in campaign.tests if len(test.wrenches)]
    noise = (
        DEVIATIONS * float(np.sqrt(3.0 * model.averaging_samples)) * model.noise.moment
    )  # drift is as large
    over = []
    for test in read:
        wrench = test.wrenches.mean(axis=0)
        arm = 0.0 if test.frame == "base" else float(np.linalg.norm(model.T_sensor_base[:3, 3]))
        force, moment = float(np.linalg.norm(wrench[:3])), float(np.linalg.norm(wrench[3:]))
        if moment > LEVER * (model.rod.length + arm) * force + noise:
            over.append((test.name, force, moment))
    if 2 * len(over) > len(read):
        name, force, moment = over[0]
        lever = moment / max(force, TINY)
        says = f"{force:.4g} N with {moment / N_MM:.4g} N·mm act {lever / MM:.4g} mm away"
        _fail(
            campaign,
            WRENCHES,
            name,
            f"{says}, {_on(model)}; are forces and moments in the units of their columns?",
        )


def _base(campaign: Campaign, test: Test, model: ProbeModel) -> Array:
    """Mean of a test's readings, of the flexible part about its base (6,)."""
    mean = np.asarray(test.wrenches.mean(axis=0))
    return mean if test.frame == "base" else model.to_base(mean, _gravity(campaign, test))


def _sensor(campaign: Campaign, test: Test, model: ProbeModel) -> Array:
    """The same as the sensor reads it (6,)."""
    mean = np.asarray(test.wrenches.mean(axis=0))
    return mean if test.frame == "sensor" else model.to_sensor(mean, _gravity(campaign, test))


def _gravity(campaign: Campaign, test: Test) -> Array:
    return np.asarray(inverse(test.T_world_base)[:3, :3] @ campaign.gravity_world)


def _on(model: ProbeModel) -> str:
    return f"{model.name} is {model.rod.length / MM:g} mm long"


def _fail(campaign: Campaign, file: str, test: str, says: str) -> NoReturn:
    raise InputError(f"{campaign.folder / file}: test {test}: {says}")
