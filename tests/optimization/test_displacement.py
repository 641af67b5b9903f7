"""Force at a given deflection: against the elastica, and as a limit of `optimize`."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from probedesign.core.errors import InputError
from probedesign.design import check_design, load_design
from probedesign.design.edit import tables_of
from probedesign.optimization import displacement
from probedesign.optimization.constraints import OptimizationProblem, parse_limit
from probedesign.optimization.displacement import forces_at_deflection_mN, push
from probedesign.optimization.objective import Task
from probedesign.optimization.optimum import optimum
from probedesign.probe import build_probe
from probedesign.rod.rod import Rod

LARGE = Path(__file__).parents[2] / "designs/large.toml"
TASK = Task(touches=1, fractions=(0.7,))
NO_GRAVITY = (0.0, 0.0, 0.0)


@pytest.fixture(scope="module")
def large():
    return load_design(LARGE)


@pytest.fixture(scope="module")
def elastica():
    """Euler's elastica, 100 mm long, with its bending stiffness E I [N·m²]."""
    rod = Rod(np.array([0.0, 0.1]), np.full(2, 2e-3), 2e6, 0.7e6, 1000.0, inextensible=True)
    return rod, 2e6 * math.pi / 4.0 * 2e-3**4


@pytest.mark.parametrize(("load", "deflection"), [(1.0, 0.30172), (2.0, 0.49346), (5.0, 0.71379)])
def test_the_force_at_a_deflection_is_that_of_the_elastica(elastica, load, deflection):
    """P L²/EI by deflection/L of the tip: table of Mattiasson, IJNME 17 (1981) 145, five digits."""
    rod, EI = elastica
    pushed = push(rod, NO_GRAVITY, (0.0, 1.0, 0.0), deflection * rod.length)
    assert pushed.ok
    # The last digit of the table, 5e-6, times the slope of the load, which is 19 at the largest deflection.
    assert pushed.force * rod.length**2 / EI == pytest.approx(load, abs=2e-4)


def test_a_small_push_is_linear_in_any_direction(elastica):
    rod, EI = elastica
    for phi in (0.0, 1.0, 2.5):
        pushed = push(rod, NO_GRAVITY, (math.cos(phi), math.sin(phi), 0.0), 1e-3 * rod.length)
        assert pushed.force == pytest.approx(3.0 * EI / rod.length**3 * 1e-3 * rod.length, rel=1e-5)


def test_a_push_beside_the_axis_bends_the_rod_aside(elastica):
    """10° off the axis the force stays near Euler's load π² E I / (4 L²) instead of compressing the straight rod."""
    rod, EI = elastica
    aside = (math.sin(0.17), 0.0, -math.cos(0.17))
    euler = (math.pi / 2.0) ** 2 * EI / rod.length**2
    before, after = (push(rod, NO_GRAVITY, aside, share * rod.length) for share in (0.02, 0.3))
    assert before.ok and after.ok
    assert 0.0 < before.force < after.force < euler
    assert after.force > 0.9 * euler
    travelled = np.dot(aside, after.last.p_contact_base - (0.0, 0.0, rod.length))
    assert travelled == pytest.approx(0.3 * rod.length, rel=1e-5)


def test_the_straight_axis_is_pushed_up_to_eulers_load(elastica):
    """Without a side to bend to, the push ends at the buckling load, which is the largest force."""
    rod = replace(elastica[0], inextensible=False)
    pushed = push(rod, NO_GRAVITY, (0.0, 0.0, -1.0), 0.02 * rod.length)
    euler = (math.pi / 2.0) ** 2 * elastica[1] / rod.length**2
    # Compression and shear change the load by the strain at buckling, 0.1 %, times a few.
    assert pushed.result == "snaps" and pushed.force == pytest.approx(euler, rel=5e-3)


@pytest.mark.parametrize("polar", [math.pi / 2.0, math.radians(135.0)])
def test_a_distance_beyond_the_rods_reach_has_no_force(elastica, polar):
    """The tip cannot travel further than twice the length: whatever ends the search, the result is not "ok"."""
    rod, _ = elastica
    e = (math.sin(polar), 0.0, math.cos(polar))
    assert not push(rod, NO_GRAVITY, e, 2.5 * rod.length).ok


@pytest.mark.parametrize("solves", [1, 3])
def test_an_unfinished_push_gives_no_load(large, monkeypatch, solves):
    """The loads of the way are smaller than that at the distance, so they must not pass for it."""
    model = build_probe(large).model
    assert push(model.rod, model.gravity_base, (0.0, 1.0, 0.0), 0.05).ok
    monkeypatch.setattr(displacement, "_MAX_SOLVES", solves)
    assert push(model.rod, model.gravity_base, (0.0, 1.0, 0.0), 0.05).result == "not_converged"
    assert forces_at_deflection_mN(model, TASK, 50.0) is None
    limits = (parse_limit("force_mN@50mm<=1e5"), parse_limit("force_mN@50mm>=1e-3"))
    problem = OptimizationProblem(large, ("cone",), TASK, limits=limits).problem
    x = problem.evaluator.space.x_of(large)
    margins = [c.min_margin(x) for c in problem.constraints if c.text in {limit.text for limit in limits}]
    assert len(margins) == 2 and max(margins) < 0.0


def test_a_lower_limit_on_the_force_holds_in_every_direction(large):
    """An elliptic probe is stiffest along x and softest along y: each limit bounds the force on its own side."""
    tables = tables_of(large)
    tables["probe"] |= {"section": "elliptic", "flatness": 0.6}
    flat = check_design(tables)
    model = build_probe(flat).model
    low, high = forces_at_deflection_mN(model, TASK, 5.0)
    s = TASK.fractions[0] * model.rod.length
    by_axis = [push(model.rod, model.gravity_base, e, 0.005, s).force for e in np.eye(3)[:2]]
    assert low <= 1e3 * by_axis[1] < 1e3 * by_axis[0] <= high
    limits = [parse_limit(f"force_mN@5mm{sign}{(low + high) / 2.0:g}") for sign in ("<=", ">=")]
    for limit, force in zip(limits, (high, low), strict=True):
        problem = OptimizationProblem(flat, ("cone",), TASK, limits=(limit,)).problem
        found = next(c for c in problem.constraints if c.text == limit.text)
        x = problem.evaluator.space.x_of(flat)
        # The dimensions of the point are not rounded, those of the design are: 1e-3 mm of 7 mm, to the fourth power.
        assert problem.evaluator.metrics(x)[limit.figure] == pytest.approx(force, rel=1e-3)
        assert found.min_margin(x) < 0.0


def test_a_softer_print_pushes_in_proportion(large):
    """Without gravity all forces are proportional to the stiffness."""
    tables = tables_of(large)
    tables["mount"]["gravity_base_m_s2"] = [0.0, 0.0, 0.0]
    tables["material"] |= {key: 0.5 * tables["material"][key] for key in ("youngs_modulus_mpa", "shear_modulus_mpa")}
    soft = build_probe(check_design(tables)).model
    tables["material"] |= {key: 2.0 * tables["material"][key] for key in ("youngs_modulus_mpa", "shear_modulus_mpa")}
    stiff = build_probe(check_design(tables)).model
    assert forces_at_deflection_mN(stiff, TASK, 10.0)[1] == pytest.approx(
        2.0 * forces_at_deflection_mN(soft, TASK, 10.0)[1], rel=1e-4
    )


def test_a_limit_with_a_distance_is_kept(large):
    limit = parse_limit("force_mN@10mm<=20")
    search = OptimizationProblem(large, ("cone",), TASK, limits=(limit,))

    def figure(design):
        return forces_at_deflection_mN(build_probe(design).model, TASK, 10.0)[1]

    assert limit.margin(figure(large)) < 0.0  # or the limit would not matter
    found = optimum(search, "best", lambda _step, _share: None)
    assert limit.margin(figure(found.design)) >= -1e-6  # round-off: the search keeps 0.1 %


@pytest.mark.parametrize(
    "text", ["force_mN<=5", "force_mN@<=1", "force_mN@5<=1", "force_mN@0mm<=1", "force_mN@nanmm<=1",
             "force_mN@2000mm<=1", "force_mN@5mm<=0", "sag_mm@5mm<=3"]
)  # fmt: skip
def test_a_limit_with_a_wrong_distance_is_refused(text):
    with pytest.raises(InputError):
        parse_limit(text)
