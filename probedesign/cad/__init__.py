"""Solids, meshes and files of a design: the only package that uses CadQuery, imported on demand."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from probedesign.core.errors import MissingDependencyError
from probedesign.core.parallel import defer_sigint
from probedesign.design import Design

if TYPE_CHECKING:
    import cadquery as cq


def export_parts(
    design: Design, out: Path | None = None, progress: Callable[[str], None] = lambda step: None
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
    """Write the STL file of one printed part only: probe, sensor_adapter, clamp_ring or flange_adapter.

    Returns the file, its volume and its scale; raises what `export_parts` raises, and an InputError where the file
    belongs to an export of another design.
    """
    with _kernel():
        from probedesign.cad.mesh import export_part as export
    return export(design, part, out)


def export_coupon(design: Design, out: Path | None = None) -> dict[str, Any]:
    """Write a stepped cone and a straight rod in the resin of a design, with sheets for the diameters.

    Args:
        design: whose range of diameters the coupons cover.
        out: output folder; `exports/NAME/coupon` if None.

    Returns:
        The manifest, with the output folder under `folder`.

    Raises:
        InputError: the folder cannot be written, or a sheet there was filled in.
        CheckFailedError: a part disagrees with its closed form; nothing is written.
        MissingDependencyError: CadQuery or trimesh is not installed.
    """
    with _kernel():
        from probedesign.cad.coupon import export_coupon as export
    return export(design, out)


def probe_solid(design: Design) -> "cq.Workplane":
    """Return the probe with its flange as a CadQuery workplane of one solid.

    Args:
        design: the design, for example from `load_design`.

    Returns:
        The solid in millimetres in the base frame. Tagged faces: base_plane, tip, underside; frames: probe_base,
        probe_tip; point: clocking_mark.

    Raises:
        InputError: the mount cannot clamp this probe.
        MissingDependencyError: CadQuery is not installed.
    """
    return _part(design, "probe")


def sensor_adapter(design: Design) -> "cq.Workplane":
    """Return the sensor adapter in millimetres in the sensor frame; raises what `probe_solid` raises.

    Tagged faces: tool_face, seat, rim; frames: sensor, probe_base; centres of holes: tool_screws, dowels, ring_screws.
    """
    return _part(design, "sensor_adapter")


def clamp_ring(design: Design) -> "cq.Workplane":
    """Return the clamp ring in millimetres in its own frame; raises what `probe_solid` raises.

    Tagged faces: base_plane, top; frame: probe_base; centres of holes: ring_screws.
    """
    return _part(design, "clamp_ring")


def flange_adapter(design: Design) -> "cq.Workplane":
    """Return the robot flange's adapter in millimetres in that flange's frame; raises what `probe_solid` raises.

    Tagged faces: robot_face, sensor_face; frames: robotflange, sensor; centres of holes: robot_bolts, mounting_screws,
    centring_pins.
    """
    return _part(design, "flange_adapter")


def _part(design: Design, part: str) -> "cq.Workplane":
    with _kernel():
        from probedesign.cad.workplanes import part_workplane
    design.sensor_model.check_holes_known()
    return part_workplane(design, part)


def assembly(
    design: Design,
    *,
    probe: "cq.Workplane | None" = None,
    sensor_adapter: "cq.Workplane | None" = None,
    clamp_ring: "cq.Workplane | None" = None,
    flange_adapter: "cq.Workplane | None" = None,
) -> "cq.Assembly":
    """Return all parts, screws, pins and the sensor's envelope, named, coloured and placed in the sensor frame.

    Args:
        design: the design.
        probe, sensor_adapter, clamp_ring, flange_adapter: changed parts that replace the design's, each in its own
            frame; None for the design's.

    Returns:
        The assembly in millimetres. Its printed parts carry their tags, such as `probe?tip` in a constraint.

    Raises:
        InputError: the mount cannot clamp this probe, or a part is not one solid.
        CheckFailedError: a changed solid is not valid.
        MissingDependencyError: CadQuery is not installed.
    """
    with _kernel():
        from probedesign.cad.workplanes import assembly as build
    design.sensor_model.check_holes_known()
    return build(design, _given(probe, sensor_adapter, clamp_ring, flange_adapter))


def export_changed(
    design: Design,
    out: Path,
    *,
    probe: "cq.Workplane | None" = None,
    sensor_adapter: "cq.Workplane | None" = None,
    clamp_ring: "cq.Workplane | None" = None,
    flange_adapter: "cq.Workplane | None" = None,
) -> dict[str, Any]:
    """Check changed parts in the assembly, and write their STL and STEP, the assembly's STEP and GLB and a manifest.

    Checked are what needs no formula of the original part: valid solids, closed meshes, no overlap of parts, the
    clearance to the sensor and its cable, the entry of every screw, measured in the changed parts, and that adapters
    touch sensor and probe. Tolerance stacks and printability of a changed part are neither checked nor in the
    manifest.

    Args:
        design: the design.
        out: output folder.
        probe, sensor_adapter, clamp_ring, flange_adapter: changed parts, as for `assembly`.

    Returns:
        The manifest, with the output folder under `folder`; `changed` has the mass of each part beside that of the
        design, which `deploy` uses.

    Raises:
        InputError: as `assembly`, or no part is given, or the folder cannot be written.
        CheckFailedError: a check fails; nothing is written.
        MissingDependencyError: CadQuery or trimesh is not installed.
    """
    with _kernel():
        from probedesign.cad.workplanes import export_changed as export
    design.sensor_model.check_holes_known()
    return export(design, _given(probe, sensor_adapter, clamp_ring, flange_adapter), out)


def _given(*parts: "cq.Workplane | None") -> "dict[str, cq.Workplane]":
    names = ("probe", "sensor_adapter", "clamp_ring", "flange_adapter")
    return {name: part for name, part in zip(names, parts, strict=True) if part is not None}


@contextmanager
def _kernel() -> Iterator[None]:
    """Let the CAD kernel be imported, and report what is missing."""
    try:
        with defer_sigint():  # Ctrl-C while the kernel loads would crash it
            yield
    except ImportError as error:
        if (error.name or "").startswith("probedesign"):
            raise
        if isinstance(error, ModuleNotFoundError):
            raise MissingDependencyError.of_extra("export", "CadQuery", "cad") from None
        # CadQuery is installed, a system library is missing
        raise MissingDependencyError(
            f"CadQuery does not load: {error}; on Debian and Ubuntu: apt-get install libgl1 libexpat1"
        ) from None
