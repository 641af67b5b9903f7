"""Cost of a fresh installation: time to install, first solve, first estimate, later processes.

A copy of the working tree is installed by `pip install` into a new virtual environment. Its dependencies are those of
the current environment, so that only the compilation is measured. Only the build back end is downloaded.
"""

import json
import os
import resource
import shutil
import subprocess
import sysconfig
import tempfile
import time
import venv
from pathlib import Path

from benchmarks.timing import print_table

ROOT = Path(__file__).parents[1]
LATER = 3  #: Number of later processes.
SCRIPT = """
import json, resource, time
from probedesign import build_probe, load_design
probe = build_probe(load_design("designs/large.toml"))
def spent():
    used = resource.getrusage(resource.RUSAGE_SELF)
    return time.perf_counter(), used.ru_utime + used.ru_stime
marks = [spent()]
equilibrium = probe.solve(gravity_base=(9.81, 0.0, 0.0), s_contact=0.06, force_base=(0.014, 0.0, 0.0))
marks.append(spent())
estimate = probe.estimator().estimate(equilibrium.wrench_base)
marks.append(spent())
print(json.dumps([[b[i] - a[i] for i in (0, 1)] for a, b in zip(marks, marks[1:])] + [estimate.s_contact.hex()]))
"""
Times = tuple[float, float]  #: Wall time and processor time [s].


def run(command: list[str], folder: Path, **environment: str) -> tuple[Times, str]:
    """Run a command that must succeed; return its times, including its children, and its output."""
    began, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    clean = {name: value for name, value in os.environ.items() if not name.startswith(("NUMBA_", "PYTHONPATH"))}
    done = subprocess.run(command, cwd=folder, env=clean | environment, text=True, capture_output=True)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)}: {done.stderr[-2000:]}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return (time.perf_counter() - began, used), done.stdout


def environment_in(folder: Path) -> list[str]:
    """Return the Python command of a new environment that can import the packages of this one."""
    venv.create(folder, with_pip=True)
    python = folder / "bin" / "python"
    site = folder / "lib" / f"python{sysconfig.get_python_version()}" / "site-packages"
    (site / "benchmark.pth").write_text(sysconfig.get_path("purelib") + "\n")
    return [str(python)]


def clone(folder: Path) -> Path:
    """Copy all files that git tracks or would add."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        check=True,
        capture_output=True,
    )
    for name in listed.stdout.decode().split("\0"):
        if name and (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, folder / name)
    return folder


def format_times(times: Times) -> str:
    """Return wall and processor time as text."""
    return f"{times[0]:.2f} s ({times[1]:.2f} s)"


def measure(folder: Path, precompile: str) -> list[list[str]]:
    """Return the rows of an installation with or without kernels compiled during the build."""
    source, python = clone(folder / "clone"), environment_in(folder / "environment")
    run([*python, "-m", "pip", "install", "--quiet", "--no-deps", "hatchling", "pathspec", "pluggy", "packaging",
         "trove-classifiers"], folder)  # fmt: skip
    install = [*python, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "."]
    installed, _ = run(install, source, PROBEDESIGN_PRECOMPILE=precompile, PIP_NO_CACHE_DIR="1")
    shutil.rmtree(source / "probedesign")  # so that the installed package is imported
    found = [run([*python, "-c", SCRIPT], source, XDG_CACHE_HOME=str(folder)) for _ in range(1 + LATER)]
    calls = [json.loads(text) for _, text in found]
    assert len({call[2] for call in calls}) == 1, "the estimates of all processes are bitwise equal"
    later = min(range(1, 1 + LATER), key=lambda i: found[i][0][1])
    name = "with compiled kernels in the wheel" if precompile == "1" else "with compilation at first use"
    return [
        [f"{name}: pip install .", format_times(installed), "≤ 30 s of compilation"],
        ["  first solve", format_times(calls[0][0]), "≤ 10 s"],
        ["  first estimate, after the solve", format_times(calls[0][1]), "≤ 15 s including the solve"],
        ["  that process and those that compile beside it", format_times(found[0][0]), ""],
        ["  solve and estimate, later process", format_times((calls[later][0][0] + calls[later][1][0],
                                                       calls[later][0][1] + calls[later][1][1])), "≤ 0.5 s"],
        ["  that process, including imports", format_times(found[later][0]), ""],
    ]  # fmt: skip


def report() -> None:
    """Print the table."""
    rows = []
    for precompile in ("1", "0"):
        with tempfile.TemporaryDirectory() as folder:
            rows += measure(Path(folder), precompile)
    print_table("Fresh installation in a new environment: wall time (CPU time)", ["step", "time", "target"], rows)
