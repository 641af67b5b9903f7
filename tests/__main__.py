"""`python -m tests`: every check of this project; stops at the first failure. Types are checked beside the tests.

Arguments go to pytest, e.g. `python -m tests -m slow`.
"""

import signal
import subprocess
import sys
import tempfile
import time
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
    # mypy takes most of a minute on one core where nothing is cached, while the tests use what others are there.
    # A worker a core; a file stays with one of them, and with it what its tests share. The longest come first.
    shared = ["-n", "auto", "--dist", "loadfile", "--no-loadscope-reorder"]
    pytest, mypy = (
        [sys.executable, "-m", *words] for words in (["pytest", *shared, *sys.argv[1:]], ["mypy"])
    )
    with (
        tempfile.TemporaryFile() as output,
        subprocess.Popen(mypy, cwd=ROOT, stdout=output, stderr=subprocess.STDOUT) as types,
        subprocess.Popen(pytest, cwd=ROOT) as tests,
    ):
        while tests.poll() is None and not types.poll():
            time.sleep(0.2)
        if types.wait():
            tests.send_signal(signal.SIGINT)  # as Ctrl-C: it prints what it has found so far
            tests.wait()
        output.seek(0)
        print(f"== types\n{output.read().decode()}", end="", flush=True)
        return types.returncode or tests.returncode


def _module(command: list[str]) -> list[str]:
    if command == ["importlinter.cli"]:  # it has no __main__
        return ["-c", "from importlinter.cli import lint_imports_command as run; run(standalone_mode=True)"]
    return ["-m", *command]


if __name__ == "__main__":
    sys.exit(main())
