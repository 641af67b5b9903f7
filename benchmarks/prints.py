"""Estimates from one reading of perturbed probes, with and without the tolerances in the weights."""

import time

import numpy as np

from benchmarks.error_statistics import CHI2_95
from benchmarks.timing import format_seconds, print_table
from benchmarks.touches import paper_models
from probedesign.core.frames import Array
from probedesign.core.units import MM
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.tolerances import Tolerances
from probedesign.prediction.monte_carlo import PrintSamples
from probedesign.prediction.touches import DIRECTIONS

DRAWS = 300
TOUCHES = ((0.3, 0.02, "+y"), (0.6, 0.02, "+y"), (0.9, 0.01, "+y"), (0.5, 0.1, "+x"), (0.3, 0.2, "+y"))


def report() -> None:
    """Print the table."""
    rows = []
    for name, model in paper_models().items():
        samples = PrintSamples.draw(model, Tolerances.of(model), DRAWS, 3)
        exact = Estimator(model, Tolerances.none())
        for fraction, force, direction in TOUCHES:
            rng, phi = np.random.default_rng(7), DIRECTIONS[direction] + np.pi
            wrenches, points = (values[:, 0] for values in samples.simulate_touches(fraction, phi, (force,), rng))
            read = wrenches + samples.draw_noise(DRAWS, 1, rng)[:, 0]
            columns = [_statistics(estimator, read, points) for estimator in (exact, exact.with_tolerances())]
            rows.append([f"{name}, {1e3 * force:g} mN at {fraction:g} L, {direction}",
                         *(" / ".join(pair) for pair in zip(*columns, strict=True))])  # fmt: skip
    head = [
        "probe exact / tolerances in the weights",
        "located",
        "RMS error",
        "stated RMS",
        "in 95 %",
        "time per estimate",
    ]
    print_table(f"Probes drawn from their tolerances, {DRAWS} each", head, rows)


def _statistics(estimator: Estimator, read: Array, points: Array) -> tuple[str, ...]:
    """Return located share, RMS error of the best candidates, stated RMS, coverage of the 95 % ellipsoid and time."""
    estimator.estimate(read[0])
    start = time.process_time()
    found = [estimator.estimate(wrench) for wrench in read]
    spent = (time.process_time() - start) / len(read)
    errors = [e.candidates[0].p_surface_base - p for e, p in zip(found, points, strict=True) if e.candidates]
    located = [(e.p_surface_base - p, e.cov_surface_base) for e, p in zip(found, points, strict=True) if e.ok]
    inside = np.mean([d @ np.linalg.solve(cov, d) <= CHI2_95 for d, cov in located])
    stated = np.sqrt(np.mean([np.trace(cov) for _, cov in located]))
    rms = np.sqrt(np.mean(np.sum(np.square(errors), axis=1)))
    return (f"{len(located) / len(found):.0%}", f"{rms / MM:.2f} mm", f"{stated / MM:.2f} mm",
            f"{inside:.0%}", format_seconds(spent))  # fmt: skip
