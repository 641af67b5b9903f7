"""Result codes of a rod without an equilibrium, and the critical loads."""

from dataclasses import replace

import numpy as np
import pytest
from rods import CONE, CYLINDER, EVERYTHING, FINITE, FLAT, PROFILE, RHO, E, G

from probedesign.core.errors import InputError
from probedesign.rod.rod import Rod

ELASTICA = replace(CYLINDER, inextensible=True)
EI = ELASTICA.youngs_modulus * np.pi / 4.0 * ELASTICA.radius[0] ** 4
#: Critical load of a clamped-free column [N]: Gere & Timoshenko, Mechanics of Materials, chapter 11.
EULER = np.pi**2 * EI / (4.0 * ELASTICA.length**2)
#: Critical weight per length of a clamped-free column [N/m], 7.8373 = 9/4 · (first zero of J_-1/3)²: A. G. Greenhill,
#: Proc. Cambridge Phil. Soc. 4 (1881) 65-73.
GREENHILL = 7.8373474 * EI / ELASTICA.length**3


def upright(weight):
    """Return the upright elastica under a weight per length [N/m]."""
    g = weight / (ELASTICA.density * np.pi * ELASTICA.radius[0] ** 2)
    return ELASTICA.solve((0, 0, -g))


def assert_no_numbers(eq):
    assert eq.result in ("unstable", "not_converged")
    assert not eq.ok and eq.sensitivity is None
    for numbers in (eq.wrench_base, eq.p_contact_base, eq.tip_tangent, eq.p_at(0.01), eq.R_at(0.01)):
        assert np.isnan(numbers).all()
    for arrays in (eq.s, eq.p_base, eq.R_base, eq.n_base, eq.m_base):
        assert len(arrays) == 0


@pytest.mark.parametrize("mode", ["fast", "reference"])
@pytest.mark.parametrize("share", [0.5, 0.999, 1.001, 2.0, 8.9, 9.1, 30.0])
def test_a_straight_column_is_stable_below_eulers_load(share, mode):
    eq = ELASTICA.solve(force=(0, 0, -share * EULER), mode=mode)  # 9: the second critical load
    if share > 1.0:
        assert eq.result == "unstable"
        assert_no_numbers(eq)
        return
    assert eq.result == "ok" and eq.margin > 0.0
    np.testing.assert_array_equal(eq.p_base[:, :2], 0.0)
    np.testing.assert_allclose(eq.p_base[-1, 2], ELASTICA.length, rtol=1e-14)


@pytest.mark.parametrize("share", [0.9, 0.99, 1.001, 1.02, 1.5, 6.0, 8.0])
def test_a_column_is_stable_below_greenhills_weight(share):
    assert upright(share * GREENHILL).result == ("ok" if share < 1.0 else "unstable")  # 7.1: the second critical one


ROUND_OR_NOT = {
    "flat": (FLAT[0], FLAT[1], FLAT[2], FLAT[3]),
    "flat the other way": (FLAT[0], FLAT[2], FLAT[1], FLAT[3]),
    "nearly round": (1.0, 1.0, 1.0 + 1e-9, 1.0),
}


@pytest.mark.parametrize("mode", ["fast", "reference"])
@pytest.mark.parametrize("factors", ROUND_OR_NOT.values(), ids=ROUND_OR_NOT)
@pytest.mark.parametrize(
    ("share", "result"),
    [(0.5, "ok"), (0.999, "ok"), (1.001, "unstable"), (1.5, "unstable"), (3.0, "unstable"), (20.0, "unstable")],
)
def test_a_flat_column_gives_way_about_its_softer_axis(factors, share, result, mode):
    """The critical load has the smaller I; 2 is that of the stiffer direction, 9 the second critical one."""
    rod = replace(ELASTICA, factors=factors)
    eq = rod.solve(force=(0, 0, -share * min(factors[1:3]) * EULER), mode=mode)
    assert eq.result == result
    if eq.ok:
        np.testing.assert_array_equal(eq.p_base[:, :2], 0.0)


@pytest.mark.parametrize("share", [0.99, 1.001, 1.5, 3.0, 6.0, 20.0])
def test_a_flat_column_gives_way_to_its_weight_about_its_softer_axis(share):
    rod = replace(ELASTICA, factors=ROUND_OR_NOT["flat"])
    g = share * rod.factors[1] * GREENHILL / (rod.mass / rod.length)
    assert rod.solve((0, 0, -g)).result == ("ok" if share < 1.0 else "unstable")


def test_a_hollow_column_bears_what_is_left_of_its_stiffness():
    rod = replace(ELASTICA, factors=(0.5, 0.4, 0.4, 0.4))
    assert rod.solve(force=(0, 0, -0.399 * EULER)).result == "ok"
    assert rod.solve(force=(0, 0, -0.401 * EULER)).result == "unstable"


def test_a_taper_lets_a_column_stand_taller():
    """Less weight above, the same stiffness below."""
    tallest = {}
    for tip in (0.2, 1.0):
        radius = 6e-3 * np.array([1.0, tip])
        rods = [Rod(np.array([0.0, length]), radius, E, G, RHO) for length in np.linspace(0.1, 0.6, 51)]
        tallest[tip] = max(rod.length for rod in rods if rod.solve((0, 0, -9.81)).ok)
    assert tallest[0.2] > 1.1 * tallest[1.0]


def test_what_hangs_is_stable():
    """Tension only: nothing can buckle. 3 N would stretch the real column by a tenth."""
    for rod, pulls in ((ELASTICA, (1e-3, 1.0, 3.0)), (CONE, (0.1, 0.5))):
        assert all(rod.solve((0, 0, 9.81), (0, 0, pull)).result == "ok" for pull in pulls)


def test_a_push_a_little_off_the_axis_bends_round_on_the_stable_branch():
    eq = ELASTICA.solve(force=(1e-3 * EULER, 0, -1.1 * EULER), mode="reference")
    assert eq.result == "ok" and eq.margin > 0.0
    assert eq.p_base[-1, 0] > 0.1 * ELASTICA.length  # bent well over, the way it was pushed


HOPELESS = {
    "straight down": ((0, 0, 0), (0, 0, -1e3), None),
    "sideways": ((0, 0, 0), (1e4, 0, 0), None),
    "anyhow": ((300.0, -2e3, -5e3), (50.0, 20.0, -80.0), 0.05),
    "gravity": ((0, 1e5, -1e6), (0, 0, 0), None),
    "enormous": ((0, 0, 0), (1e200, 1e200, -1e200), 0.05),
    "endless": ((1e308, 0, 0), (1e308, 0, 0), 0.05),
}
HELPLESS = {"cone": CONE, "cylinder": CYLINDER, "profile": PROFILE, "finite": FINITE, "everything": EVERYTHING}


@pytest.mark.parametrize("mode", ["fast", "reference"])
@pytest.mark.parametrize("rod", HELPLESS.values(), ids=HELPLESS)
@pytest.mark.parametrize("case", HOPELESS)
def test_a_hopeless_load_gives_a_code(case, rod, mode):
    """The number of steps of a solve is bounded, so that it ends for any load."""
    gravity, force, s_c = HOPELESS[case]
    eq = rod.solve(gravity, force, s_c, mode=mode, columns="all")
    if eq.ok:  # a sideways load of any size has its stable equilibrium: bent round and pulled straight
        assert np.isfinite(eq.wrench_base).all() and np.isfinite(eq.p_base).all()
    else:
        assert_no_numbers(eq)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("which", ["gravity", "force", "tip_moment", "couple"])
def test_a_load_that_is_no_number_is_refused_in_a_line(which, bad):
    with pytest.raises(InputError, match=which) as refused:
        CONE.solve(**{which: (0.0, bad, 0.0)})
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("s_contact", [np.nan, -1e-3, 0.151, np.inf])
def test_a_contact_off_the_rod_is_refused(s_contact):
    with pytest.raises(InputError, match="s_contact"):
        CONE.solve((9.81, 0, 0), (0.01, 0, 0), s_contact)


@pytest.mark.parametrize("shape", [(2,), (4,), (3, 1), ()])
def test_a_load_of_the_wrong_shape_is_refused(shape):
    with pytest.raises(InputError, match="force"):
        CONE.solve((9.81, 0, 0), np.zeros(shape), 0.1)


@pytest.mark.parametrize(
    "guess", [(0, 0, 0, 1, 0, 0), (0, 0, 1), (np.inf, 0, 0, 0, 1, 0), (0, 0, 1, 0, 0, 1), (0, 0, 1, np.nan, 0, 0)]
)
def test_a_guess_that_is_no_direction_is_refused(guess):
    with pytest.raises(InputError, match="guess"):
        CONE.solve((9.81, 0, 0), guess=guess)


def test_a_bad_guess_costs_only_time():
    wanted = CONE.solve((9.81, 0, 0), (0.01, 0.01, 0), 0.1)
    for guess in ((0, 0, -1, 1, 0, 0), (-1, 0, 0, 0, 1, 0), (0, 5, 0.1, 1, 0, 0)):
        found = CONE.solve((9.81, 0, 0), (0.01, 0.01, 0), 0.1, guess=guess)
        # Two fast answers, each within a micrometre.
        np.testing.assert_allclose(found.p_base[-1], wanted.p_base[-1], atol=2e-6)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"youngs_modulus": 0.0}, "youngs_modulus"),
        ({"shear_modulus": np.nan}, "shear_modulus"),
        ({"shear_coefficient": -1.0}, "shear_coefficient"),
        ({"density": -1.0}, "density"),
        ({"density": np.nan}, "density"),
        ({"rigid_length": 0.15}, "rigid_length"),
        ({"rigid_length": -6.1e-3}, "rigid_length"),  # more than a base radius
        ({"rigid_length": np.nan}, "rigid_length"),
        ({"factors": (1.0, 1.0, 1.0)}, "factors"),
        ({"factors": (1.0, 0.0, 1.0, 1.0)}, "factors"),
        ({"factors": (1.0, 1.0, np.inf, 1.0)}, "factors"),
        ({"factors": (1.0, 1.0, 1.0, np.nan)}, "factors"),
        ({"finite_strain": True, "factors": (1.0, 0.9, 1.0, 1.0)}, "finite_strain"),
        ({"finite_strain": True, "inextensible": True}, "finite_strain"),
        ({"rest_curvature": np.zeros(3)}, "rest_curvature"),
        ({"rest_curvature": np.zeros((3, 3))}, "rest_curvature"),
        ({"rest_curvature": np.full((2, 3), np.nan)}, "rest_curvature"),
        ({"s": np.array([0.0, 0.0])}, "increase"),
        ({"s": np.array([0.1, 0.2])}, "increase"),
        ({"s": np.array([0.0, np.inf])}, "increase"),
        ({"s": np.array([0.0, np.nan])}, "increase"),
        ({"s": np.array([0.0])}, "knots"),
        ({"radius": np.array([1e-3, 0.0])}, "radius"),
        ({"radius": np.array([1e-3, np.nan])}, "radius"),
    ],
)
def test_an_invalid_rod_is_refused(change, message):
    with pytest.raises(InputError, match=message):
        replace(CONE, **change)
