"""Proof that what was drawn is what the mechanics compute with: solids, slices, meshes against formulae."""

from typing import Any

import numpy as np

from probedesign import section
from probedesign.cad.assembly import air_of, cable_sector, shared_volume
from probedesign.cad.drawing import Drawing
from probedesign.cad.kernel import mass_of, section_of
from probedesign.cad.mesh import Mesh
from probedesign.cad.packages import pieces_of
from probedesign.cad.reach import obstructed
from probedesign.cad.threemf import read_back
from probedesign.errors import CheckFailedError
from probedesign.frames import Array
from probedesign.geometry import ProbeGeometry
from probedesign.mass import MassProperties, combined, flexible_part
from probedesign.mount import mount_mass_properties, mount_part_masses
from probedesign.units import MM

Findings = dict[str, dict[str, Any]]

SOLID_LIMIT = 1e-9
"""Relative. The kernel integrates these surfaces to about 1e-14; anything drawn wrongly is far above."""
SECTION_LIMIT = 1e-6
"""Relative."""
MESH_LIMIT = 5e-4
"""Relative. Facets that turn by at most δ = 0.05 rad leave out δ²/6 = 4.2e-4 of a round body, and nothing else."""
OVERLAP_LIMIT = 0.0
"""Of volume [m³]: touching faces share none, and no fit is drawn pressed."""
STATIONS = 9


def verify(drawing: Drawing, meshes: dict[str, Mesh], packages: dict[str, bytes]) -> Findings:
    """Check a drawing, its meshes and its 3MF packages.

    Args:
        drawing: of the design.
        meshes: of the printed parts, by name.
        packages: content of the 3MF files, by name.

    Returns:
        Each finding by name, with `measured`, `limit`, `ok` and `what`.

    Raises:
        CheckFailedError: naming every finding that is not ok.
    """
    findings = {
        **_solids(drawing),
        **_sections(drawing),
        **_meshes(drawing, meshes),
        **_packages(drawing, meshes, packages),
        **_room(drawing),
        **_reach(drawing),
    }
    failed = [
        f"{n} = {f['measured']:.3g} (limit {f['limit']:.3g})" for n, f in findings.items() if not f["ok"]
    ]
    if failed:
        raise CheckFailedError(f"{drawing.design.name}: the drawn parts do not hold: {'; '.join(failed)}")
    return findings


def _solids(drawing: Drawing) -> Findings:
    geometry, adapter = drawing.geometry, drawing.adapter
    density = drawing.design.density.value
    drawn = dict(drawing.bodies)
    drawn["hanging"] = combined(body for name, body in drawn.items() if name != "flexible")
    formula = mount_part_masses(geometry, adapter, density)
    formula["hanging"] = mount_mass_properties(geometry, adapter, density)
    formula["flexible"] = flexible_part(geometry, density).moved(adapter.T_sensor_base)
    findings: Findings = {}
    for name, body in drawn.items():
        findings |= _same_body(name, body, formula[name])
    return findings


def _same_body(name: str, drawn: MassProperties, formula: MassProperties) -> Findings:
    extent = float(np.sqrt(np.trace(formula.inertia) / formula.mass))
    volume = abs(drawn.volume / formula.volume - 1.0)
    centre = _largest(drawn.p_com - formula.p_com) / extent
    inertia = _largest(drawn.inertia - formula.inertia) / _largest(formula.inertia)
    return {
        f"{name}_volume": _finding(volume, SOLID_LIMIT, "relative"),
        f"{name}_centre": _finding(centre, SOLID_LIMIT, "relative to the body's extent"),
        f"{name}_inertia": _finding(inertia, SOLID_LIMIT, "relative, about the centre of mass"),
    }


def _sections(drawing: Drawing) -> Findings:
    geometry, solid = drawing.geometry, drawing.parts["probe"].shape
    formulae = {
        "section_area": section.area,
        "section_second_moment_xx": section.second_moment_xx,
        "section_second_moment_yy": section.second_moment_yy,
    }
    stations = _stations(geometry)
    drawn = np.array([section_of(solid, s) for s in stations])
    wanted = np.column_stack([formula(geometry, stations) for formula in formulae.values()])
    worst = np.abs(drawn / wanted - 1.0).max(axis=0)
    what = f"relative, worst of {STATIONS} slices of the solid"
    return {name: _finding(w, SECTION_LIMIT, what) for name, w in zip(formulae, worst, strict=True)}


def _stations(geometry: ProbeGeometry) -> list[float]:
    """Heights spread evenly, kept off the knots: a cut along the edge between two faces is ill-posed."""
    even = (np.arange(STATIONS) + 0.5) / STATIONS * geometry.length
    gaps = np.diff(geometry.s)
    i = np.clip(np.searchsorted(geometry.s, even, side="right") - 1, 0, len(gaps) - 1)
    clear = 0.01 * gaps[i]
    return [float(s) for s in np.clip(even, geometry.s[i] + clear, geometry.s[i + 1] - clear)]


def _meshes(drawing: Drawing, meshes: dict[str, Mesh]) -> Findings:
    findings: Findings = {}
    for name, mesh in meshes.items():
        missing = abs(mesh.volume / mass_of(drawing.parts[name].shape, 1.0).volume - 1.0)
        findings[f"{name}_mesh_closed"] = _yes(mesh.closed, "watertight, winding consistent, outside outside")
        findings[f"{name}_mesh_volume"] = _finding(missing, MESH_LIMIT, "relative, to the solid")
    return findings


def _packages(drawing: Drawing, meshes: dict[str, Mesh], packages: dict[str, bytes]) -> Findings:
    findings: Findings = {}
    for file, wanted in pieces_of(drawing, meshes).items():
        found, warnings = read_back(packages[file])
        read = [piece for piece, _ in found]
        named = [(p.name, p.part_number) for p in read] == [(p.name, p.part_number) for p in wanted]
        pairs = [(a.mesh, b.mesh) for a, b in zip(read, wanted, strict=False)]
        lost = sum(abs(len(a.triangles) - len(b.triangles)) for a, b in pairs)
        worst = max(abs(a.volume / b.volume - 1.0) for a, b in pairs) if pairs else np.inf
        findings |= {
            f"{file}_warnings": _finding(warnings, 0.0, "of a strict reader"),
            f"{file}_names": _yes(named, "its objects, their names and part numbers survive"),
            f"{file}_triangles": _finding(lost, 0.0, "difference to the meshes"),
            # 3MF writes coordinates as decimals, cut after some digits.
            f"{file}_volume": _finding(worst, 1e-5, "relative, to the meshes"),
        }
    return findings


def _room(drawing: Drawing) -> Findings:
    ours = [part for part in drawing.parts.values() if part.name != "sensor"]
    sector = cable_sector(drawing.design.sensor_model)
    in_sector = sum(shared_volume(sector, part.placed) for part in ours)
    in_air = sum(
        shared_volume(air, part.placed) for air in air_of(drawing.design.sensor_model) for part in ours
    )
    wide = ("probe", "sensor_adapter", "clamp_ring", "ring_screws", "ring_nuts")
    lowest = min(drawing.parts[name].placed.BoundingBox().zmin for name in wide) * MM
    return {
        "overlap": _finding(max(drawing.shared_volumes.values()), OVERLAP_LIMIT, "m³, worst pair of parts"),
        "cable_sector": _finding(in_sector, OVERLAP_LIMIT, "m³ of our parts where the cable must be free"),
        "air": _finding(
            in_air, OVERLAP_LIMIT, "m³ of our parts within 0.5 mm of the sensor's body and cable"
        ),
        # A nanometre: the kernel's boxes are wider than the part by its tolerance of 1e-10 m.
        "below_tool_face": _finding(max(0.0, -lowest), 1e-9, "m that wide parts reach below the tool face"),
    }


def _reach(drawing: Drawing) -> Findings:
    ways = obstructed(drawing.parts, drawing.screws, drawing.adapter, drawing.design.sensor_model)
    what = "m³ of what is mounted before in the way in, and in the way of the key"
    return {f"reach_{name}": _finding(volume, OVERLAP_LIMIT, what) for name, volume in ways.items()}


def _finding(measured: float, limit: float, what: str) -> dict[str, Any]:
    return {"measured": float(measured), "limit": limit, "ok": bool(measured <= limit), "what": what}


def _yes(ok: bool, what: str) -> dict[str, Any]:
    return _finding(0.0 if ok else 1.0, 0.0, f"{what} (0 is yes)")


def _largest(values: Array) -> float:
    return float(np.max(np.abs(values)))
