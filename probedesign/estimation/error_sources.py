"""What may differ between a probe, its mount and its sensor and their model: one set of priors for every estimate.

A source moves the reading h of a touch and the touched point while the touch itself stays: the same arclength (of the
length, where that differs), angle and force in the section's axes. To first order it does not matter what of the touch
is fixed.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from probedesign.core.errors import InputError
from probedesign.core.frames import Array, inverse, wrench_map
from probedesign.core.units import MM
from probedesign.estimation import uncertainty_kernel
from probedesign.estimation.model import ProbeModel, Tolerances
from probedesign.rod.equilibrium import Equilibrium
from probedesign.rod.kernels import surface_contact
from probedesign.rod.rod import Rod, bow_curvature

#: Of an error, in the order of the tables.
CAUSES = ("noise", "drift", "E", "G", "density", "diameter", "diameter scatter", "bore", "length", "bow", "root",
          "base place", "base tilt", "clocking", "pose", "gravity", "gain", "creep", "stiffness scatter")  # fmt: skip

#: Changes of a rod before those of its knots' log diameters: of log E, log G, log density and log length, and the
#: curvature at rest about x and y [1/m].
BEFORE_KNOTS = surface_contact.OWN - 3


_STRAIGHT = 1e-9  #: Change of slope below which a knot is no corner of the flank, as those of a curved axis.


def parameters_of(rod: Rod, tolerances: Tolerances, hung: bool = False) -> dict[str, Array]:
    """Return one standard deviation of each source of the rod itself: log E and what follows it, a row each.

    Where E was identified with the design's diameters, it goes with all of them together.

    Args:
        rod: of the model.
        tolerances: how well it is known.
        hung: whether only what a touch adds creeps: a rod that is lighter by as much as it is softer hangs the same.

    Raises:
        InputError: the bow is not smaller than the length.
    """
    K, diameters = len(rod.s), 2.0 * rod.radius / MM
    unit = np.eye(BEFORE_KNOTS + K)
    t = tolerances
    if not t.bow_mm * MM < rod.length:
        raise InputError(f"bow_mm = {t.bow_mm:g} must be smaller than the length of the probe, {rod.length / MM:g} mm")
    common = np.maximum(t.diameter_mm, t.diameter_share * diameters) / diameters
    length = max(t.length_mm, t.length_share * rod.length / MM) * MM / rod.length
    softer = unit[0:1] + unit[1:2] + hung * unit[2:3]
    return {
        "E": t.youngs_modulus * unit[0:1],
        "G": t.shear_modulus * unit[1:2],
        "density": t.density * unit[2:3],
        "diameter": (common @ unit[BEFORE_KNOTS:] + t.youngs_modulus_by_diameter * common[0] * unit[0])[None],
        "diameter scatter": t.diameter_scatter_mm * _at_corners(rod) / diameters @ unit[BEFORE_KNOTS:],
        "bore": t.bore_mm * _wider_bore(rod),
        "length": length * unit[3:4],
        "creep": t.creep * softer,
        "stiffness scatter": t.stiffness_scatter * softer,
        "bow": t.bow_mm * MM * bow_curvature(rod.length) @ unit[4:6],
    }


def bow_of(model: ProbeModel, rod: Rod, factor: float = 1.0) -> Array:
    """Return the bow of a print towards x and y [m], (2,): its constant curvature beside that of the designed axis.

    Args:
        model: of the probe as designed.
        rod: as printed.
        factor: on the curvature of the designed axis.
    """
    if rod.rest_curvature is None:
        return np.zeros(2)
    bow = rod.rest_curvature[0]
    if model.axis is not None:
        bow = bow - factor * model.axis.length / rod.length * model.axis.rest_curvature([0.0])[0]
    return np.asarray(bow_curvature(rod.length) @ bow[:2] * rod.length**4 / 4.0)


def scaled_curvature(model: ProbeModel, rod: Rod, x: float) -> Rod:
    """Return the rod with x times the curvature of the designed axis added, unless the axis is straight or an arc."""
    axis = model.axis
    if axis is None or rod.rest_curvature is None or axis.is_arc:
        return rod
    stretch = axis.length / rod.length
    return replace(rod, rest_curvature=rod.rest_curvature + x * stretch * axis.rest_curvature(rod.s * stretch))


def curvature_std(model: ProbeModel, tolerances: Tolerances) -> float:
    """Return the standard deviation of the factor on the curvature of an axis: it moves the tip by as much as the bow.

    0 for a straight axis and for an arc, whose factor is a bow.
    """
    reach = 0.0 if model.axis is None or model.axis.is_arc else model.axis.tip_by_factor()
    return tolerances.bow_mm * MM / reach if reach > 0.0 else 0.0


def _at_corners(rod: Rod) -> Array:
    """Return the diameters at all knots for a unit at each end or corner of the flank, linear between them, (c, K)."""
    slope = np.diff(rod.radius) / np.diff(rod.s)
    corners = np.flatnonzero(np.r_[True, np.abs(np.diff(slope)) > _STRAIGHT, True])
    return np.array([np.interp(rod.s, rod.s[corners], row) for row in np.eye(len(corners))])


def _wider_bore(rod: Rod) -> Array:
    """Return the change of log E, G, density, length and diameters that acts as a bore wider by 1 mm, (1, 6 + K).

    With β the bore ratio and ε = δ/(β d) the relative change of the bore, bending and torsional stiffness change by
    -4 β⁴/(1 - β⁴) ε, which is that of a diameter changed by -β⁴/(1 - β⁴) ε at the same place; the mass changes by
    -2 β²/(1 - β²) ε, whose rest is put into the density, averaged over the volume. A section without a
    bore has no row, (0, 6 + K).
    """
    area, moment, other, _ = rod.factors
    if area == 1.0 or moment != other:
        return np.empty((0, BEFORE_KNOTS + len(rod.s)))
    row = np.zeros(BEFORE_KNOTS + len(rod.s))
    by_area, by_moment = (1.0 - area) / area, (1.0 - moment) / moment
    widened = MM / (math.sqrt(1.0 - area) * 2.0 * rod.radius)
    row[BEFORE_KNOTS:] = -by_moment * widened
    volume = np.convolve(np.diff(rod.s), (0.5, 0.5)) * rod.radius**2
    row[2] = -2.0 * (by_area - by_moment) * float(widened @ volume / volume.sum())
    return row[None]


def across(gravity: Array) -> Array:
    """Return two unit vectors across gravity and each other, (2, 3); zeros without gravity."""
    g = np.asarray(gravity, dtype=float)
    return np.asarray(np.linalg.svd(g[None])[2][1:] if g.any() else np.zeros((2, 3)))


def turns_of(gravity: Array, tolerances: Tolerances, axes: Array | None = None) -> dict[str, Array]:
    """Return one standard deviation of each pose error source, a row each: shift and turn of the base
    [m, rad] and change of gravity [m/s²], (9,).

    Args:
        gravity: base axes [m/s²], (3,).
        tolerances: how well all is known.
        axes: two axes across gravity, in base axes, the same in the world for all poses, (2, 3); any if None.
    """
    unit, size = np.eye(9), float(np.linalg.norm(gravity))
    axes = across(gravity) if axes is None else axes
    return {
        "base place": tolerances.base_mm * MM * unit[0:3],
        "base tilt": math.radians(tolerances.tilt_deg) * unit[3:5],
        "clocking": math.radians(tolerances.clocking_deg) * unit[5:6],
        "gravity": math.radians(tolerances.gravity_deg) * size * axes @ unit[6:9],
    }


def _filtered(rows: dict[str, Array]) -> tuple[Array, tuple[str, ...]]:
    """Return all rows that are not zero, one below the other, and the source of each."""
    stacked = np.concatenate(list(rows.values()))
    names = [name for name, its_rows in rows.items() for _ in its_rows]
    kept = np.asarray(stacked.any(axis=1))
    return np.ascontiguousarray(stacked[kept]), tuple(names[i] for i in np.flatnonzero(kept))


@dataclass(frozen=True)
class ErrorSources:
    """The error sources of a probe under one gravity, one standard deviation a column."""

    model: ProbeModel  #: of the probe.
    tolerances: Tolerances  #: how well it is known.
    gravity: Array  #: base axes [m/s²], (3,).
    rod: Array  #: of the rod's own sources, log E and what follows it, (a, 6 + K).
    #: of the others, (b, 9), see `turns_of`, or (b, 15) with shift and turn of the points alone [m, rad].
    base: Array
    names: tuple[str, ...]  #: the source of each of the J columns.
    reference: Array  #: wrench at the base at which the sensor reads zero, (6,).
    tared: Array  #: columns of the free probe's reading, which a tare has taken away, (6, J).

    @classmethod
    def of(
        cls,
        model: ProbeModel,
        tolerances: Tolerances,
        gravity: Array,
        free: Equilibrium,
        tared: "ErrorSources | None" = None,
        axes: Array | None = None,
        posed: bool = False,
    ) -> "ErrorSources":
        """Return the sources of a probe that hangs free under a gravity.

        Args:
            model: of the probe.
            tolerances: how well it is known.
            gravity: base axes [m/s²], (3,).
            free: the free probe under it.
            tared: the sources where the sensor was tared; None: under this gravity.
            axes: see `turns_of`.
            posed: whether points count in the world. The base's place is then uncertain twice, by `base_mm` each: on
                the sensor, which the moment shows, and as the robot reports it, which no reading shows. A reported
                rotation that is off by θ turns the points by θ × x, and gravity in base axes by g × θ.
        """
        rod, names = _filtered(parameters_of(model.rod, tolerances))
        turns = turns_of(gravity, tolerances, axes)
        if posed:
            turns = {name: np.pad(rows, ((0, 0), (0, 6))) for name, rows in turns.items()}
            shift = np.pad(tolerances.base_mm * MM * np.eye(3), ((0, 0), (9, 3)))
            turn, unseen = math.radians(tolerances.pose_deg) * np.eye(3), np.zeros((3, 6))
            turns["base place"] = np.vstack([turns["base place"], shift])
            turns["pose"] = np.hstack([unseen, np.cross(gravity, turn), unseen[:, :3], turn])
        base, base_names = _filtered(turns)
        names = (*names, *base_names, "root", *["gain"] * 6)
        nothing = np.zeros((6, len(names)))
        base_from_sensor = wrench_map(inverse(model.T_sensor_base))
        unloaded = -base_from_sensor @ model.gravity_wrench_sensor(gravity)
        sources = cls(model, tolerances, gravity, rod, base, names, unloaded, nothing)
        if not tolerances.tared:
            return sources
        if tared is not None:
            return replace(sources, reference=tared.reference, tared=tared.tared)
        sources = replace(sources, reference=free.wrench_base)
        return replace(sources, tared=sources.free_columns(free))

    def column(self, name: str) -> int:
        """Return the first column of a source, or -1."""
        return self.names.index(name) if name in self.names else -1

    @cached_property
    def arguments(self) -> uncertainty_kernel.SourceArrays:
        """Return the sources as the compiled estimate takes them."""
        model, t = self.model, self.tolerances
        base_from_sensor = np.ascontiguousarray(wrench_map(inverse(model.T_sensor_base)))
        return uncertainty_kernel.SourceArrays(
            self.rod, self.base, float(t.root_radii * model.rod.radius[0]), np.full(6, t.gain),
            np.ascontiguousarray(base_from_sensor @ model.payload_by_gravity),
            np.ascontiguousarray(wrench_map(model.T_sensor_base)), base_from_sensor,
            np.ascontiguousarray(self.reference), np.ascontiguousarray(self.tared),
        )  # fmt: skip

    @cached_property
    def drift(self) -> Array:
        """Return the covariance of the bias since the tare, about the base, (6, 6)."""
        steps = self.tolerances.drift_steps
        return np.asarray(steps**2 * self.model.averaging_samples * self.model.noise_base())

    def columns_at(self, touch: Array) -> tuple[Array, Array]:
        """Return the linearisation of a touch (ROWS, 1 + 5 + OWN + K), and what one standard deviation of each source
        does to base wrench, touched point and centreline point, (12, J); NaN where there is no equilibrium.

        Args:
            touch: (TOUCH,); its dead loads and tip are made consistent in place.
        """
        rod = self.model.rod
        parameters = surface_contact.OWN + len(rod.s)
        lin = np.empty((surface_contact.ROWS, 1 + surface_contact.UNKNOWNS + parameters))
        D = np.empty((12, len(self.names)))
        if not self.linearise(touch, True, np.empty(surface_contact.work_size(parameters)), lin, D):
            lin[:], D[:] = np.nan, np.nan
        return lin, D

    def linearise(self, touch: Array, settled: bool, work: Array, lin: Array, D: Array) -> bool:
        """Fill in what `columns_at` returns; return whether there is a stable equilibrium.

        Args:
            touch: (TOUCH,).
            settled: whether its dead loads and tip are made consistent in place.
            work: scratch, (work_size(OWN + K),).
            lin, D: filled.
        """
        body = self.model.rod.body
        if not surface_contact.linearise_touch(
            body, self.gravity, self.model.mass, FINE, touch, settled, lin.shape[1] - surface_contact.BY_PARAMETER,
            work, lin,
        ):  # fmt: skip
            return False
        uncertainty_kernel.columns_of(body, self.gravity, lin, *self.arguments, D)
        return True

    def free_columns(self, free: Equilibrium) -> Array:
        """Return the columns of the free probe's reading, (6, J)."""
        touch = np.zeros(surface_contact.TOUCH)
        touch[surface_contact.S] = self.model.rod.length
        touch[surface_contact.NORMAL] = NOTHING
        touch[surface_contact.TIP :] = free.tip
        return self.columns_at(touch)[1][:6]


FINE = 5e-7  #: Error of a sweep's step [rad], that of the rod's fast mode.
NOTHING = 1e-15  #: A normal force [N] that is none.
