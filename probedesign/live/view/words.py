"""What there is to say of a moment, the same on the page and in the terminal: numbers with their units."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from probedesign.estimation.estimate import RESULTS
from probedesign.frames import Array
from probedesign.live.answer import Answer
from probedesign.live.view.moment import Mood, Place, Said
from probedesign.units import MILLINEWTON, MM

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
    said = [_result(answer, health)]
    if answer is not None:
        said.append(Said("phase", answer.phase or "not followed"))
        said += _contact(place)
        said += _fused(answer)
        said += _wrench(answer.wrench_base)
    return (*said, *_health(answer, health))


def _result(answer: Answer | None, health: Health) -> Said:
    if health.stale:
        return Said("result", f"stale: nothing read for {health.silence:.1f} s", "bad")
    if answer is None:
        return Said("result", "no estimate yet" if health.taken else "nothing read yet", "fair")
    if health.no_answer:
        return Said("result", "no estimate now: what is shown is old", "bad")
    result = answer.estimate.result
    moods: dict[str, Mood] = {"ok": "good", "no_contact": "plain", "too_light": "fair", "ambiguous": "fair"}
    return Said("result", f"{result}: {RESULTS[result]}", moods.get(result, "bad"))


def _contact(place: Place | None) -> list[Said]:
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


def _fused(answer: Answer) -> list[Said]:
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


def _wrench(wrench: Array) -> list[Said]:
    """What is read at the base."""
    if not np.isfinite(wrench).all():
        return [Said("forces", "–"), Said("moments", "–")]
    return [
        Said("forces", f"{_numbers(wrench[:3], MILLINEWTON)} mN at the base"),
        Said("moments", f"{_numbers(wrench[3:], NEWTON_MM, 2)} N·mm"),
    ]


def _health(answer: Answer | None, health: Health) -> list[Said]:
    fault: list[Said] = [Said("fault", health.fault, "bad")] if health.fault else []
    return [
        *fault,
        Said("rate", _rates(answer, health)),
        _loss(health.counts, health.taken),
        Said("tare", health.tare.removeprefix("tare").lstrip(": ") or "none taken"),
        Said("recording", health.recording.removeprefix("recording ") or "no"),
    ]


def _rates(answer: Answer | None, health: Health) -> str:
    told = [f"{health.rate:.0f} readings/s", f"{health.answers:.0f} estimates/s"]
    if answer is not None and np.isfinite(late := answer.made - answer.reading.received):
        told.append(f"{1e3 * late:.1f} ms from reading to estimate")
    return ", ".join(told).replace("nan", "–")


def _loss(counts: Mapping[str, int], taken: int) -> Said:
    lost = {name: count for name in ("lost", "late", "dropped", "faults") if (count := counts.get(name, 0))}
    told = ", ".join(f"{count} {name}" for name, count in lost.items())
    return Said("loss", f"{told or 'none known'} of {taken} readings", "fair" if lost else "plain")


def _stds(cov: Array) -> Array:
    stds: Array = np.sqrt(np.maximum(np.diag(cov), 0.0))
    return stds


def _numbers(values: Array, unit: float, digits: int = 1) -> str:
    return "(" + ", ".join(f"{float(value) / unit:z.{digits}f}" for value in values) + ")"
