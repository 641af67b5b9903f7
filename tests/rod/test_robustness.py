"""Test random rods over the working envelope from a cold start: solved, in equilibrium, and on the unloaded branch."""

from itertools import pairwise

import numpy as np
from rods import bending_force

from probedesign.rod.batch import solve_batch
from probedesign.rod.rod import Rod

CASES = 5_000
FOLLOWED = 80


def random_rod(rng):
    """30-200 mm long, 2-20 mm thick, tapering to a tenth or not at all, 0.3-10 MPa, with and without a root."""
    radius, modulus = rng.uniform(1e-3, 10e-3), np.exp(rng.uniform(np.log(0.3e6), np.log(10e6)))
    return Rod(
        s=np.array([0.0, rng.uniform(0.03, 0.2)]),
        radius=radius * np.array([1.0, rng.uniform(0.1, 1.0)]),
        youngs_modulus=modulus,
        shear_modulus=rng.uniform(0.3, 0.4) * modulus,
        density=rng.uniform(900.0, 1200.0),
        rigid_length=rng.choice([-0.2, 0.0, 0.12]) * radius,
    )


def directions(rng, n):
    v = rng.normal(size=(n, 3))
    return v / np.linalg.norm(v, axis=1)[:, None]


def random_cases(n, seed):
    """Rods, gravity of any direction, and a force of any direction at 0.02 L ... tip that turns the tip by up to
    two radians where it bends; thin ones stand upright far beyond their own buckling weight."""
    rng = np.random.default_rng(seed)
    rods = [random_rod(rng) for _ in range(n)]
    lengths = np.array([rod.length for rod in rods])
    s = np.where(rng.random(n) < 0.3, 1.0, rng.uniform(0.02, 1.0, n)) * lengths
    size = [bending_force(rod, at, a) for rod, at, a in zip(rods, s, rng.uniform(0.0, 1.5, n), strict=True)]
    return rods, 9.81 * directions(rng, n), np.array(size)[:, None] * directions(rng, n), s


def test_of_five_thousand_all_but_one_in_a_thousand_are_solved():
    rods, gravity, force, s = random_cases(CASES, 0)
    found = solve_batch(rods, gravity, force, s)
    assert found.ok.mean() >= 0.999
    assert set(found.result[~found.ok]) <= {"not_converged", "unstable"}
    assert (found.margin[found.ok] > 0.0).all()
    assert (found.residual[found.ok] <= 1e-6).all()  # the base's tangent, of a turn of one [rad]
    assert np.isnan(found.wrench_base[~found.ok]).all() and np.isfinite(found.wrench_base[found.ok]).all()


def test_the_base_moment_is_that_of_force_and_weight_on_the_bent_rod():
    """M = p_c × F + ∫ p × ρ A g ds: equilibrium of the whole rod, which the solver does not use."""
    rods, gravity, force, s = random_cases(FOLLOWED, 1)
    for rod, g, F, at in zip(rods, gravity, force, s, strict=True):
        eq = rod.solve(g, F, at)
        if not eq.ok:
            continue
        x, w = np.polynomial.legendre.leggauss(24)  # on either side of the root's reach and of the contact
        breaks = np.unique(np.clip([0.0, rod.root[1], at, rod.length], 0.0, rod.length))
        moment = np.cross(eq.p_contact_base, F)
        for low, high in pairwise(breaks):
            stations = low + (high - low) * (1.0 + x) / 2.0
            weight = rod.density * np.pi * rod.radius_at(stations) ** 2 * w * (high - low) / 2.0
            moment = moment + np.cross(weight @ eq.p_at(stations), g)
        scale = np.linalg.norm(F) * at + rod.mass * 9.81 * rod.length
        # The documented accuracy of mode "fast".
        assert np.linalg.norm(eq.wrench_base[3:] - moment) <= 1e-6 * scale


def test_the_answer_is_the_end_of_the_path_from_no_load():
    """Follow the equilibrium in a hundred small steps, each started only from the one before."""
    rods, gravity, force, s = random_cases(FOLLOWED, 2)
    followed = 0
    for rod, g, F, at in zip(rods, gravity, force, s, strict=True):
        cold, eq = rod.solve(g, F, at), rod.solve()
        for share in np.linspace(0.0, 1.0, 101)[1:]:
            eq = rod.solve(share * g, share * F, at, guess=eq.tip, guess_only=True)
            if not eq.ok:
                break
        if eq.ok and cold.ok:
            # Two fast answers, each within a micrometre.
            assert np.linalg.norm(eq.p_at(rod.length) - cold.p_at(rod.length)) <= 2e-6
            followed += 1
    assert followed >= 0.9 * FOLLOWED  # very soft ones need smaller steps than these
