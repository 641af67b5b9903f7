"""From readings and poses to a map: the chain of `live`, its touches segmented, located and combined."""

from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np

from probedesign.core.errors import InputError
from probedesign.core.frames import Array, is_pose
from probedesign.estimation.estimate import Estimate
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.model import ProbeModel, Tolerances
from probedesign.live.blocks import Block, WrenchReading
from probedesign.live.datagrams import Parsed
from probedesign.live.outputs.sinks import SCHEMA, Sink
from probedesign.live.poses.base_poses import MAX_DISTANCE, MAX_TIME, BasePoses
from probedesign.live.processing.chain import ProcessingOptions
from probedesign.live.processing.estimates import EstimateUpdate
from probedesign.live.processing.touches import Contact, Phase
from probedesign.live.run import estimate_stream
from probedesign.live.sources.replay import RecordingOptions, open_recording
from probedesign.live.sources.source import Source
from probedesign.live.sources.udp import MAX_SEQUENCE, MAX_WRENCH
from probedesign.mapping.contact_map import MIN_SEPARATION, ContactMap, build_map
from probedesign.mapping.segmentation import TouchSegment, TouchSegmenter
from probedesign.mapping.touch_point import LocatedTouch, locate_touch

#: Least extent of the positions of a base that touches an object [m]: a touch with a free probe before it alone takes
#: some millimetres of travel.
MIN_EXTENT = 1e-3


@dataclass
class LoadedRecording:
    """A recording as a source, read completely before it is processed."""

    title: str  #: description in one line.
    notes: tuple[str, ...]  #: what a user should know about it.
    blocks: tuple[Block, ...]  #: its readings.
    recorded_from: str = ""  #: source stated in the recording; empty if it states none.

    def __iter__(self) -> Generator[Block, None, None]:
        yield from self.blocks


def load_recording(
    path: Path, model: ProbeModel, mend: bool = False, options: RecordingOptions | None = None
) -> LoadedRecording:
    """Return the recording at a path.

    Args:
        path: recording of any kind that `estimate` reads.
        model: the probe it was recorded with.
        mend: accept an incomplete recording.
        options: topic and units of a bag.

    Raises:
        InputError: the file is not a recording of this probe, is incomplete, or is not in the sensor frame.
    """
    opened = open_recording(path, model, options)
    if opened.frame == "base":
        raise InputError(
            f"{path}: is in the base frame, with a gravity correction that depends on the base rotation; explore needs "
            "the sensor frame"
        )
    blocks = tuple(opened.blocks())
    if (missing := opened.missing()) and not mend:
        raise InputError(f"{path}: {'; '.join(missing)}; --mend continues without the missing parts")
    if not any(len(block) for block in blocks):
        raise InputError(f"{path}: contains no readings")
    notes = tuple(dict.fromkeys((*opened.notes, *missing)))
    return LoadedRecording(f"{path}, {opened.description}", notes, blocks, opened.source)


def check_poses(poses: BasePoses, blocks: Iterable[Block]) -> None:
    """Check that there are poses for the time of readings, as far as they are known beforehand.

    Raises:
        InputError: their clocks differ, or the base hardly moves.
    """
    times, read = poses.track.times, np.concatenate([block.time for block in blocks])
    if not times:
        return
    start, end = float(read[0]), float(read[-1])
    if not (times[0] < end and start < times[-1]):
        raise InputError(
            f"the poses span {times[0]:.9g} ... {times[-1]:.9g} s, the readings {start:.9g} ... {end:.9g} s: "
            "the clocks do not overlap; stamp the poses with the clock of the recording"
        )
    p = np.array([pose.p for pose in poses.track.spanning(start, end)])
    if problem := _too_little_motion(float(np.ptp(p, axis=0).max())):
        raise InputError(problem)


def _too_little_motion(extent: float) -> str:
    """Return a line if positions of a base with an extent [m] cannot be those of touches; empty if they can."""
    if not 0.0 < extent < MIN_EXTENT:  # without any motion it is a base at rest
        return ""
    return (
        f"the base moves by {1e3 * extent:.2g} mm in all, too little for touches of several points; are its positions "
        "in metres instead of millimetres?"
    )


@dataclass
class Exploration:
    """The touches of a run, located as they come, and their map."""

    estimator: Estimator  #: of the probe.
    priors: Tolerances | None = None  #: standard deviations of the error sources; those of the estimator if None.
    min_separation: float = MIN_SEPARATION  #: as in `build_map` [m].
    one_object: bool = False  #: whether all touches are of one object, whose compliance is the same everywhere.
    touches: list[LocatedTouch] = field(default_factory=list)  #: touches so far, in order of time.
    gravity_world: Array = field(default_factory=lambda: np.array([0.0, 0.0, -9.81]))  #: of the run [m/s²], (3,).
    _segmenter: TouchSegmenter = field(default_factory=TouchSegmenter)
    n_readings: int = 0  #: number of readings.
    n_without_pose: int = 0  #: number of readings without a pose.
    _low: Array = field(default_factory=lambda: np.full(3, np.inf))
    _high: Array = field(default_factory=lambda: np.full(3, -np.inf))

    def run(
        self,
        source: Source,
        options: ProcessingOptions,
        poses: BasePoses,
        log: Callable[[str], None],
        sink: Sink | None = None,
    ) -> Iterator[LocatedTouch]:
        """Yield each touch when it has ended and the free probe after it has been read.

        Raises:
            InputError: the tare window is invalid, or the source fails.
        """
        self.gravity_world = poses.gravity_world
        try:
            with closing(estimate_stream(self.estimator, source, options, log, sink, None, poses)) as updates:
                for update in updates:
                    yield from self.take(update, log)
        except KeyboardInterrupt:
            log("interrupted; the touches so far are evaluated")
        yield from self.finish(log)

    def take(self, update: EstimateUpdate, log: Callable[[str], None]) -> Iterator[LocatedTouch]:
        """Yield the touch that an estimate completes, if any."""
        self.n_readings += 1
        self.n_without_pose += update.stale == "pose"
        p = update.T_world_base[:3, 3]
        self._low, self._high = np.fmin(self._low, p), np.fmax(self._high, p)
        for segment in self._segmenter.update(update):
            yield self._located(segment, log)

    def finish(self, log: Callable[[str], None]) -> Iterator[LocatedTouch]:
        """Yield the touch that has not ended, if any; what is taken afterwards is another run, with another tare."""
        for segment in self._segmenter.finish():
            yield self._located(segment, log)
        self._segmenter = TouchSegmenter(self._segmenter.count)

    def map(self) -> ContactMap:
        """Return the map of all touches so far."""
        priors = self.priors or self.estimator.priors
        return build_map(self.touches, priors.youngs_modulus, self.min_separation, priors.object_compliance)

    def _located(self, segment: TouchSegment, log: Callable[[str], None]) -> LocatedTouch:
        if problem := _too_little_motion(float((self._high - self._low).max())):
            log(problem)
            touch = LocatedTouch(segment, "inconsistent")
        else:
            priors = self.priors or self.estimator.priors
            touch = locate_touch(segment, self.estimator, priors, self.gravity_world, self.one_object)
        self.touches.append(touch)
        return touch


def followed_update(gravity_world: Array, values: Mapping[str, Any]) -> Parsed[EstimateUpdate | None]:
    """Return the estimate of a datagram of `live --publish udp://`; None for an event or a reading without a pose.

    Args:
        gravity_world: gravity in the world [m/s²], (3,).
        values: content of the datagram.

    Raises:
        InputError: it is none, or of a run without poses.
    """
    sequence = values.get("number")
    if values.get("schema") != SCHEMA or type(sequence) is not int or not 0 <= sequence < MAX_SEQUENCE:
        raise InputError("is not one of `live --publish udp://`")
    if values.get("kind") == "estimate" and "phase" not in values:
        raise InputError("is of a run without poses; start `live` with --pose")
    if values.get("kind") != "estimate" or "T_world_base" not in values:
        return Parsed(None, sequence=sequence)
    try:
        T = np.array(values["T_world_base"], dtype=float).reshape(4, 4)
        wrench = np.array([*values["mount_force_base_N"], *values["mount_moment_base_Nm"]], dtype=float).reshape(6)
        time, touch, phase = float(values["time_s"]), values["touch"], values["phase"]
        contacts = (Contact(int(touch), time),) if touch else ()
        plausible = (np.abs(wrench) <= MAX_WRENCH).all() and (np.abs(T[:3, 3]) <= MAX_DISTANCE).all()
        if not plausible or not abs(time) <= MAX_TIME or not is_pose(T) or phase not in get_args(Phase):
            raise ValueError
    except (KeyError, TypeError, ValueError, OverflowError):
        raise InputError("has no valid pose, wrench, time, phase or touch") from None
    reading = WrenchReading(time, wrench, T[:3, :3].T @ gravity_world)
    update = EstimateUpdate(
        reading, Estimate("no_contact"), phase, T_world_base=T, wrench_base=wrench, contacts=contacts,
        probe=str(values.get("probe", "")),
    )  # fmt: skip
    return Parsed(update, sequence=sequence)


def joint_map(explorations: Mapping[str, Exploration]) -> ContactMap:
    """Return one map of the touches of several probes by their names, each with error sources of its own.

    Touches of one point by two probes are fused as those by one, and what one probe knows better helps the other. So
    does the compliance of one object, for which all probes have the same prior.
    """
    runs = [exploration.touches for exploration in explorations.values()]
    names = [[touch.point.names for touch in touches if touch.point is not None] for touches in runs]
    sizes = [len(known[0]) - (known[0][-1:] == ("object",)) if known else 0 for known in names]
    touches = [
        replace(touch, probe=name, point=touch.point and touch.point.among(sizes, i))
        for i, (name, exploration) in enumerate(explorations.items())
        for touch in exploration.touches
    ]
    touches.sort(key=lambda touch: touch.segment.start)  # they touch at the same time
    first = next(iter(explorations.values()))
    priors = first.priors or first.estimator.priors
    return build_map(touches, priors.youngs_modulus, first.min_separation, priors.object_compliance)
