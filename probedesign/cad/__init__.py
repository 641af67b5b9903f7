"""Solids, meshes and files of a design: the only package that uses CadQuery, imported on demand."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from probedesign.core.errors import MissingDependencyError
from probedesign.core.parallel import defer_sigint
from probedesign.design import Design


def _quiet(_: str) -> None:
    """Ignore progress."""


def export_parts(
    design: Design, out: Path | None = None, progress: Callable[[str], None] = _quiet
) -> dict[str, Any]:
    """Build a design's parts, verify them, and write the files of one export.

    Args:
        design: the design to export.
        out: output folder; `exports/NAME` if None.
        progress: called with the name of each step.

    Returns:
        The manifest, with the output folder under `folder`.

    Raises:
        InputError: the folder cannot be written, or the mount cannot clamp the probe.
        CheckFailedError: a part disagrees with its closed form; nothing is written.
        MissingDependencyError: CadQuery, trimesh or lib3mf is not installed.
    """
    try:
        with defer_sigint():  # Ctrl-C while the kernel loads would crash it
            from probedesign.cad.export import export_parts as export
    except ModuleNotFoundError as error:
        if (error.name or "").startswith("probedesign"):
            raise
        raise MissingDependencyError.of_extra("export", "CadQuery", "cad") from None
    except ImportError as error:  # CadQuery is installed, a system library is missing
        raise MissingDependencyError(
            f"CadQuery does not load: {error}; on Debian and Ubuntu: apt-get install libgl1 libexpat1"
        ) from None
    return export(design, out, progress)
