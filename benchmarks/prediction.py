"""Time of predictions: a map with its error budget, Monte Carlo runs of the estimator, and the whole command."""

import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.timing import format_seconds, print_table
from probedesign.design import load_design
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.tolerances import Tolerances
from probedesign.prediction.monte_carlo import MonteCarloPlan, run_monte_carlo
from probedesign.prediction.predict import predict
from probedesign.prediction.touches import DIRECTIONS, touches_of
from probedesign.probe import Probe, build_probe

ROOT = Path(__file__).parents[1]
PLACES, FORCES = np.linspace(0.05, 1.0, 40), np.geomspace(0.002, 0.2, 40)
#: Monte Carlo estimates with sensor noise alone. With all error sources there are a tenth of them, because an estimate
#: that fails the consistency test repeats the global search, which takes milliseconds.
ESTIMATES = 100_000
RUNS = 3


def report() -> None:
    """Print the tables."""
    probe = build_probe(load_design(ROOT / "designs/large.toml"))
    rows = [_map(probe)]
    rows.append(_command())
    rows.append(_monte_carlo(probe, False, ESTIMATES, "≤ 15 s"))
    rows.append(_monte_carlo(probe, True, ESTIMATES // 10, ""))
    print_table(f"Predictions on {len(os.sched_getaffinity(0))} cores; CPU time is the sum over all cores",
                ["", "wall", "CPU", "target (wall)"], rows)  # fmt: skip


def _map(probe: Probe) -> list[str]:
    """Time a map of 40 places, 40 forces and four directions with all error sources; the best of a few warm runs."""
    lines = [(float(place), direction) for place in PLACES for direction in DIRECTIONS]
    forces = [float(force) for force in FORCES]
    best, solved = (np.inf, np.inf), 0
    for _ in range(RUNS + 1):
        wall, cpu = time.perf_counter(), time.process_time()
        touches = touches_of(Estimator(probe.model, probe.tolerances), lines, forces)
        for touch in touches.values():
            _ = touch.within_95, touch.rms
        solved = sum(int(touch.ok.sum()) for touch in touches.values())
        best = min(best, (time.perf_counter() - wall, time.process_time() - cpu))
    name = f"map of 40 × 40 × 4 with full error budget ({solved} of 6400 solved), best of {RUNS}"
    return [name, format_seconds(best[0]), format_seconds(best[1]), "≤ 1 s"]


def _monte_carlo(probe: Probe, all_sources: bool, estimates: int, target: str) -> list[str]:
    """Time full estimates from a cold start, including the simulation of the truth and the start of the workers."""
    tolerances = probe.tolerances if all_sources else Tolerances.none()
    prediction = predict(probe.model, (0.3, 0.5, 0.7, 0.9), (0.01, 0.02, 0.03), ("+x", "+y"), tolerances)
    touches = sum(c.result == "ok" for c in prediction.conditions)
    plan = MonteCarloPlan(probe.model, tolerances, estimates // touches, 1)
    wall = time.perf_counter()
    found = run_monte_carlo(plan, prediction, None)
    wall = time.perf_counter() - wall
    few = replace(plan, draws=max(plan.draws // 8, 2))
    cpu = time.process_time()
    done = sum(row.draws for row in run_monte_carlo(few, prediction, None, workers=1))
    cpu = (
        (time.process_time() - cpu) / done * touches * plan.draws
    )  # CPU time of the workers is not available, so one process is measured
    located = sum(row.located for row in found) / sum(row.draws for row in found)
    differ = sum(row.differs for row in found)
    sources = "all error sources" if all_sources else "sensor noise alone"
    name = (f"Monte Carlo, {touches * plan.draws} estimates, {sources}; {located:.0%} located, "
            f"{differ} of {len(found)} differ from the prediction by a tenth")  # fmt: skip
    return [name, format_seconds(wall), format_seconds(cpu), target]


def _cpu() -> float:
    """Return the CPU time of this process and of its finished children [s]."""
    own, children = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return own.ru_utime + own.ru_stime + children.ru_utime + children.ru_stime


def _command() -> list[str]:
    """Time the whole process with warm caches."""
    walls, cpus = [], []
    with tempfile.TemporaryDirectory() as out:
        design = str(ROOT / "designs/large.toml")
        command = [sys.executable, "-m", "probedesign.cli.main", "predict", design, "--out", out]
        for _ in range(RUNS):
            wall, cpu = time.perf_counter(), _cpu()
            subprocess.run(command, check=True, capture_output=True)
            walls.append(time.perf_counter() - wall)
            cpus.append(_cpu() - cpu)
    return ["predict designs/large.toml, whole process", format_seconds(statistics.median(walls)),
            format_seconds(statistics.median(cpus)), "≤ 6 s"]  # fmt: skip
