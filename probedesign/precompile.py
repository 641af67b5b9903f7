"""`python -m probedesign.precompile FOLDER [PART ...]`: compile the kernels into a folder, in several processes.

The build of a wheel runs it for all parts, and the first process that compiles runs it for some of them
(`rod.kernels.cache`). Where two processes use the same kernel, one compiles it and the other waits, so that there are
more processes than the two cores of a small machine.
"""

import os
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, cast

import numpy as np

from probedesign.rod.kernels import cache

if TYPE_CHECKING:
    from probedesign.estimation.error_sources import ErrorSources
    from probedesign.probe import Probe
    from probedesign.rod.equilibrium import Equilibrium

#: Any design serves: the machine code does not depend on its numbers.
DESIGN = """
schema = 1
name = "precompile"
[probe]
shape = "cone"
length_mm = 150.0
base_d_mm = 12.0
tip_d_mm = 2.0
"""


def _sources(probe: "Probe") -> "ErrorSources":
    from probedesign.estimation.error_sources import ErrorSources

    model, free = probe.model, cast("Equilibrium", SimpleNamespace(wrench_base=np.zeros(6)))
    assert model.tolerances is not None
    return ErrorSources.of(model, replace(model.tolerances, tared=False), model.gravity_base, free)


def _touches(probe: "Probe") -> None:
    from probedesign.rod.kernels.surface_contact import TOUCH

    _sources(probe).columns_at(np.zeros(TOUCH))


def _fit(probe: "Probe") -> None:
    from probedesign.estimation.contact_fit import FIT_SCRATCH
    from probedesign.estimation.multistart import EVERYWHERE, FIT, MAX_STARTS, fit_contacts, fit_memory

    model, sources = probe.model, _sources(probe)
    fit_contacts(
        model.rod.body, model.rod.flank_end, model.gravity_base, model.mass, np.zeros(6), np.zeros((6, 6)), 1.0,
        *sources.arguments, EVERYWHERE, fit_memory(len(model.rod.s), len(sources.names)),
        np.empty(1, dtype=FIT_SCRATCH), np.empty(MAX_STARTS, dtype=FIT),
    )  # fmt: skip


def _live(probe: "Probe") -> None:
    from probedesign.live.run import warm_up

    warm_up(probe.estimator(), print, fusing=True)


#: What compiles the kernels of one subject, by calling them; the last one needs all of them.
PARTS: dict[str, Callable[["Probe"], None]] = {"fit": _fit, "touches": _touches, "live": _live}


def main(folder: str, *parts: str) -> None:
    """Compile the named parts into a folder, one after the other, or all of them in several processes.

    All parts are compiled for the baseline processor, or for this machine's where it lacks the baseline.
    """
    cache.only = Path(folder).absolute()
    if parts:
        from probedesign import build_probe, parse_design

        probe = build_probe(parse_design(DESIGN))
        for part in parts:
            PARTS[part](probe)
        return
    environment = {**os.environ, "PYTHONPATH": str(cache.PACKAGE.parent)}
    if cache.BASELINE in cache.runs():
        environment |= {"NUMBA_CPU_NAME": cache.BASELINE, "NUMBA_CPU_FEATURES": ""}
    began = time.perf_counter()
    command = [sys.executable, "-m", __spec__.name, str(cache.only)]
    processes = [subprocess.Popen([*command, *shared], env=environment) for shared in (("live",), *cache.BESIDE)]
    failed = sum(process.wait() != 0 for process in processes)
    if failed:
        raise RuntimeError(f"{failed} of {len(processes)} processes that compile the kernels failed")
    compiled, times = list(cache.only.glob(f"*/*{cache.SUFFIX}")), os.times()
    print(f"{len(compiled)} functions compiled in {time.perf_counter() - began:.0f} s, "
          f"{times.children_user + times.children_system:.0f} s of processor time")  # fmt: skip


if __name__ == "__main__":
    main(*sys.argv[1:])
