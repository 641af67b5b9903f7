"""Compute the compliance of the clamped flange, `root_rigid_radii` of the rod, and the force of its lip.

All by linear finite elements.

For a body of revolution under a bending moment, u = (U cos θ, V sin θ, W cos θ) in cylindrical coordinates reduces the
solid to its half plane. Displacement and pressure are independent (Taylor–Hood, Q2/Q1), which prevents locking of
incompressible material. The end of a stub above the flange rotates by φ, and the rod without a flange by M ∫ ds/(E I);
the difference as a length of rod in base radii is c = (∫ ds/(E I) - φ/M) E I₀/r₀. The force that compresses the lip
between ring and land is that of the axisymmetric problem, of which the formula in `mount.lip.pad_force` is compared.
scikit-fem is needed: pip install 'probedesign[bench]'.
"""

import itertools
import math
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from benchmarks.timing import print_table

ROOT = Path(__file__).parents[1]
POISSON = 0.49
STUB = 4.0  #: Height of the stub in base radii. The effect of the root has decayed there by Saint-Venant's principle.
Support = Literal["face", "glued", "clamped", "slipping", "hollow seat"]
SUPPORTS: dict[Support, str] = {
    "face": "base bonded at s = 0, no flange",
    "glued": "underside glued, lip clamped",
    "clamped": "lip bonded, underside without friction (clamped)",
    "slipping": "lip and underside without friction",
    "hollow seat": "lip bonded, middle of the underside free",
}


class ClampedBase(NamedTuple):
    """Dimensions of a round base with its flange [m]: radius, slope -dr/ds, radius and thickness of the flange, bore
    radius of the ring."""

    r0: float
    slope: float
    flange_r: float
    thickness: float
    bore_r: float


def lines(ends: list[float], sharp: list[bool], cells: int, ratio: float) -> np.ndarray:
    """Return grid lines through `ends`, refined by `ratio` from cell to cell towards the ends that are sharp."""
    pieces = []
    for a, b, at_a, at_b in zip(ends, ends[1:], sharp, sharp[1:], strict=False):
        steps = ratio ** np.arange(cells)
        if at_a and at_b:
            steps = np.concatenate([steps, steps[::-1]])
        elif at_b:
            steps = steps[::-1]
        elif not at_a:
            steps = np.ones(cells)
        pieces.append(a + (b - a) * np.cumsum([0.0, *steps])[:-1] / steps.sum())
    return np.concatenate([*pieces, [ends[-1]]])


def missing_compliance(base: ClampedBase, support: Support, poisson: float = POISSON, cells: int = 10) -> float:
    """Return c of a base in base radii; it is positive if the base bends less than the rod."""
    from skfem import (
        Basis,
        BilinearForm,
        ElementQuad1,
        ElementQuad2,
        ElementVector,
        FacetBasis,
        LinearForm,
        MeshQuad,
        asm,
        bmat,
        condense,
        solve,
    )

    r0, h, top = base.r0, base.thickness, STUB * base.r0
    mu = 1.0
    E, lam = 2 * mu * (1 + poisson), 2 * mu * poisson / (1 - 2 * poisson)
    flange = support != "face"
    radial = [0.0, r0, base.bore_r, base.flange_r] if flange else [0.0, r0]
    axial = [-h, 0.0, top] if flange else [0.0, top]
    r = lines(radial, [False, True, True, False], cells, 1.45)
    z = lines(axial, [False, True, False] if flange else [True, False], cells, 1.35)
    mesh = MeshQuad.init_tensor(r, z)
    middle = mesh.p[:, mesh.t].mean(axis=1)
    mesh = mesh.remove_elements(np.flatnonzero((middle[1] > 0.0) & (middle[0] > r0)))
    points = mesh.p.copy()
    points[0] *= np.where(points[1] > 0.0, 1.0 - base.slope * points[1] / r0, 1.0)
    mesh = MeshQuad(points, mesh.t)

    u_basis = Basis(mesh, ElementVector(ElementQuad2(), 3), intorder=6)
    p_basis = u_basis.with_element(ElementQuad1())

    def strain(u: Any, x: Any) -> tuple[Any, ...]:
        radius = x[0]
        (U, V, W), g = u, u.grad
        return (
            g[0, 0], (U + V) / radius, g[2, 1],
            0.5 * (g[0, 1] + g[2, 0]), 0.5 * (g[1, 0] - (U + V) / radius), 0.5 * (g[1, 1] - W / radius),
        )  # fmt: skip

    @BilinearForm
    def stiffness(u: Any, v: Any, w: Any) -> Any:
        a, b = strain(u, w.x), strain(v, w.x)
        return 2 * mu * w.x[0] * (sum(a[i] * b[i] for i in range(3)) + 2 * sum(a[i] * b[i] for i in range(3, 6)))

    @BilinearForm
    def divergence(u: Any, q: Any, w: Any) -> Any:
        return -q * sum(strain(u, w.x)[:3]) * w.x[0]

    @BilinearForm
    def bulk(p: Any, q: Any, w: Any) -> Any:
        return -p * q / lam * w.x[0]

    top_r = r0 - base.slope * top
    end = FacetBasis(mesh, u_basis.elem, facets=mesh.facets_satisfying(lambda x: np.isclose(x[1], top)), intorder=6)

    @LinearForm
    def moment(v: Any, w: Any) -> Any:
        return v[2] * w.x[0] ** 2  # traction k r cos θ with k = 1 has the moment I; like all forms divided by π

    B, f = asm(divergence, u_basis, p_basis), asm(moment, end)
    K = bmat([[asm(stiffness, u_basis), B.T], [B, asm(bulk, p_basis)]], "csr")
    load = np.concatenate([f, np.zeros(p_basis.N)])
    fixed = _fixed(base, support, u_basis, p_basis)
    x = solve(*condense(K, load, D=fixed))
    second = math.pi * top_r**4 / 4.0  # I at the end; M = k I
    phi_over_moment = math.pi * float(f @ x[: u_basis.N]) / second**2
    s = np.linspace(0.0, top, 2001)
    rod = float(np.trapezoid(4.0 / (math.pi * E * (r0 - base.slope * s) ** 4), s))
    return (rod - phi_over_moment) * E * math.pi * r0**4 / 4.0 / r0


def _fixed(base: ClampedBase, support: Support, u_basis: Any, p_basis: Any) -> np.ndarray:
    """Return the fixed degrees of freedom on the axis, the lip and the underside."""
    x, tiny = u_basis.doflocs, 1e-9
    index = np.arange(u_basis.N)
    component = np.empty(u_basis.N, dtype=int)
    for name in ("nodal_dofs", "facet_dofs", "interior_dofs"):
        dofs = getattr(u_basis, name)
        for i in range(3):
            component[dofs[i::3].ravel()] = i
    axis = np.isclose(x[0], 0.0, atol=tiny)
    fixed = axis & (component == 2)
    axial = component == 2
    if support == "face":
        fixed |= np.isclose(x[1], 0.0, atol=tiny)
    else:
        under = np.isclose(x[1], -base.thickness, atol=tiny)
        beyond = x[0] >= base.bore_r - tiny
        lip = (np.isclose(x[1], 0.0, atol=tiny) | under) & beyond
        if support == "slipping":
            fixed |= (lip | under) & axial
        else:
            fixed |= lip
        if support == "clamped":
            fixed |= under & axial
        if support == "glued":
            fixed |= under
    p_axis = np.isclose(p_basis.doflocs[0], 0.0, atol=tiny)
    return np.concatenate([index[fixed], u_basis.N + np.flatnonzero(p_axis)])


YOUNGS_MODULUS = 2.32  #: E of Elastic 50A [MPa]; forces are proportional to it.
INCOMPRESSIBLE = 0.4999


def lip_force(
    base: ClampedBase, land_r: float, compression: float, sticks: bool, rim_held: bool, cell: float = 0.25
) -> tuple[float, float]:
    """Return the force [N] that compresses the lip between ring and land [mm], and how far the rim moves out [mm].

    Axisymmetric, incompressible, at small strain; the probe is represented by a cylinder of two flange thicknesses.

    Args:
        base: of the probe, with its flange.
        land_r: radius of the land below the flange, which is free beyond [mm].
        compression: of the lip [mm].
        sticks: whether ring and land hold the lip radially; they let it slip otherwise.
        rim_held: whether the flange has no play in its recess.
        cell: width of the elements [mm].
    """
    from skfem import (
        Basis,
        BilinearForm,
        ElementQuad1,
        ElementQuad2,
        ElementVector,
        MeshQuad,
        asm,
        bmat,
        condense,
        solve,
    )

    t, ends = base.thickness, [0.0, base.r0, base.bore_r, land_r, base.flange_r]
    pieces = [np.linspace(a, b, max(3, round((b - a) / cell)) + 1) for a, b in itertools.pairwise(ends)]
    z = np.concatenate([np.linspace(-t, 0.0, 13), np.linspace(0.0, 2.0 * t, 25)])
    mesh = MeshQuad.init_tensor(np.unique(np.concatenate(pieces).round(9)), np.unique(z))
    middle = mesh.p[:, mesh.t].mean(axis=1)
    mesh = mesh.remove_elements(np.flatnonzero((middle[1] > 0.0) & (middle[0] > base.r0)))
    mesh = MeshQuad(mesh.p, mesh.t)
    u_basis = Basis(mesh, ElementVector(ElementQuad2()), intorder=5)
    p_basis = u_basis.with_element(ElementQuad1())
    mu = YOUNGS_MODULUS / 2.0 / (1.0 + INCOMPRESSIBLE)
    lam = 2.0 * mu * INCOMPRESSIBLE / (1.0 - 2.0 * INCOMPRESSIBLE)

    def strain(u: Any, r: Any) -> tuple[Any, ...]:
        g = u.grad
        return g[0, 0], g[1, 1], u.value[0] / r, (g[0, 1] + g[1, 0]) / 2.0

    @BilinearForm
    def stiffness(u: Any, v: Any, w: Any) -> Any:
        a, b = strain(u, w.x[0]), strain(v, w.x[0])
        return 2.0 * mu * (sum(a[i] * b[i] for i in range(3)) + 2.0 * a[3] * b[3]) * 2.0 * np.pi * w.x[0]

    @BilinearForm
    def divergence(u: Any, q: Any, w: Any) -> Any:
        return -q * sum(strain(u, w.x[0])[:3]) * 2.0 * np.pi * w.x[0]

    @BilinearForm
    def bulk(p: Any, q: Any, w: Any) -> Any:
        return -p * q / lam * 2.0 * np.pi * w.x[0]

    B = asm(divergence, u_basis, p_basis)
    K = bmat([[asm(stiffness, u_basis), B.T], [B, asm(bulk, p_basis)]], "csr")
    x, tiny = u_basis.doflocs, 1e-7
    axial = np.zeros(u_basis.N, dtype=bool)
    for name in ("nodal_dofs", "facet_dofs", "interior_dofs"):
        axial[getattr(u_basis, name)[1::2].ravel()] = True
    ring = (np.abs(x[1]) < tiny) & (x[0] > base.bore_r - tiny)
    land = (np.abs(x[1] + t) < tiny) & (x[0] < land_r + tiny)
    rim = x[0] > base.flange_r - tiny
    fixed = ((ring | land) & axial) | ((x[0] < tiny) & ~axial)
    if sticks:
        fixed |= (ring | (land & (x[0] > base.bore_r - tiny))) & ~axial
    if rim_held:
        fixed |= rim & ~axial
    given = np.zeros(K.shape[0])
    given[: u_basis.N][ring & axial] = -compression
    solution = solve(*condense(K, x=given, D=np.flatnonzero(fixed)))
    force = -float((K @ solution)[: u_basis.N][ring & axial].sum())
    return force, float(solution[: u_basis.N][rim & ~axial].max())


def lip_rows(compression: float = 0.4) -> list[list[str]]:
    """Return the table of the lip's force: the formula at small strain against finite elements."""
    from probedesign.mount.lip import LAND_RELIEF, pad_force

    rows = []
    for d, face_d, land in (*((d, 17.0, True) for d in (5.0, 8.0, 12.0, 25.0)), (12.0, 40.0, True),
                            (5.0, 17.0, False), (12.0, 17.0, False), (12.0, 40.0, False)):  # fmt: skip
        base = base_of(d, 0.0, face_mm=face_d)
        land_r = d / 2 + 3.5 - 1e3 * LAND_RELIEF if land else base.flange_r - 1e-3
        tiny = 1e-6
        formula = pad_force(1e6 * YOUNGS_MODULUS, 2e-3 * base.bore_r, 2e-3 * land_r, 1e-3 * base.thickness, tiny * 1e-3)
        formula *= compression / tiny
        found = {
            (sticks, held): lip_force(base, land_r, compression, sticks, held)
            for sticks in (False, True) for held in (False, True)
        }  # fmt: skip
        rows.append(
            [f"{d:g}", f"{2 * base.flange_r:g}", f"{land_r - base.bore_r:.2g}", f"{formula:.0f}",
             *(f"{force:.0f}" for force, _ in found.values()), f"{_with_play(found):.0f}"]
        )  # fmt: skip
    return rows


def _with_play(found: dict[tuple[bool, bool], tuple[float, float]], play: float = 0.1) -> float:
    """Return the force with faces that stick and a rim that meets the wall when its play [mm] is used up."""
    (free, moves), (held, _) = found[True, False], found[True, True]
    share = min(play / moves, 1.0)
    return share * free + (1.0 - share) * held


def base_of(base_d_mm: float, slope: float, thickness_mm: float = 3.0, face_mm: float = 17.0) -> ClampedBase:
    """Return the base of an exported probe of a given diameter."""
    from probedesign.geometry import flange_for
    from probedesign.mount.sensor_adapter import RING_CLEARANCE

    flange = flange_for(1e-3 * base_d_mm, 1e-3 * face_mm, 1e-3 * thickness_mm)
    r0 = base_d_mm / 2
    return ClampedBase(r0, slope, 5e2 * flange.diameter, thickness_mm, r0 + 1e3 * RING_CLEARANCE)


def report() -> None:
    """Print the result for the three designs, for other bases and thicknesses, and on finer meshes."""
    from probedesign.design import load_design
    from probedesign.mount import build_geometry
    from probedesign.mount.mount import exported_root_radii

    rows = []
    for name in ("large", "medium", "small"):
        geometry = build_geometry(load_design(ROOT / f"designs/{name}.toml"))
        slope = (geometry.base_radius - geometry.tip_radius) / geometry.length
        base = base_of(2e3 * geometry.base_radius, slope)
        computed = [missing_compliance(base, support) for support in SUPPORTS]
        used = [exported_root_radii(geometry, "glued"), exported_root_radii(geometry)]
        rows.append([name, f"{2 * base.r0:g}", *(f"{c:.3f}" for c in (*computed, *used))])
    print_table("root_rigid_radii by finite elements, ν = 0.49",
                ["design", "d [mm]", *SUPPORTS, "formula, glued", "formula, clamped"], rows)  # fmt: skip
    rows = []
    for thickness in (2.8, 3.0, 4.0, 6.0):
        for d in (3.0, 6.0, 12.0, 25.0):
            base = base_of(d, 0.0, thickness)
            rows.append(
                [f"{thickness:g}", f"{d:g}", *(f"{missing_compliance(base, support):.3f}" for support in SUPPORTS)]
            )
    print_table("Other bases, cylinders", ["flange [mm]", "d [mm]", *SUPPORTS], rows)
    base = base_of(12.0, 0.0)
    rows = [
        [f"{cells}", *(f"{missing_compliance(base, support, cells=cells):.4f}" for support in SUPPORTS)]
        for cells in (6, 10, 14)
    ]
    rows += [
        [f"ν = {nu:g}", *(f"{missing_compliance(base, support, nu):.4f}" for support in SUPPORTS)]
        for nu in (0.48, 0.499)
    ]
    print_table("Cells between two edges, and Poisson's ratio; d = 12 mm", ["", *SUPPORTS], rows)
    for support, description in SUPPORTS.items():
        print(f"  {support}: {description}")
    heads = ["d [mm]", "flange [mm]", "lip pressed [mm]", "formula", "slips", "slips, rim held", "sticks",
             "sticks, rim held", "sticks, play 0.1 mm"]  # fmt: skip
    print_table("Force [N] of the lip, 3 mm thick, 0.4 mm compressed, E = 2.32 MPa, small strain", heads, lip_rows())
    print("  the last three rows: without a groove, the ring presses the whole lip")
