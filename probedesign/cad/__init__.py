"""Solids, meshes and files of a design: the only package that uses CadQuery, imported on demand."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
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
    with _kernel():
        from probedesign.cad.export import export_parts as export
    return export(design, out, progress)


def export_part(design: Design, part: str, out: Path | None = None) -> dict[str, Any]:
    """Build one printed part, check its mesh, and write its STL file only.

    Args:
        design: the design to export.
        part: probe, sensor_adapter, clamp_ring or flange_adapter.
        out: output folder; `exports/NAME` if None.

    Returns:
        The file, its volume and its scale.

    Raises:
        InputError: the file cannot be written, or belongs to an export of another design.
        CheckFailedError: the part is not one valid solid, or its mesh is not closed.
        MissingDependencyError: CadQuery, trimesh or lib3mf is not installed.
    """
    with _kernel():
        from probedesign.cad.single_part import export_part as export
    return export(design, part, out)


@contextmanager
def _kernel() -> Iterator[None]:
    """Let the CAD kernel be imported, and report what is missing."""
    try:
        with defer_sigint():  # Ctrl-C while the kernel loads would crash it
            yield
    except ModuleNotFoundError as error:
        if (error.name or "").startswith("probedesign"):
            raise
        raise MissingDependencyError.of_extra("export", "CadQuery", "cad") from None
    except ImportError as error:
        if (error.name or "").startswith("probedesign"):
            raise
        # CadQuery is installed, a system library is missing
        raise MissingDependencyError(
            f"CadQuery does not load: {error}; on Debian and Ubuntu: apt-get install libgl1 libexpat1"
        ) from None
