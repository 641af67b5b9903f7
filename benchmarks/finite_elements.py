"""Finite-element solutions of touches with friction on the surface of printed cones.

`python -m benchmarks.finite_elements --out tests/data/fem_surface_cases.json` computes the cases and adds each one to
the file as soon as it is solved; a second run computes only what the file lacks. `--convergence` solves two of the
cases on three meshes and writes their differences into the file's header. The elements and the material are those of
`benchmarks.hyperelastic`; scikit-fem is needed (`pip install probedesign[bench]`).

The base face is bonded (u = 0), gravity is a body force, and the touch is a dead traction F w(X) / ∫ w on a patch of
the lateral surface, so that its resultant acts at the traction-weighted mean of the deformed patch.
"""

import argparse
import json
import math
import sys
import time
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.hyperelastic import (
    PATCH_ANGLE,
    PATCH_LENGTH,
    POISSON,
    Cone,
    Fineness,
    Mesh,
    State,
    deformation,
    equilibrium,
)
from probedesign.core.frames import Array
from probedesign.rod.equilibrium import Equilibrium

MAX_BEND = math.radians(45.0)
"""Largest angle between the tangent at the tip and the undeformed axis."""
MIN_MARGIN = 0.3
"""Smallest stability margin of the rod; closer to buckling the shape is ill-conditioned."""
MIN_FORCE, MAX_FORCE = 0.005, 0.2
"""Range of the normal forces [N] before they are reduced to `MAX_BEND`."""
COARSE, USED, FINE = Fineness(2, 1, 1.8), Fineness(3, 2, 1.8), Fineness(4, 2, 1.3)
CONVERGENCE = (19, 30)
"""Cases solved on all three meshes: the medium and the large probe bent by 40°, with and without friction."""


@dataclass(frozen=True)
class Touch:
    """Definition of a touch; lengths in m, angles in rad, forces in N."""

    design: str  #: name of the design under designs/.
    fraction: float  #: undeformed arclength over the length.
    phi: float  #: angle of the touched generator about z, from x towards y, in the undeformed section.
    gravity: tuple[float, float, float]  #: in base axes [m/s²], (3,).
    #: tangential over normal force around the axis and along the generator towards the tip, (2,).
    friction: tuple[float, float]
    force: float  #: requested normal force; it is reduced until the probe bends by less than `MAX_BEND`.


def touches() -> list[Touch]:
    """Return 60 touches that cover probes, places, directions, gravity and friction; no random numbers."""
    fractions = (0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95)
    gravities = ((9.81, 0.0, 0.0), (0.0, 0.0, 9.81), (9.81, 0.0, 0.0), (0.0, 0.0, -9.81), (5.664, -5.664, 5.664))
    golden = 0.5 * (math.sqrt(5.0) - 1.0)
    cases = []
    for k in range(60):
        j, angle = k // 3, 2.0 * math.pi * ((k * golden) % 1.0)
        size = 0.1 * (j % 6)
        phi = 2.0 * math.pi * ((0.1 + k * math.sqrt(2.0)) % 1.0)
        force = MIN_FORCE * (MAX_FORCE / MIN_FORCE) ** ((k * math.sqrt(3.0)) % 1.0)
        cases.append(
            Touch(
                ("large", "medium", "small")[k % 3],
                fractions[(3 * j + k % 3) % 8],
                phi,
                gravities[j % 5],
                (size * math.cos(angle), size * math.sin(angle)),
                force,
            )
        )
    return cases


def from_rod(mesh: Mesh, eq: Equilibrium) -> State:
    """Return an initial guess of the deformed cone from the sections of the rod and St Venant's lateral contraction.

    A section point ξ with axial strain ε = e + c·ξ moves within its section by -ν (e ξ + (c·ξ) ξ - ½ |ξ|² c).
    Source: S. P. Timoshenko, J. N. Goodier, Theory of Elasticity, 3rd edition, 1970, section 102.
    """
    cone, xi = mesh.cone, mesh.nodes[:, :2]
    z, of = np.unique(np.round(mesh.nodes[:, 2], 12), return_inverse=True)
    z = np.clip(z, 0.0, cone.length)
    p, R, r = eq.p_at(z), eq.R_at(z), cone.radius(z)
    states = eq.states_at(z)
    m = np.einsum("zji,zj->zi", R, states[:, 3:6]) / (0.25 * np.pi * cone.youngs_modulus * r**4)[:, None]
    stretch = np.einsum("zi,zi->z", R[:, :, 2], eq.n_at(z)) / (np.pi * cone.youngs_modulus * r**2)
    c = np.stack([-m[:, 1], m[:, 0]], axis=1)[of]
    inward = stretch[of][:, None] * xi + (c * xi).sum(1)[:, None] * xi - 0.5 * (xi**2).sum(1)[:, None] * c
    inward *= (1.0 - np.exp(-mesh.nodes[:, 2] / cone.base_radius))[:, None]
    across = np.concatenate([xi - POISSON * inward, np.zeros((len(xi), 1))], axis=1)
    x = p[of] + np.einsum("nij,nj->ni", R[of], across)
    base = mesh.nodes[:, 2] < 1e-12
    x[base] = mesh.nodes[base]
    return State(x, np.zeros((len(mesh.of_element), 4)))


def rod_frame(cone: Cone, eq: Equilibrium, s: float, phi: float) -> tuple[Array, Array, Array]:
    """Return the centre of the rod's section, the touched point relative to it and the deformed surface's frame."""
    point, frame = cone.on_surface(s, phi)
    R = eq.R_at(s)
    return eq.p_at(s), R @ point, frame @ R.T


def solve_rod(cone: Cone, gravity: Array, force: Array, s: float, phi: float) -> Equilibrium:
    """Solve the rod under a force at a point of its deformed surface by iteration of the couple.

    Raises:
        ArithmeticError: the rod has no stable equilibrium.
    """
    arm, eq = cone.on_surface(s, phi)[0], None
    for _ in range(12):
        eq = cone.rod.solve(gravity, force, s, couple=np.cross(arm, force))
        if not eq.ok:
            raise ArithmeticError(f"the rod is {eq.result}")
        arm = rod_frame(cone, eq, s, phi)[1]
    assert eq is not None
    return eq


def choose_force(touch: Touch, cone: Cone) -> tuple[Array, Equilibrium]:
    """Return a force that has the requested friction on the deformed surface of the rod and bends it moderately."""
    s, normal, gravity = touch.fraction * cone.length, touch.force, np.array(touch.gravity)
    direction, (_, frame) = np.array([1.0, *touch.friction]), cone.on_surface(s, touch.phi)
    while True:
        force = normal * direction @ frame
        try:
            eq = solve_rod(cone, gravity, force, s, touch.phi)
            # The force rotates with the surface, which it rotates itself; for a large force the iteration diverges.
            settled = False
            for _ in range(30):
                before, force = force, normal * direction @ rod_frame(cone, eq, s, touch.phi)[2]
                settled = float(np.linalg.norm(force - before)) < 1e-4 * normal
                if settled:
                    break
                eq = solve_rod(cone, gravity, force, s, touch.phi)
            if settled and math.acos(min(1.0, float(eq.tip_tangent[2]))) <= MAX_BEND and eq.margin >= MIN_MARGIN:
                return force, eq
        except ArithmeticError:
            pass
        normal *= 0.8


@dataclass(frozen=True)
class Section:
    """Touched section of a solution: centroid [m], rotation, deformed position of the surface point [m] and patch."""

    centroid: Array
    R: Array
    surface: Array
    patch: Array
    patch_frame: Array

    @classmethod
    def of(cls, mesh: Mesh, x: Array) -> "Section":
        """Evaluate a solution; the rotation is the area-weighted best fit over the section."""
        w = mesh.section
        centroid, rest = w @ x, w @ mesh.nodes
        U, _, V = np.linalg.svd(np.einsum("n,ni,nj->ij", w, x - centroid, mesh.nodes - rest))
        R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ V)]) @ V
        centre = centroid - R @ (rest - np.array([0.0, 0.0, mesh.s]))
        point, frame = mesh.cone.on_surface(mesh.patch_s, mesh.patch_phi)
        F = deformation(x, mesh.patch_gradients, mesh.patch_element)
        nanson = np.linalg.det(F)[..., None] * np.einsum("eqji,eqj->eqi", np.linalg.inv(F), mesh.patch_normal)
        normal = np.einsum("eqi,eq->i", nanson, mesh.patch_weight)
        normal /= np.linalg.norm(normal)
        along = np.einsum("eqij,j,eq->i", F, frame[2], mesh.patch_weight)
        along -= along @ normal * normal
        along /= np.linalg.norm(along)
        surface = centre + R @ (point + np.array([0.0, 0.0, mesh.patch_s - mesh.s]))
        return cls(centre, R, surface, mesh.patch @ x, np.stack([-normal, np.cross(along, normal), along]))


def solve(name: str, touch: Touch) -> dict[str, Any]:
    """Solve one touch on the coarse and on the used mesh and return its record.

    The force is dead, so its direction is iterated on the coarse mesh until it has the requested friction on the
    deformed surface. The used mesh is solved with that force, and the record has the friction that results.
    """
    cone, gravity = Cone.of(touch.design), np.array(touch.gravity)
    s = touch.fraction * cone.length
    force, eq = choose_force(touch, cone)
    normal = float(np.linalg.norm(force)) / math.hypot(1.0, *touch.friction)
    coarse = Mesh(cone, s, touch.phi, COARSE)
    state = from_rod(coarse, eq)
    for _ in range(3):
        state, _, _ = equilibrium(coarse, gravity, force, state)
        new = normal * np.array([1.0, *touch.friction]) @ Section.of(coarse, state.x).patch_frame
        changed, force = float(np.linalg.norm(new - force)), new
        if changed < 1e-5 * normal:
            break
    state, _, _ = equilibrium(coarse, gravity, force, state)
    rough = Section.of(coarse, state.x)
    record = evaluate(Mesh(cone, s, touch.phi, USED), gravity, force)
    found = record.pop("section")
    record["coarse_mesh_differs_mm"] = {
        "p_surface": _mm(rough.patch - found.patch), "p_surface_section": _mm(rough.surface - found.surface),
        "p_centreline": _mm(rough.centroid - found.centroid)}  # fmt: skip
    given = {
        "id": name, "design": touch.design, "length_m": cone.length, "base_d_m": 2.0 * cone.base_radius,
        "tip_d_m": 2.0 * cone.tip_radius, "youngs_modulus_Pa": cone.youngs_modulus,
        "shear_modulus_Pa": cone.shear_modulus, "poissons_ratio": POISSON, "density_kg_m3": cone.density,
        "gravity_base_m_s2": list(touch.gravity), "friction_asked": _rounded(touch.friction, 6)}  # fmt: skip
    return given | record


def evaluate(mesh: Mesh, gravity: Array, force: Array) -> dict[str, Any]:
    """Solve on a mesh from the rod as initial guess and return the part of the record that depends on the solution."""
    cone = mesh.cone
    eq = solve_rod(cone, gravity, force, mesh.s, mesh.patch_phi)
    state, out, steps = equilibrium(mesh, gravity, force, from_rod(mesh, eq))
    x, found = state.x, Section.of(mesh, state.x)
    weight = np.outer(mesh.nodal_volumes, cone.density * gravity)
    base_force = force + weight.sum(0)
    base_moment = np.cross(found.patch, force) + np.cross(x, weight).sum(0)
    touched = found.patch_frame @ force
    by_section = cone.on_surface(mesh.patch_s, mesh.patch_phi)[1] @ found.R.T
    off = by_section @ (found.patch - found.surface)
    pull = by_section @ force
    crossing = off[1:] - off[0] * pull[1:] / pull[0]
    return {
        "s_contact_m": mesh.patch_s, "phi_rad": mesh.patch_phi,
        "force_base_N": force.tolist(), "force_normal_N": float(touched[0]),
        "friction": _rounded(touched[1:] / touched[0], 6), "friction_section": _rounded(pull[1:] / pull[0], 6),
        "p_surface_base_m": _rounded(found.patch, 9), "p_surface_section_base_m": _rounded(found.surface, 9),
        "p_centreline_base_m": _rounded(found.centroid, 9), "R_section_base": _rounded(found.R, 9),
        "wrench_base": [*base_force.tolist(), *base_moment.tolist()],
        "surface_differs_mm": {"inward_around_along": _rounded(1e3 * off, 5), "line_of_action": _mm(crossing)},
        "bend_deg": round(math.degrees(math.acos(min(1.0, float(eq.tip_tangent[2])))), 2),
        "mesh": {"elements": len(mesh.of_element), "nodes": len(mesh.nodes), "newton_steps": steps,
                 "reaction_force_differs_N": float(np.abs(out.sum(0) + base_force).max()),
                 "reaction_moment_differs_Nm": float(np.abs(np.cross(x, out).sum(0) + base_moment).max())},
        "section": found,
    }  # fmt: skip


def _mm(off: Array) -> float:
    return round(1e3 * float(np.linalg.norm(off)), 5)


def _rounded(values: Any, digits: int) -> Any:
    return (np.round(np.asarray(values, dtype=float), digits) + 0.0).tolist()  # + 0.0: no -0.0


def converge(index: int) -> dict[str, Any]:
    """Solve one case on all three meshes with the force chosen for the rod, and return the changes of the points."""
    touch = touches()[index]
    cone, gravity = Cone.of(touch.design), np.array(touch.gravity)
    force, _ = choose_force(touch, cone)
    rows, found = [], []
    for fineness in (COARSE, USED, FINE):
        record = evaluate(Mesh(cone, touch.fraction * cone.length, touch.phi, fineness), gravity, force)
        found.append(record.pop("section"))
        rows.append({"square": fineness.square, "rings": fineness.rings, "layer_radii": fineness.layer,
                     "elements": record["mesh"]["elements"], "nodes": record["mesh"]["nodes"],
                     **{key: record[key] for key in ("p_surface_base_m", "p_surface_section_base_m",
                                                     "p_centreline_base_m", "wrench_base")}})  # fmt: skip
        print(rows[-1], file=sys.stderr, flush=True)
    changes = [{"p_surface_mm": _mm(b.patch - a.patch), "p_surface_section_mm": _mm(b.surface - a.surface),
                "p_centreline_mm": _mm(b.centroid - a.centroid)}
               for a, b in pairwise(found)]  # fmt: skip
    return {"case": case_name(index), "force_base_N": force.tolist(), "meshes": rows,
            "coarse_to_used": changes[0], "used_to_fine": changes[1]}  # fmt: skip


def case_name(index: int) -> str:
    """Return the name of a case, e.g. `07_medium_s0.95_mu0.2`."""
    touch = touches()[index]
    friction = math.hypot(*touch.friction)
    return f"{index:02d}_{touch.design}_s{touch.fraction:g}_mu{friction:.1f}"


def header() -> dict[str, Any]:
    """Return the header of the file, with method, fields and sources."""
    import skfem

    return {
        "note": "3-D finite elements of touches with friction on the surface of printed cones, base face bonded "
                "rigid. Computed by python -m benchmarks.finite_elements --out tests/data/fem_surface_cases.json.",
        "method": "27-node hexahedra with discontinuous linear pressure, 3 x 3 x 2 Gauss points (2 along the axis), "
                  "total Lagrangian, Newton's method with consistent tangent and banded Cholesky factorisation; "
                  "dead gravity and a dead traction on an elliptic patch of the lateral surface",
        "energy": "W = G/2 (tr F^T F - 3) - G ln J + lambda/2 (J - 1)^2, G = E/(2 (1 + nu)), "
                  "lambda = 2 G nu/(1 - 2 nu), J - 1 in the last term projected onto linear functions per element",
        "library": {"scikit-fem": getattr(skfem, "__version__", "unknown"), "licence": "BSD-3-Clause"},
        "material": "E and density of designs/*.toml (elastic-50a); nu = 0.49 assumed; G by isotropy, not the design's",
        "patch": {"half_angle_rad": PATCH_ANGLE, "half_length_radii": PATCH_LENGTH,
                  "traction": "F w/∫w dA, w = (1 - (dphi/half_angle)^2 - (ds/half_length)^2)^2 / r"},
        "mesh": {"square": USED.square, "rings": USED.rings, "layer_radii": USED.layer},
        "fields": {
            "phi_rad": "angle of the touched generator about z in the undeformed section, from x towards y",
            "friction": "tangential over normal force [around the axis, along the generator towards the tip], by "
                        "the traction-weighted mean normal of the deformed patch; friction_section: by the normal of "
                        "the cone turned with the section",
            "p_surface_base_m": "traction-weighted mean of the deformed patch: the resultant acts exactly here; it "
                                "lies inside the surface by the patch's curvature and the indentation",
            "p_surface_section_base_m": "the undeformed surface point (s, phi) moved with the best-fit rigid motion "
                                        "of its section: the touched point in the sense of a rod",
            "surface_differs_mm": "p_surface - p_surface_section on [inward normal, around, along], and the distance "
                                  "on the surface from p_surface_section to the force's line of action",
            "wrench_base": "[N, N, N, Nm, Nm, Nm], what the probe does to its mount about the base origin: statics of "
                           "the deformed body; mesh.reaction_* is its difference from the sum of nodal reactions",
            "bend_deg": "angle between the axis at rest and the tip's tangent of the rod under the same load",
            "coarse_mesh_differs_mm": "change from a mesh of 2 x 2 + 8 elements a layer: an upper bound of the mesh "
                                      "error; the error itself is estimated under convergence",
        },
        "sources": ["D. Boffi, F. Brezzi, M. Fortin, Mixed Finite Element Methods and Applications, 2013, 8.6",
                    "J. Bonet, R. D. Wood, Nonlinear Continuum Mechanics for Finite Element Analysis, 2008",
                    "O. C. Zienkiewicz, R. L. Taylor, J. M. Too, Int. J. Num. Meth. Eng. 3, 275-290, 1971",
                    "T. Gustafsson, G. D. McBain, scikit-fem, JOSS 5(52), 2369, 2020"],
    }  # fmt: skip


def write(path: Path, convergence: list[dict[str, Any]], cases: list[dict[str, Any]]) -> None:
    """Write the file with one case per line."""
    head = json.dumps(header() | {"convergence": convergence}, indent=1, ensure_ascii=False)
    rows = ",\n  ".join(json.dumps(case) for case in sorted(cases, key=lambda case: str(case["id"])))
    partial = path.with_suffix(".part")
    partial.write_text(f'{head[:-2]},\n "cases": [\n  {rows}\n ]\n}}\n')
    partial.replace(path)


def main(arguments: list[str]) -> int:
    """Compute the cases that the file lacks and return the exit status."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.finite_elements", description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="JSON file, extended case by case")
    parser.add_argument("--convergence", action="store_true", help="solve two cases on three meshes as well")
    options = parser.parse_args(arguments)
    if find_spec("skfem") is None:
        print("finite elements need scikit-fem: pip install scikit-fem", file=sys.stderr)
        return 2
    old = json.loads(options.out.read_text()) if options.out.exists() else {}
    convergence, cases = old.get("convergence", []), old.get("cases", [])
    for index, touch in enumerate(touches()):
        name = case_name(index)
        if any(case["id"] == name for case in cases):
            continue
        started = time.perf_counter()
        try:
            cases.append(solve(name, touch))
        except ArithmeticError as error:
            print(f"{name}: {error}", file=sys.stderr)
            continue
        write(options.out, convergence, cases)
        case = cases[-1]
        took = f"{time.perf_counter() - started:.1f} s"
        print(name, took, f"bend {case['bend_deg']}°, {case['surface_differs_mm']}", file=sys.stderr)
    for index in CONVERGENCE if options.convergence else ():
        if not any(row["case"] == case_name(index) for row in convergence):
            convergence.append(converge(index))
            write(options.out, convergence, cases)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
