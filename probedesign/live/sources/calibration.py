"""ATI calibration files (`.cal`): the matrix from six gauge voltages to a wrench, for a sensor on a DAQ card.

Source: files of Nano17 sensors, versions 1.0 and 1.1; version 1.1 contains the matrix in both forms.
"""

from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from probedesign.core.errors import InputError, MissingDependencyError
from probedesign.core.frames import Array
from probedesign.live.sources.netft.configuration import FORCE_UNITS, LENGTH_UNITS, TORQUE_UNITS, unit_of

CHANNELS = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")
MAX_FILE_BYTES = 1 << 20
MAX_GAUGE_VOLTS = 9.8
"""Limit of a gauge voltage [V]; beyond it the amplifier clips and the sample is invalid."""
MAX_CONDITION = 100.0
"""Maximum condition number of the matrix with rows divided by full scale; a Nano17's is about 2.5."""


@dataclass(frozen=True)
class GaugeCalibration:
    """Calibration of one sensor.

    Attributes:
        serial: serial number of the sensor.
        part: name of the calibration, as SI-12-0.12.
        matrix: wrench [N, N·m] per gauge voltage, about the centre of the tool face, (6, 6).
        ranges: range of each channel [N, N·m], (6,).
    """

    serial: str
    part: str
    matrix: Array
    ranges: Array

    def wrench(self, volts: Array, zero: Array | float = 0.0) -> Array:
        """Return the wrench [N, N·m] of gauge voltages minus zero voltages [V], (6,) or (n, 6)."""
        return np.asarray((volts - zero) @ self.matrix.T)


def clipped(volts: Array) -> NDArray[np.bool_]:
    """Return which gauges are clipped by the amplifier or not finite, in the shape of `volts`."""
    return ~(np.abs(volts) <= MAX_GAUGE_VOLTS)


def read_calibration(path: Path) -> GaugeCalibration:
    """Read a calibration file of either version.

    Without `UserAxis` (1.0), the rows of `Axis` are divided by their scales and shifted by Dz from the transducer's
    own origin to the tool face: Tx += Dz Fy, Ty -= Dz Fx.

    Args:
        path: path of the file.

    Raises:
        InputError: the file cannot be read, is not a calibration, or contains an impossible one.
        MissingDependencyError: defusedxml is not installed.
    """
    root = _root(path)
    found = root.find("Calibration")
    if root.tag != "FTSensor" or found is None:
        raise InputError(f"{path}: not an ATI calibration: FTSensor with a Calibration is missing")
    try:
        force = unit_of("ForceUnits", found.get("ForceUnits", ""), FORCE_UNITS)
        torque = unit_of("TorqueUnits", found.get("TorqueUnits", ""), TORQUE_UNITS)
        user = found.findall("UserAxis")
        rows = _by_name(user or found.findall("Axis"))
        matrix = np.array([_numbers(row, "values", 6) for row in rows])
        ranges = np.array([_numbers(row, "max", 1)[0] for row in rows]) * np.repeat([force, torque], 3)
        if not user:
            matrix /= np.array([_numbers(row, "scale", 1) for row in rows])
        matrix *= np.repeat([force, torque], 3)[:, None]
        if not user:
            _move_origin(matrix, found)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    if not (ranges > 0.0).all() or not np.linalg.cond(matrix / ranges[:, None]) < MAX_CONDITION:
        raise InputError(f"{path}: its matrix is singular or its range not positive; is the file complete?")
    return GaugeCalibration(str(root.get("Serial", "")), str(found.get("PartNumber", "")), matrix, ranges)


def _move_origin(matrix: Array, calibration: Element) -> None:
    """Move the origin along z, in place."""
    transform = calibration.find("BasicTransform")
    if transform is None:
        raise InputError("has neither UserAxis nor BasicTransform, so its origin is unknown")
    turned = [name for name in ("Dx", "Dy", "Rx", "Ry", "Rz") if _numbers(transform, name, 1)[0] != 0.0]
    if turned:
        raise InputError(f"BasicTransform has {', '.join(turned)}; only Dz is supported")
    dz = _numbers(transform, "Dz", 1)[0] * unit_of(
        "DistUnits", calibration.get("DistUnits", ""), LENGTH_UNITS
    )
    matrix[3] += dz * matrix[1]
    matrix[4] -= dz * matrix[0]


def _root(path: Path) -> Element:
    try:
        from defusedxml.common import DefusedXmlException
        from defusedxml.ElementTree import ParseError, fromstring
    except ImportError:
        raise MissingDependencyError.of_extra("reading a calibration", "defusedxml", "live") from None
    try:
        with path.open("rb") as file:
            text = file.read(MAX_FILE_BYTES)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        why = getattr(error, "strerror", None) or str(error)
        raise InputError(f"{path}: cannot be read as a calibration: {why}") from None
    try:
        root: Element = fromstring(text, forbid_dtd=True)
    except (ParseError, DefusedXmlException, ValueError, LookupError) as error:
        raise InputError(f"{path}: not valid or safe XML: {type(error).__name__}") from None
    return root


def _by_name(axes: list[Element]) -> list[Element]:
    named = {axis.get("Name"): axis for axis in axes}
    if len(axes) != 6 or set(named) != set(CHANNELS):
        raise InputError(f"has {len(axes)} axes; a calibration has {', '.join(CHANNELS)}, once each")
    return [named[name] for name in CHANNELS]


def _numbers(element: Element, name: str, count: int) -> list[float]:
    what = f"{name} of {element.tag} {element.get('Name', '')}".strip()
    try:
        values = [float(text) for text in element.get(name, "").split()]
    except ValueError:
        values = []
    if len(values) != count or not np.isfinite(values).all() or (name == "scale" and values[0] == 0.0):
        raise InputError(f"{what} = {element.get(name, '')[:40]!r} must be {count} numbers")
    return values
