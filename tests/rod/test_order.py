"""Test the order of the integration pair, 6 and 5, by quadrature and on a rod."""

import numpy as np
import pytest

from probedesign.rod.kernels import steps


def test_stages_are_at_the_sums_of_their_coefficients():
    np.testing.assert_allclose(steps.A.sum(axis=1), steps.C, atol=2e-15)  # rounding of eight fractions


@pytest.mark.parametrize(("weights", "order"), [(steps.B, 6), (steps.B_LOW, 5)])
def test_quadrature_holds_up_to_the_order_and_no_further(weights, order):
    """Σ b c^(k-1) = 1/k for k up to the order."""
    for k in range(1, order + 1):
        assert weights @ steps.C ** (k - 1) == pytest.approx(1.0 / k, abs=1e-15)
    assert abs(weights @ steps.C**order - 1.0 / (order + 1)) > 1e-6


@pytest.mark.parametrize(("weights", "order"), [(steps.B, 6), (steps.B_LOW, 5)])
def test_one_step_of_growth_is_its_taylor_sum(weights, order):
    """Test the conditions b A^(k-1) 1 = 1/k! of y' = y, which quadrature does not include."""
    chain, factorial = np.ones(8), 1.0
    square = steps.A
    for k in range(1, order + 1):
        factorial *= k
        assert weights @ chain == pytest.approx(1.0 / factorial, abs=1e-14)
        chain = square @ chain
