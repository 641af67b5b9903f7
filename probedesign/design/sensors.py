"""Force/moment sensors: frame, mechanical interface, ranges, resolution and noise.

The types only; `sensor_catalog` has the known sensors and reads the user's own. Mount, CAD, print rules and the model
for estimation read them.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from probedesign.core.errors import InputError, unknown_name
from probedesign.core.frames import Array
from probedesign.core.units import MM
from probedesign.design.catalog import MIN_GRIP, PRINT_TOLERANCE, SocketScrew

DEFAULT_SENSOR = "nano17"  #: Sensor of designs and frozen probes that name none.
NANO17_BODY = (17.0 * MM, 14.5 * MM)  #: Diameter and height of its body [m], for frozen probes that lack them.


@dataclass(frozen=True)
class SensorCalibration:
    """A calibration of a sensor; channels in the order Fx, Fy, Fz [N], Mx, My, Mz [N·m]."""

    name: str  #: as written in a design file.
    wrench_range: tuple[float, ...]  #: largest absolute value of each channel, six numbers.
    resolution: tuple[float, ...]  #: one step of each channel, six numbers.
    #: covariance of one sample, six rows; None if it is not known.
    sample_cov: tuple[tuple[float, ...], ...] | None = None

    def noise(self, samples: int = 1) -> "Noise":
        """Return the noise of the mean of `samples` independent samples.

        Without a known covariance, each sample has a σ of one resolution step. This is assumed and conservative: a Net
        Box was measured at 0.35 steps without filter.
        """
        if self.sample_cov is not None:
            return Noise(np.array(self.sample_cov) / samples)
        return Noise(np.diag((np.array(self.resolution) / np.sqrt(samples)) ** 2))

    @property
    def noise_cov(self) -> Array:
        """Return the covariance of one sample [N, N·m], (6, 6)."""
        return self.noise().cov


@dataclass(frozen=True, eq=False)
class Noise:
    """White noise of one reading [force; moment]."""

    cov: Array  #: covariance of the six channels [N, N·m], (6, 6).

    @classmethod
    def isotropic(cls, force: float, moment: float) -> "Noise":
        """Return the noise of independent channels with one σ for the forces [N] and one for the moments [N·m]."""
        return cls(np.diag([force**2] * 3 + [moment**2] * 3))

    def __eq__(self, other: object) -> bool:
        """Return whether both have the same covariance."""
        return isinstance(other, Noise) and np.array_equal(self.cov, other.cov)

    @cached_property
    def std(self) -> Array:
        """Return the standard deviation of each channel [N, N·m], (6,)."""
        return np.asarray(np.sqrt(np.diag(self.cov)))

    @cached_property
    def force(self) -> float:
        """Return the largest standard deviation of a force channel [N]."""
        return float(self.std[:3].max())

    @cached_property
    def moment(self) -> float:
        """Return the largest standard deviation of a moment channel [N·m]."""
        return float(self.std[3:].max())

    @property
    def is_isotropic(self) -> bool:
        """Return whether `force` and `moment` describe it completely."""
        return self == Noise.isotropic(self.force, self.moment)


@dataclass(frozen=True)
class ScrewPattern:
    """Equal threaded holes on a bolt circle in one face of a sensor."""

    face_d: float  #: diameter of the face [m].
    bolt_circle_d: float  #: [m]; 0 for one hole on the axis.
    azimuths_deg: tuple[float, ...]  #: of the holes in the sensor frame.
    screw: SocketScrew  #: that fits.
    min_entry: float  #: least useful depth of thread [m].
    max_entry: float  #: longer screws destroy the sensor [m].

    @property
    def length(self) -> float:
        """Return the shortest stock length that leaves `MIN_GRIP` under the head [m]."""
        stock = [n * MM for n in self.screw.stock_mm]
        return min((n for n in stock if self._grip(n) >= MIN_GRIP - 1e-9), default=stock[-1])  # 1 nm for round-off

    @property
    def grip(self) -> float:
        """Return the thickness under the head [m], to 0.1 mm: the shortest screw through the thickest print enters by
        `min_entry`. This leaves most of the room for sanding, which makes a screw enter deeper."""
        return self._grip(self.length)

    def _grip(self, length: float) -> float:
        thickest = length - self.min_entry - self.screw.length_tolerance(length) - PRINT_TOLERANCE
        return math.floor(thickest / (0.1 * MM) + 1e-6) * 0.1 * MM


@dataclass(frozen=True)
class DowelPattern:
    """Dowel holes in the tool face of a sensor, two at most, with azimuths in the sensor frame."""

    diameter: float  #: diameter, depth: of a hole [m].
    depth: float
    circle_d: float  #: of their centres [m].
    azimuths_deg: tuple[float, ...]  #: of the holes.
    pin_length: float  #: length of the stock pin in them [m].


@dataclass(frozen=True)
class CableExit:
    """The cable's exit from a sensor, and the sector that is kept free for the cable."""

    azimuth_deg: float  #: in the sensor frame.
    #: half_width_deg, free_height: of the sector, on either side of the cable, and above the mounting face [m].
    half_width_deg: float
    free_height: float
    width: float  #: width, reach: of the exit's block, and its distance from the axis [m].
    reach: float
    heights: tuple[float, float]  #: of the block's lower and upper face above the mounting face [m].


@dataclass(frozen=True)
class SensorInterface:
    """The mechanical interface of a sensor: what mount, CAD and print rules need to know of it."""

    body_d: float  #: body_d, height: of the body, from tool face to mounting face [m].
    height: float
    tool: ScrewPattern  #: tool, mounting: threaded holes of both faces.
    mounting: ScrewPattern
    dowels: DowelPattern  #: holes in the tool face.
    cable: CableExit  #: exit and free sector.
    mass: float  #: without cable [kg].
    p_com: tuple[float, float, float]  #: centre of mass in the sensor frame [m], (3,).


@dataclass(frozen=True)
class SensorModel:
    """A sensor: its mechanical interface and its calibrations.

    Its frame is right-handed, with the origin at the centre of the tool face, +X through the tool-side dowel hole at 0°
    and +Z out of the tool face.
    """

    name: str  #: as written in a design file.
    product: str  #: maker and type, for documents.
    interface: SensorInterface  #: mechanical.
    calibrations: tuple[SensorCalibration, ...]  #: the finest first.
    source: str  #: of the numbers.
    #: keys of the numbers without a source, as in a sensor file, such as `interface.tool.azimuths_deg`.
    assumed: tuple[str, ...] = ()
    #: load on one axis that the sensor survives [N, N·m], six numbers; None if it is not known.
    overload: tuple[float, ...] | None = None

    @property
    def assumed_shape(self) -> tuple[str, ...]:
        """Return what of the interface is assumed and decides whether parts fit: tables, and keys of tables."""
        tables = ("tool", "mounting", "dowels", "body_d_mm", "height_mm")
        keys = [key.removeprefix("interface.") for key in self.assumed if key.startswith("interface.")]
        return tuple(key for key in keys if key.partition(".")[0] in tables or key == "cable")

    def check_holes_known(self) -> None:
        """Refuse a sensor with an interface that is assumed: parts made for it are not known to fit.

        Raises:
            InputError: names the tables of the sensor file.
        """
        assumed = self.assumed_shape
        if assumed:
            raise InputError(
                f"sensor {self.name}: {', '.join(assumed)} of its interface are assumed, so parts may not fit. Measure "
                "them, enter them in [sensor.own.interface] of the design, and remove them from sensor.own.assumed; "
                f"'probedesign new ... --sensor {self.name}' writes a design with these tables"
            )

    def calibration(self, name: str) -> SensorCalibration:
        """Return the calibration of that name.

        Raises:
            InputError: no such calibration.
        """
        for calibration in self.calibrations:
            if calibration.name == name:
                return calibration
        raise unknown_name("sensor.calibration", name, (c.name for c in self.calibrations), of=self.name)
