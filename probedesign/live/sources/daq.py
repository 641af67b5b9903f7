"""nidaqmx, driven: six gauges sampled by the card's own clock for as long as it is wanted."""

import re
from collections.abc import Callable, Generator
from contextlib import closing
from dataclasses import dataclass
from itertools import pairwise
from math import inf, isfinite
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from probedesign.errors import InputError, MissingDependencyError
from probedesign.estimation.model import ProbeModel
from probedesign.frames import Array
from probedesign.live.processing.blocks import Block, silence
from probedesign.live.sources.calibration import CHANNELS, LIMIT, Calibration, clipped, read_calibration
from probedesign.live.sources.dropout import Outage
from probedesign.live.sources.parameters import Parameter, parse_parameters, taken_text

if TYPE_CHECKING:
    from nidaqmx.errors import DaqError
    from nidaqmx.task import Task


GAUGES = 6
INPUT_RANGE = 10.0
"""Of the card's inputs, both ways [V]: what ATI's amplifiers give."""
TICK = 0.002
"""Samples are waited for so long at once [s]."""
BUFFER = 10.0
"""Samples that wait for us in the driver at most [s]."""
MAX_READ = 0.1
"""Samples that are taken at once at most [s]."""
STALE = 0.040
"""Without a sample for so long, what was last estimated is old [s]; told within 50 ms of the last one."""

DRIVER = "NI-DAQmx; get it from ni.com/downloads and restart"
NOT_YET = -200284  # SAMPLES_NOT_YET_AVAILABLE
LAGGED = (-200279, -200222, -200361, -200010)
"""Samples were not taken, or not passed on by the card, before they were written over."""


@dataclass(frozen=True)
class Volts:
    """n samples of the gauges; none where nothing came.

    Attributes:
        volts: (n, 6).
        since: when the first was taken, since the acquisition began, by the card's clock [s].
        rate: of the card's clock [Hz].
        received: when the last came, by `time.monotonic` [s].
        broken: samples are missing before these.
    """

    volts: Array
    since: float
    rate: float
    received: float
    broken: bool = False


class Card:
    """Six inputs of a card, differential, sampled together."""

    def __init__(self, channels: str, rate: float) -> None:
        """Look whether the driver and the card are there; nothing is acquired yet.

        Args:
            channels: as NI names them, `Dev1/ai0:5`, or six in a row with commas between.
            rate: of samples [Hz]; a card may only come near it.

        Raises:
            InputError: these are not six inputs of one card, or there is no such card.
            MissingDependencyError: nidaqmx or NI's driver is not installed.
        """
        self.name = f"daq://{channels}"
        self._channels, self._rate = channels, rate
        self._taken = 0  # since the acquisition began
        device = _device(channels)
        names = _devices()
        if device.lower() not in (name.lower() for name in names):
            there = f"there are {', '.join(names)}" if names else "there is none"
            raise InputError(f"{self.name}: no card {device}; {there}; NI's own tools show and rename them")

    def acquired(self) -> Generator[Volts, None, None]:
        """Samples as they come; none after each `STALE` without one. What the driver overwrote is begun anew.

        Raises:
            InputError: the driver refuses or loses the card.
        """
        from nidaqmx.errors import DaqError

        broken = False
        while True:
            try:
                with self._task() as task:
                    yield from self._from(task, broken)
            except DaqError as error:
                if error.error_code not in LAGGED or not self._taken:
                    raise self._refused(error) from None
                broken = True

    def _from(self, task: "Task", broken: bool) -> Generator[Volts, None, None]:
        from nidaqmx.errors import DaqError
        from nidaqmx.stream_readers import AnalogMultiChannelReader

        rate = float(task.timing.samp_clk_rate)
        reader = AnalogMultiChannelReader(task.in_stream)
        least, most = max(1, round(TICK * rate)), max(1, round(MAX_READ * rate))
        task.start()
        self._taken = 0
        while True:
            count = int(np.clip(task.in_stream.avail_samp_per_chan, least, most))
            data = np.empty((GAUGES, count))
            try:
                reader.read_many_sample(data, count, timeout=STALE)
            except DaqError as error:
                if error.error_code != NOT_YET:
                    raise
                data = data[:, :0]
            yield Volts(data.T, self._taken / rate, rate, monotonic(), broken)
            self._taken += data.shape[1]
            broken = broken and not data.shape[1]

    def _task(self) -> "Task":
        from nidaqmx import Task
        from nidaqmx.constants import AcquisitionType, TerminalConfiguration

        task = Task()
        try:
            task.ai_channels.add_ai_voltage_chan(
                self._channels,
                terminal_config=TerminalConfiguration.DIFF,
                min_val=-INPUT_RANGE,
                max_val=INPUT_RANGE,
            )
            task.timing.cfg_samp_clk_timing(
                self._rate,
                sample_mode=AcquisitionType.CONTINUOUS,
                samps_per_chan=max(1000, round(BUFFER * self._rate)),
            )
        except BaseException:
            task.close()
            raise
        return task

    def _refused(self, error: "DaqError") -> InputError:
        line = " ".join(str(error).split("\n\n")[0].split())
        return InputError(f"{self.name}: NI's driver says: {line} (error {error.error_code})")


def _device(channels: str) -> str:
    """The card whose six inputs these are."""
    cards, count = set(), 0
    for part in channels.split(","):
        found = re.fullmatch(r"\s*([^/,:\s]+)/ai(\d{1,4})(?::(?:ai)?(\d{1,4}))?\s*", part)
        if found is None:
            count = 0
            break
        card, first, last = found.groups()
        cards.add(card)
        count += abs(int(last or first) - int(first)) + 1
    if count != GAUGES or len(cards) != 1:
        raise InputError(f"daq://{channels}: name six inputs of one card, as daq://Dev1/ai0:5?cal=FILE")
    return cards.pop()


def _devices() -> list[str]:
    """The cards that NI's driver knows."""
    try:
        from nidaqmx.errors import DaqError, DaqNotFoundError, DaqNotSupportedError
        from nidaqmx.system import System
    except ImportError:
        raise MissingDependencyError("daq:// needs nidaqmx; install probedesign[daq]") from None
    try:
        return list(System.local().devices.device_names)
    except DaqNotFoundError:
        raise MissingDependencyError(f"daq:// needs NI's driver {DRIVER}") from None
    except DaqNotSupportedError:
        raise InputError("daq:// runs on Windows and Linux alone: NI has no driver for this system") from None
    except DaqError as error:
        raise InputError(f"daq:// cannot ask NI's driver for its cards (error {error.error_code})") from None


PARAMETERS = {"rate_hz": Parameter(7000.0, 1.0, 100_000.0)}
NEVER = "the card gives no sample; is its clock used by another program?"
LOST = "samples were lost because we lagged; the acquisition began anew, the tare is kept"


class DAQ:
    """A sensor at a card.

    Attributes:
        title: one line that says what it is.
        notes: what a user should know of it.
    """

    def __init__(self, model: ProbeModel, place: str, query: str, say: Callable[[str], None]) -> None:
        """Read the calibration, look for the card; nothing is acquired yet.

        Args:
            model: the probe on the sensor.
            place: `//DEVICE/ai0:5`.
            query: cal, zero_V, and parameters as `PARAMETERS` has them.
            say: takes what happens.

        Raises:
            InputError: the channels, a parameter or the calibration is wrong, or there is no such card.
            MissingDependencyError: nidaqmx or NI's driver is not installed.
        """
        if not place.startswith("//"):
            raise InputError(f"daq:{place}: write daq://Dev1/ai0:5?cal=FILE")
        cal, query = taken_text("daq:", query, "cal")
        zero, query = taken_text("daq:", query, "zero_V")
        rate = parse_parameters("daq:", query, PARAMETERS)["rate_hz"]
        if not cal:
            raise InputError(
                f"daq:{place}: needs its sensor's calibration; write daq:{place}?cal=FT12345.cal"
            )
        self.calibration: Calibration = read_calibration(Path(cal))
        self._zero = _zero(zero)
        self._card = Card(place.removeprefix("//"), rate)
        self._gravity, self._say = model.gravity_base, say
        self.title = f"{self._card.name}, sensor {self.calibration.serial} {self.calibration.part}"
        self.notes = (
            "gauges are taken in the order of the channels",
            *_other_sensor(self.calibration, model),
        )

    def __iter__(self) -> Generator[Block, None, None]:
        outage, stretch = Outage(self._card.name, self._say, NEVER), 0
        begun, last = 0.0, (0.0, -inf)  # time and arrival of the last sample
        with closing(self._card.acquired()) as stream:
            for found in stream:
                if not len(found.volts):
                    outage.silent(last[1], "still waiting")
                    if outage.lasts:
                        yield silence(self._gravity, outage.why, stretch)
                    continue
                ticks = np.arange(len(found.volts)) / found.rate
                received = found.received - ticks[::-1]
                gap = float(received[0]) - last[1]
                if isfinite(gap) and (found.broken or outage.lasts):
                    stretch += 1
                    if found.broken:  # its clock counts from zero again; the host's bridges what is missing
                        begun = last[0] + max(gap, 1.0 / found.rate)
                        self._say(f"{self._card.name}: {LOST}")
                    if outage.lasts:
                        outage.over(gap)
                time = begun + found.since + ticks
                yield from self._blocks(found.volts, time, received, stretch)
                last = float(time[-1]), float(received[-1])

    def _blocks(
        self, volts: Array, time: Array, received: Array, stretch: int
    ) -> Generator[Block, None, None]:
        """Samples as wrenches, cut where what is wrong with them is another."""
        wrench = self.calibration.wrench(volts, self._zero)
        wrong = np.hstack([clipped(volts), ~(np.abs(wrench) <= self.calibration.ranges)])
        cuts = np.flatnonzero((wrong[1:] != wrong[:-1]).any(axis=1)) + 1
        for start, end in pairwise([0, *cuts.tolist(), len(time)]):
            part = slice(start, end)
            fault = _fault(wrong[start])
            yield Block(time[part], wrench[part], self._gravity, received[part], fault, stretch)


def _fault(wrong: NDArray[np.bool_]) -> str:
    """What is wrong with a sample: gauges at the amplifier's limit, or channels beyond what was calibrated."""
    gauges = ", ".join(str(i) for i in np.flatnonzero(wrong[:GAUGES]))
    if gauges:
        return f"transducer saturated: gauge {gauges} beyond {LIMIT:g} V"
    channels = ", ".join(CHANNELS[i] for i in np.flatnonzero(wrong[GAUGES:]))
    return f"{channels} beyond the calibrated range" if channels else ""


def _zero(text: str) -> Array:
    """The gauges' voltages without a load [V], (6,); none are taken off where none are said."""
    if not text:
        return np.zeros(GAUGES)
    try:
        volts = np.array([float(part) for part in text.split(",")])
    except ValueError:
        volts = np.full(GAUGES, np.nan)
    if volts.shape != (GAUGES,) or clipped(volts).any():
        raise InputError(
            f"daq: zero_V = {text[:60]!r} must be {GAUGES} voltages within {LIMIT:g} V, with commas"
        )
    return volts


def _other_sensor(calibration: Calibration, model: ProbeModel) -> tuple[str, ...]:
    """A note if the calibration reaches further or less far than the probe's sensor."""
    if np.allclose(calibration.ranges, model.wrench_range, rtol=0.01):
        return ()
    told = ", ".join(f"{value:g}" for value in calibration.ranges)
    return (
        f"the calibration reaches {told} N, Nm, not what the frozen probe's sensor does: is it its file?",
    )
