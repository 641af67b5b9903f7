"""False alarms of the sequential contact test with a free probe, and its detection limits over time."""

import time

import numpy as np

from benchmarks.cases import GRAVITY
from benchmarks.timing import format_seconds, print_table
from benchmarks.touches import paper_models
from probedesign.estimation.detector import Detector

HOURS, MINUTE = 4, 7000 * 60


def report() -> None:
    """Print the false-alarm rate and the detection limits."""
    model = paper_models()["large"]
    detector, rng = Detector(model, 7000.0, 1.0), np.random.default_rng(6)
    root = np.linalg.cholesky(model.noise_base() * model.averaging_samples)
    alarms, spent = 0, 0.0
    for _ in range(60 * HOURS):
        samples = rng.normal(size=(MINUTE, 6)) @ root.T
        start = time.perf_counter()
        states = np.array(detector.run(samples))
        spent += time.perf_counter() - start
        alarms += int(((states[1:] == "contact") & (states[:-1] != "contact")).sum() + (states[0] == "contact"))
    by_force = {
        place: model.rod.solve(GRAVITY, (0.0, 0.0, 0.0), place * model.rod.length, columns="load")
        for place in (0.2, 0.5, 0.9)
    }
    rows = []
    for length in detector.lengths:
        forces = []
        for eq in by_force.values():
            assert eq.sensitivity is not None
            forces.append(f"{1e3 * detector.detectable(eq.sensitivity.d_wrench[:, 1], length):.2g} mN")
        rows.append([f"{length} samples, {1e3 * length / 7000.0:.3g} ms", *forces])
    print_table("Contact test at 7 kHz, large probe: force detected with probability 1/2, by place over the length",
                ["time", *(f"at {place:g} L" for place in by_force)], rows)  # fmt: skip
    print(f"  false alarms: {alarms} in {HOURS} simulated hours, specified rate 1 per hour; "
          f"{format_seconds(spent / (HOURS * 60 * MINUTE))} per sample, state names included")  # fmt: skip
