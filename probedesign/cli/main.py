"""The command line: which commands there are, and what an error looks like.

Every command lives in a file of its own and is imported when it is called for, so that the help of one
never waits for the numerics of another.
"""

import os
import sys
from importlib.metadata import version

from cyclopts import App, CycloptsError, Parameter

from probedesign.errors import InputError, MissingDependencyError

COMMANDS = {
    "new": "Write designs/NAME.toml from a few numbers.",
    "check": "Check whether a design will print.",
    "export": "Make the parts to print: STL, STEP, 3MF and their manifest.",
    "print": "Prepare the exported parts in PreForm, and send them to a printer if asked.",
    "predict": "Predict sensitivity and contact error of a design.",
    "compare": "Put several designs side by side, as a table and a page.",
    "sweep": "Compute a grid of designs, on this machine or on many.",
    "optimize": "Find the body that does a task best.",
    "identify": "Find E, G and their kin from tests of a print.",
    "deploy": "Freeze the estimator of a design into one file.",
    "estimate": "Locate the contacts of a recording, one estimate a row.",
    "campaign": "Make up what a laboratory would measure of a print: a data folder as example.",
    "validate": "Compare the frozen probe with a stereo reference, as the paper's Table I.",
    "live": "Locate contacts as the sensor reads them.",
    "explore": "Turn touches from a moving base into points of the world.",
    "recover": "Make an MCAP recording whole that was cut off.",
    "markers": "Find the dots of a probe in the photographs of a campaign.",
    "simulate": "Play a Net F/T box with the probe on it, for live and other clients.",
    "demo": "Run the whole chain on a built-in example.",
    "doctor": "Tell what is installed and what is missing for what.",
}
"""Commands in the order of the chain, with their line of help: it stands here because reading it from the
commands would import them all."""

FUNCTIONS = {"print": "print_job"}
"""Module and function of a command, where its name will not do."""

DEBUG = "PROBEDESIGN_DEBUG"
INTERRUPTED = 130
"""Exit status after SIGINT: 128 plus the number of the signal."""


def build_app() -> App:
    """The command line, ready to be called with arguments."""
    app = App(
        name="probedesign",
        help="Design, print and run soft conic probes that locate a touch from the wrench at their base.",
        version=lambda: version("probedesign"),
        default_parameter=Parameter(negative=()),
        help_format="plaintext",
        print_error=False,
        exit_on_error=False,
        suppress_keyboard_interrupt=False,
        result_action="return_value",
    )
    for sort_key, (name, line) in enumerate(COMMANDS.items()):
        function = FUNCTIONS.get(name, name)
        app.command(f"probedesign.cli.{function}:{function}", name=name, help=line, sort_key=sort_key)
    return app


def run(arguments: list[str]) -> int:
    """Run one command line.

    Args:
        arguments: without the program's name.

    Returns:
        Exit status: 0 on success; 2 for a file, option or argument that cannot be used; 130 after an interruption
        (Ctrl-C), as shells expect of SIGINT (128 + 2); 1 for any other failure, such as a closed output pipe.
    """
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # a terminal that knows no "±" gets a "?"
            stream.reconfigure(errors="replace")
    try:
        status = build_app()(arguments)
        sys.stdout.flush()
        return status if isinstance(status, int) else 0
    except (CycloptsError, InputError, MissingDependencyError) as error:
        return _fail(str(error), 2)
    except KeyboardInterrupt as interruption:
        return _fail(str(interruption) or "interrupted", INTERRUPTED)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # else Python complains at exit
        return 1
    except Exception as error:
        return _fail(f"{error} ({type(error).__name__}; {DEBUG}=1 shows where)", 1)


def _fail(message: str, status: int) -> int:
    """One line on stderr, with the traceback above it if it was asked for."""
    if os.environ.get(DEBUG):
        import traceback

        traceback.print_exc()
    print("probedesign: error:", " ".join(message.split()), file=sys.stderr)
    return status


def main() -> None:
    """Entry point of `probedesign`."""
    sys.exit(run(sys.argv[1:]))


if __name__ == "__main__":
    main()
