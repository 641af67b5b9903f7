"""Nothing is compiled or loaded once a sensor waits."""

import subprocess
import sys

SCRIPT = """
import gc, sys
import numpy as np
from numba.core.dispatcher import Dispatcher
from probedesign.frozen_probe import load_estimator
from probedesign.estimation.tracker import Tracker
from probedesign.live.processing.chain import ProcessingOptions
from probedesign.live.run import estimate_stream
from probedesign.live.sources.sim import SimulatedSource
from probedesign.live.run import _warm_up_touches
from probedesign.live.run import warm_up

def kernels():
    gc.unfreeze()
    return {
        f"{found.__module__}.{found.__name__}": len(found.overloads)
        for found in gc.get_objects() if isinstance(found, Dispatcher) and found.overloads
    }

estimator = load_estimator(sys.argv[1])
warm_up(estimator, print, fusing=True)
before = kernels()
source = SimulatedSource(estimator.model, "speed=max&rate_hz=5")
answers = list(estimate_stream(estimator, source, ProcessingOptions(), print))
for answer in answers:
    estimator.estimate(answer.wrench_base, near=answer.estimate)
assert {"ok", "no_contact"} <= {answer.estimate.result for answer in answers}
tracker = Tracker(estimator, gravity_world=estimator.model.gravity_base)
noise = np.random.default_rng(1).standard_normal((100, 6)) * estimator.model.noise.std
touches = [touch for touch in _warm_up_touches(estimator) for _ in range(5)]
results = {tracker.update(wrench + noise[i], T, i / 7000).result for i, (wrench, T) in enumerate(touches)}
assert "ok" in results
print(sorted(kernels().items() - before.items()))
"""


def test_every_kernel_of_an_answer_is_there_before(bundle):
    run = subprocess.run([sys.executable, "-c", SCRIPT, str(bundle)], capture_output=True, text=True, timeout=600)
    assert run.returncode == 0, run.stderr
    assert run.stdout.splitlines()[-1] == "[]"
