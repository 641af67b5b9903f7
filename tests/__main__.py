"""`python -m tests`: every check of this project; stops at the first failure. Types are checked beside the tests.

Arguments go to pytest, e.g. `python -m tests -m slow`.
"""

import signal
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
STEPS = (
    ("format and lint", ["ruff", "check", "."]),
    ("formatting", ["ruff", "format", "--check", "."]),
    ("layers", ["importlinter.cli"]),
)


def main() -> int:
    """Run all steps; return the exit status of the first that fails."""
    for name, command in STEPS:
        print(f"== {name}", flush=True)
        status = subprocess.run([sys.executable, *_module(command)], cwd=ROOT).returncode
        if status:
            return status
    print("== types and tests", flush=True)
    # A worker a core; a file stays with one of them, and with it what its tests share. The longest come first.
    shared = ["-n", "auto", "--dist", "loadfile", "--no-loadscope-reorder"]
    return _run_beside_types([sys.executable, "-m", "pytest", *shared, *sys.argv[1:]])


def _run_beside_types(command: list[str]) -> int:
    """Run a command while mypy, which uses one core for most of a minute where nothing is cached, checks the types."""
    status, mypy = 0, [sys.executable, "-m", "mypy"]
    with (
        tempfile.TemporaryFile() as output,
        subprocess.Popen(mypy, cwd=ROOT, stdout=output, stderr=subprocess.STDOUT) as types,
    ):
        with suppress(subprocess.TimeoutExpired):
            types.wait(5.0)  # enough where all is cached
        if not types.returncode:
            with subprocess.Popen(command, cwd=ROOT) as tests:
                while tests.poll() is None and not types.poll():
                    time.sleep(0.2)
                if types.wait():
                    tests.send_signal(signal.SIGINT)  # as Ctrl-C
            status = tests.returncode
        output.seek(0)
        print(f"== types\n{output.read().decode()}", end="", flush=True)
        return types.returncode or status


def _module(command: list[str]) -> list[str]:
    if command == ["importlinter.cli"]:  # it has no __main__
        return ["-c", "from importlinter.cli import lint_imports_command as run; run(standalone_mode=True)"]
    return ["-m", *command]


if __name__ == "__main__":
    sys.exit(main())
