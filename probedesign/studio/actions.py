"""What the buttons of the studio write: the design, its parts, its estimator."""

from collections.abc import Callable
from pathlib import Path

from probedesign.core.errors import InputError, MissingDependencyError
from probedesign.core.files import exports_of
from probedesign.design import Design, check_design
from probedesign.design.edit import tables_of
from probedesign.design.io import render_design, write_design

DESIGNS = Path("designs")


def checked(design: Design) -> Design:
    """Return the design, checked as its file would be.

    Raises:
        InputError: a value is wrong, such as a name that is no file name.
    """
    return check_design(tables_of(design))


def save(design: Design, replace: bool) -> str:
    """Write designs/NAME.toml and return a message."""
    path = DESIGNS / f"{design.name}.toml"
    write_design(render_design(design), path, replace)
    return f"wrote {path}"


def export(design: Design, replace: bool) -> str:
    """Write the parts to print and return a message."""
    from probedesign import pipeline

    try:
        manifest = pipeline.export(design, exports_of() / design.name, lambda _: None)
    except MissingDependencyError as error:
        raise InputError(str(error)) from None
    return f"wrote {manifest['folder']}: {len(manifest['files']) + 1} files; open assembly.html"


def deploy(design: Design, replace: bool) -> str:
    """Write the frozen probe and return a message."""
    from probedesign.frozen_probe import deploy_model
    from probedesign.probe import build_probe

    folder = exports_of() / design.name
    return f"wrote {deploy_model(build_probe(design).model, folder / f'{design.name}.probe.json')}"


Action = Callable[[Design, bool], str]
#: Label of a button and what it does.
ACTIONS: dict[str, Action] = {"Save the design": save, "Export the parts": export, "Deploy the estimator": deploy}
