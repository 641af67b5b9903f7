"""From blocks of raw readings to answers: pose and gravity, tare, filter, phases and fusion, estimate.

What comes out does not depend on how the source cuts its blocks: everything goes on in batches of so many samples as
are averaged to one reading, so that a replay gives the same answers.
"""

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from time import monotonic

import numpy as np

from probedesign.errors import InputError
from probedesign.estimation.estimate import Estimate
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.fused import FusedEstimate
from probedesign.live.poses.base_poses import Poses
from probedesign.live.processing.blocks import Batch, Batches, Block, Reading
from probedesign.live.processing.estimates import Answer, locate
from probedesign.live.processing.low_pass import LowPass
from probedesign.live.processing.scheduler import MAX_AGE, Due, Plan
from probedesign.live.processing.tare import ASKED, Tare, Taring, Window, describe_tare, without_bias
from probedesign.live.processing.touches import Contact, Contacts, Say, Seen, Watch

FEWEST = 8
"""Samples from which the source's rate is told, before anything else."""
RECENT = 1000
"""Batches of a tare's window that the test for touches learns from, at most: the last."""
MANY = 500.0
"""Means a second beyond which somebody forgot to average."""


class Chain:
    """Answers as the blocks come.

    Attributes:
        tare: taken from every reading; None where none was.
        due: counts the estimates that were due.
    """

    def __init__(self, estimator: Estimator, plan: Plan, poses: Poses | None, say: Say) -> None:
        """Begin.

        Args:
            estimator: of the probe.
            plan: what to do with the readings.
            poses: of the base; None if it stands as the frozen probe or the source says.
            say: takes each line that a user should know.
        """
        self.tare: Tare | None = None
        self._estimator, self._plan, self._poses, self._say = estimator, plan, poses, say
        self._batches, self._waiting = Batches(plan.samples), deque[Batch]()
        self._taring = Taring(plan.window, estimator) if plan.window is not None else None
        self._free = deque[Batch](maxlen=RECENT)
        self._contacts = Contacts()
        self._watch: Watch | None = None
        self._low_pass: LowPass | None = None
        self._rate = self._first = math.nan
        self._now = -math.inf
        self.due = Due(plan.rate, say, MAX_AGE if plan.estimates else math.inf)
        self._stretch = 0
        self._seen = Seen("", None)
        self._lacks_pose = False

    @property
    def contacts(self) -> tuple[Contact, ...]:
        """Every touch so far."""
        return self._contacts.so_far

    def take(self, block: Block) -> Iterator[Answer]:
        """Answers that a block completes."""
        if len(block) == 0:
            return
        self._now = float(block.time[-1])
        held, now = len(self._waiting), monotonic()  # for want of a pose
        if self._poses is not None:
            self._poses.refresh(block)
        self._waiting.extend(self._batches.cut(block))
        if math.isnan(self._rate) and not self._began():
            return
        while self._waiting and not self._awaits_pose(self._waiting[0].reading.time):
            yield from self._step(self._waiting.popleft(), now if held > 0 else -math.inf)
            held -= 1

    def ended(self) -> Iterator[Answer]:
        """Those that are left when the source has ended.

        Raises:
            InputError: the tare's window was not over, and is no good.
        """
        while self._waiting:
            yield from self._step(self._waiting.popleft(), math.inf)
        if self._taring is not None and not self._taring.asked:
            self._say(describe_tare(self._taring.tare()))

    def take_tare(self) -> None:
        """Take a tare from the readings that come next; what comes of it is told."""
        if math.isnan(self._first) or self._taring is not None:
            return self._say("tare: not now, one is being taken")
        if self._refused():
            return
        start = self._now - self._first
        self._taring = Taring(Window(start, start + ASKED), self._estimator, asked=True)
        self._say(f"tare: keep the probe free and still for {ASKED:g} s")

    # before the first batch goes on

    def _began(self) -> bool:
        """Whether enough is there to tell the rate; if so, all that needs it is made."""
        needed = math.ceil(FEWEST / self._plan.samples)
        if len(self._waiting) < needed:
            return False
        time = np.concatenate([batch.block.time for batch in islice(self._waiting, needed)])
        step = float(np.median(np.diff(time))) or float(time[-1] - time[0]) / (len(time) - 1)
        self._rate = 1.0 / step if step > 0.0 else math.inf
        if math.isinf(self._rate):
            self._say("the source's clock stands still: no phases, no filter")
            return True
        if self._rate / self._plan.samples > MANY:
            fits = self._estimator.model.averaging_samples
            self._say(f"{self._rate:.0f} readings/s: --average {fits} is what the probe's noise counts")
        if self._plan.filter_hz is not None:
            self._low_pass = LowPass(self._plan.filter_hz, self._rate)
            delay = 1e3 * self._low_pass.delay
            self._say(f"low-pass {self._plan.filter_hz:g} Hz: estimates tell of {delay:.1f} ms before")
        self._anew()
        return True

    def _anew(self) -> None:
        """Watch with nothing seen yet."""
        self._watch = Watch(
            self._estimator, self._contacts, self._rate, self._plan.samples, self._poses, self._say,
            self._plan.estimates,
        )  # fmt: skip

    # one batch

    def _step(self, batch: Batch, ready: float) -> Iterator[Answer]:
        """The answer of a batch, if one is due; for when it was ready see `Due.wants`."""
        if math.isnan(self._first):
            self._first = batch.reading.time
        whole = replace(batch.reading, fault=batch.reading.fault or self._limit(batch.block))
        reading = self._placed(whole)
        self._say_pose(reading)
        if reading.stretch != self._stretch:
            self._interrupted(reading.stretch)
        smooth = self._filtered(batch.block, whole)
        self._gather(Batch(batch.block, reading))
        if self._taring is not None and not self._taring.asked:
            return
        self._seen = self._see(Batch(batch.block, reading))
        if self.due.wants(reading, ready):
            yield self._answer(reading if smooth is None else self._placed(smooth))

    def _answer(self, reading: Reading) -> Answer:
        """Of a reading, filtered or not, and of what is seen by now."""
        estimate = Estimate("unobservable")
        if self._plan.estimates:
            estimate = locate(self._estimator, reading, self.tare, self._plan.method)
            self._contacts.locate(estimate, self._seen.phase)
        T = None if self._poses is None else self._poses.at(reading.time)
        free_of_bias = without_bias(reading, self.tare).wrench_sensor
        wrench = self._estimator.model.to_base(free_of_bias, reading.gravity_base)
        return Answer(
            reading,
            estimate,
            self._seen.phase,
            self._seen.fused,
            np.full((4, 4), np.nan) if T is None else T,
            wrench if not reading.fault else np.full(6, np.nan),
            monotonic(),
            "pose" if self._poses is not None and T is None else "",
            self.contacts,
        )

    def _limit(self, block: Block) -> str:
        """What is wrong with a batch of which a single sample is at its limit: its mean would not show it."""
        within = np.abs(block.wrench_sensor) <= self._estimator.model.readable
        return "" if within.all() else "a channel is at its limit or no number"

    def _placed(self, reading: Reading) -> Reading:
        """The reading with gravity as the base is turned then, or with a fault where that is not known."""
        if self._poses is None:
            return reading
        T = self._poses.at(reading.time)
        if T is None:
            return replace(reading, fault=reading.fault or self._poses.why(reading.time))
        return replace(reading, gravity_base=self._poses.gravity(T))

    def _say_pose(self, reading: Reading) -> None:
        """Tell when poses begin to lack and when they are there again."""
        if self._poses is None or (lacks := self._poses.at(reading.time) is None) == self._lacks_pose:
            return
        self._lacks_pose = lacks
        why = self._poses.why(reading.time) + "; no estimate until there is one"
        self._say(why if lacks else "the base's pose is known again")

    def _interrupted(self, stretch: int) -> None:
        """Readings are missing before this one."""
        self._stretch = stretch
        if self._low_pass is not None:
            self._low_pass.rest()
        if self._watch is not None:
            self._watch.interrupted()

    def _filtered(self, block: Block, reading: Reading) -> Reading | None:
        """The reading through the filter, of the moment that it tells of; None without a filter."""
        if self._low_pass is None:
            return None
        if reading.fault:
            self._low_pass.rest()
            return reading
        wrench = self._low_pass.run(block.wrench_sensor).mean(axis=0)
        return replace(reading, time=reading.time - self._low_pass.delay, wrench_sensor=wrench)

    def _gather(self, batch: Batch) -> None:
        """Let the tare that is being taken, if one is, have a reading; take it when its window is over."""
        taring, reading = self._taring, batch.reading
        if taring is None or (taring.asked and self._refused()):
            return
        if not taring.over(reading, reading.time - self._first):
            self._free.append(batch)
            return
        free, self._taring = tuple(self._free), None
        self._free.clear()
        try:
            self.tare = taring.tare()
        except InputError as error:
            if not taring.asked:
                raise
            return self._say(f"tare refused: {error}")
        self._say(describe_tare(self.tare))
        self._contacts.follow(reading.time, "", None)
        if self._watch is not None:
            self._anew()
            since = self._first + taring.window.start
            self._watch.learn([b for b in free if b.reading.time >= since], self.tare)

    def _refused(self) -> bool:
        """Whether a tare that is asked for is refused, since the probe is not free; that is told. Before the first
        tare nobody knows: a bias looks like a touch."""
        phase = self._seen.phase
        if self.tare is None or phase in ("", "free"):
            return False
        self._taring = None
        self._free.clear()
        self._say(f"tare refused: the probe is {phase}; the tare from before is kept")
        return True

    def _see(self, batch: Batch) -> Seen:
        """What the watch sees; nothing where a reading has a fault."""
        if self._watch is None or batch.reading.fault:
            return Seen("", None if self._poses is None else FusedEstimate("out_of_range"))
        T = None if self._poses is None else self._poses.at(batch.reading.time)
        return self._watch.see(batch, self.tare, T)

    def _awaits_pose(self, time: float) -> bool:
        return self._poses is not None and self._poses.awaits(time, self._now)
