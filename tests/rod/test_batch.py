"""Test that batches have the equilibria of `Rod.solve` for any neighbours and number of threads."""

import numpy as np
import pytest
from rods import CURVED, ELLIPTIC, EVERYTHING, PROFILE, bending_force

from probedesign.core.errors import InputError
from probedesign.rod import batch
from probedesign.rod.batch import solve_batch

GRAVITY = np.array([3.0, 4.0, -8.0])
RODS = (PROFILE, CURVED, EVERYTHING)  #: Rods with equal numbers of knots.
CASES = 40


def cases(rods, count=CASES, hopeless=True):
    """Return loads of all kinds and the rod of each; every eighth load has no equilibrium."""
    rng = np.random.default_rng(5)
    which = rng.integers(len(rods), size=count)
    s_c = np.array([rng.uniform(0.05, 1.0) * rods[k].length for k in which])
    way = rng.normal(size=(count, 3))
    strength = [bending_force(rods[k], s, 0.6 * x) for k, s, x in zip(which, s_c, rng.uniform(size=count), strict=True)]
    force = way / np.linalg.norm(way, axis=1, keepdims=True) * np.array(strength)[:, None]
    if hopeless:
        force[::8] = (0.0, 0.0, -1e3)
    gravity = rng.normal(size=(count, 3)) * 5.0
    couple = 1e-5 * rng.normal(size=(count, 3))
    return {"gravity": gravity, "force": force, "s_contact": s_c, "couple": couple, "which": which}


def solve_each(rods, given, **kwargs):
    each = zip(*(given[key] for key in ("which", "gravity", "force", "s_contact", "couple")), strict=True)
    return [rods[k].solve(g, F, s, couple=C, **kwargs) for k, g, F, s, C in each]


@pytest.mark.parametrize("mode", ["fast", "reference"])
@pytest.mark.parametrize("columns", ["load", "contact", "all"])
def test_the_batch_is_each_case_by_itself(columns, mode):
    given = cases(RODS)
    found = solve_batch(RODS, **given, columns=columns, mode=mode)
    one = solve_each(RODS, given, columns=columns, mode=mode)
    assert list(found.result) == [eq.result for eq in one]
    assert 20 < found.ok.sum() < CASES
    for numbers in (found.tip, found.d_moment, found.d_contact):
        assert np.isnan(numbers[~found.ok]).all() and np.isfinite(numbers[found.ok]).all()
    for i, eq in enumerate(one):
        np.testing.assert_array_equal(found.wrench_base[i], eq.wrench_base)
        np.testing.assert_array_equal(found.p_contact_base[i], eq.p_contact_base)
        if eq.ok:
            assert found.margin[i] == eq.margin and found.residual[i] == eq.residual
            np.testing.assert_array_equal(found.tip[i], eq.tip)
            np.testing.assert_array_equal(found.d_moment[i], eq.sensitivity.d_moment)
            np.testing.assert_array_equal(found.d_contact[i], eq.sensitivity.d_contact)


def test_without_columns_the_answer_is_as_good():
    """No last sweep with columns: its steps differ, so within the accuracy of "fast" for either."""
    given = cases(RODS)
    found, wanted = solve_batch(RODS, **given), solve_batch(RODS, **given, columns="load")
    assert found.d_moment.shape == (CASES, 3, 0) and found.d_contact.shape == (CASES, 12, 0)
    np.testing.assert_array_equal(found.result, wanted.result)
    ok = found.ok
    np.testing.assert_allclose(found.p_contact_base[ok], wanted.p_contact_base[ok], rtol=0.0, atol=2e-6)
    scale = np.linalg.norm(given["force"], axis=1) * given["s_contact"]
    scale += np.array([RODS[k].mass * RODS[k].length for k in given["which"]]) * 9.81
    off = np.abs(found.wrench_base - wanted.wrench_base)[:, 3:].max(axis=1)
    assert (off[ok] <= 2e-6 * scale[ok]).all()


@pytest.mark.parametrize("columns", ["none", "all"])
def test_not_a_bit_depends_on_threads_or_neighbours(columns, monkeypatch):
    given = cases(RODS, count=53)  # a prime: no chunk below divides it
    whole = solve_batch(RODS, **given, columns=columns, threads=1)
    order = np.random.default_rng(6).permutation(53)
    shuffled = {key: value[order] for key, value in given.items()}
    for threads, chunk in ((2, 7), (5, 1), (None, 256)):
        monkeypatch.setattr(batch, "CHUNK", chunk)
        for other, rows in (
            (solve_batch(RODS, **given, columns=columns, threads=threads), slice(None)),
            (solve_batch(RODS, **shuffled, columns=columns, threads=threads), order),
        ):
            for name in vars(whole):
                np.testing.assert_array_equal(getattr(other, name), getattr(whole, name)[rows], err_msg=name)


def test_one_rod_and_one_load_serve_for_all():
    force = bending_force(ELLIPTIC, 0.1, 0.3) * np.array([1.0, 0.5, 0.0])
    s_c = np.linspace(0.05, 0.15, 5)
    found = solve_batch(ELLIPTIC, GRAVITY, force, s_c, columns="load")
    for i, s in enumerate(s_c):
        eq = ELLIPTIC.solve(GRAVITY, force, s, columns="load")
        np.testing.assert_array_equal(found.wrench_base[i], eq.wrench_base)
    assert len(solve_batch(ELLIPTIC, GRAVITY, force, 0.1).result) == 1
    each = solve_batch([PROFILE, CURVED], GRAVITY, 0.1 * force, 0.05, columns="load")
    for i, rod in enumerate((PROFILE, CURVED)):
        eq = rod.solve(GRAVITY, 0.1 * force, 0.05, columns="load")
        np.testing.assert_array_equal(each.wrench_base[i], eq.wrench_base)


def test_no_cases_are_no_answers():
    found = solve_batch(PROFILE, np.empty((0, 3)), (0.0, 0.0, 0.0), 0.05)
    assert found.result.shape == (0,) and found.wrench_base.shape == (0, 6)


def test_a_stop_in_the_middle_is_heard(monkeypatch):
    solved = []

    def stop(first, *_arguments):
        solved.append(first)
        if len(solved) > 3:
            raise KeyboardInterrupt

    monkeypatch.setattr(batch, "CHUNK", 1)
    monkeypatch.setattr(batch, "solve_cases", stop)
    with pytest.raises(KeyboardInterrupt):
        solve_batch(RODS, **cases(RODS), threads=2)
    assert len(solved) < CASES


FINE = {"gravity": GRAVITY, "force": np.zeros((2, 3)), "s_contact": 0.05}


@pytest.mark.parametrize(
    ("rods", "change", "message"),
    [
        (PROFILE, {"gravity": np.zeros((3, 3))}, "3"),
        (PROFILE, {"force": np.zeros((2, 2))}, "force"),
        (PROFILE, {"couple": np.zeros(2)}, "couple"),
        (PROFILE, {"s_contact": np.zeros((2, 1))}, "s_contact"),
        (PROFILE, {"s_contact": [0.05, 0.121]}, "case 1"),
        (PROFILE, {"s_contact": [np.nan, 0.1]}, "case 0"),
        (PROFILE, {"force": [[0.0, 0.0, 0.0], [0.0, np.inf, 0.0]]}, "case 1"),
        (PROFILE, {"couple": (0.0, np.nan, 0.0)}, "case 0"),
        (PROFILE, {"which": [0, 1]}, "which"),
        (PROFILE, {"which": [0, -1]}, "which"),
        (PROFILE, {"which": [0.0, 0.0]}, "which"),
        (RODS, {"force": np.zeros((2, 3))}, "3"),
        ([PROFILE, ELLIPTIC], {}, "knots"),
        ([], {"which": [0, 0]}, "rods"),
    ],
)
def test_cases_that_do_not_fit_are_refused(rods, change, message):
    with pytest.raises(InputError, match=message):
        solve_batch(rods, **(FINE | change))
