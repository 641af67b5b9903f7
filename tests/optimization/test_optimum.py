"""Optimisation of a design: derivatives, print constraints, known optima, infeasible limits."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from probedesign.cli.main import run
from probedesign.core.errors import InputError
from probedesign.design import check_design, load_design
from probedesign.design.catalog import PrintLimits
from probedesign.design.io import render_design
from probedesign.optimization.constraints import Limit, NonlinearProgram, OptimizationProblem, check_limits, parse_limit
from probedesign.optimization.design_space import DesignEvaluator, DesignSpace, critical_load_factor, tables_of
from probedesign.optimization.objective import Task, design_metrics, predict_task
from probedesign.optimization.optimum import confirm, optimum
from probedesign.prediction.predict import predict
from probedesign.printing.check import SOFT_FACTOR, check_print
from probedesign.probe import build_probe
from probedesign.rod.rod import natural_frequency

LARGE = Path(__file__).parents[2] / "designs/large.toml"
TASK = Task()


def quiet(_step, _share):
    pass


@pytest.fixture(scope="module")
def large():
    """The paper's large probe with 3 % on E."""
    tables = tables_of(load_design(LARGE))
    tables["material"]["stiffness_spread"] = 0.03
    return check_design(tables)


@pytest.fixture(scope="module")
def rigid(large):
    """The same for objects that do not yield, a straight print and a reported rotation that is exact."""
    known = {"contact": {"object_compliance_m_N": 0.0}, "tolerances": {"bow_mm": 0.0, "pose_deg": 0.0}}
    return check_design(tables_of(large) | known)


def test_the_error_equals_the_prediction_for_fused_and_single_touches(large):
    """One model, one set of priors: designs are judged by the predicted error with all error sources."""
    probe = build_probe(large)
    predicted = probe.predict(fractions=(0.7,), forces_N=(0.01,), directions=("+y",))
    for touched, condition in ((5, predicted.fused[0]), (1, predicted.conditions[0])):
        task = Task((0.01,), touched, fractions=(0.7,))
        assert 1e3 * predict_task(probe.model, task).errors[0] == pytest.approx(condition.predicted_error_mm, rel=1e-5)
    felt = predict(probe.model, (0.8,), (0.01,), ("+y",)).detection[0].detectable_force_mN
    assert design_metrics(large, TASK).detectable_mN == pytest.approx(felt, rel=1e-6)


def test_several_tasks_at_once_are_combined(large):
    model = build_probe(large).model
    task = Task((0.005, 0.02), fractions=(0.5, 0.8), gravities=((9.81, 0.0, 0.0), (0.0, 0.0, 9.81)))
    found = predict_task(model, task, slipping=False)
    assert len(found.cases) == len(set(found.cases)) == 8
    single = [
        predict_task(model, replace(task, forces_N=(c.force_N,), fractions=(c.contact_fraction,),
                               gravities=(c.gravity_base_m_s2,)), slipping=False).errors[0]
        for c in found.cases
    ]  # fmt: skip
    np.testing.assert_allclose(found.errors, single, rtol=1e-4)  # presses divided otherwise
    assert task.combined(found.errors) == pytest.approx(np.sqrt(np.mean(np.square(found.errors))))
    assert replace(task, combine="worst").combined(found.errors) == max(found.errors)


@pytest.mark.parametrize(("x", "rule"), [((12.0, 1.4), "smallest_feature"), ((3.7, 3.6), "slenderness")])
def test_the_print_constraints_are_those_of_the_print_check(large, x, rule):
    space, x = DesignSpace.of(large, ("cone",)), np.array(x)
    broken = [name for name, rooms in space.printable(x).items() if rooms.min() < 0.0]
    errors = [f.rule for f in check_print(space.design(x)).errors if f.part == "probe"]
    assert broken == [f"print rule {rule}"] and errors == [rule]


def test_the_best_cone_improves_the_error(rigid):
    search = OptimizationProblem(rigid, ("cone",), TASK, limits=(Limit("sag_mm", True, 60.0),))
    found = optimum(search, "best", quiet)
    assert found.after.error_mm < found.before.error_mm
    assert found.after.sag_mm <= 60.0 and found.after.print_errors == 0 and found.design.name == "best"
    for factor in (0.97, 1.03):  # either way along the base it gets worse
        x = np.array([found.design.probe.base_d_mm * factor, found.design.probe.tip_d_mm])
        assert search.problem.evaluator.metrics(x)["error_mm"] > found.after.error_mm


def test_a_search_that_slides_off_the_probe_is_taken_back(large, monkeypatch):
    """On a soft tip the object slides off in a straight press; the next search begins at a probe that holds it."""
    program = OptimizationProblem(large, ("cone",), replace(TASK, fractions=(0.9,))).problem
    soft, starts = np.array([7.0, 1.5]), []

    def end_on_the_soft_tip(_self, _objective, _slope, x0, *_):
        starts.append(x0)
        return soft if len(starts) == 1 else x0

    monkeypatch.setattr(NonlinearProgram, "_slsqp", end_on_the_soft_tip)
    x = program.solve(program.evaluator.space.x_of(large))
    assert len(starts) == 2 and (x == starts[1]).all() and x[0] < starts[0][0]
    assert not program.is_feasible(soft) and program.is_feasible(x)
    assert not program.is_feasible(x + 0.02 * (soft - starts[0]))


def test_combine_worst_minimises_the_worst_case(large):
    limits = (Limit("sag_mm", True, 60.0),)
    mean, worst = (
        optimum(
            OptimizationProblem(large, ("cone",), Task(fractions=(0.4, 0.8), combine=how), limits=limits), "best", quiet
        )
        for how in ("mean", "worst")
    )
    assert worst.after.error_mm == worst.after.worst_error_mm
    assert worst.after.worst_error_mm <= mean.after.worst_error_mm * 1.001  # a search ends within a thousandth


def test_an_object_slides_off_a_soft_tip(large):
    """7 to 1.5 mm bends so far at 0.9 of its length that the object comes off the tip."""
    soft, stiff = (design_metrics(design, TASK) for design in
                   (DesignSpace.of(large, ("cone",)).design(np.array([7.0, 1.5])), large))  # fmt: skip
    assert soft.slide_mm is None and 0.0 < stiff.slide_mm < 1.0
    assert design_metrics(large, Task(touches=1)).slide_mm is None


def test_an_active_limit_is_reached_and_not_exceeded(large):
    task = replace(TASK, fractions=(0.5, 0.8))
    found = optimum(OptimizationProblem(large, ("cone",), task, limits=(Limit("sag_mm", True, 12.0),)), "best", quiet)
    assert 11.9 < found.after.sag_mm <= 12.0 and "sag_mm <= 12" in found.active_constraints


def test_infeasible_limits_are_named(large):
    limits = (Limit("sag_mm", True, 2.0), Limit("error_mm", True, 1.0))
    with pytest.raises(InputError, match=r"sag_mm <= 2 \(there .*error_mm <= 1 \(there"):
        optimum(OptimizationProblem(large, ("cone",), Task(touches=2, fractions=(0.6,)), limits=limits), "best", quiet)


def test_the_estimator_has_the_predicted_error(rigid):
    """With all error sources drawn, 24 draws determine the RMS to 1/√(2·24) = 14 %; the tolerance is three of these."""
    for task in (replace(TASK, fractions=(0.6,)), Task((0.03,), 1, fractions=(0.6,))):
        found = confirm(rigid, task, 24, 1, quiet, workers=1)
        assert found.drawn == 24 and found.located >= 20
        assert 0.57 < found.rms_mm / found.bound_mm < 1.43
        assert 0.75 * found.located <= found.inside <= found.located


def test_the_critical_load_is_predicted_below_buckling(large):
    """The probe is stable just below and buckles just above; extrapolated from lower forces, to one per cent."""
    task = replace(TASK, fractions=(0.9,))
    for base_d_mm in (5.8, 6.0):
        probe = build_probe(DesignSpace.of(large, ("cone",)).design(np.array([base_d_mm, 1.5])))
        most = critical_load_factor(probe.model, task, 1.4)
        assert 1.0 < most < 1.4
        found = [
            predict_task(probe.model, replace(task, forces_N=(f * most * task.force_N,))).errors[0]
            for f in (0.99, 1.01)
        ]
        assert np.isfinite(found[0]) and np.isinf(found[1])


def test_a_design_that_the_clamp_ring_does_not_pass_is_infeasible(large):
    space = DesignSpace.of(large, ("taper",))
    s, d = space.knots_mm(space.x_of(large))
    np.testing.assert_allclose(d, 12.0 - 10.0 * s / 150.0, atol=1e-9)  # a cubic spline draws a line exactly
    # The flange of a 6 mm base is 17 mm wide: 3 mm of it are pressed, 1 mm is the ring's gap, 1 mm lies in the groove.
    x = np.array([6.0, 14.0, 6.0, 4.0, 2.0])
    assert [name for name, rooms in space.printable(x).items() if rooms.min() < 0.0] == ["room for the clamp ring"]
    assert not DesignEvaluator(space, TASK).is_stable(x)
    x[1] = 11.5  # the curve through the knots reaches 11.9 mm
    assert DesignEvaluator(space, TASK).is_stable(x)


def test_a_wider_lip_lets_a_wider_probe_pass(large):
    """The flange of a 12 mm base is 19 mm wide with a lip of 3.5 mm, and 24 mm with 6 mm."""
    tables = tables_of(large)
    tables["mount"]["flange_lip_mm"] = 6.0
    wide = check_design(tables)
    x = np.array([12.0, 16.0, 6.0, 4.0, 2.0])
    for design, passes in ((large, False), (wide, True)):
        space = DesignSpace.of(design, ("taper",))
        assert (space.printable(x)["room for the clamp ring"].min() >= 0.0) == passes
        assert DesignEvaluator(space, TASK).is_stable(x) is passes


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--subject-to", "print_warnings<=2"], "write 'print_warnings<=0'"),
        (["--subject-to", "sagg_mm<=60"], "did you mean 'sag_mm'?"),
        (["--subject-to", "sag_mm=60"], "write FIGURE<=NUMBER"),
        (["--subject-to", "sag_mm<=-1"], "positive number"),
        (["--subject-to", "sag_mm<=10", "--subject-to", "sag_mm>=20"], "contradict"),
        (["--error-mm", "1"], "contradicts --goal error-at-force"),
        (["--goal", "force-for-error"], "needs --error-mm"),
        (["--over", "cone", "taper"], "contradict"),
        (["--over", "section"], "nothing to vary"),
        (["--goal", "force-for-error", "--error-mm", "1", "--subject-to", "error_mm>=2"], "contradict"),
        (["--subject-to", "length_mm>=200"], "the length stays 150 mm"),
        (["--gravity", "9.81,0"], "write X,Y,Z"),
        (["--force-N", "0.005", "-1"], "must lie in (0, 100]"),
        (["--at", "1.5"], "must lie in (0, 1]"),
        (["--touches", "0"], "touches = 0"),
    ],
)
def test_invalid_options_are_refused_in_one_line(arguments, message, tmp_path, capsys):
    out = tmp_path / "best.toml"
    assert run(["optimize", str(LARGE), "--out", str(out), *arguments]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and message in err and not out.exists()


def test_limits_read_as_written():
    limit = parse_limit("sag_mm <= 60")
    assert limit == Limit("sag_mm", True, 60.0) and limit.margin(30.0) == 0.5 and limit.margin(90.0) == -0.5
    check_limits([parse_limit("sag_mm>=10"), parse_limit("sag_mm<=60")])


def test_an_unwritable_output_is_refused_before_the_search(tmp_path, capsys):
    """The output folder is checked before the search, which takes a minute."""
    (tmp_path / "file").write_text("")
    assert run(["optimize", str(LARGE), "--out", str(tmp_path / "file/best.toml")]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and "cannot be written" in err


def test_a_start_that_buckles_is_improved_and_not_drawn(rigid, tmp_path, capsys):
    """A start that buckles has no gradient: the search begins with a thicker one."""
    limp, out = tmp_path / "limp.toml", tmp_path / "best.toml"
    limp.write_text(render_design(check_design(DesignSpace.of(rigid, ("cone",)).tables(np.array([4.0, 1.5]), 3))))
    assert run(["optimize", str(limp), "--at", "0.9", "--confirm", "2", "--out", str(out)]) == 0
    assert "start: not run, because the probe buckles" in capsys.readouterr().out
    task = replace(TASK, fractions=(0.9,))
    before, after = (design_metrics(load_design(path), task).error_mm for path in (limp, out))
    assert before is None and after < 2.0


@pytest.mark.parametrize("shape", ["cone", "cylinder", "profile"])
def test_with_the_length_alone_the_diameters_stay(large, shape):
    tables = tables_of(large)
    tables["probe"] |= {"shape": shape}
    if shape == "cylinder":
        tables["probe"]["tip_d_mm"] = 12.0
    if shape == "profile":
        tables["probe"]["profile_mm"] = [[0.0, 12.0], [60.0, 5.0], [150.0, 2.0]]
    start = check_design(tables)
    space = DesignSpace.of(start, ("length",))
    assert space.design(space.x_of(start)).probe == start.probe
    longer = space.design(np.array([18.0])).probe  # centimetres
    assert longer.length_mm == 180.0 and longer.shape == shape
    np.testing.assert_allclose(longer.blunt_mm, np.array(start.probe.blunt_mm) * [1.2, 1.0], rtol=1e-12)


def test_with_the_length_alone_the_longest_that_may_be_reached_is_found(large):
    limits = (Limit("reach_mm", True, 140.0), Limit("reach_mm", False, 120.0))
    found = optimum(
        OptimizationProblem(large, ("length",), replace(TASK, fractions=(0.7,)), limits=limits), "best", quiet
    )
    assert 120.0 <= found.after.reach_mm <= 140.0 and found.after.thinnest_mm == 2.0
    assert len(found.active_constraints) == 1 and "reach_mm" in found.active_constraints[0]


@pytest.mark.slow
def test_a_free_taper_is_no_worse_than_the_best_cone(large):
    limits = (Limit("sag_mm", True, 60.0),)
    cone, taper = (
        optimum(OptimizationProblem(large, (free,), TASK, limits=limits), "best", quiet) for free in ("cone", "taper")
    )
    assert taper.after.error_mm < cone.after.error_mm * 1.001 and taper.after.print_errors == 0
    assert taper.after.sag_mm <= 60.0


@pytest.mark.parametrize(
    ("texts", "over"),
    [(("thinnest_mm>=3", "natural_frequency_Hz>=25"), ("cone",)), (("detectable_mN<=0.18",), ("cone", "length"))],
)
def test_limits_that_are_computed_on_demand_are_kept(large, texts, over):
    """The values are those of the written design. Only a longer arm detects a weaker force."""
    limits = tuple(map(parse_limit, texts))
    search = OptimizationProblem(large, over, replace(TASK, fractions=(0.7,)), limits=limits)

    def margins(design):
        metrics = design_metrics(design, search.task).as_dict() | {"natural_frequency_Hz": frequency_of(design)}
        return [limit.margin(metrics[limit.metric]) for limit in limits]

    assert max(margins(large)) < 0.0  # or the limits would not matter
    assert min(margins(optimum(search, "best", quiet).design)) >= -1e-6  # round-off: the search keeps 0.1 %


def frequency_of(design):
    probe = build_probe(design)
    return natural_frequency(probe.rod, probe.model.gravity_base)


def test_a_limit_on_the_buckling_margin_is_kept(large):
    """The optimum is stable at three times the task's force; the start buckles before."""
    limit, task = parse_limit("buckling_margin>=3"), Task(forces_N=(0.1,), touches=1, fractions=(0.7,))
    more = replace(task, forces_N=(3.0 * task.force_N,))
    assert np.isinf(predict_task(build_probe(large).model, more).errors[0])
    found = optimum(OptimizationProblem(large, ("cone",), task, limits=(limit,)), "best", quiet)
    assert np.isfinite(predict_task(build_probe(found.design).model, more).errors[0])


def test_a_search_without_print_warnings_finds_a_design_without(large):
    tables = tables_of(large)
    tables["probe"] |= {"base_d_mm": 6.0}  # 6 mm below 150 mm: slender
    large = check_design(tables)
    search = OptimizationProblem(large, ("cone",), replace(TASK, fractions=(0.7,)),
                                 limits=(parse_limit("print_warnings<=0"),))  # fmt: skip
    assert design_metrics(large, search.task).print_warnings > 0
    found = optimum(search, "best", quiet)
    assert found.after.print_warnings == 0


def test_a_hollow_optimum_keeps_the_limits_of_soft_resin(large):
    """The search may choose wall and bore, and would end at the limits of rigid resin, which do not print. The optimum
    is at a print rule, and rounded dimensions still satisfy it."""
    tables = tables_of(large)
    tables["probe"] |= {"section": "hollow", "bore_ratio": 0.5, "tip_d_mm": 4.0}
    search = OptimizationProblem(check_design(tables), ("cone", "section"), replace(TASK, fractions=(0.7,)))
    found = optimum(search, "best", quiet)
    assert any("print rule" in text for text in found.active_constraints) and found.after.print_errors == 0
    probe = found.design.probe
    wall, bore = (1 - probe.bore_ratio) * probe.tip_d_mm / 2, probe.bore_ratio * probe.tip_d_mm
    assert wall >= SOFT_FACTOR * PrintLimits.supported_wall_mm and bore >= SOFT_FACTOR * PrintLimits.hole_mm
    assert not [f for f in check_print(found.design).warnings if f.rule in ("wall", "hole") and f.part == "probe"]


# Curved probes

#: A whisker's task: one reading of 5 mN at 0.8 L, the worst direction within 60° of one working side.
WHISKING = Task((0.005,), 1, fractions=(0.8,), directions_deg=(-60.0, -30.0, 0.0, 30.0, 60.0), combine="worst")


def test_a_bent_axis_locates_light_touches_of_one_side(large, monkeypatch):
    """E and G known to 3 %, a bow of 1 mm: the straight probe has 21 mm whatever its direction.

    The search has a twelfth of its starts, and the worst directions are the outermost or the middle one.
    """
    monkeypatch.setattr("probedesign.optimization.optimum.TURNS", (0.5,))
    monkeypatch.setattr("probedesign.optimization.optimum.AZIMUTHS_DEG", (0.0, 90.0, 180.0, 270.0))
    known = tables_of(large) | {"tolerances": {"youngs_modulus": 0.03, "shear_modulus": 0.03, "bow_mm": 1.0}}
    task = replace(WHISKING, directions_deg=(-60.0, 0.0, 60.0))
    search = OptimizationProblem(check_design(known), ("axis",), task, limits=(parse_limit("tip_offset_mm<=60"),))
    found = optimum(search, "whisker", quiet)
    assert found.before.error_mm == pytest.approx(21.0, rel=0.05) and found.before.tip_offset_mm == 0.0
    model = build_probe(found.design).model
    assert max(predict_task(model, WHISKING).errors) < 6.5e-3 and found.after.tip_offset_mm <= 60.0
    assert not found.after.print_errors and found.design.probe.axis == "helix"
    # Directions more than 60° off are not promised: the blind one is there.
    everywhere = replace(WHISKING, directions_deg=tuple(15.0 * k for k in range(24)))
    assert max(predict_task(model, everywhere).errors) > 2e-3 * found.after.worst_error_mm


def test_directions_of_a_task_are_cases_of_its_error(large):
    model = build_probe(check_design(curved(large))).model
    task = replace(WHISKING, combine="mean")
    each = [predict_task(model, replace(task, directions_deg=(angle,))).errors[0] for angle in task.directions_deg]
    together = predict_task(model, task)
    np.testing.assert_allclose(together.errors, each, rtol=1e-12)
    assert [case.direction_deg for case in together.cases] == pytest.approx(list(task.directions_deg))
    assert task.combined(together.errors) == pytest.approx(np.sqrt(np.mean(np.square(each))))


def test_a_search_over_the_length_ends_at_the_longest_probe_that_the_printer_takes(large):
    longest = DesignSpace.of(large, ("length",)).bounds[-1][1] * 10.0  # its unit is 10 mm
    fits = [large.model_copy(update={"probe": large.probe.model_copy(update={"length_mm": length})})
            for length in (longest, longest + 2.0)]  # fmt: skip
    assert [check_print(design).fits for design in fits] == [True, False]


def curved(design, **axis):
    tables = tables_of(design)
    return tables | {"probe": tables["probe"] | {"axis": "arc", "axis_bend_deg": 60.0, "axis_azimuth_deg": 90.0} | axis}


def test_a_point_of_a_bent_design_space_is_its_design(large):
    start = check_design(curved(large, axis="helix", axis_turns=0.5))
    space = DesignSpace.of(start, ("cone", "axis"))
    x = space.x_of(start)
    again = space.design(x)
    assert space.x_of(again) == pytest.approx(x) and again.probe.axis_turns == 0.5
    arc = space.design(space.with_axis(x, {"axis_bend_deg": 30.0, "axis_turns": 0.0, "axis_azimuth_deg": 10.0}))
    assert (arc.probe.axis, arc.probe.axis_turns, arc.probe.axis_bend_deg) == ("arc", None, 30.0)
    # The margins are those by which the schema refuses: a bend of 250° in the plane returns into the mount.
    low = space.printable(space.with_axis(x, {"axis_bend_deg": 250.0, "axis_turns": 0.0, "axis_azimuth_deg": 0.0}))
    assert low["axis above the mount"].min() < 0.0 < space.printable(x)["axis above the mount"].min()


def test_second_roots_of_a_helix_are_told_by_its_distinction(large):
    """A single reading of an arc has one place; a helix of a turn has a second root near 0.6 and one near the tip."""
    straight, arc, helix = (
        design_metrics(check_design(tables), WHISKING).distinction
        for tables in (
            tables_of(large),
            curved(large),
            curved(large, axis="helix", axis_bend_deg=166.0, axis_turns=0.9),
        )
    )
    assert straight is None and helix < 3.0 < arc
    assert design_metrics(check_design(curved(large)), replace(WHISKING, touches=2)).distinction is None
