"""`python -m tests`: every check of this project, in the order of what fails soonest; stops at the first failure.

Arguments go to pytest, e.g. `python -m tests -m slow`.
"""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
STEPS = (
    ("format and lint", ["ruff", "check", "."]),
    ("formatting", ["ruff", "format", "--check", "."]),
    ("layers", ["importlinter.cli"]),
    ("types", ["mypy"]),
)


def main() -> int:
    """Run all steps; the exit status of the first that fails."""
    for name, command in STEPS:
        print(f"== {name}", flush=True)
        status = subprocess.run([sys.executable, *_module(command)], cwd=ROOT).returncode
        if status:
            return status
    print("== tests", flush=True)
    # A worker a core; a file stays with one of them, and with it what its tests share. The longest come first.
    shared = ["-n", "auto", "--dist", "loadfile", "--no-loadscope-reorder"]
    return subprocess.run([sys.executable, "-m", "pytest", *shared, *sys.argv[1:]], cwd=ROOT).returncode


def _module(command: list[str]) -> list[str]:
    if command == ["importlinter.cli"]:  # it has no __main__
        return ["-c", "from importlinter.cli import lint_imports_command as run; run(standalone_mode=True)"]
    return ["-m", *command]


if __name__ == "__main__":
    sys.exit(main())
