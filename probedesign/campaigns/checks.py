"""Whether what was measured can be of this probe: a column in a wrong unit is off by a thousand."""

import numpy as np

from probedesign.campaigns.campaign import Campaign
from probedesign.campaigns.manifest import FILE as MANIFEST
from probedesign.campaigns.means import TINY, gravity_base, on_probe, refuse, sensor_wrench
from probedesign.campaigns.tables import FILE as TESTS
from probedesign.campaigns.wrenches_table import FILE as WRENCHES
from probedesign.errors import InputError
from probedesign.estimation.model import ProbeModel
from probedesign.frames import Array
from probedesign.units import GRAM, MM, N_MM

DEVIATIONS = 5.0
"""Room for errors of the reference and noise of the sensor, in standard deviations."""
STRETCH = 0.10
"""So much longer than drawn a bent probe may be along its surface (assumed, as for markers)."""
FAR = 100.0
"""A factor that no error of measurement makes, and a wrong unit exceeds tenfold (assumed)."""
HANGS = 5.0
"""So many times more or less than designed no print hangs: published moduli of one resin differ by two (assumed)."""
LEVER = 3.0
"""So many lengths of the probe from its base no contact force acts, even if part of it is lifted by another
(assumed)."""
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
        refuse(
            campaign,
            TESTS,
            name,
            f"s_contact_mm = {s[name] / MM:.4g} is the largest, {on_probe(model)}; {METRES}",
        )


def _check_sag(campaign: Campaign, model: ProbeModel) -> None:
    """None is longer than the probe, of the wrong sign, or many times more or less than the probe as designed hangs."""
    for test in campaign.tests:
        told, room = test.tip_sag, DEVIATIONS * test.std_sag
        if np.isnan(told):
            continue
        says = f"tip_sag_mm = {told / MM:.4g}"
        if abs(told) > model.rod.length * (1.0 + STRETCH) + room:
            refuse(campaign, TESTS, test.name, f"{says}, {on_probe(model)}; a wrong unit?")
        if told < -room:
            refuse(
                campaign,
                TESTS,
                test.name,
                f"{says}: a tip hangs below its unbent place, which counts positive",
            )
        designed = _sag_of(gravity_base(campaign, test), model) if test.free else 0.0
        if not designed / HANGS - room < told < designed * HANGS + room and designed > room:
            says = f"{says}, of a probe that as designed hangs {designed / MM:.3g} mm"
            refuse(campaign, TESTS, test.name, f"{says}; centimetres, or another pose of the base?")


def _sag_of(gravity: Array, model: ProbeModel) -> float:
    """How far the free tip hangs below its unbent place [m]; 0 where the design does not stand."""
    free = model.rod.solve(gravity)
    if not free.ok or not gravity.any():
        return 0.0
    off = free.p_at(model.rod.length) - np.array([0.0, 0.0, model.rod.length])
    return float(off @ gravity / np.linalg.norm(gravity))


def _check_contacts(campaign: Campaign, model: ProbeModel) -> None:
    """Of the touched points none is beyond the probe, and not all are at its base."""
    away: dict[str, float] = {}
    for test in campaign.tests:
        if test.p_contact_world is None:
            continue
        away[test.name] = float(np.linalg.norm(test.p_contact_world - test.T_world_base[:3, 3]))
        room = STRETCH * model.rod.length + float(model.rod.radius.max())
        if away[test.name] > model.rod.length + room + DEVIATIONS * (test.std_contact + campaign.std_base):
            says = f"contact is {away[test.name] / MM:.4g} mm from the base, {on_probe(model)}"
            refuse(campaign, TESTS, test.name, f"{says}; a wrong unit, or another pose of the base?")
    if away and max(away.values()) < model.rod.length / FAR:
        name = max(away, key=lambda test: away[test])
        says = f"contact is {away[name] / MM:.4g} mm from the base, the farthest, {on_probe(model)}"
        refuse(campaign, TESTS, name, f"{says}; {METRES}")


def _check_markers(campaign: Campaign, model: ProbeModel) -> None:
    """Not all at the base; that none is beyond the probe was seen when they were read."""
    seen = [(test, test.markers) for test in campaign.tests if test.markers is not None]
    away = [float(np.linalg.norm(m.p_world - t.T_world_base[:3, 3], axis=1).max()) for t, m in seen]
    if seen and max(away) < model.rod.length / FAR:
        test, markers = seen[int(np.argmax(away))]
        says = f"a marker is {max(away) / MM:.4g} mm from the base, the farthest, {on_probe(model)}"
        refuse(campaign, markers.file, test.name, f"{says}; {METRES}")


def _check_known_forces(campaign: Campaign, model: ProbeModel) -> None:
    """None is beyond the sensor."""
    for test in campaign.tests:
        known = 0.0 if test.force_world is None else float(np.linalg.norm(test.force_world))
        if known > model.wrench_range[:3].max():
            says = f"known force of {known:.4g} N is more than the sensor reads"
            refuse(campaign, TESTS, test.name, f"{says}; millinewtons in a column of newtons?")


def _check_range(campaign: Campaign, model: ProbeModel) -> None:
    """Where most loaded tests are beyond the sensor, no touch was too strong: the unit is another."""
    read = [test for test in campaign.tests if len(test.wrenches)]
    loaded = [test for test in read if not test.free] or read
    over = {test.name: np.abs(sensor_wrench(campaign, test, model)) / model.wrench_range for test in loaded}
    beyond = [name for name, share in over.items() if share.max() > 1.0]
    if 2 * len(beyond) > len(loaded):
        name = max(beyond, key=lambda test: float(over[test].max()))
        axis = int(np.argmax(over[name]))
        value, unit = over[name][axis] * model.wrench_range[axis], "N" if axis < 3 else "N·m"
        says = f"|{'FM'[axis // 3]}{'xyz'[axis % 3]}| = {value:.4g} {unit}, beyond the sensor"
        many = f"{len(beyond)} of {len(loaded)} tests are"
        refuse(
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
        refuse(
            campaign,
            WRENCHES,
            name,
            f"{says}, {on_probe(model)}; are forces and moments in the units of their columns?",
        )
