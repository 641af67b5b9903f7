"""Identification of drawn campaigns: how far off, and whether stated intervals come true."""

import math
import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace

import numpy as np
from scipy.stats import beta

from benchmarks.laboratory import CAMERAS, STAGE, Truth, draw
from benchmarks.timing import print_table, shown
from benchmarks.touches import paper_models
from probedesign.estimation.model import ProbeModel
from probedesign.identification.identify import identify

DRAWS = 120
PROBE = "large"
KINDS = {kind.name: kind for kind in (CAMERAS, STAGE)}
PRESSED = (0.6, 0.02)
"""Fraction of the length and newtons of the push that a stiffness is told by."""


def report() -> None:
    """Print the table."""
    rows = []
    with ProcessPoolExecutor(os.cpu_count()) as workers:
        for name, kind in KINDS.items():
            for drawn in (False, True):
                found = list(workers.map(_campaign, [name] * DRAWS, [drawn] * DRAWS, range(DRAWS)))
                dimensions = "drawn by the tolerances" if drawn else "as designed"
                rows.append([f"{name}, {kind.words}; dimensions {dimensions}", *_row(np.array(found))])
    head = ["campaign", "ok", "E off, RMS", "95 % of them", "stated", "within stated 95 %", "stiffness off, RMS",
            "before", "one"]  # fmt: skip
    print_table(f"{DRAWS} campaigns of the {PROBE} probe each, E drawn with 10 %", head, rows)


def _campaign(name: str, drawn: bool, seed: int) -> tuple[float, ...]:
    """Of one campaign: whether it ended well, log error of E and stated deviation, of the stiffness after and before,
    seconds."""
    model = paper_models()[PROBE]
    data, truth = draw(model, KINDS[name], 1000 + seed, dimensions=drawn)
    found = identify(data, ("E",))
    E = found.of("E")
    if E is None or E.std is None or E.value_of_print is None or E.std_of_print is None:
        return 0.0, math.nan, math.nan, math.nan, math.nan, found.seconds
    value, std = (E.value_of_print, E.std_of_print) if drawn else (E.value, E.std)
    off = math.log(1e6 * value / truth.rod.youngs_modulus)
    return (float(found.result == "ok"), off, std / value, _stiffness_off(model, truth, 1e6 * E.value),
            _stiffness_off(model, truth, model.rod.youngs_modulus), found.seconds)  # fmt: skip


def _stiffness_off(model: ProbeModel, truth: Truth, youngs_modulus: float) -> float:
    """Logarithm of how much less the probe as designed, with this E, yields to a push than the true one."""
    fraction, force = PRESSED
    s, yields = fraction * model.rod.length, []
    for rod in (truth.rod, replace(model.rod, youngs_modulus=youngs_modulus)):
        pushed, free = rod.solve(force=(0.0, force, 0.0), s_contact=s), rod.solve()
        yields.append(float(np.linalg.norm(pushed.p_at(s) - free.p_at(s))))
    return math.log(yields[0] / yields[1])


def _row(found: "np.ndarray[tuple[int, int], np.dtype[np.float64]]") -> list[str]:
    ok, off, stated, after, before, seconds = found.T
    inside = np.abs(off) <= 1.959964 * stated
    low, high = _interval(int(inside.sum()), len(off))
    return [f"{ok.mean():.0%}", f"{_rms(off):.2%}", f"{np.quantile(np.abs(off), 0.95):.2%}", f"{_rms(stated):.2%}",
            f"{inside.mean():.1%} ({low:.0%} – {high:.0%})", f"{_rms(after):.2%}", f"{_rms(before):.2%}",
            shown(float(np.median(seconds)))]  # fmt: skip


def _rms(values: "np.ndarray[tuple[int], np.dtype[np.float64]]") -> float:
    return float(np.sqrt(np.mean(values**2)))


def _interval(hits: int, n: int) -> Sequence[float]:
    """Of a share, 95 %. Source: C. J. Clopper, E. S. Pearson, Biometrika 26, 1934."""
    low = 0.0 if hits == 0 else float(beta.ppf(0.025, hits, n - hits + 1))
    return low, 1.0 if hits == n else float(beta.ppf(0.975, hits + 1, n - hits))
