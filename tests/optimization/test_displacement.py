"""Force at a given deflection, and load of the sensor in a crash: against the elastica, and as limits of `optimize`."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from probedesign.core.errors import InputError
from probedesign.design import check_design, load_design
from probedesign.optimization.constraints import OptimizationProblem, parse_limit
from probedesign.optimization.design_space import design_dict
from probedesign.optimization.displacement import crash_use, force_at_deflection_mN, push
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
    assert pushed.load[1] * rod.length**2 / EI == pytest.approx(load, abs=2e-4)


def test_a_small_push_is_linear_in_any_direction(elastica):
    rod, EI = elastica
    for phi in (0.0, 1.0, 2.5):
        pushed = push(rod, NO_GRAVITY, (math.cos(phi), math.sin(phi), 0.0), 1e-3 * rod.length)
        force = float(np.linalg.norm(pushed.load[:3]))
        assert force == pytest.approx(3.0 * EI / rod.length**3 * 1e-3 * rod.length, rel=1e-5)


def test_a_push_beside_the_axis_bends_the_rod_aside(elastica):
    """10° off the axis the force stays near Euler's load π² E I / (4 L²) instead of compressing the straight rod."""
    rod, EI = elastica
    aside = (math.sin(0.17), 0.0, -math.cos(0.17))
    euler = (math.pi / 2.0) ** 2 * EI / rod.length**2
    before, after = (push(rod, NO_GRAVITY, aside, share * rod.length) for share in (0.02, 0.3))
    assert before.ok and after.ok
    assert 0.0 < np.linalg.norm(before.load[:3]) < np.linalg.norm(after.load[:3]) < euler
    assert np.linalg.norm(after.load[:3]) > 0.9 * euler
    travelled = np.dot(aside, after.p_contact_base - (0.0, 0.0, rod.length))
    assert travelled == pytest.approx(0.3 * rod.length, rel=1e-5)


def test_the_straight_axis_is_pushed_up_to_eulers_load(elastica):
    """Without a side to bend to, the push ends at the buckling load, which is the largest force."""
    rod = replace(elastica[0], inextensible=False)
    pushed = push(rod, NO_GRAVITY, (0.0, 0.0, -1.0), 0.02 * rod.length)
    euler = (math.pi / 2.0) ** 2 * elastica[1] / rod.length**2
    # Compression and shear change the load by the strain at buckling, 0.1 %, times a few.
    assert pushed.ok and -pushed.load[2] == pytest.approx(euler, rel=5e-3)


def test_a_softer_print_pushes_and_crashes_in_proportion(large):
    """Without gravity all forces are proportional to the stiffness."""
    tables = design_dict(large)
    tables["mount"]["gravity_base_m_s2"] = [0.0, 0.0, 0.0]
    tables["material"] |= {
        key: 0.5 * tables["material"][key] for key in ("youngs_modulus_mpa", "shear_modulus_mpa")
    }
    soft = build_probe(check_design(tables)).model
    tables["material"] |= {
        key: 2.0 * tables["material"][key] for key in ("youngs_modulus_mpa", "shear_modulus_mpa")
    }
    stiff = build_probe(check_design(tables)).model
    overload = (250.0, 250.0, 480.0, 1.6, 1.6, 1.8)
    for figure in (
        lambda model: force_at_deflection_mN(model, TASK, 10.0),
        lambda model: crash_use(model, TASK, 20.0, overload),
    ):
        assert figure(stiff) == pytest.approx(2.0 * figure(soft), rel=1e-4)


def test_a_crash_loads_the_sensor_more_the_farther_it_goes(large):
    probe, overload = build_probe(large), np.array(large.sensor_model.overload)
    model = probe.model
    rest = model.to_sensor(probe.rod.solve(model.gravity_base).wrench_base, model.gravity_base)
    uses = [crash_use(model, TASK, distance, overload) for distance in (1e-3, 10.0, 30.0)]
    assert uses[0] == pytest.approx(np.max(np.abs(rest) / overload), rel=1e-2)  # the weight alone
    assert uses[0] < uses[1] < uses[2]
    assert crash_use(model, TASK, 10.0, overload / 2.0) == pytest.approx(2.0 * uses[1])


@pytest.mark.parametrize(
    "text", ["force_mN@10mm<=20", pytest.param("crash_use@20mm<=0.002", marks=pytest.mark.slow)]
)
def test_a_limit_with_a_distance_is_kept(large, text):
    limit = parse_limit(text)
    search = OptimizationProblem(large, ("cone",), TASK, limits=(limit,))

    def figure(design):
        model = build_probe(design).model
        if limit.metric.startswith("force"):
            return force_at_deflection_mN(model, TASK, 10.0)
        return crash_use(model, TASK, 20.0, design.sensor_model.overload)

    assert limit.margin(figure(large)) < 0.0  # or the limit would not matter
    found = optimum(search, "best", lambda _step, _share: None)
    assert limit.margin(figure(found.design)) >= -1e-6  # round-off: the search keeps 0.1 %


@pytest.mark.parametrize(
    "text", ["force_mN<=5", "crash_use@<=1", "force_mN@5<=1", "force_mN@0mm<=1", "force_mN@nanmm<=1",
             "crash_use@2000mm<=1", "force_mN@5mm<=0", "sag_mm@5mm<=3"]
)  # fmt: skip
def test_a_limit_with_a_wrong_distance_is_refused(text):
    with pytest.raises(InputError):
        parse_limit(text)


def test_a_crash_is_not_limited_without_a_known_overload(large):
    tables = design_dict(large)
    tables["sensor"] = {"model": "rft40"}
    without = check_design(tables)
    assert without.sensor_model.overload is None
    with pytest.raises(InputError):
        OptimizationProblem(without, ("cone",), TASK, limits=(parse_limit("crash_use@20mm<=0.5"),))
