"""From readings and poses to points: the chain of `live`, its touches gathered and fused, all of them one cloud."""

import math
from collections.abc import Callable, Generator, Iterator
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

from probedesign.errors import InputError
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.model import ProbeModel
from probedesign.estimation.tolerances import Tolerances
from probedesign.live.outputs.sinks import Sink
from probedesign.live.poses.base_poses import BasePoses
from probedesign.live.poses.open_poses import FIXED
from probedesign.live.processing.blocks import Block
from probedesign.live.processing.scheduler import ProcessingOptions
from probedesign.live.run import estimate_stream
from probedesign.live.sources.replay import RecordingOptions, open_recording
from probedesign.live.sources.source import Source
from probedesign.mapping.contact_map import APART, Cloud, cloud_of
from probedesign.mapping.segmentation import Gathering, Series
from probedesign.mapping.touch_point import Touched, touched

Say = Callable[[str], None]


@dataclass
class Played:
    """A recording as a source: read whole before anything is made of it.

    Attributes:
        title: one line that says what it is.
        notes: what a user should know of it.
        held: its readings.
        recorded_from: what it was read from, by its own words; empty where it does not say.
    """

    title: str
    notes: tuple[str, ...]
    held: tuple[Block, ...]
    recorded_from: str = ""

    def __iter__(self) -> Generator[Block, None, None]:
        yield from self.held

    @property
    def span(self) -> tuple[float, float]:
        """From the first reading to the last [s]."""
        times = [block.time for block in self.held if len(block)]
        return float(times[0][0]), float(times[-1][-1])


def play(path: Path, model: ProbeModel, mend: bool = False, choice: RecordingOptions | None = None) -> Played:
    """The recording at a path.

    Args:
        path: of any kind that `estimate` reads.
        model: the probe it was recorded with.
        mend: go on with a recording that lacks something.
        choice: what of a bag is read.

    Raises:
        InputError: it is no recording, not of this probe, lacks something, or is not told in the sensor's frame.
    """
    recorded = open_recording(path, model, choice)
    if recorded.frame == "base":
        raise InputError(
            f"{path}: is told in the base frame, less a weight that hangs as the base is turned; explore needs the "
            "sensor's frame"
        )
    held = tuple(block for block in recorded.blocks())
    if (lacking := recorded.missing()) and not mend:
        raise InputError(f"{path}: {'; '.join(lacking)}; --mend goes on without what is missing")
    if not any(len(block) for block in held):
        raise InputError(f"{path}: holds no readings")
    notes = tuple(dict.fromkeys((*recorded.notes, *lacking)))
    return Played(f"{path}, {recorded.description}", notes, held, recorded.source)


def check_poses(poses: BasePoses | None, span: tuple[float, float] | None) -> BasePoses:
    """The poses, that there must be, at the time of the readings.

    Args:
        poses: as they were opened.
        span: of the readings' times [s], where it is known beforehand.

    Raises:
        InputError: there are none, or by another clock.
    """
    if poses is None:
        raise InputError(
            f"--pose {FIXED}: points of the world need the base's poses; say --pose FILE.csv, a ROS 2 bag or udp://:PORT"
        )
    times = poses.track.times
    if span is not None and times and not (times[0] < span[1] and span[0] < times[-1]):
        raise InputError(
            f"poses are told for {times[0]:.9g} ... {times[-1]:.9g} s, the readings for {span[0]:.9g} ... "
            f"{span[1]:.9g} s: the clocks do not overlap; stamp the poses by the recording's clock"
        )
    return poses


@dataclass
class Exploration:
    """Touches as they come, and the cloud that they make.

    Attributes:
        estimator: of the probe.
        priors: standard deviations of the error sources; those of the estimator if None.
        apart: as in `cloud_of` [m].
        touches: every touch so far, in the order of time.
        readings: how many there were.
        placeless: how many of them without a pose.
    """

    estimator: Estimator
    priors: Tolerances | None = None
    apart: float = APART
    touches: list[Touched] = field(default_factory=list)
    readings: int = 0
    placeless: int = 0

    def run(
        self, source: Source, plan: ProcessingOptions, poses: BasePoses, say: Say, sink: Sink | None = None
    ) -> Iterator[Touched]:
        """Each touch when it is over, and the free probe after it has been read.

        Raises:
            InputError: the tare's window is no good, or the source fails.
        """
        gathering = Gathering()
        try:
            with closing(estimate_stream(self.estimator, source, plan, say, sink, None, poses)) as answers:
                for answer in answers:
                    self.readings += 1
                    self.placeless += answer.stale == "pose"
                    for series in gathering.take(answer):
                        yield self._touched(series, poses)
        except KeyboardInterrupt:
            say("interrupted: what was touched by now is told")
        for series in gathering.ended():
            yield self._touched(series, poses)

    def cloud(self) -> Cloud:
        """Return all points by now."""
        return cloud_of(self.touches, self._priors.youngs_modulus, self.apart)

    @property
    def _priors(self) -> Tolerances:
        return self.estimator.priors if self.priors is None else self.priors

    def _touched(self, series: Series, poses: BasePoses) -> Touched:
        found = touched(series, self.estimator, self._priors, poses.gravity_world)
        self.touches.append(found)
        return found


def check_apart(millimetres: float) -> float:
    """How far points of the object lie from each other at least [m].

    Raises:
        InputError: no such number can be meant.
    """
    if not 0.0 <= millimetres < math.inf:
        raise InputError(f"--apart-mm {millimetres:g} must not be negative; 0 fuses no touches")
    return 1e-3 * millimetres
