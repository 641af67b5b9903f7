"""Source `daq://Dev1/ai0:5?cal=FILE`: six gauges on a National Instruments card, converted by ATI's calibration.

A calibration file (`.cal`) has the matrix from six gauge voltages to a wrench. Samples are acquired with nidaqmx on the
card's own clock for as long as the source is read.

Source: calibration files of Nano17 sensors, versions 1.0 and 1.1; version 1.1 contains the matrix in both forms.
"""

import re
from collections.abc import Generator
from contextlib import closing
from dataclasses import dataclass
from itertools import pairwise
from math import inf, isfinite
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING
from xml.etree.ElementTree import Element

import numpy as np

from probedesign.core.errors import InputError, MissingDependencyError
from probedesign.core.frames import Array
from probedesign.core.units import FORCE_UNITS, LENGTH_UNITS, TORQUE_UNITS, unit_of
from probedesign.estimation.model import ProbeModel
from probedesign.live import Log
from probedesign.live.blocks import Block, dropout_block
from probedesign.live.sources.netft_configuration import parse_xml
from probedesign.live.sources.source import STALE_TIME, DropoutMonitor, SourceParameter, parse_parameters, range_note

if TYPE_CHECKING:
    from nidaqmx.task import Task


CHANNELS = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")
MAX_FILE_BYTES = 1 << 20
MAX_GAUGE_VOLTS = 9.8  #: Limit of a gauge voltage [V]; beyond it the amplifier clips and the sample is invalid.
#: Maximum condition number of the matrix with rows divided by full scale; a Nano17's is about 2.5.
MAX_CONDITION = 100.0


@dataclass(frozen=True)
class GaugeCalibration:
    """Calibration of one sensor."""

    serial: str  #: serial number of the sensor.
    part: str  #: name of the calibration, as SI-12-0.12.
    matrix: Array  #: wrench [N, N·m] per gauge voltage, about the centre of the tool face, (6, 6).
    ranges: Array  #: range of each channel [N, N·m], (6,).


def read_calibration(path: Path) -> GaugeCalibration:
    """Read a calibration file of either version.

    Without `UserAxis` (1.0), the rows of `Axis` are divided by their scales and shifted by Dz from the transducer's
    own origin to the tool face: Tx += Dz Fy, Ty -= Dz Fx.

    Raises:
        InputError: the file cannot be read, is not a calibration, or contains an impossible one.
        MissingDependencyError: defusedxml is not installed.
    """
    try:
        with path.open("rb") as file:
            text = file.read(MAX_FILE_BYTES)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        why = getattr(error, "strerror", None) or str(error)
        raise InputError(f"{path}: cannot be read as a calibration: {why}") from None
    root = parse_xml(text, path)
    calibration = root.find("Calibration")
    if root.tag != "FTSensor" or calibration is None:
        raise InputError(f"{path}: not an ATI calibration: FTSensor with a Calibration is missing")
    try:
        force = unit_of("ForceUnits", calibration.get("ForceUnits", ""), FORCE_UNITS)
        torque = unit_of("TorqueUnits", calibration.get("TorqueUnits", ""), TORQUE_UNITS)
        user = calibration.findall("UserAxis")
        axes = user or calibration.findall("Axis")
        named = {axis.get("Name"): axis for axis in axes}
        if len(axes) != 6 or set(named) != set(CHANNELS):
            raise InputError(f"has {len(axes)} axes; a calibration has {', '.join(CHANNELS)}, once each")
        rows = [named[name] for name in CHANNELS]
        matrix = np.array([_numbers(row, "values", 6) for row in rows])
        ranges = np.array([_numbers(row, "max", 1)[0] for row in rows]) * np.repeat([force, torque], 3)
        if not user:
            matrix /= np.array([_numbers(row, "scale", 1) for row in rows])
        matrix *= np.repeat([force, torque], 3)[:, None]
        if not user:  # move the origin along z
            transform = calibration.find("BasicTransform")
            if transform is None:
                raise InputError("has neither UserAxis nor BasicTransform, so its origin is unknown")
            turned = [name for name in ("Dx", "Dy", "Rx", "Ry", "Rz") if _numbers(transform, name, 1)[0] != 0.0]
            if turned:
                raise InputError(f"BasicTransform has {', '.join(turned)}; only Dz is supported")
            unit = unit_of("DistUnits", calibration.get("DistUnits", ""), LENGTH_UNITS)
            dz = _numbers(transform, "Dz", 1)[0] * unit
            matrix[3] += dz * matrix[1]
            matrix[4] -= dz * matrix[0]
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    if not (ranges > 0.0).all() or not np.linalg.cond(matrix / ranges[:, None]) < MAX_CONDITION:
        raise InputError(f"{path}: its matrix is singular or its range not positive; is the file complete?")
    return GaugeCalibration(str(root.get("Serial", "")), str(calibration.get("PartNumber", "")), matrix, ranges)


def _numbers(element: Element, name: str, count: int) -> list[float]:
    try:
        values = [float(text) for text in element.get(name, "").split()]
    except ValueError:
        values = []
    if len(values) != count or not np.isfinite(values).all() or (name == "scale" and values[0] == 0.0):
        what = f"{name} of {element.tag} {element.get('Name', '')}".strip()
        raise InputError(f"{what} = {element.get(name, '')[:40]!r} must be {count} numbers")
    return values


GAUGES = 6
INPUT_RANGE = 10.0  #: Range of the card's inputs, ± [V]: that of ATI's amplifiers.
WAIT_TIME = 0.002  #: Time to wait for samples at once [s].
BUFFER_DURATION = 10.0  #: Duration of the driver's buffer [s].
MAX_READ = 0.1  #: Maximum duration of the samples read at once [s].

DRIVER = "NI-DAQmx; get it from ni.com/downloads and restart"
NOT_YET_AVAILABLE = -200284  # SAMPLES_NOT_YET_AVAILABLE
#: Error codes for samples that were overwritten before they were read or transferred.
OVERRUN_CODES = (-200279, -200222, -200361, -200010)


def _devices() -> list[str]:
    """Return the names of the cards that NI's driver reports."""
    try:
        from nidaqmx.errors import DaqError, DaqNotFoundError, DaqNotSupportedError
        from nidaqmx.system import System
    except ImportError:
        raise MissingDependencyError.of_extra("daq://", "nidaqmx", "daq") from None
    try:
        return list(System.local().devices.device_names)
    except DaqNotFoundError:
        raise MissingDependencyError(f"daq:// needs NI's driver {DRIVER}") from None
    except DaqNotSupportedError:
        raise InputError("daq:// requires Windows or Linux: NI has no driver for this system") from None
    except DaqError as error:
        raise InputError(f"daq:// cannot list the cards of NI's driver (error {error.error_code})") from None


PARAMETERS = {"rate_hz": SourceParameter(7000.0, 1.0, 100_000.0)}
NO_SAMPLE = "the card delivers no samples; is another program using its clock?"
SAMPLES_LOST = "samples were lost because reading was too slow; the acquisition restarted, the tare is kept"


class DaqSource:
    """A sensor at six differential inputs of a card, sampled together; see `Source`."""

    def __init__(self, model: ProbeModel, target: str, query: str, log: Log) -> None:
        """Read the calibration and find driver and card; nothing is acquired yet.

        Args:
            model: probe on the sensor.
            target: `//DEVICE/ai0:5`, or six inputs separated by commas.
            query: cal, and the parameters of `PARAMETERS`; a card may only approximate the rate.
            log: callback for messages.

        Raises:
            InputError: the channels, a parameter or the calibration is invalid, or there is no such card.
            MissingDependencyError: nidaqmx or NI's driver is not installed.
        """
        if not target.startswith("//"):
            raise InputError(f"daq:{target}: write daq://Dev1/ai0:5?cal=FILE")
        numbers, texts = parse_parameters("daq:", query, PARAMETERS, {"cal": ()})
        if not texts["cal"]:
            raise InputError(f"daq:{target}: needs its sensor's calibration; write daq:{target}?cal=FT12345.cal")
        self._calibration = read_calibration(Path(texts["cal"]))
        self._rate, self._channels = numbers["rate_hz"], target.removeprefix("//")
        pattern = re.compile(r"\s*([^/,:\s]+)/ai(\d{1,4})(?::(?:ai)?(\d{1,4}))?\s*")
        parts = [match.groups() for part in self._channels.split(",") if (match := pattern.fullmatch(part))]
        count = sum(abs(int(last or first) - int(first)) + 1 for _, first, last in parts)
        cards = {card for card, _, _ in parts}
        if count != GAUGES or len(cards) != 1 or len(parts) <= self._channels.count(","):
            raise InputError(f"daq:{target}: name six inputs of one card, as daq://Dev1/ai0:5?cal=FILE")
        self._name, device, names = f"daq:{target}", cards.pop(), _devices()
        if device.lower() not in (name.lower() for name in names):
            there = f"available are {', '.join(names)}" if names else "none is present"
            raise InputError(f"{self._name}: no card {device}; {there}; NI's tools list and rename them")
        self._gravity, self._log, self._n_read = model.gravity_base, log, 0
        self.title = f"{self._name}, sensor {self._calibration.serial} {self._calibration.part}"
        self.notes = (
            "gauges are assigned in the order of the channels",
            *range_note("calibration", self._calibration.ranges, model),
        )

    def __iter__(self) -> Generator[Block, None, None]:
        dropout, stretch = DropoutMonitor(self._name, self._log, NO_SAMPLE), 0
        offset, last = 0.0, (0.0, -inf)  # time and arrival of the last sample
        with closing(self._acquired()) as stream:
            for volts, start, rate, interrupted in stream:
                if not len(volts):
                    dropout.on_silence(last[1], "still waiting")
                    if dropout.ongoing:
                        yield dropout_block(self._gravity, dropout.reason, stretch)
                    continue
                ticks = np.arange(len(volts)) / rate
                received = monotonic() - ticks[::-1]
                gap = float(received[0]) - last[1]
                if isfinite(gap) and (interrupted or dropout.ongoing):
                    stretch += 1
                    if interrupted:  # the card's clock restarts at zero; the host's clock covers the gap
                        offset = last[0] + max(gap, 1.0 / rate)
                        self._log(f"{self._name}: {SAMPLES_LOST}")
                    if dropout.ongoing:
                        dropout.on_resumed(gap)
                time = offset + start + ticks
                yield from self._blocks(volts, time, received, stretch)
                last = float(time[-1]), float(received[-1])

    def _acquired(self) -> Generator[tuple[Array, float, float, bool], None, None]:
        """Yield samples as they arrive, none after each `STALE_TIME` without one; restart after a buffer overrun.

        They are voltages [V], (n, 6), with the time of the first by the card's clock [s], its rate [Hz], and whether
        samples are missing before them.
        """
        from nidaqmx import Task
        from nidaqmx.constants import AcquisitionType, TerminalConfiguration
        from nidaqmx.errors import DaqError

        interrupted = False
        limits = {"min_val": -INPUT_RANGE, "max_val": INPUT_RANGE}
        differential, continuous = TerminalConfiguration.DIFF, AcquisitionType.CONTINUOUS
        size = max(1000, round(BUFFER_DURATION * self._rate))
        while True:
            try:
                with Task() as task:
                    task.ai_channels.add_ai_voltage_chan(self._channels, terminal_config=differential, **limits)
                    task.timing.cfg_samp_clk_timing(self._rate, sample_mode=continuous, samps_per_chan=size)
                    yield from self._from(task, interrupted)
            except DaqError as error:
                if error.error_code not in OVERRUN_CODES or not self._n_read:
                    line = " ".join(str(error).split("\n\n")[0].split())
                    raise InputError(f"{self._name}: NI's driver reports: {line} (error {error.error_code})") from None
                interrupted = True

    def _from(self, task: "Task", interrupted: bool) -> Generator[tuple[Array, float, float, bool], None, None]:
        from nidaqmx.errors import DaqError
        from nidaqmx.stream_readers import AnalogMultiChannelReader

        rate = float(task.timing.samp_clk_rate)
        reader = AnalogMultiChannelReader(task.in_stream)
        minimum, maximum = max(1, round(WAIT_TIME * rate)), max(1, round(MAX_READ * rate))
        task.start()
        self._n_read = 0
        while True:
            count = int(np.clip(task.in_stream.avail_samp_per_chan, minimum, maximum))
            data = np.empty((GAUGES, count))
            try:
                reader.read_many_sample(data, count, timeout=STALE_TIME)
            except DaqError as error:
                if error.error_code != NOT_YET_AVAILABLE:
                    raise
                data = data[:, :0]
            yield data.T, self._n_read / rate, rate, interrupted
            self._n_read += data.shape[1]
            interrupted = interrupted and not data.shape[1]

    def _blocks(self, volts: Array, time: Array, received: Array, stretch: int) -> Generator[Block, None, None]:
        """Yield samples as wrenches, split where their fault changes."""
        wrench = volts @ self._calibration.matrix.T
        invalid = ~np.hstack([np.abs(volts) <= MAX_GAUGE_VOLTS, np.abs(wrench) <= self._calibration.ranges])
        cuts = np.flatnonzero((invalid[1:] != invalid[:-1]).any(axis=1)) + 1
        for start, end in pairwise([0, *cuts.tolist(), len(time)]):
            part, fault = slice(start, end), ""
            if gauges := ", ".join(str(i) for i in np.flatnonzero(invalid[start, :GAUGES])):
                fault = f"transducer saturated: gauge {gauges} beyond {MAX_GAUGE_VOLTS:g} V"
            elif channels := ", ".join(CHANNELS[i] for i in np.flatnonzero(invalid[start, GAUGES:])):
                fault = f"{channels} beyond the calibrated range"
            yield Block(time[part], wrench[part], self._gravity, received[part], fault, stretch)
