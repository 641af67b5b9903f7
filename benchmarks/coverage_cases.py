"""Rows of the tables of `python -m benchmarks coverage`: error sources, friction, forces and model errors."""

from dataclasses import dataclass, replace
from functools import partial

from benchmarks.reference_probes import SOURCES

DECADES = {"2-10 mN": (2e-3, 1e-2), "10-100 mN": (1e-2, 1e-1), "0.1-1 N": (1e-1, 1.0)}
"""Ranges of the magnitude of the force [N]."""
ALL_SOURCES = tuple(SOURCES)
SINGLE_SOURCES = tuple(source for source in ALL_SOURCES if source != "robot")
"""Error sources of a single touch, whose point is in the base frame."""


@dataclass(frozen=True)
class Case:
    """One row of a table."""

    group: str  #: group, name: title of the table and label of the row.
    name: str
    sources: tuple[str, ...] = ()  #: error sources that are drawn.
    friction: float | None = None  #: tangential over normal force, in a random direction; None draws it from the prior.
    forces: tuple[float, float] = (2e-3, 1.0)  #: smallest and largest force of a single touch [N].
    std_factor: float = 1.0  #: true over stated standard deviations.
    #: place, newtons: of fused touches: place over the length and largest normal force [N]; 0 for single touches.
    place: float = 0.0
    newtons: float = 0.0
    kind: str = "estimate"  #: "estimate", "moments", "all six" or "tracker".
    sticks: bool = False  #: whether the touched material point stays the same during a press.
    anew: bool = False  #: whether the direction of the friction is drawn anew at each touch of a press.
    #: relative standard deviation stated for E and G of fused touches; None for the design's.
    youngs_modulus: float | None = None
    #: "" or a condition that no single contact within the priors explains: "stiffness" (E and G are off), "pull" (a
    #: force away from the object), "moved" (the object moves), "bias" (the bias jumps).
    model_error: str = ""


def single_cases() -> list[Case]:
    """Return the rows of single touches."""
    by_source = partial(Case, "One touch, by error source; friction drawn from the prior")
    cases = [by_source("sensor noise alone")]
    cases += [by_source(source, (source,)) for source in SINGLE_SOURCES]
    cases += [
        by_source("all together", SINGLE_SOURCES),
        by_source("all, true spread twice the stated", SINGLE_SOURCES, std_factor=2.0),
    ]
    for title, sources in (("sensor noise alone", ()), ("all error sources", SINGLE_SOURCES)):
        group = f"One touch, by friction and force; {title}"
        for mu in (0.0, 0.2, 0.5, 0.8, None):
            name = "drawn from the prior" if mu is None else f"{mu:g}"
            cases += [Case(group, f"friction {name}, {decade}", sources, mu, forces)
                      for decade, forces in DECADES.items()]  # fmt: skip
    return cases


def fused_cases() -> list[Case]:
    """Return the rows of fused touches of the large probe."""
    cases, some = [], ("E", "G", "drift", "robot")
    of = partial(Case, "Five touches of the large probe, 3 % on E and G, 0.01 mm poses, drift", sources=some,
                 youngs_modulus=0.03)  # fmt: skip
    for place in (0.5, 0.8):
        for newtons in (2e-3, 5e-3):
            for kind in ("all six", "moments"):
                name = f"{place:g} L, up to {1e3 * newtons:g} mN, {kind}, friction "
                cases += [of(name=f"{name}{mu:g}", friction=mu, place=place, newtons=newtons, kind=kind)
                          for mu in (0.0, 0.3, 0.6)]  # fmt: skip
    at = partial(replace, of(name="", place=0.8, newtons=5e-3, kind="all six"))
    cases += [at(name=f"0.8 L, up to 5 mN, all six, friction {mu:g}, anew at each touch", friction=mu, anew=True)
              for mu in (0.3, 0.6)]  # fmt: skip
    cases.append(at(name="0.8 L, up to 5 mN, all six, friction 0.6, E to 0.5 %", friction=0.6, youngs_modulus=0.005))
    cases.append(at(name="0.8 L, up to 5 mN, all six, friction 0.3, sticks", friction=0.3, sticks=True))
    cases.append(at(name="0.8 L, up to 5 mN, tracker, friction 0.3", friction=0.3, kind="tracker"))
    every = at(group="Five touches of the large probe, 0.8 L, up to 5 mN, all six; friction drawn from the prior",
               youngs_modulus=None)  # fmt: skip
    cases.append(replace(every, name="sensor noise alone", sources=()))
    cases += [replace(every, name=source, sources=(source,)) for source in ALL_SOURCES]
    cases.append(replace(every, name="all together", sources=ALL_SOURCES))
    cases.append(replace(every, name="all together, moments alone", sources=ALL_SOURCES, kind="moments"))
    cases.append(replace(every, name="all together, tracker", sources=ALL_SOURCES, kind="tracker"))
    cases.append(replace(every, name="all, true spread twice the stated", sources=ALL_SOURCES, std_factor=2.0))
    return cases


def model_error_cases() -> list[Case]:
    """Return the rows of readings that the estimators should refuse."""
    single = Case("Readings that no single contact explains, all error sources", "", SINGLE_SOURCES)
    press = replace(single, sources=ALL_SOURCES, place=0.8, newtons=5e-3, kind="all six")
    return [
        replace(single, name="one touch, E and G off by 20 %", model_error="stiffness"),
        replace(single, name="one touch that pulls", model_error="pull"),
        replace(press, name="five touches, E and G off by 20 %", model_error="stiffness"),
        replace(press, name="five touches, the object moves by 1 mm", model_error="moved"),
        replace(press, name="five touches, the bias jumps by 5 steps", model_error="bias"),
    ]
