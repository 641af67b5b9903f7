"""`daq://Dev1/ai0:5?cal=FILE`: six gauges at a card, turned to a wrench by ATI's calibration of the sensor."""

from collections.abc import Callable, Generator
from contextlib import closing
from itertools import pairwise
from math import inf, isfinite
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from probedesign.errors import InputError
from probedesign.estimation.model import ProbeModel
from probedesign.frames import Array
from probedesign.live.block import Block, silence
from probedesign.live.calibration import CHANNELS, LIMIT, Calibration, clipped, read_calibration
from probedesign.live.daq.card import GAUGES, Card
from probedesign.live.outage import Outage
from probedesign.live.spec import Parameter, parse_parameters, taken_text

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
