"""Localisation of one touch, as a conditional distribution of its point given the error sources common to all touches.

The fusion of one touch leaves the information matrix Λ and vector η of the touched point x, of the error sources m,
each in standard deviations of its prior, and of the sensor bias. With the bias marginalised, the touch gives the
conditional distribution of the point and information on m:

    x = a + B m + e,   e ~ N(0, S),   S = Λxx⁻¹,  B = -S Λxm,  a = S ηx
    information on m: Λmm - Λmx S Λxm,   its vector: ηm - Λmx S ηx,   both without the prior

Stiffness, diameters, length, root, base pose, gravity and gain are the same in every touch of a run, so m is one
vector: the map adds the information of all touches on it to the unit prior, once. Two touches of one point are fused by
the same terms, and their difference is an observation of m. The bias, and the scatter of stiffness between touches,
belong to each touch alone.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.core.statistics import positive_part
from probedesign.estimation.estimate import RESULTS, FusedEstimate
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.fusion import Fusion, Reading
from probedesign.estimation.fusion_state import FusionState, channels_of
from probedesign.estimation.model import Tolerances, covariance
from probedesign.mapping.segmentation import TouchSegment

#: Options of `explore` for the reported pose of the base, and the tolerance that each replaces.
BASE_OPTIONS = {"base_offset_mm": "base_mm", "base_repeat_mm": "robot_mm", "tilt_deg": "tilt_deg",
                "clocking_deg": "clocking_deg"}  # fmt: skip
#: Largest standard deviation accepted [mm, deg]: beyond it errors are not linear in a rotation any more, and touches of
#: one point do not lie near each other. Assumed; the `[tolerances]` of a design allow as many degrees.
MAX_STD = 10.0


def with_base(tolerances: Tolerances, **stds: float | None) -> Tolerances:
    """Return tolerances with other standard deviations of the reported base pose; None keeps that of the tolerances.

    Tilt and clocking are those of the base against the report, whether it turned on the sensor or with it.

    Args:
        tolerances: of probe, sensor and mount.
        stds: by the names of `BASE_OPTIONS` [mm, deg].

    Raises:
        InputError: one is out of range.
    """
    given = {name: value for name, value in stds.items() if value is not None}
    for name, value in given.items():
        if not 0.0 <= value <= MAX_STD:
            option = name.replace("_", "-")
            raise InputError(f"--{option} {value:g} is a standard deviation; it must lie in 0 ... {MAX_STD:g}")
    stated: dict[str, Any] = {BASE_OPTIONS[name]: value for name, value in given.items()}
    return replace(tolerances, pose_deg=0.0, **stated)


def describe_base(tolerances: Tolerances) -> str:
    """Return the standard deviations of the reported base pose in one line."""
    return (
        f"base pose uncertainty: {tolerances.base_mm:g} mm common, {tolerances.robot_mm:g} mm per pose, "
        f"tilt {tolerances.tilt_deg:g}°, clocking {tolerances.clocking_deg:g}°"
    )


#: Standard deviation of the bias, in steps of the sensor's resolution, without readings of the free probe next to the
#: touch: what the assumed random walk makes in 100 s.
BIAS_STEPS = 0.5
#: Information on a common error source, relative to its prior, below which it is a rounding error.
MIN_INFORMATION = 1e-9
#: Standard deviation of the bias, in steps of the sensor's resolution, where readings of the free probe next to the
#: touch determine it: practically unknown. An hour of the assumed random walk makes 3 (`bias.WALK_STEPS`).
UNKNOWN_BIAS_STEPS = 10.0
NEVER_SETTLED = "never_settled"
#: Meaning of each result code of a touch.
RESULT_MEANINGS: dict[str, str] = {
    **{str(result): meaning for result, meaning in RESULTS.items()},
    NEVER_SETTLED: "the base or the readings were never stationary during the touch",
}


@dataclass(frozen=True)
class ConditionalPoint:
    """The point of one or more touches, conditional on the common error sources."""

    mean: Array  #: the point if all common error sources were zero [m], (3,).
    #: derivative of the point by the common error sources in standard deviations of their priors [m], (3, J).
    sensitivity: Array
    cov: Array  #: covariance of the point if the common error sources were known [m²], (3, 3).
    information: Array  #: on the common error sources, without their prior, (J, J).
    information_vector: Array  #: that information times the value that these touches indicate, (J,).
    names: tuple[str, ...] = ()  #: error source of each column, as `ErrorSources.names`.

    @classmethod
    def from_fusion(cls, state: FusionState, fused: FusedEstimate, one_object: bool = False) -> "ConditionalPoint":
        """Return the conditional point of the fusion of one touch.

        Args:
            state: of the fusion, linearised and solved with its own priors.
            fused: its result, whose point and covariance count what the linearised fusion does not.
            one_object: whether the object's compliance is common to all touches too, in the last column.
        """
        information, vector = state.information(one_object)
        J = state.causes + one_object
        x, m = slice(0, 3), slice(3, 3 + J)
        S = np.linalg.inv(information[x, x])
        B = -S @ information[x, m]
        on_m = information[m, m] - np.eye(J) + information[m, x] @ B
        # Directions without information are removed, or rounding errors would make it indefinite.
        values, vectors = np.linalg.eigh(0.5 * (on_m + on_m.T))
        kept = vectors[:, values > MIN_INFORMATION]
        on_m = (kept * values[values > MIN_INFORMATION]) @ kept.T
        vector_m = kept @ (kept.T @ (vector[m] - information[m, x] @ S @ vector[x]))
        names = state.sources[0].names + ("object",) * one_object
        shift, added = fused.p_surface_world - state.point, fused.cov_surface_world - state.cov[:3, :3]
        cov = 0.5 * (S + S.T) + added
        if not np.linalg.eigvalsh(cov)[0] > 0.0:  # what is added is that of the point with its common error sources
            cov = 0.5 * (S + S.T) + positive_part(added)
        return cls(S @ vector[x] + shift, B, cov, on_m, vector_m, names)

    def among(self, sizes: list[int], number: int) -> "ConditionalPoint":
        """Return the point conditional on the error sources of several probes, of which those of one concern it.

        The compliance of one object is the last column of all of them.

        Args:
            sizes: number of common error sources of each probe, without that compliance.
            number: number of the probe of this point.
        """
        shared = self.names[-1:] if self.names[-1:] == ("object",) else ()
        J, start = sum(sizes), sum(sizes[:number])
        columns = [*range(start, start + sizes[number]), *([J] if shared else [])]
        J += len(shared)
        sensitivity, information, vector = np.zeros((3, J)), np.zeros((J, J)), np.zeros(J)
        sensitivity[:, columns], vector[columns] = self.sensitivity, self.information_vector
        information[np.ix_(columns, columns)] = self.information
        return ConditionalPoint(self.mean, sensitivity, self.cov, information, vector, shared)

    def position(self, common: Array) -> Array:
        """Return the point for given common error sources (J,) [m], (3,)."""
        return np.asarray(self.mean + self.sensitivity @ common)

    def covariance(self, cov_common: Array) -> Array:
        """Return the covariance of the point for a covariance of the common error sources (J, J) [m²], (3, 3)."""
        return np.asarray(self.cov + self.sensitivity @ cov_common @ self.sensitivity.T)

    def fused_with(self, other: "ConditionalPoint") -> "ConditionalPoint":
        """Return both as one point."""
        mine, others = np.linalg.inv(self.cov), np.linalg.inv(other.cov)
        S = np.linalg.inv(mine + others)
        d_mean, d_sensitivity = self.mean - other.mean, self.sensitivity - other.sensitivity
        weight = np.linalg.inv(self.cov + other.cov)
        return ConditionalPoint(
            S @ (mine @ self.mean + others @ other.mean),
            S @ (mine @ self.sensitivity + others @ other.sensitivity),
            0.5 * (S + S.T),
            self.information + other.information + d_sensitivity.T @ weight @ d_sensitivity,
            self.information_vector + other.information_vector - d_sensitivity.T @ weight @ d_mean,
            self.names,
        )


@dataclass(frozen=True)
class LocatedTouch:
    """A touch and its localisation."""

    segment: TouchSegment  #: readings of the touch.
    result: str  #: a key of `RESULT_MEANINGS`.
    point: ConditionalPoint | None = None  #: touched point of the object; None unless the result is "ok".
    force: float = float("nan")  #: largest contact force of its intervals [N]; NaN unless ok.
    direction: Array | None = None  #: direction of that force on the probe in the world, unit vector, (3,).
    s_contact: Array | None = None  #: arclength of the contact at each interval [m], (k,).
    rms: float = float("nan")  #: RMS error of the point by this touch alone [m].
    probe: str = ""  #: name of the probe in a map of several.
    tangent: Array | None = None  #: of the free probe at the contact, towards the tip, in the world, (3,).
    beyond: float = float("nan")  #: length of a straight probe beyond the contact [m]; NaN of a curved one.

    @property
    def label(self) -> str:
        """Number of the touch, after the name of the probe in a map of several."""
        return f"{self.probe} {self.segment.number}".lstrip()


def locate_touch(
    segment: TouchSegment, estimator: Estimator, priors: Tolerances, gravity_world: Array, one_object: bool = False
) -> LocatedTouch:
    """Return the touch with its point, from a batch fusion of its intervals and of the free probe around them.

    Args:
        segment: readings of the touch.
        estimator: of the probe.
        priors: standard deviations of the error sources; that of the bias is replaced by `UNKNOWN_BIAS_STEPS` or
            `BIAS_STEPS`.
        gravity_world: gravity in the world [m/s²], (3,).
        one_object: as in `ConditionalPoint.from_fusion`.
    """
    if not segment.intervals:
        return LocatedTouch(segment, NEVER_SETTLED)
    fusion = _fusion(segment, estimator, priors, gravity_world)
    if fusion is None:
        return LocatedTouch(segment, "out_of_range")
    solutions = fusion.solutions()
    if isinstance(solutions, FusedEstimate):
        return LocatedTouch(segment, solutions.result)
    fused = fusion.answer(solutions)
    if not fused.ok:
        return LocatedTouch(segment, fused.result)
    state = fusion.state(solutions[0].touches)
    if not state.linearise():
        return LocatedTouch(segment, "not_converged")
    state.solved()
    point = ConditionalPoint.from_fusion(state, fused, one_object and priors.object_compliance > 0.0)
    if not np.linalg.eigvalsh(point.cov)[0] > 0.0:  # a direction is open, or the readings contradict each other
        return LocatedTouch(segment, "not_converged")
    forces = np.linalg.norm(fused.force_base, axis=1)
    strongest = int(np.argmax(forces))
    R = fusion.readings[strongest].T_world_base[:3, :3]
    direction = R @ fused.force_base[strongest] / forces[strongest]
    s, rod = float(fused.s_contact[strongest]), estimator.model.rod
    tangent = R @ estimator.free(fusion.readings[strongest].gravity).R_at(s)[:, 2]
    return LocatedTouch(
        segment, "ok", point, float(forces[strongest]), direction, fused.s_contact[np.isfinite(fused.s_contact)],
        fused.rms, tangent=tangent, beyond=np.nan if rod.is_curved else rod.length - s,
    )  # fmt: skip


def _fusion(segment: TouchSegment, estimator: Estimator, priors: Tolerances, gravity_world: Array) -> Fusion | None:
    """Return the fusion; None if a wrench exceeds the sensor's range or the free probe has no stable equilibrium."""
    model = estimator.model
    around = [
        (segment.free_before, False),
        *((touched, True) for touched in segment.intervals),
        (segment.free_after, False),
    ]
    used = [(interval, contact) for interval, contact in around if interval is not None]
    for interval, _ in used:
        if not model.in_range(model.to_sensor(interval.wrench, interval.gravity)):
            return None
        if not estimator.free(interval.gravity).ok:
            return None
    bias = BIAS_STEPS if all(contact for _, contact in used) else UNKNOWN_BIAS_STEPS
    readings = tuple(
        Reading(
            interval.wrench, covariance(model, interval.wrench, interval.n_readings), interval.T_world_base,
            interval.gravity, contact,
        )
        for interval, contact in used
    )  # fmt: skip
    return Fusion(model, readings, replace(priors, drift_steps=bias), channels_of(model, None), gravity_world)
