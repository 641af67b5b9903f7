"""From the end of a search to numbers with their intervals, and what they do not count."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import norm, t

from probedesign.frames import Array
from probedesign.identification.held import DIAMETERS, cov_held, held_of
from probedesign.identification.observability import Untold
from probedesign.identification.parameters import ASKABLE, PARTS, PRINT, ROOT, Shared, parts_of
from probedesign.identification.residuals import Group
from probedesign.identification.result import CONFIDENCE, Identified, Outlier, Residual, Shift
from probedesign.identification.robust import ROBUST, distance
from probedesign.identification.solver import Fit, solve_at, units_of
from probedesign.identification.trial import Trial
from probedesign.units import MM, MPA

ROOT_LEFT = 0.05
"""What the ways to hold a flange leave open of root_rigid_radii. Source: docs/decisions/0006."""
GAIN_LEFT = 0.01
"""Of a sensor's gain. Assumed: certificates of the Nano17 state 1 to 1.75 % of full scale."""
REFERENCE_LEFT = 0.005
"""Of the size of a reference's millimetre. Assumed: 0.5 mm on a box of 100 mm."""


def found_of(fit: Fit, asked: Sequence[str], given_up: Sequence[Untold], names: Sequence[str],
             quantile: float) -> tuple[tuple[Identified, ...], Array, tuple[str, ...]]:  # fmt: skip
    """Every number asked for, the correlation of those told, and their names.

    Args:
        fit: the search's end.
        asked: what was fitted.
        given_up: what was not told.
        names: all that the user asked for.
        quantile: of the intervals.
    """
    shared, places = fit.point.problem.shared, parts_of(asked)
    found = {PARTS[place]: _identified(fit, place, quantile) for place in places}
    why = {one.name: one.words for one in given_up}
    for name in names:
        if name in why:
            found |= {part: _untold(shared, PARTS.index(part), why[name]) for part in ASKABLE[name].parts}
    order = [PARTS[place] for place in parts_of(names)]
    cov = cov_held(fit, places)
    std = np.sqrt(np.diag(cov))
    return tuple(found[part] for part in order), cov / np.outer(std, std), tuple(PARTS[p] for p in places)


def _scale_of(shared: Shared, place: int) -> tuple[str, str, float, float, bool]:
    """Words, unit, the design's value in it, the unit of the vector in it, and whether that is a logarithm."""
    rod, part = shared.model.rod, PARTS[place]
    if part == "E":
        return "Young's modulus", "MPa", rod.youngs_modulus / MPA, 1.0, True
    if part == "G":
        return "shear modulus", "MPa", rod.shear_modulus / MPA, 1.0, True
    if part == "density":
        return "density", "kg/m³", rod.density, 1.0, True
    if part == "diameters":
        return "all diameters over the design's", "", 1.0, 1.0, True
    if part == ROOT:
        return (
            "compliance that the base lacks, in base radii",
            "",
            rod.rigid_length / rod.radius[0],
            1.0,
            False,
        )
    if part.startswith("offset"):
        return f"place of the base along its {part[-1]} axis", "mm", 0.0, 1.0 / MM, False
    words = "turn about z" if part == "clocking" else f"turn about {part[-1]}"
    if part.startswith("gravity"):
        words = f"turn of gravity about the {('first', 'second')[part.endswith('2')]} axis across it"
    return words, "deg", 0.0, 180.0 / np.pi, False


def _identified(fit: Fit, place: int, quantile: float) -> Identified:
    """One number with the design's dimensions, and with dimensions that are not known."""
    words, unit, design, scale, logarithm = _scale_of(fit.point.problem.shared, place)

    def told(value: float, std: float) -> tuple[float, float, float, float]:
        ends = [value, value - quantile * std, value + quantile * std]
        v, low, high = (design * float(np.exp(e)) if logarithm else design + scale * float(e) for e in ends)
        return v, float(v * std if logarithm else scale * std), low, high

    held = held_of(fit, place)
    value, std, low, high = told(held.value, held.std)
    i = int(fit.point.problem.active[:place].sum())
    of_print = told(float(fit.point.guess.x[place]), float(np.sqrt(fit.cov[i, i])))
    return Identified(PARTS[place], words, unit, "identified", value, design, std, low, high, *of_print,
                      by_diameter=held.by_diameter if logarithm else None)  # fmt: skip


def _untold(shared: Shared, place: int, why: str) -> Identified:
    words, unit, design, _, _ = _scale_of(shared, place)
    return Identified(PARTS[place], words, unit, "not_told", design, design, why=why)


def quantile_of(fit: Fit) -> float:
    """Of a 95 % interval: Student's with the least freedom that a measured scatter was told by, else normal."""
    freedom = [one.freedom for one in fit.noise if one.measured]
    share = 0.5 * (1.0 + CONFIDENCE)
    return float(t.ppf(share, min(freedom)) if freedom else norm.ppf(share))


def outliers_of(off: Sequence[tuple[Group, float]]) -> tuple[Outlier, ...]:
    """Readings that noise does not explain, from `robust.outliers`."""
    return tuple(Outlier(group.test, group.kind, group.item, far) for group, far in off)


def residuals_of(fit: Fit) -> tuple[Residual, ...]:
    """Every reading against the fit."""
    bents = {bent.trial.name: bent for bent in fit.point.bents}
    found = []
    for group, weight in zip(fit.point.groups, fit.weight, strict=True):
        scale = fit.scales.get(group.kind, 1.0) if group.kind in ROBUST else 1.0
        s = None
        if group.kind == "markers":
            trial = bents[group.test].trial
            s = float(trial.marker_s[trial.marker_numbers.index(group.item)]) / MM
        elif group.kind in ("touches", "wrenches") and not bents[group.test].trial.free:
            s = bents[group.test].eq.s_contact / MM
        unit = {"wrenches": 1.0, "friction": 1.0, "scales": 1e3}.get(group.kind, 1.0 / MM)
        off = tuple(float(v) * unit for v in group.off)
        far = float(np.sqrt(distance(group) / len(group.r))) / scale
        found.append(Residual(group.test, group.kind, group.item, s, off, far, float(weight) * scale**2))
    return tuple(found)


def shifts_of(fit: Fit, asked: Sequence[str]) -> tuple[Shift, ...]:
    """What root, gain and millimetre would do to moduli, density and diameters, to first order, were they a little
    other."""
    moved = [name for name in asked if ASKABLE[name].logarithm]
    if not moved:
        return ()
    columns = _misreadings(fit, ROOT in asked)
    return tuple(
        Shift(cause, name, 100.0 * float(np.expm1(_change(fit, name, column))))
        for cause, column in columns.items()
        for name in moved
    )


def _misreadings(fit: Fit, rooted: bool) -> dict[str, Array]:
    """What each cause does to the misfits, if anything; `rooted`: the root was asked for, so it is no cause."""
    point = fit.point
    columns = {
        f"a sensor that reads {GAIN_LEFT:.0%} too much": GAIN_LEFT * _by_gain(fit),
        f"a reference whose millimetre is {REFERENCE_LEFT:.1%} too short": REFERENCE_LEFT * _by_size(fit),
    }
    if not rooted:
        other = solve_at(point.problem, point.guess, [bent.own for bent in point.bents], point, root=True)
        if other.ok:
            root = ROOT_LEFT * other.columns_of([PARTS.index(ROOT)], fit.weight)[:, 0]
            columns = {f"root_rigid_radii {ROOT_LEFT:g} more": root, **columns}
    return {cause: column for cause, column in columns.items() if column.any()}


def _change(fit: Fit, name: str, column: Array) -> float:
    """Of one number's logarithm to first order, where misfits change so and the design's dimensions stay."""
    active, place = np.flatnonzero(fit.point.problem.active), PARTS.index(name)
    held = (active >= PRINT) | ((active == DIAMETERS) & (place != DIAMETERS))
    keep = np.concatenate([~held, np.ones(fit.point.problem.size - len(active), dtype=bool)])
    rows = fit.point.system(fit.weight)[0][:, keep]
    units = units_of(rows)
    i = int(np.count_nonzero(~held & (active < place)))
    return float(-(np.linalg.lstsq(rows * units, column)[0] * units)[i])


def counted_in_all(
    numbers: Sequence[Identified], shifts: Sequence[Shift], quantile: float
) -> tuple[Identified, ...]:
    """The numbers with their standard deviations and intervals in all: the fit's and each shift of theirs, as if
    independent.

    Args:
        numbers: as the fit tells them.
        shifts: what it does not count.
        quantile: of the intervals.
    """
    return tuple(_in_all(one, shifts, quantile) if one.identified else one for one in numbers)


def _in_all(one: Identified, shifts: Sequence[Shift], quantile: float) -> Identified:
    assert one.std is not None
    std = math.hypot(one.std, *(one.value * 1e-2 * shift.percent for shift in shifts if shift.of == one.name))
    low, high = one.value - quantile * std, one.value + quantile * std
    if one.name in ASKABLE and ASKABLE[one.name].logarithm:
        low, high = (one.value * math.exp(sign * quantile * std / one.value) for sign in (-1.0, 1.0))
    return replace(one, std_in_all=std, low_in_all=low, high_in_all=high)


def _by_gain(fit: Fit) -> Array:
    """Misfits by the logarithm of the sensor's gain: all that it reads is too much."""

    def read(group: Group, trial: Trial) -> tuple[Array, Array] | None:
        told, cov = trial.wrench_base, trial.cov_wrench
        return (told, cov) if group.kind == "wrenches" and told is not None and cov is not None else None

    return _by_reading(fit, read)


def _by_size(fit: Fit) -> Array:
    """Misfits by the logarithm of the reference's size: places are too far from the base."""

    def read(group: Group, trial: Trial) -> tuple[Array, Array] | None:
        base = trial.T_world_base[:3, 3]
        if group.kind == "markers":
            i = trial.marker_numbers.index(group.item)
            return trial.p_markers_world[i] - base, trial.cov_markers[i]
        if group.kind == "touches" and trial.p_touch_world is not None:
            return trial.p_touch_world - base, trial.std_touch**2 * np.eye(3)
        if group.kind == "sags":
            return np.array([trial.sag]), np.array([[trial.std_sag**2]])
        return None

    return _by_reading(fit, read)


def _by_reading(fit: Fit, read: Callable[[Group, Trial], tuple[Array, Array] | None]) -> Array:
    """Rows of a change of readings, whitened as the misfits are; `read` tells a group's change and covariance."""
    rows = [np.zeros(int(fit.point.problem.active.sum()))]
    trials = {bent.trial.name: bent.trial for bent in fit.point.bents}
    for group, w in zip(fit.point.groups, fit.weight, strict=True):
        change = read(group, trials[group.test]) if group.test in trials else None
        if change is None:
            rows.append(np.zeros(len(group.r)))
        else:
            rows.append(np.sqrt(w) * np.linalg.solve(np.linalg.cholesky(change[1]), change[0]))
    return np.concatenate(rows)
