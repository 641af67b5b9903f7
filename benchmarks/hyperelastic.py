"""Finite elements of a clamped cone of nearly incompressible rubber under gravity and a traction on its surface.

27-node isoparametric hexahedra with a discontinuous linear pressure (the inf-sup stable Q2/P1 pair, free of
volumetric locking), compressible neo-Hookean energy

    W = G/2 (tr FᵀF - 3) - G ln J + λ/2 (J - 1)²,   G = E / (2 (1 + ν)),   λ = 2 G ν / (1 - 2 ν),

in whose last term the pressure is p = λ Π(J - 1), with Π the projection onto linear functions in each element.
The equations are solved by Newton's method in displacement and pressure, with the pressure eliminated element by
element and a banded Cholesky factorisation. scikit-fem provides the mesh and the shape functions.

Sources: D. Boffi, F. Brezzi, M. Fortin, Mixed Finite Element Methods and Applications, 2013, section 8.6 (Q2/P1);
J. Bonet, R. D. Wood, Nonlinear Continuum Mechanics for Finite Element Analysis, 2nd edition, 2008, chapters 6 and 8;
T. Gustafsson, G. D. McBain, scikit-fem, Journal of Open Source Software 5(52), 2369, 2020 (BSD-3-Clause).
"""

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import LinAlgError, cho_solve_banded, cholesky_banded

import probedesign
from probedesign.core.frames import Array
from probedesign.rod.rod import Rod

POISSON = 0.49
"""Poisson's ratio (assumed: nearly incompressible rubber; as in tests/data/fem_cases.json)."""
ROOT_RADII = 0.12
"""`root_rigid_radii` of a bonded base (docs/decisions/0006), used for the initial guess and the choice of loads."""
PATCH_ANGLE, PATCH_LENGTH = 0.35, 1.5
"""Half widths of the patch: around the axis [rad], along the generator [radii of the section]. Assumed: 200 mN
indent the 12 mm cone by a few hundredths of a millimetre, and the patch is still a point on the scale of the rod."""
INNER = 0.55
"""Half the side of the section's inner square of elements over its radius, before the map onto the disc."""
RESIDUAL = 1e-9
"""Largest nodal residual over the force at convergence."""


@dataclass(frozen=True)
class Fineness:
    """Mesh density."""

    square: int  #: elements along a side of the section's inner square.
    rings: int  #: rings of elements around the square.
    layer: float  #: height of the layers of elements [radii of the section].


@dataclass(frozen=True)
class Cone:
    """Printed cone and its material in SI units."""

    length: float
    base_radius: float
    tip_radius: float
    youngs_modulus: float
    density: float

    @classmethod
    def of(cls, name: str) -> "Cone":
        """Read the cone of designs/NAME.toml."""
        design = probedesign.load_design(Path(__file__).parents[1] / f"designs/{name}.toml")
        body, material = design.probe, design.material
        return cls(1e-3 * body.length_mm, 5e-4 * body.base_d_mm, 5e-4 * body.tip_d_mm,
                   1e6 * material.youngs_modulus_mpa, material.density_kg_m3)  # fmt: skip

    @property
    def shear_modulus(self) -> float:
        """G of isotropic linear elasticity with Poisson's ratio `POISSON` [Pa]."""
        return self.youngs_modulus / (2.0 * (1.0 + POISSON))

    @property
    def slope(self) -> float:
        """Change of radius along the axis."""
        return (self.tip_radius - self.base_radius) / self.length

    def radius(self, s: Any) -> Any:
        """Radius of the section at s [m]."""
        return self.base_radius + self.slope * s

    def on_surface(self, s: float, phi: float) -> tuple[Array, Array]:
        """Return a point of the undeformed surface relative to its section's centre and its frame.

        Returns:
            The point [m], (3,), and the frame whose rows are the inward normal, the tangent around the axis and the
            tangent along the generator towards the tip, (3, 3).
        """
        radial = np.array([math.cos(phi), math.sin(phi), 0.0])
        around = np.array([-math.sin(phi), math.cos(phi), 0.0])
        along = np.array([*(self.slope * radial[:2]), 1.0]) / math.hypot(1.0, self.slope)
        return self.radius(s) * radial, np.stack([-np.cross(around, along), around, along])

    @cached_property
    def rod(self) -> Rod:
        """The Cosserat rod of this cone with a bonded root."""
        radius = np.array([self.base_radius, self.tip_radius])
        return Rod(np.array([0.0, self.length]), radius, self.youngs_modulus, self.shear_modulus, self.density,
                   rigid_length=ROOT_RADII * self.base_radius, finite_strain=True)  # fmt: skip


class Mesh:
    """Mesh of 27-node hexahedra whose sections are rotated so that elements are narrowest at the touched generator."""

    def __init__(self, cone: Cone, s: float, phi: float, fineness: Fineness) -> None:
        from skfem import Basis, ElementHex2, MeshHex, MeshHex2

        self.cone, self.s = cone, s
        square, quads = _butterfly(fineness.square, fineness.rings)
        layers = _layers(cone, s, fineness.layer)
        n, k = len(square), len(layers)
        points = np.concatenate([np.tile(square, (k, 1)), np.repeat(layers, n)[:, None]], axis=1)
        lower = np.concatenate([quads + i * n for i in range(k - 1)])
        hexes = np.concatenate([lower, lower + n], axis=1)
        # scikit-fem numbers a brick's corners (111, 110, 101, 011, 100, 010, 001, 000) in its own coordinates, so
        # that these run from top to bottom and from outside to inside.
        hexes = hexes[:, [0, 4, 3, 1, 7, 5, 2, 6]]
        logical = MeshHex2.from_mesh(MeshHex(points.T.copy(), hexes.T.copy()))
        xy = _disc(logical.doflocs[:2].T, phi) * cone.radius(logical.doflocs[2])[:, None]
        element, tolerance = ElementHex2(), 1e-6 * cone.tip_radius
        mesh = MeshHex2(np.stack([*xy.T, logical.doflocs[2]]), logical.t)
        of_layer = np.arange(len(hexes)).reshape(k - 1, len(quads))
        base = _Face(mesh, of_layer[0], "end", 3)
        # Quadratic edges through the circle enclose too little; the same area gives the right mass and stiffness.
        xy *= cone.base_radius * math.sqrt(math.pi / np.linalg.norm(base.areas, axis=2).sum())
        mesh = MeshHex2(np.stack([*xy.T, logical.doflocs[2]]), logical.t)
        basis = Basis(mesh, element, quadrature=_quadrature())
        self.nodes = basis.doflocs.T.copy()
        self.of_element = basis.element_dofs.T.copy()
        self.gradients = np.stack([np.moveaxis(b[0].grad, 0, 2) for b in basis.basis], axis=2)
        self.volumes = basis.dx
        values = np.stack([np.broadcast_to(b[0].value, basis.dx.shape) for b in basis.basis])
        self.nodal_volumes = self._lump(np.einsum("aeq,eq->ea", values, basis.dx), self.of_element)
        x = np.moveaxis(np.asarray(basis.global_coordinates()), 0, 2)
        x = x - x.mean(1, keepdims=True)
        self.linear = np.concatenate([np.ones_like(x[..., :1]), x / x.std(1, keepdims=True)], axis=2)

        section = _Face(mesh, of_layer[int(np.argmin(np.abs(layers - s)))], "end", 3)
        self.section = self._lump(section.shares(np.linalg.norm(section.areas, axis=2)), section.element_dofs)
        self.section /= self.section.sum()
        patch = _Face(mesh, of_layer[:, -4 * fineness.square :].ravel(), "side", 8)
        X = patch.points
        angle = np.mod(np.arctan2(X[..., 1], X[..., 0]) - phi + np.pi, 2.0 * np.pi) - np.pi
        distance = (angle / PATCH_ANGLE) ** 2 + ((X[..., 2] - s) / (PATCH_LENGTH * cone.radius(s))) ** 2
        area = np.linalg.norm(patch.areas, axis=2)
        weight = np.maximum(1.0 - distance, 0.0) ** 2 / np.hypot(X[..., 0], X[..., 1]) * area
        weight /= weight.sum()
        loaded = np.flatnonzero(weight.sum(1) > 0.0)
        self.patch_weight, self.patch_element = weight[loaded], patch.element_dofs[loaded]
        self.patch_normal = (patch.areas / area[..., None])[loaded]
        self.patch_gradients = patch.gradients[loaded]
        self.patch = self._lump(patch.shares(weight), patch.element_dofs)
        self.patch_s = float((weight * X[..., 2]).sum())
        self.patch_phi = phi + float((weight * angle).sum())

        # Nodes sorted along z make the matrix banded: an element couples three layers of nodes.
        place = np.empty(len(self.nodes), dtype=np.int64)
        place[np.lexsort((self.nodes[:, 0], np.round(self.nodes[:, 2] / tolerance)))] = np.arange(len(place))
        fixed = int((self.nodes[:, 2] < tolerance).sum())
        self.fixed, self.place = fixed, place
        equations = 3 * (place[self.of_element][:, :, None] - fixed) + np.arange(3)
        self.equations = equations.reshape(len(equations), 81)
        rows, columns = np.broadcast_arrays(self.equations[:, :, None], self.equations[:, None, :])
        self.lower = (rows >= columns) & (columns >= 0)
        rows, columns = rows[self.lower], columns[self.lower]
        self.size, self.band = 3 * (len(place) - fixed), int((rows - columns).max()) + 1
        self.slots = columns * self.band + rows - columns

    def _lump(self, shares: Array, of_element: Array) -> Array:
        return np.bincount(of_element.ravel(), shares.ravel(), minlength=len(self.nodes))

    def scatter(self, by_element: Array) -> Array:
        """Sum vectors of the elements' nodes, (e, 81), into nodal ones, (n, 3)."""
        parts = by_element.reshape(-1, 27, 3)
        return np.stack([self._lump(parts[..., i], self.of_element) for i in range(3)], axis=1)

    def ordered(self, nodal: Array) -> Array:
        """Return the free equations' right-hand side of nodal vectors."""
        sorted_by_z = np.empty_like(nodal)
        sorted_by_z[self.place] = nodal
        return sorted_by_z.ravel()[3 * self.fixed :]


class _Face:
    """Gauss points on one face of some elements: the lower end (local z = 1) or the outer side (local x = 0).

    scikit-fem's FacetBasis finds the local coordinates of a face's points by Newton's method, which fails on some of
    the curved elements; here they are known.
    """

    def __init__(self, mesh: Any, elements: Array, face: str, points: int) -> None:
        from skfem import Basis, ElementHex2

        x, w = np.polynomial.legendre.leggauss(points)
        a, b = (grid.ravel() for grid in np.meshgrid(0.5 * (x + 1.0), 0.5 * (x + 1.0)))
        W = 0.25 * np.outer(w, w).ravel()
        axis = 2 if face == "end" else 0
        X = np.stack([a, b, np.ones_like(a)] if face == "end" else [np.zeros_like(a), a, b])
        basis = Basis(mesh, ElementHex2(), elements=elements, quadrature=(X, W))
        inverse = basis.mapping.invDF(X, elements)
        self.areas = -basis.dx[..., None] * np.moveaxis(inverse[axis], 0, 2)
        self.points = np.moveaxis(np.asarray(basis.global_coordinates()), 0, 2)
        self.values = np.stack([np.broadcast_to(b[0].value, basis.dx.shape) for b in basis.basis])
        self.gradients = np.stack([np.moveaxis(b[0].grad, 0, 2) for b in basis.basis], axis=2)
        self.element_dofs = basis.element_dofs.T
        if len(self.element_dofs) != len(elements):
            self.element_dofs = basis.dofs.element_dofs.T[elements]

    def shares(self, weight: Array) -> Array:
        """Integrate the shape functions with weights at the points, (e, 27)."""
        shares: Array = np.einsum("aeq,eq->ea", self.values, weight)
        return shares


def _quadrature() -> tuple[Array, Array]:
    """Return Gauss points and weights of the reference brick [0, 1]³, 3 × 3 in the section and 2 along the axis.

    Three points along the axis would make the rotation of a section follow a quadratic deflection and keep the
    curvature constant in each element (shear locking of the quadratic Timoshenko beam); two points do not.
    Source: O. C. Zienkiewicz, R. L. Taylor, J. M. Too, Int. J. Numerical Methods in Engineering 3, 275–290, 1971.
    """
    three, two = ((0.5 * (x + 1.0), 0.5 * w) for x, w in map(np.polynomial.legendre.leggauss, (3, 2)))
    X = np.stack([a.ravel() for a in np.meshgrid(three[0], three[0], two[0], indexing="ij")])
    return X, np.einsum("i,j,k->ijk", three[1], three[1], two[1]).ravel()


def _butterfly(n: int, rings: int) -> tuple[Array, Array]:
    """Return quadrilaterals of the square [-1, 1]²: an inner n × n grid and rings of trapezia around it."""
    ticks = np.linspace(-INNER, INNER, n + 1)
    points = [np.array([x, y]) for y in ticks for x in ticks]
    quads = [[j * (n + 1) + i + o for o in (0, 1, n + 2, n + 1)] for j in range(n) for i in range(n)]
    there, back = range(n), range(n, 0, -1)
    corners = [(i, 0) for i in there] + [(n, j) for j in there] + [(i, n) for i in back] + [(0, j) for j in back]
    rim = [j * (n + 1) + i for i, j in corners]
    for ring in range(rings):
        scale = 1.0 / (INNER + (1.0 - INNER) * ring / rings) * (INNER + (1.0 - INNER) * (ring + 1) / rings)
        outer = list(range(len(points), len(points) + 4 * n))
        points += [scale * points[i] for i in rim]
        quads += [[rim[i - 1], outer[i - 1], outer[i], rim[i]] for i in range(4 * n)]
        rim = outer
    return np.array(points), np.array(quads)


def _disc(square: Array, phi: float) -> Array:
    """Map points of the square [-1, 1]² onto the unit disc, denser around the direction phi."""
    size = np.abs(square).max(1)
    q = square / np.where(size > 0.0, size, 1.0)[:, None]
    flat = np.abs(q[:, 0]) >= np.abs(q[:, 1])
    safe = np.where(flat, q[:, 0], q[:, 1])
    safe = np.where(safe == 0.0, 1.0, safe)
    quarter = 0.25 * np.pi * np.where(flat, q[:, 1], -q[:, 0]) / safe
    theta = quarter + np.where(flat, np.where(q[:, 0] < 0, np.pi, 0.0), np.where(q[:, 1] < 0, -0.5, 0.5) * np.pi)
    round_part = np.clip((size - INNER) / (1.0 - INNER), 0.0, 1.0)
    circle = np.stack([np.cos(theta), np.sin(theta)], axis=1)
    point = size[:, None] * ((1.0 - round_part)[:, None] * 0.85 * q + round_part[:, None] * circle)
    r, angle = np.hypot(*point.T), np.arctan2(point[:, 1], point[:, 0])
    angle = angle - 0.2 * r**2 * np.sin(angle) + phi
    return np.stack([r * np.cos(angle), r * np.sin(angle)], axis=1)


def _layers(cone: Cone, s: float, height: float) -> Array:
    """Return the ends of the layers of elements, finer at the bonded face and at the touched section, which is one."""

    def ends(start: float, stop: float) -> Array:
        z = np.linspace(start, stop, 2000)
        r = cone.radius(z)
        near = np.exp(-(((z - s) / (1.5 * r)) ** 2)) + np.exp(-((z / r) ** 2))
        density = (1.0 + 1.5 * near) / (height * r)
        count = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(z))])
        n = max(2, math.ceil(count[-1]))
        return np.interp(np.linspace(0.0, count[-1], n + 1), count, z)

    return np.concatenate([ends(0.0, s)[:-1], ends(s, cone.length)])


@dataclass
class State:
    """Deformed nodes [m], (n, 3), and the pressure's coefficients in each element [Pa], (e, 4)."""

    x: Array
    pressure: Array


def equilibrium(mesh: Mesh, gravity: Array, force: Array, state: State, limit: int = 40) -> tuple[State, Array, int]:
    """Solve for the deformed cone by Newton's method from a given state.

    Returns:
        The state, the internal less the applied forces at the nodes [N], (n, 3), which are the reactions at the
        base and zero elsewhere, and the number of steps.

    Raises:
        ArithmeticError: Newton's method does not converge.
    """
    loads = np.outer(mesh.nodal_volumes, mesh.cone.density * gravity) + np.outer(mesh.patch, force)
    x, pressure, worst = state.x.copy(), state.pressure.copy(), math.inf
    for step in range(limit):
        forces, by_dilation, tangent, gain, dilation = _linearised(mesh, x, pressure)
        out = mesh.scatter(forces) - loads
        right = mesh.ordered(out + mesh.scatter(by_dilation))
        worst = float(np.abs(right).max() / np.linalg.norm(force))
        if worst < RESIDUAL:
            return State(x, pressure + dilation), out + mesh.scatter(by_dilation), step
        banded = np.bincount(mesh.slots, tangent[mesh.lower], minlength=mesh.size * mesh.band)
        banded = banded.reshape(mesh.size, mesh.band).T
        try:
            factor = cholesky_banded(banded, overwrite_ab=True, lower=True, check_finite=False)
        except LinAlgError as error:
            raise ArithmeticError(f"the tangent is not positive definite at step {step}") from error
        moved = cho_solve_banded((factor, True), -right, check_finite=False)
        du = np.concatenate([np.zeros(3 * mesh.fixed), moved]).reshape(-1, 3)[mesh.place]
        dp = dilation + (gain @ du[mesh.of_element].reshape(-1, 81, 1))[..., 0]
        share = 1.0
        while np.linalg.det(deformation(x + share * du, mesh.gradients, mesh.of_element)).min() <= 0.05:
            share *= 0.5
            if share < 1e-3:
                raise ArithmeticError(f"elements are inverted at step {step}")
        x, pressure = x + share * du, pressure + share * dp
    raise ArithmeticError(f"no convergence in {limit} steps, residual {worst:.1e} of the force")


def deformation(x: Array, gradients: Array, of_element: Array) -> Array:
    """Return the deformation gradients F at the quadrature points, (e, q, 3, 3)."""
    return np.swapaxes(x[of_element], 1, 2)[:, None] @ gradients


def _linearised(mesh: Mesh, x: Array, pressure: Array) -> tuple[Array, Array, Array, Array, Array]:
    """Linearise the elements' equations.

    With R_p = ∫ φ (J - 1) - M p, M = ∫ φ φᵀ/λ and B = ∫ (∂J/∂u) φᵀ the pressure changes by dp = d + C du,
    d = M⁻¹ R_p, C = M⁻¹ Bᵀ, so that (K + B C) du = -(internal forces - loads) - B d.

    Returns:
        Internal forces (e, 81), B d (e, 81), the tangents K + B C (e, 81, 81), C (e, 4, 81) and d (e, 4).
    """
    G, dV, phi = mesh.cone.shear_modulus, mesh.volumes, mesh.linear
    bulk = 2.0 * G * POISSON / (1.0 - 2.0 * POISSON)
    F = deformation(x, mesh.gradients, mesh.of_element)
    J = np.linalg.det(F)
    p = (phi @ pressure[..., None])[..., 0]
    e, q = J.shape
    spatial = (mesh.gradients @ np.linalg.inv(F)).reshape(e, q, 81)
    material = (mesh.gradients @ np.swapaxes(F, 2, 3)).reshape(e, q, 81)
    pJ = p * J
    forces = G * np.einsum("eqa,eq->ea", material, dV) + np.einsum("eqa,eq->ea", spatial, (pJ - G) * dV)
    B = np.swapaxes(spatial, 1, 2) @ ((J * dV)[..., None] * phi)
    mass = np.swapaxes(phi, 1, 2) @ (phi * dV[..., None]) / bulk
    misfit = np.einsum("eqm,eq->em", phi, (J - 1.0) * dV) - (mass @ pressure[..., None])[..., 0]
    dilation = np.linalg.solve(mass, misfit[..., None])[..., 0]
    gain = np.linalg.solve(mass, np.swapaxes(B, 1, 2))
    turned = np.swapaxes(spatial, 1, 2)
    tangent = turned @ ((pJ * dV)[..., None] * spatial) + B @ gain
    crossed = (turned @ (((G - pJ) * dV)[..., None] * spatial)).reshape(e, 27, 3, 27, 3)
    tangent += np.swapaxes(crossed, 2, 4).reshape(e, 81, 81)
    flat = np.swapaxes(mesh.gradients, 2, 3).reshape(e, 3 * q, 27)
    plain = np.swapaxes(flat, 1, 2) @ (flat * G * np.repeat(dV, 3, axis=1)[..., None])
    blocks = tangent.reshape(e, 27, 3, 27, 3)
    for i in range(3):
        blocks[:, :, i, :, i] += plain
    return forces, (B @ dilation[..., None])[..., 0], tangent, gain, dilation
