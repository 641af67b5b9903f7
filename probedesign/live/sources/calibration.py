"""ATI's `.cal` files: the matrix from six gauge voltages to a wrench, for a sensor on a DAQ card.

Source: the files of Nano17 sensors, versions 1.0 and 1.1; the latter holds the matrix in both ways.
"""

from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from probedesign.errors import InputError, MissingDependencyError
from probedesign.frames import Array
from probedesign.live.sources.netft.configuration import FORCE_UNITS, LENGTH_UNITS, TORQUE_UNITS, unit_of

CHANNELS = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")
MOST_BYTES = 1 << 20
LIMIT = 9.8
"""Of a gauge [V]: beyond, the amplifier clips and the sample is invalid."""
CROOKED = 100.0
"""A matrix whose rows over full scale have this condition is no sensor's; a Nano17's have 2.5 or so."""


@dataclass(frozen=True)
class Calibration:
    """One sensor's calibration.

    Attributes:
        serial: of the sensor.
        part: its calibration, as SI-12-0.12.
        matrix: wrench [N, N·m] of gauge volts, about the centre of the tool face, (6, 6).
        ranges: largest reading of each channel [N, N·m], (6,).
    """

    serial: str
    part: str
    matrix: Array
    ranges: Array

    def wrench(self, volts: Array, zero: Array | float = 0.0) -> Array:
        """Wrench [N, N·m] of gauge voltages less those at zero [V], (6,) or (n, 6)."""
        return np.asarray((volts - zero) @ self.matrix.T)


def clipped(volts: Array) -> NDArray[np.bool_]:
    """Which gauges are beyond what the amplifier passes, or no number, shaped as they are."""
    return ~(np.abs(volts) <= LIMIT)


def read_calibration(path: Path) -> Calibration:
    """Read a file of either version.

    Without `UserAxis` (1.0) the rows of `Axis` are divided by their scales and carried by Dz from the
    transducer's own origin to the tool face: Tx += Dz Fy, Ty -= Dz Fx.

    Args:
        path: of the file.

    Raises:
        InputError: it cannot be read, is no calibration, or holds one that no sensor can have.
        MissingDependencyError: defusedxml is not installed.
    """
    root = _root(path)
    found = root.find("Calibration")
    if root.tag != "FTSensor" or found is None:
        raise InputError(f"{path}: is no calibration; ATI's begin with FTSensor and hold a Calibration")
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
            _carry(matrix, found)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    if not (ranges > 0.0).all() or not np.linalg.cond(matrix / ranges[:, None]) < CROOKED:
        raise InputError(f"{path}: its matrix is none that a sensor can have; is the file whole?")
    return Calibration(str(root.get("Serial", "")), str(found.get("PartNumber", "")), matrix, ranges)


def _carry(matrix: Array, calibration: Element) -> None:
    """Move the origin along z, in place."""
    transform = calibration.find("BasicTransform")
    if transform is None:
        raise InputError("has neither UserAxis nor BasicTransform; where its origin lies is not known")
    turned = [name for name in ("Dx", "Dy", "Rx", "Ry", "Rz") if _numbers(transform, name, 1)[0] != 0.0]
    if turned:
        raise InputError(f"BasicTransform has {', '.join(turned)}; only Dz is known to be meant as here")
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
        raise MissingDependencyError(
            "reading a calibration needs defusedxml; install probedesign[live]"
        ) from None
    try:
        with path.open("rb") as file:
            text = file.read(MOST_BYTES)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        why = getattr(error, "strerror", None) or str(error)
        raise InputError(f"{path}: cannot be read as a calibration: {why}") from None
    try:
        root: Element = fromstring(text, forbid_dtd=True)
    except (ParseError, DefusedXmlException, ValueError, LookupError) as error:
        raise InputError(f"{path}: is no XML that can be trusted: {type(error).__name__}") from None
    return root


def _by_name(axes: list[Element]) -> list[Element]:
    named = {axis.get("Name"): axis for axis in axes}
    if len(axes) != 6 or set(named) != set(CHANNELS):
        raise InputError(f"holds {len(axes)} axes; a calibration has {', '.join(CHANNELS)}, once each")
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
