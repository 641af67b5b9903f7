"""Equilibria of the paper's large probe: the compiled rod beside the other ways to solve it."""

from collections.abc import Callable, Sequence
from functools import partial
from importlib.util import find_spec
from typing import NamedTuple

import numpy as np

from benchmarks.cases import GRAVITY, Load, bare_large, paper_loads
from benchmarks.inside import BESIDE, COPIES, NODES, Request, solver
from benchmarks.peers.collocation import solve_by_bvp
from benchmarks.peers.shooting import shoot_rk45
from benchmarks.timing import digits, interleaved, print_table, shown, spread
from probedesign.core.frames import Array
from probedesign.rod.rod import Rod

ROUNDS = 9
STATIONS = 31
OURS, INSIDE = "Rod.solve", "the kernel of Rod.solve, shape included"
TARGETS = {"RK45 shooting": 5000.0, "solve_bvp": 500.0, "Exudyn": 1000.0}
"""How many times as long as ours inside the kernel each peer should take, by how its rows begin."""
EXUDYN_ELEMENTS = (25, 50, 100, 200, 1600)
"""200 come within about 1 µm; the last about as close as ours."""
NEW_PLACE = 200
"""Elements of the row that builds them too."""
ELASTICA = {"documented clamp, 100 elements": (100, 0.0), "clamp at the first element's middle, 50": (50, 0.5),
            "clamp at the first element's middle, 100": (100, 0.5)}  # fmt: skip

CALLS = ("cold", "from a neighbouring load", "the same with the Jacobian by force and s_contact",
         "the same with all derivatives")  # fmt: skip

Centreline = tuple[Array, Array]
"""Stations [m], (k,), and the points there [m], (k, 3)."""


class Method(NamedTuple):
    """One way to solve a case: what is timed, its centreline, and how many cases are timed at once."""

    timed: Callable[[], object]
    centreline: Callable[[], Centreline]
    copies: int = 1


class Found(NamedTuple):
    """What came of one method on one case: median time [s], worst distance from the converged centreline [m]."""

    seconds: float
    error: float


def methods(rod: Rod, load: Load) -> dict[str, Method | None]:
    """Every row of the table; None where a package is not installed."""
    return {**ours(rod, load), **by_scipy(rod, load), **by_exudyn(rod, load), **by_elastica(rod, load)}


def ours(rod: Rod, load: Load) -> dict[str, Method]:
    """The compiled rod, from no load."""
    s = np.linspace(0.0, rod.length, STATIONS)
    fast = partial(rod.solve, GRAVITY, load.force, load.s)
    reference = partial(rod.solve, GRAVITY, load.force, load.s, mode="reference")
    return {
        INSIDE: Method(solver(rod, load, Request(room=NODES)), lambda: (s, fast().p_at(s)), COPIES),
        OURS: Method(fast, lambda: (s, fast().p_at(s))),
        'Rod.solve(mode="reference")': Method(reference, lambda: (s, reference().p_at(s))),
    }


def by_scipy(rod: Rod, load: Load) -> dict[str, Method]:
    """Shooting at RK45's default tolerance, which misses 1 µm, and at one that keeps it; collocation."""
    s = np.linspace(0.0, rod.length, STATIONS)
    case = (rod, GRAVITY, load.force, load.s, s)
    solvers = {
        "RK45 shooting, rtol 1e-3": partial(shoot_rk45, *case, 1e-3),
        "RK45 shooting, rtol 1e-5": partial(shoot_rk45, *case, 1e-5),
        "solve_bvp, tol 1e-3": partial(solve_by_bvp, *case, 1e-3),
    }
    return {name: Method(solver, lambda solver=solver: (s, solver())) for name, solver in solvers.items()}


def by_exudyn(rod: Rod, load: Load) -> dict[str, Method | None]:
    """Beam elements, their model built beforehand; at last with building it, as a new s_contact makes it do."""
    if find_spec("exudyn") is None:
        return {"Exudyn": None}
    from benchmarks.peers import exudyn

    rows: dict[str, Method | None] = {}
    for count in EXUDYN_ELEMENTS:
        solver = partial(exudyn.solve, exudyn.build(rod, GRAVITY, load.force, load.s, count))
        rows[f"Exudyn, {count} elements"] = Method(solver, solver)

    def whole() -> Centreline:
        return exudyn.solve(exudyn.build(rod, GRAVITY, load.force, load.s, NEW_PLACE))

    return {**rows, f"Exudyn, {NEW_PLACE} elements and building them": Method(whole, whole)}


def by_elastica(rod: Rod, load: Load) -> dict[str, Method | None]:
    """A swinging rod brought to rest."""
    if find_spec("elastica") is None:
        return {"PyElastica": None}
    from benchmarks.peers.pyelastica import relax

    rows: dict[str, Method | None] = {}
    for name, (elements, behind) in ELASTICA.items():
        solver = partial(relax, rod, GRAVITY, load.force, load.s, elements, behind)
        rows[f"PyElastica, {name}"] = Method(solver, solver)
    return rows


def measure(rod: Rod, load: Load) -> dict[str, Found | None]:
    """All methods on one case."""
    truth = rod.solve(GRAVITY, load.force, load.s, mode="reference")
    tried = methods(rod, load)
    seconds = interleaved({name: method.timed for name, method in tried.items() if method}, ROUNDS)
    found: dict[str, Found | None] = {}
    for name, method in tried.items():
        found[name] = None
        if method:
            s, p = method.centreline()
            found[name] = Found(
                seconds[name] / method.copies, float(np.linalg.norm(p - truth.p_at(s), axis=1).max())
            )
    return found


def compared(rod: Rod) -> list[dict[str, Found | None]]:
    """All methods on every load."""
    return [measure(rod, load) for load in paper_loads(rod)]


def print_compared(found: Sequence[dict[str, Found | None]]) -> None:
    """Print the table of ratios."""
    print_table(
        f"One equilibrium of the large probe, cold, under {len(found)} loads of the paper: from the least to the most. "
        f"Medians of up to {ROUNDS} interleaved rounds",
        ["method", "time", "error µm", f"× {OURS}", "× its kernel", "target of the kernel"],
        [row(name, found) for name in found[0]],
    )
    print("  error: largest distance from the converged centreline (Rod.solve in reference mode, "
          "itself within 1e-11 L of tests/reference/shooting.py; tests/rod/test_shooting.py)\n"
          "  target: of every load, and ours at equal or better error")  # fmt: skip


def row(name: str, found: Sequence[dict[str, Found | None]]) -> list[str]:
    """One method's line from what came of all on every case."""
    peer = [theirs for case in found if (theirs := case[name])]
    if not peer:
        return [name, "not installed: pip install '.[bench]'", "", "", "", ""]
    least = next((times for start, times in TARGETS.items() if name.startswith(start)), None)
    inside = ratios(name, found, INSIDE)
    verdict = ""
    if least:
        reached = fair(name, found) and min(inside) >= least
        verdict = f"≥ {least:g}: {'reached' if reached else 'missed'}"
    return [
        name,
        spread([theirs.seconds for theirs in peer], shown),
        spread(
            [theirs.error for theirs in peer],
            lambda error: "< 0.001" if error < 1e-9 else digits(error / 1e-6),
        ),
        spread(ratios(name, found, OURS), digits),
        spread(inside, digits),
        verdict,
    ]


def ratios(name: str, found: Sequence[dict[str, Found | None]], ours: str) -> list[float]:
    """How many times as long as ours a method took, on every case."""
    pairs = [(case[name], case[ours]) for case in found]
    return [theirs.seconds / our.seconds for theirs, our in pairs if theirs and our]


def fair(name: str, found: Sequence[dict[str, Found | None]]) -> bool:
    """Whether a method is nowhere closer to the converged centreline than ours."""
    pairs = [(case[name], case[OURS]) for case in found]
    return all(our.error <= theirs.error for theirs, our in pairs if theirs and our)


def closest(start: str, found: Sequence[dict[str, Found | None]]) -> str | None:
    """Of the methods so called and nowhere closer than ours, the one of the least error: None if none is there."""
    names = [
        name for name, theirs in found[0].items() if theirs and name.startswith(start) and fair(name, found)
    ]
    return min(names, key=lambda name: max(f.error for case in found if (f := case[name])), default=None)


def calls_from_python(rod: Rod) -> dict[str, float]:
    """What a caller waits for [s], under the slowest of the loads."""
    slowest = dict.fromkeys(CALLS, 0.0)
    for load in paper_loads(rod):
        beside = rod.solve(GRAVITY, BESIDE * load.force, load.s).tip
        case = (GRAVITY, load.force, load.s)
        calls = (
            partial(rod.solve, *case),
            partial(rod.solve, *case, guess=beside),
            partial(rod.solve, *case, guess=beside, columns="load"),
            partial(rod.solve, *case, guess=beside, columns="all"),
        )
        seconds = interleaved(dict(zip(CALLS, calls, strict=True)), ROUNDS)
        slowest = {name: max(slowest[name], seconds[name]) for name in CALLS}
    return slowest


def print_calls(slowest: dict[str, float]) -> None:
    """Print the table."""
    print_table(
        f"One call from Python, all included. Median of {ROUNDS} interleaved rounds, the slowest of the loads",
        ["Rod.solve", "time"],
        [[name, shown(seconds)] for name, seconds in slowest.items()],
    )


def report() -> None:
    """Print both."""
    rod = bare_large()
    print_compared(compared(rod))
    print_calls(calls_from_python(rod))
