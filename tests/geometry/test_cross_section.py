"""Test sections other than solid round ones by quadrature of the definitions and in limits."""

import math

import numpy as np
import pytest
from scipy.integrate import dblquad

from probedesign.core.errors import InputError
from probedesign.geometry.cross_section import FULL_ROUND, CrossSection

EXACT = 1e-12  #: Relative tolerance of two closed forms.
QUADRATURE = 1e-9  #: Relative tolerance; the tolerance of `dblquad` is ten times smaller.

SECTIONS = [
    FULL_ROUND,
    *(CrossSection(bore_ratio=b) for b in (0.05, 0.5)),
    *(CrossSection(flatness=f) for f in (0.2, 0.6)),
]


def integral(section: CrossSection, f) -> float:
    """∫ f(x, y) dA over the section of half-width 1 along x, rim by rim."""

    def within(a: float, b: float) -> float:
        def half(x: float) -> float:
            return b * math.sqrt(max(0.0, 1.0 - (x / a) ** 2))

        whole = dblquad(lambda y, x: f(x, y), -a, a, lambda x: -half(x), half, epsabs=0, epsrel=1e-10)
        return float(whole[0])

    bore = within(section.bore_ratio, section.bore_ratio) if section.hollow else 0.0
    return within(1.0, section.flatness) - bore


@pytest.mark.parametrize("section", SECTIONS, ids=str)
def test_area_and_second_moments_by_quadrature(section):
    of = section.factors
    assert integral(section, lambda x, y: 1.0) == pytest.approx(of.area * math.pi, rel=QUADRATURE)
    assert integral(section, lambda x, y: y * y) == pytest.approx(of.xx * math.pi / 4, rel=QUADRATURE)
    assert integral(section, lambda x, y: x * x) == pytest.approx(of.yy * math.pi / 4, rel=QUADRATURE)


@pytest.mark.parametrize("section", [s for s in SECTIONS if s.flat], ids=str)
def test_torsion_of_an_ellipse_from_its_stress_function(section):
    """Prandtl: ∇²φ = -2 inside, φ = 0 on the rim, J = 2 ∫φ dA. Here φ is a multiple of 1 - x² - (y/b)²."""
    b = section.flatness

    def zero_on_the_rim(x: float, y: float) -> float:
        return 1.0 - x * x - (y / b) ** 2

    x, y, d = 0.3, 0.1 * b, 0.01  # central differences of a quadratic are exact, whatever the step
    around = [zero_on_the_rim(x + i, y + j) for i, j in ((d, 0), (-d, 0), (0, d), (0, -d))]
    laplacian = (sum(around) - 4 * zero_on_the_rim(x, y)) / d**2
    J = 2.0 * integral(section, lambda x, y: zero_on_the_rim(x, y) * -2.0 / laplacian)
    assert section.factors.torsion * math.pi / 2 == pytest.approx(J, rel=QUADRATURE)


@pytest.mark.parametrize("section", [s for s in SECTIONS if not s.flat], ids=str)
def test_torsion_of_a_round_section_is_its_polar_moment(section):
    polar = integral(section, lambda x, y: x * x + y * y)
    assert polar == pytest.approx(section.factors.torsion * math.pi / 2, rel=QUADRATURE)


def test_the_limits_are_the_full_round_section():
    assert CrossSection(bore_ratio=0.0, flatness=1.0) == FULL_ROUND
    assert FULL_ROUND.factors == (1.0, 1.0, 1.0, 1.0) and FULL_ROUND.full_round
    for nearly in (CrossSection(bore_ratio=1e-6), CrossSection(flatness=1.0 - 1e-6)):
        assert not nearly.full_round
        # A bore of 1e-6 takes 1e-12; an ellipse flatter by 1e-6 has 3e-6 less of I_xx.
        assert np.allclose(nearly.factors, 1.0, rtol=0.0, atol=4e-6)


@pytest.mark.parametrize(
    "proportions",
    [
        {"bore_ratio": 1.0},
        {"bore_ratio": -0.1},
        {"bore_ratio": math.nan},
        {"flatness": 0.0},
        {"flatness": 1.1},
        {"flatness": math.nan},
        {"bore_ratio": 0.5, "flatness": 0.5},
    ],
    ids=str,
)
def test_what_is_no_section_is_one_line(proportions):
    with pytest.raises(InputError, match="section") as error:
        CrossSection(**proportions)
    assert str(error.value).isprintable()


@pytest.mark.parametrize("section", SECTIONS, ids=str)
@pytest.mark.parametrize("side", [0.0, 0.4, math.pi / 2.0, 2.5])
def test_the_surface_lies_on_the_ellipse_in_the_direction_that_is_meant(section, side):
    x, y = section.reach(side) * math.cos(side), section.reach(side) * math.sin(side)
    assert x**2 + (y / section.flatness) ** 2 == pytest.approx(1.0, rel=EXACT)
