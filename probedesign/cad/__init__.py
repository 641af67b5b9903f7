"""Solids, meshes and files of a design. The only package that reaches CadQuery, and only when it is asked."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from probedesign.cad.staging import undisturbed
from probedesign.design import Design
from probedesign.errors import MissingDependencyError


def _quiet(_: str) -> None:
    """Say nothing."""


def export_parts(
    design: Design, out: Path | None = None, progress: Callable[[str], None] = _quiet
) -> dict[str, Any]:
    """Draw a design's parts, check them, and write the files of one export.

    Args:
        design: what to draw.
        out: folder to write; `exports/NAME` if None.
        progress: told each step in a few words.

    Returns:
        The manifest, with the folder written under `folder`.

    Raises:
        InputError: the folder cannot be written, or the probe cannot be held by this mount; one line.
        CheckFailedError: a part does not agree with its formulae; nothing is written.
        MissingDependencyError: CadQuery, trimesh or lib3mf is not installed.
    """
    try:
        with undisturbed():  # the kernel dies of a Ctrl-C while it loads
            from probedesign.cad.export import export_parts as export
    except ModuleNotFoundError as error:
        if (error.name or "").startswith("probedesign"):
            raise
        raise MissingDependencyError("export needs CadQuery: pip install 'probedesign[cad]'") from None
    except ImportError as error:  # CadQuery is there, a library of the system is not
        raise MissingDependencyError(
            f"CadQuery does not load: {error}; on Debian and Ubuntu: apt-get install libgl1 libexpat1"
        ) from None
    return export(design, out, progress)
