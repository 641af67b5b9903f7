"""Force/moment sensors: mechanical interface, frame, ranges and resolution.

Source of all numbers unless noted otherwise: the drawing and specifications of the Nano17 published by ATI; other
values are marked as assumed.
"""

from dataclasses import dataclass

import numpy as np

from probedesign.core.errors import unknown_name
from probedesign.core.frames import Array
from probedesign.core.units import MM, N_MM


@dataclass(frozen=True)
class Calibration:
    """A calibration of a sensor: range and resolution of each channel."""

    name: str
    force_range: tuple[float, float, float]  # |Fx|, |Fy|, |Fz| [N]
    moment_range: tuple[float, float, float]  # [N·m]
    force_resolution: float  # one step [N]
    moment_resolution: float  # one step [N·m]


@dataclass(frozen=True)
class ScrewPattern:
    """Equal screw holes on a bolt circle, with azimuths in the sensor frame [deg]."""

    bolt_circle_d: float  # [m]
    azimuths_deg: tuple[float, ...]
    max_entry: float  # longer screws destroy the sensor [m]
    min_entry: float  # useful thread [m]


@dataclass(frozen=True)
class SensorModel:
    """A sensor: its body, its interfaces and its calibrations.

    Its frame is right-handed, with the origin at the centre of the tool face, +X through the tool-side dowel hole at 0°
    and +Z out of the tool face.
    """

    name: str
    body_d: float  # [m]
    height: float  # tool face to mounting face [m]
    tool: ScrewPattern
    dowel_d: float  # tool-side dowel holes [m]
    dowel_depth: float  # [m]
    dowel_azimuths_deg: tuple[float, ...]
    mounting: ScrewPattern
    cable_azimuth_deg: float
    cable_half_width_deg: float  # kept free on either side of the cable
    cable_free_height: float  # above the mounting face [m]
    rate_hz: float  # of the sensor's own clock
    calibrations: tuple[Calibration, ...]

    def calibration(self, name: str) -> Calibration:
        """Return the calibration of that name.

        Raises:
            InputError: no such calibration.
        """
        for calibration in self.calibrations:
            if calibration.name == name:
                return calibration
        raise unknown_name("sensor.calibration", name, (c.name for c in self.calibrations), of=self.name)


def _si(force: float, force_z: float, moment_n_mm: float, per_n: float, per_n_mm: float) -> Calibration:
    m = moment_n_mm * N_MM
    return Calibration(
        f"si-{force:g}-{moment_n_mm / 1000:g}", (force, force, force_z), (m, m, m), 1 / per_n, N_MM / per_n_mm
    )


NANO17 = SensorModel(
    name="nano17",
    body_d=17.0 * MM,
    height=14.5 * MM,
    tool=ScrewPattern(12.5 * MM, (60.0, 180.0, 300.0), max_entry=3.5 * MM, min_entry=2.5 * MM),
    dowel_d=2.0 * MM,
    dowel_depth=3.0 * MM,
    dowel_azimuths_deg=(0.0, 120.0),
    # Two sources disagree on this bolt circle (12.5 and 12.306 mm): assumed 12.5; Ø2.4 holes take either.
    mounting=ScrewPattern(12.5 * MM, (95.0, 215.0, 335.0), max_entry=3.5 * MM, min_entry=2.5 * MM),
    cable_azimuth_deg=150.0,
    cable_half_width_deg=25.0,
    cable_free_height=8.0 * MM,
    rate_hz=7000.0,
    calibrations=(_si(12, 17, 120, 320, 64), _si(25, 35, 250, 160, 32), _si(50, 70, 500, 80, 16)),
)

SENSORS = {NANO17.name: NANO17}


def sensor_named(name: str) -> SensorModel:
    """Return the sensor of that name.

    Raises:
        InputError: no such sensor.
    """
    try:
        return SENSORS[name]
    except KeyError:
        raise unknown_name("sensor.model", name, SENSORS) from None


@dataclass(frozen=True)
class Noise:
    """Standard deviations of the channels of one reading, which are independent of each other.

    Attributes:
        force: of each force channel [N].
        moment: of each moment channel [N·m].
    """

    force: float
    moment: float

    def covariance(self) -> Array:
        """Return the covariance of [force; moment], (6, 6)."""
        return np.diag([self.force**2] * 3 + [self.moment**2] * 3)


def averaged_noise(calibration: Calibration, samples: int) -> Noise:
    """Return the noise of the mean of `samples` independent samples, each with a σ of one resolution step.

    One step per sample is assumed and conservative: a Net Box was measured at 0.35 steps without filter.
    """
    root = float(np.sqrt(samples))
    return Noise(calibration.force_resolution / root, calibration.moment_resolution / root)
