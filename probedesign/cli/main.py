"""Entry point of the command line: the list of commands, error messages and exit statuses.

The module of a command is imported when the command is called, so the help of one command never waits for the numerics
of another.
"""

import os
import sys

TYPE_CHECKING = False  # nothing is imported here that delays the handling of Ctrl-C
if TYPE_CHECKING:
    from typing import Any

    from cyclopts import App

#: Commands by the group of the help, each with its line of help. Kept here because reading it from the commands would
#: import them all.
COMMANDS = {
    "Design": {
        "new": "Write designs/NAME.toml from a few dimensions.",
        "studio": "Design a probe in the browser by moving sliders.",
        "check": "Check whether a design can be printed.",
        "predict": "Predict sensitivity and contact error of a design.",
        "compare": "Compare several designs in a table and on a page.",
        "sweep": "Evaluate a grid of designs, on this machine or on a cluster.",
        "optimize": "Optimize the shape of a probe for a task.",
        "advise": "Find a design for an object: the force that it bears, its stiffness and reach.",
    },
    "Make": {
        "export": "Write the parts to print: STL, STEP, 3MF and their manifest.",
        "coupon": "Write a stepped cone and a rod to print and measure, with their measuring sheets.",
        "measured": "Write diameters measured with calipers into a design.",
        "deploy": "Freeze the estimator of a design into one file.",
        "twin": "Write a probe for simulators: MJCF, SDF, URDF, USD.",
    },
    "Calibrate": {
        "plan": "Plan the tests of a campaign, with the intervals to expect, a sheet and an empty data folder.",
        "campaign": "Simulate a measurement campaign: an example data folder.",
        "markers": "Detect the markers of a probe in the photographs of a campaign.",
        "identify": "Identify E, G and other parameters from tests of a print.",
        "validate": "Compare a frozen probe's estimates with a stereo reference, as in the paper's Table I.",
        "calibrate": "Measure bias, payload, mount and stiffness with a robot that turns the free probe.",
    },
    "Run": {
        "live": "Locate contacts in real time.",
        "estimate": "Locate the contacts of a recording, one estimate per row.",
        "explore": "Turn touches from a moving base into points of the world.",
        "simulate": "Simulate a Net F/T box with a probe, for live and other clients.",
        "recover": "Repair an MCAP recording that was cut off or is damaged.",
    },
    "Tools": {"demo": "Run the whole chain on a built-in example.", "doctor": "Report installed and missing packages."},
}

NAMES = tuple(name for commands in COMMANDS.values() for name in commands)  #: Of all commands.
#: Module and function of a command, where they do not have its name.
FUNCTIONS = {"advise": "optimize:advise", "check": "export:check", "coupon": "measured:coupon",
             "deploy": "export:deploy", "twin": "export:twin", "sweep": "compare:sweep", "plan": "campaign:plan",
             "markers": "campaign:markers", "recover": "estimate:recover"}  # fmt: skip

DEBUG = "PROBEDESIGN_DEBUG"
#: Prefix of the variables that set options, such as PROBEDESIGN_LIVE_SOURCE for --source of live.
ENVIRONMENT = "PROBEDESIGN_"
#: File in the working directory or a folder above it that sets options, a table for each command.
SETTINGS = "probedesign.toml"
HELP = frozenset({"--help", "-h", "--version", "--install-completion"})  #: Options that need no settings file.
INTERRUPTED = 130  #: Exit status after SIGINT: 128 plus the number of the signal.


def build_app(with_settings: bool = True, command: str = "") -> "App":
    """Return the command line application, to be called with a list of arguments.

    Args:
        with_settings: read the settings file; help needs none, and must be there when the file is wrong.
        command: its name, if one is called: its help is then its whole docstring, and not its line in the list.
    """
    from importlib.metadata import version

    from cyclopts import App, Group, Parameter
    from cyclopts.config import Dict, Env

    settings, path = read_settings() if with_settings else ({}, SETTINGS)
    app = App(
        name="probedesign",
        help="Design, fabricate and run soft conic probes that locate contacts from the wrench at their base.",
        version=lambda: version("probedesign"),
        default_parameter=Parameter(negative=()),
        help_format="markdown",  # fills the lines
        print_error=False,
        exit_on_error=False,
        suppress_keyboard_interrupt=False,
        result_action="return_value",
        group_commands=Group("Options", sort_key=len(COMMANDS)),
        config=(Env(ENVIRONMENT, show=False), Dict(settings, source=path)),
    )
    for order, (title, commands) in enumerate(COMMANDS.items()):
        group = Group(title, sort_key=order)
        for sort_key, (name, line) in enumerate(commands.items()):
            function = FUNCTIONS.get(name, f"{name}:{name}")
            words = None if name == command else line
            app.command(f"probedesign.cli.{function}", name=name, help=words, group=group, sort_key=sort_key)
    app.register_install_completion_command(
        add_to_startup=True, help="Install completion of commands and options for bash, zsh or fish."
    )
    return app


def read_settings() -> "tuple[dict[str, Any], str]":
    """Return the options of the settings file by command, and its path; nothing if there is no such file.

    Its key `exports` becomes an environment variable, unless that is set: all commands and their helpers follow it.

    Raises:
        InputError: the file cannot be read, or has a table that is not a command.
    """
    from probedesign.core.errors import InputError
    from probedesign.core.files import EXPORTS_VARIABLE, MAX_TOML, parse_bounded_toml

    here = os.getcwd()
    while not os.path.isfile(path := os.path.join(here, SETTINGS)):
        if here == (here := os.path.dirname(here)):
            return {}, SETTINGS
    try:
        with open(path, encoding="utf-8", newline="") as file:
            settings = parse_bounded_toml(file.read(MAX_TOML + 1).replace("\r\n", "\n"))
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read as TOML: {error}") from None
    exports = settings.pop("exports", None)
    if isinstance(exports, str) and exports:
        os.environ.setdefault(EXPORTS_VARIABLE, os.path.join(os.path.dirname(path), os.path.expanduser(exports)))
    elif exports is not None:
        raise InputError(f"{path}: exports = {exports!r} is not the path of a folder")
    for name, table in settings.items():
        if not isinstance(table, dict):
            raise InputError(f"{path}: {name} is not in a table; use a table for each command, such as [live]")
        if name not in NAMES:
            raise InputError(f"{path}: [{name}] is not a command; see probedesign --help")
    return settings, path


def run(arguments: list[str]) -> int:
    """Run one command line.

    Args:
        arguments: without the program's name.

    Returns:
        Exit status: 0 on success; 2 for a file, option or argument that cannot be used; 130 after an interruption
        (Ctrl-C), as shells expect of SIGINT (128 + 2); 1 for any other failure, such as a closed output pipe.
    """
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed by the caller: `>&-`
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_WRONLY), "w"))
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # a terminal whose encoding lacks "±" prints "?"
            stream.reconfigure(errors="replace")
    try:
        return _run(arguments)
    except KeyboardInterrupt as interruption:
        return _fail(str(interruption) or "interrupted", INTERRUPTED)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # else Python reports it again at exit
        return 1
    except Exception as error:
        return _fail(f"{error} ({type(error).__name__}; set {DEBUG}=1 for a traceback)", 1)


def _run(arguments: list[str]) -> int:
    """Run one command line; errors of the input are reported, all others are raised."""
    from cyclopts import CycloptsError

    from probedesign.core.errors import InputError, MissingDependencyError

    try:
        status = build_app(bool(arguments) and HELP.isdisjoint(arguments), "".join(arguments[:1]))(arguments)
        sys.stdout.flush()
        return status if isinstance(status, int) else 0
    except (CycloptsError, InputError, MissingDependencyError) as error:
        return _fail(str(error), 2)
    except OSError as error:
        if error.filename is None or error.strerror is None:
            raise
        return _fail(f"{error.filename}: {error.strerror}", 2)


def _fail(message: str, status: int) -> int:
    """Print one line on stderr, after the traceback if the environment requests it, and return the status.

    The message may contain a piece of a file, which must not control the terminal.
    """
    if os.environ.get(DEBUG):
        import traceback

        traceback.print_exc()
    line = "".join(c for c in " ".join(message.split()) if c.isprintable())
    print("probedesign: error:", line, file=sys.stderr)
    return status


def use_one_blas_thread() -> None:
    """Set the linear algebra of numpy to one thread, unless the environment states another number.

    No matrix here gains from several threads. They wait in busy loops and take the cores from the process of the
    sensor, the browser and the workers. numpy reads the variables when it is imported.
    """
    for name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")


def main() -> None:
    """Run `probedesign` with the arguments of the process."""
    use_one_blas_thread()
    sys.exit(run(sys.argv[1:]))


if __name__ == "__main__":
    main()
