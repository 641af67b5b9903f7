"""A designed probe as one object: geometry, sections and mass; its rod, estimator and prediction when they are used.

The rod and the estimator are imported where they are used: an export needs the geometry alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from probedesign.core.frames import Array, inverse
from probedesign.core.notebook import Displayed
from probedesign.core.units import MM
from probedesign.design import Design
from probedesign.geometry import Axis, ProbeGeometry
from probedesign.geometry.mass import MassProperties, flexible_part
from probedesign.mount import (
    Mount,
    T_sensor_robotflange,
    build_geometry,
    held_tolerances,
    mount_part_masses,
    root_radii,
)

if TYPE_CHECKING:
    from probedesign.estimation.estimator import Estimator
    from probedesign.estimation.model import ProbeModel, Tolerances
    from probedesign.prediction.fused import PressSchedule
    from probedesign.prediction.predict import Prediction
    from probedesign.rod.equilibrium import Equilibrium
    from probedesign.rod.rod import Columns, Mode, Rod


@dataclass(frozen=True)
class Probe(Displayed):
    """A probe as its design describes it, for mechanics and estimation."""

    design: Design  #: the design of the probe.
    geometry: ProbeGeometry  #: its geometry, which CAD builds as well.

    @property
    def length(self) -> float:
        """Return the length of the flexible part [m]."""
        return self.geometry.length

    @cached_property
    def body(self) -> MassProperties:
        """Return the mass properties of the undeformed flexible part in the base frame."""
        return flexible_part(self.geometry, self.design.density.value, self.axis)

    @property
    def axis(self) -> Axis:
        """Return the undeformed centreline: that of the geometry with the measured bow of the print."""
        bow, axis = self.design.probe.bow_mm, self.geometry.axis
        return axis if bow is None else axis.with_curvature(2.0 * MM / self.length**2 * np.array(bow))

    @property
    def mass(self) -> float:
        """Return the mass of the flexible part [kg]."""
        return self.body.mass

    @property
    def p_base_com(self) -> Array:
        """Return the centre of mass of the undeformed flexible part in the base frame [m], (3,)."""
        return self.body.p_com

    @property
    def flange_volume(self) -> float:
        """Return the volume of the printed flange, which is weighed with the flexible part [m³]."""
        adapter = Mount.of(self.design).sensor_adapter
        return mount_part_masses(self.geometry, adapter, self.design.density.value)["flange"].volume

    @cached_property
    def rod(self) -> "Rod":
        """Return the flexible part as a Cosserat rod with the root compliance of the design; without one it is the
        rod of the paper (decision 0006)."""
        from probedesign.rod.rod import Rod

        d, axis, s, root = self.design, self.axis, self.geometry.s, root_radii(self.design, self.geometry)
        if not axis.is_straight:
            s = np.unique(np.concatenate([s, axis.s]))
        return Rod(
            s=s,
            radius=self.geometry.radius_at(s),
            youngs_modulus=d.youngs_modulus.value,
            shear_modulus=d.shear_modulus.value,
            density=d.density.value,
            shear_coefficient=d.material.shear_coefficient,
            rigid_length=root * self.geometry.base_radius,
            factors=self.geometry.cross_section.factors,
            finite_strain=root != 0.0 and self.geometry.cross_section.full_round,
            rounded_from=self.geometry.rounded_from,
            rest_curvature=None if axis.is_straight else axis.rest_curvature(s),
        )

    @cached_property
    def model(self) -> "ProbeModel":
        """Return the model from which the estimator computes: rod, mount, sensor, priors and their sources."""
        from probedesign.estimation.model import ProbeModel, Tolerances

        d = self.design
        sensor, calibration = d.sensor_model, d.calibration
        mount = Mount.of(d)
        adapter = mount.sensor_adapter
        model = ProbeModel(
            name=d.name,
            fingerprint=self.geometry.fingerprint,
            flange=self.geometry.flange,
            cross_section=self.geometry.cross_section,
            axis=self.geometry.curved,
            rod=self.rod,
            gravity_base=np.array(d.mount.gravity_base_m_s2),
            T_sensor_base=adapter.T_sensor_base,
            T_robotflange_base=inverse(T_sensor_robotflange(sensor, d.robot_flange)) @ adapter.T_sensor_base,
            payload=mount.payload,
            parts=mount.fingerprints,
            wrench_range=np.array(calibration.wrench_range),
            noise=calibration.noise(d.sensor.averaging_samples),
            averaging_samples=d.sensor.averaging_samples,
            material={"youngs_modulus": d.youngs_modulus, "shear_modulus": d.shear_modulus, "density": d.density},
            assumptions=d.assumptions,
            friction=d.friction.value,
            friction_provenance=d.friction.provenance,
            friction_source=d.friction.source,
            resin=d.resin.name,
            sensor=sensor.name,
            sensor_d=sensor.interface.body_d,
            sensor_height=sensor.interface.height,
            stiffness_spread=d.material.stiffness_spread,
            creep_spread=d.material.creep_spread,
            identified_tests=d.material.identified_tests,
        )
        stated = {key: value for key, value in d.tolerances.model_dump().items() if value is not None}
        contact = {"object_compliance": d.object_compliance.value, "object_walk_mm": d.contact.object_walk_mm}
        given = held_tolerances(mount, Tolerances.base_mm, Tolerances.clocking_deg) | stated | contact
        return replace(model, tolerances=Tolerances.of(model, given))

    def solve(
        self,
        gravity_base: ArrayLike | None = None,
        s_contact: float | None = None,
        force_base: ArrayLike = (0.0, 0.0, 0.0),
        *,
        mode: "Mode" = "fast",
        columns: "Columns" = "none",
    ) -> "Equilibrium":
        """Return the static equilibrium of the probe under gravity and a dead point force on its centreline.

        Args:
            gravity_base: in base axes [m/s²], (3,); the design's mount if None.
            s_contact: where the force acts [m]; the tip if None.
            force_base: in base axes [N], (3,).
            mode: "fast" or "reference", see `Rod.solve`.
            columns: which sensitivities to compute.

        Returns:
            The equilibrium; its `result` is "ok" or the reason why there is none.

        Raises:
            InputError: an argument is not finite or s_contact lies off the probe.
        """
        gravity = self.design.mount.gravity_base_m_s2 if gravity_base is None else gravity_base
        return self.rod.solve(gravity, force_base, s_contact, mode=mode, columns=columns)

    def estimator(self, exact: bool = False) -> "Estimator":
        """Return the estimator for this geometry, as `deploy` freezes it.

        Args:
            exact: take probe, mount, bench and bias as exactly known, so that the sensor's noise and the prior on
                friction alone remain; otherwise every error source of the design's tolerances counts.
        """
        from probedesign.estimation.estimator import Estimator
        from probedesign.estimation.model import Tolerances

        return Estimator(self.model, Tolerances.none() if exact else None)

    def predict(
        self,
        fractions: Sequence[float] | None = None,
        forces_N: Sequence[float] | None = None,
        directions: Sequence[str] | None = None,
        tolerances: "Tolerances | None" = None,
        pressing: "PressSchedule | None" = None,
    ) -> "Prediction":
        """Predict sensitivity and contact error over a grid of touches.

        Args:
            fractions: positions of the touches as fractions of the length, in (0, 1]; ten from 0.1 to 1 if None.
            forces_N: contact forces [N]; seven from 2 mN to 0.2 N if None.
            directions: in which the object pushes: "+x", "-x", "+y", "-y", or degrees about the tangent from the
                section's X axis such as "45deg"; the first three if None, eight all around if the probe is curved.
            tolerances: standard deviations of the parameters of the probe; those of the design if None.
            pressing: schedule of the touches of one point that are fused; the default one if None.

        Returns:
            The prediction; its `conditions` are one for each position, direction and force.

        Raises:
            InputError: a fraction, force or direction is out of range.
        """
        from probedesign.prediction import predict as defaults

        return defaults.predict(
            self.model,
            defaults.FRACTIONS if fractions is None else tuple(fractions),
            defaults.FORCES_N if forces_N is None else tuple(forces_N),
            None if directions is None else tuple(directions),
            self.tolerances if tolerances is None else tolerances,
            defaults.PRESSING if pressing is None else pressing,
        )

    @property
    def tolerances(self) -> "Tolerances":
        """Return the standard deviations of the parameters of the probe, from its design."""
        from probedesign.estimation.model import Tolerances

        return Tolerances.of(self.model)


def build_probe(design: Design) -> Probe:
    """Return the probe that a design describes: geometry, sections, mass and rod, without CAD.

    Args:
        design: the design, for example from `load_design`.
    """
    return Probe(design, build_geometry(design))
