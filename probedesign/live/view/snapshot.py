"""What there is to see at one moment, as plain numbers that may go to another process."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np

from probedesign.estimation.estimate import RESULTS
from probedesign.frames import Array
from probedesign.live.processing.estimates import Answer
from probedesign.units import MILLINEWTON, MM

Mood = Literal["good", "fair", "bad", "plain"]


class Said(NamedTuple):
    """One thing in words.

    Attributes:
        name: what it is about.
        text: what there is to say.
        mood: how it is.
    """

    name: str
    text: str
    mood: Mood = "plain"


def _nan(*shape: int) -> Array:
    return np.full(shape, np.nan)


@dataclass(frozen=True)
class Shape:
    """The bent centreline at the nodes of its solve.

    Attributes:
        s: arclengths, base to tip [m], (k,).
        p_base: points [m], (k, 3).
        R_base: sections, their columns x, y and tangent, (k, 3, 3).
    """

    s: Array
    p_base: Array
    R_base: Array


@dataclass(frozen=True)
class Place:
    """A contact that was located.

    Attributes:
        p_surface: the touched point [m], (3,).
        cov: its covariance [m²], (3, 3).
        force: what the object does to the probe [N], (3,).
        s, std_s: arclength and its standard deviation [m].
        in_world: whether all this is told in the world; else in the base frame.
        time: of the source [s].
        number: of the touch, from one.
        friction_ratio: tangential over normal force; NaN where it is not known.
    """

    p_surface: Array
    cov: Array
    force: Array
    s: float
    std_s: float
    in_world: bool
    time: float
    number: int
    friction_ratio: float = float("nan")


STRIP = ("time", "Fx", "Fy", "Fz", "Mx", "My", "Mz", "s", "std_s", "force")
"""What a row of a strip holds: [s], [N], [N·m], [m], [N]."""


@dataclass(frozen=True)
class Moment:
    """One moment.

    Attributes:
        since: of the last answer, from the first on [s].
        result: of the last answer; empty before the first.
        old: whether what is known of probe and contact is not of now: stale, or too long without an answer.
        words: everything in words.
        shape: of the probe, where the answer tells one.
        place: the contact, where the answer is sure of it.
        touches: the surest place of each touch so far, the last ones.
        T_world_base: pose of the base, (4, 4); NaN if it is not known.
        gravity_base: [m/s²], (3,).
        strip: what came since the last moment, rows of `STRIP`, (j, 10).
        events: what was told last, with the source's time [s].
    """

    since: float = 0.0
    result: str = ""
    old: bool = False
    words: tuple[Said, ...] = ()
    shape: Shape | None = None
    place: Place | None = None
    touches: tuple[Place, ...] = ()
    T_world_base: Array = field(default_factory=lambda: _nan(4, 4))
    gravity_base: Array = field(default_factory=lambda: np.array([0.0, 0.0, -9.81]))
    strip: Array = field(default_factory=lambda: np.empty((0, len(STRIP))))
    events: tuple[tuple[float, str], ...] = ()


NEWTON_MM = 1e-3
"""N·m in a N·mm."""


@dataclass(frozen=True)
class Health:
    """How the run is.

    Attributes:
        stale: no reading for longer than usual.
        no_answer: no answer for longer than usual.
        silence: since the last reading [s].
        rate, answers: readings and answers a second.
        fault: of the last readings.
        taken: readings so far.
        counts: what the source counts.
        tare, recording: what was said of them last; empty if nothing was.
    """

    stale: bool = False
    no_answer: bool = False
    silence: float = float("nan")
    rate: float = float("nan")
    answers: float = float("nan")
    fault: str = ""
    taken: int = 0
    counts: Mapping[str, int] = field(default_factory=dict)
    tare: str = ""
    recording: str = ""


def words_of(answer: Answer | None, place: Place | None, health: Health) -> tuple[Said, ...]:
    """Everything, in the order in which it matters."""
    said = [_result_line(answer, health)]
    if answer is not None:
        said.append(Said("phase", answer.phase or "not followed"))
        said += _contact_lines(place)
        said += _fused_lines(answer)
        said += _wrench_lines(answer.wrench_base)
    return (*said, *_health_lines(answer, health))


def _result_line(answer: Answer | None, health: Health) -> Said:
    if health.stale:
        return Said("result", f"stale: nothing read for {health.silence:.1f} s", "bad")
    if answer is None:
        return Said("result", "no estimate yet" if health.taken else "nothing read yet", "fair")
    if health.no_answer:
        return Said("result", "no estimate now: what is shown is old", "bad")
    result = answer.estimate.result
    moods: dict[str, Mood] = {"ok": "good", "no_contact": "plain", "too_light": "fair", "ambiguous": "fair"}
    return Said("result", f"{result}: {RESULTS[result]}", moods.get(result, "bad"))


def _contact_lines(place: Place | None) -> list[Said]:
    """Where it is; a dash where that is not known, so that the lines keep their places."""
    if place is None:
        return [Said(name, "–") for name in ("contact", "point", "force")]
    frame = "world" if place.in_world else "base"
    return [
        Said("contact", f"s {place.s / MM:.1f} ± {place.std_s / MM:.1f} mm"),
        Said("point", f"{_numbers(place.p_surface, MM)} mm, {frame}; ± {_numbers(_stds(place.cov), MM)} mm"),
        Said("force", f"{float(np.linalg.norm(place.force)) / MILLINEWTON:.1f} mN{_friction(place)}"),
    ]


def _friction(place: Place) -> str:
    """Return the friction in words; empty where the method does not separate it."""
    if not np.isfinite(place.friction_ratio):
        return ""
    return f", tangential over normal {place.friction_ratio:.2f}"


def _fused_lines(answer: Answer) -> list[Said]:
    """What all readings of the touch tell, where they are fused, and why not where they should be."""
    if answer.fused is None:
        return [Said("fused", f"no {answer.stale}", "fair")] if answer.stale else []
    if not answer.fused.ok:
        return [Said("fused", answer.fused.result)]
    return [
        Said(
            "fused",
            f"{_numbers(answer.fused.p_surface_world, MM)} mm, world, ± {answer.fused.rms / MM:.1f} mm",
        )
    ]


def _wrench_lines(wrench: Array) -> list[Said]:
    """What is read at the base."""
    if not np.isfinite(wrench).all():
        return [Said("forces", "–"), Said("moments", "–")]
    return [
        Said("forces", f"{_numbers(wrench[:3], MILLINEWTON)} mN at the base"),
        Said("moments", f"{_numbers(wrench[3:], NEWTON_MM, 2)} N·mm"),
    ]


def _health_lines(answer: Answer | None, health: Health) -> list[Said]:
    fault: list[Said] = [Said("fault", health.fault, "bad")] if health.fault else []
    return [
        *fault,
        Said("rate", _rates(answer, health)),
        _loss_line(health.counts, health.taken),
        Said("tare", health.tare.removeprefix("tare").lstrip(": ") or "none taken"),
        Said("recording", health.recording.removeprefix("recording ") or "no"),
    ]


def _rates(answer: Answer | None, health: Health) -> str:
    told = [f"{health.rate:.0f} readings/s", f"{health.answers:.0f} estimates/s"]
    if answer is not None and np.isfinite(late := answer.made - answer.reading.received):
        told.append(f"{1e3 * late:.1f} ms from reading to estimate")
    return ", ".join(told).replace("nan", "–")


def _loss_line(counts: Mapping[str, int], taken: int) -> Said:
    lost = {name: count for name in ("lost", "late", "dropped", "faults") if (count := counts.get(name, 0))}
    told = ", ".join(f"{count} {name}" for name, count in lost.items())
    return Said("loss", f"{told or 'none known'} of {taken} readings", "fair" if lost else "plain")


def _stds(cov: Array) -> Array:
    stds: Array = np.sqrt(np.maximum(np.diag(cov), 0.0))
    return stds


def _numbers(values: Array, unit: float, digits: int = 1) -> str:
    return "(" + ", ".join(f"{float(value) / unit:z.{digits}f}" for value in values) + ")"
