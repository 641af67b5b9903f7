"""Test plans of campaigns: proposed tests, expected intervals, and agreement with `identify`."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.planning import fill
from probedesign import data_of, identify, new
from probedesign.campaigns import read_campaign
from probedesign.cli.main import run
from probedesign.core.errors import InputError
from probedesign.core.units import MM
from probedesign.design import load_design
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.model import Tolerances
from probedesign.planning.candidates import Bench, Instruments
from probedesign.planning.plan import HANG_EVERY, PREPARATION, Information, checklist_text, make_plan, tables
from probedesign.probe import build_probe
from probedesign.reports.plan_page import plan_page
from probedesign.rod.contact import surface_point
from tests.reports.test_pages import assert_whole

LARGE = Path(__file__).parents[2] / "designs/large.toml"
STAGE = Instruments(calipers=None, balance=None)


def planned(design, *settings):
    probe = build_probe(design)
    return make_plan(probe.model, probe.flange_volume, *settings)


@pytest.fixture(scope="module")
def design():
    return load_design(LARGE)


@pytest.fixture(scope="module")
def bench(design):
    return Bench(build_probe(load_design(LARGE)).model, STAGE)


@pytest.fixture(scope="module")
def plan(design):
    """Of an hour with a stage, for E and the root."""
    return planned(design, 90.0, ("E", "root"), STAGE, 4)


def test_a_plan_keeps_the_time_and_ends_free(plan):
    assert plan.tests[-1].minutes <= 90.0
    total = PREPARATION + sum(one.minutes for one in plan.candidates)
    assert plan.tests[-1].minutes == pytest.approx(total)
    assert [one.set_up for one in (plan.candidates[0], plan.candidates[-1])] == ["hang", "hang"]
    assert len({one.name for one in plan.candidates}) == len(plan.candidates)
    assert sum(one.held_out for one in plan.candidates) == 4


def test_the_marks_lie_r_tan_alpha_beyond_the_line_of_the_force(bench):
    """A touch of the candidate's axis point touches the surface at the mark, of the undeformed probe."""
    rod = bench.model.rod
    for one in bench.candidates():
        if one.set_up == "touch" and one.test.direction == "+x":
            reach = rod.radius_at(one.test.s_contact) / math.hypot(1.0, rod.taper_at(one.test.s_contact))
            along = reach * math.sin(math.atan(rod.taper_at(one.test.s_contact)))
            # r and tan α are those of the mark and of the axis point: they differ by tan α r dα, below 0.02 mm
            assert one.test.s_contact + along == pytest.approx(one.mark, abs=2e-5)
            p = one.test.T_world_base[:3, :3].T @ (one.test.p_contact_world - one.test.T_world_base[:3, 3])
            np.testing.assert_allclose(p, surface_point(rod, one.shape), atol=1e-12)


def test_more_tests_never_widen_an_interval_of_one_parameter(design):
    """Information is additive; with E alone requested no other parameter is estimated."""
    found = planned(design, 100.0, ("E",), STAGE, 0)
    stds = [one.expected[0].std_of_print for one in found.tests if one.expected[0].std_of_print is not None]
    assert len(stds) > 5 and np.all(np.diff(stds) <= 1e-9)


def test_the_chosen_tests_are_better_than_others_of_the_same_time(plan, bench):
    """Thirty random sets of as many touches: none determines E and the root better together."""
    candidates = bench.candidates()
    information = Information(bench, tuple(candidates), 0.0)
    hang, touches = candidates[0], [one for one in candidates if one.set_up == "touch"]
    rng, chosen = np.random.default_rng(1), [one for one in plan.candidates if not one.held_out]

    def area(intervals):
        return math.inf if any(one.std is None for one in intervals) else math.prod(one.std for one in intervals)

    for _ in range(30):
        drawn = rng.choice(len(touches), size=len(chosen) - 2, replace=False)
        intervals, _ = information.expected([hang, *(touches[i] for i in drawn)], plan.names)
        assert area(intervals) > 0.98 * area(plan.expected)


def test_g_follows_e_where_the_tests_do_not_determine_it(bench):
    """A full round probe shears by a tenth of a millimetre: G is known as well as E and Poisson's ratio are."""
    plan = make_plan(bench.model, 0.0, 60.0, ("E", "G"), replace(STAGE, stage=None, turnable=False), 0)
    E, G = plan.expected
    # G = E / (2 (1 + ν)) with ν = 0.49 ± 0.01; the tests add a little, and shear with bending correlates the two
    assert G.std == pytest.approx(math.hypot(E.std, 0.01 / 1.49), rel=0.1)


def test_calipers_determine_diameters_as_well_as_they_measure(bench):
    """The diameters' common factor: six marks, measured twice."""
    instruments = replace(STAGE, stage=None, calipers=0.05 * MM, turnable=False, weights=())
    plan = make_plan(bench.model, 0.0, 60.0, ("diameters",), instruments, 0)
    assert plan.candidates[0].set_up == "calipers"
    std = plan.tests[0].expected[0].std
    diameters = 2.0 * bench.model.rod.radius_at(np.array([0.02, 0.35, 0.5, 0.65, 0.8, 0.92]) * bench.model.rod.length)
    by_hand = 0.05 * MM / math.sqrt(2.0 * 2.0) / np.linalg.norm(diameters / math.sqrt(2.0))
    # the scatter of each knot from the common factor, 0.025 mm, adds to what the calipers leave
    assert by_hand < std < 2.5 * by_hand


@pytest.mark.parametrize("exact", [True, False])
def test_identify_states_the_expected_intervals(plan, design, tmp_path, exact):
    """Simulated measurements of exactly the plan, of the designed and of a drawn print."""
    fill(tmp_path, plan, 3, exact)
    probe = build_probe(design)
    found = identify(data_of(read_campaign(tmp_path), probe.model, probe.flange_volume), ("E", "root"))
    assert found.result == "ok" and found.tests == sum(not one.held_out for one in plan.candidates)
    for one in plan.expected:
        stated = found.of(one.name)
        scale = stated.value if one.relative else 1.0
        # the fit has its derivatives at friction and place as estimated, and the drawn print bends elsewhere
        assert stated.std / scale == pytest.approx(one.std, rel=0.02)
        assert stated.std_of_print / scale == pytest.approx(one.std_of_print, rel=0.02)
        if exact:  # four standard deviations
            assert abs(stated.value - stated.design) < 4.0 * stated.std


def test_an_empty_folder_is_read_and_a_part_of_it_is_enough(plan, design, tmp_path):
    for name, text in tables(plan).items():
        (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match="no rows"):
        read_campaign(tmp_path)
    fill(tmp_path, plan, 2)
    assert [test.name for test in read_campaign(tmp_path).tests] == [one.name for one in plan.candidates]
    rows = (tmp_path / "wrenches.csv").read_text().splitlines()
    (tmp_path / "wrenches.csv").write_text("\n".join(row for row in rows if not row.startswith("touch-03")) + "\n")
    lines = (tmp_path / "tests.csv").read_text().splitlines()
    empty = [line for line in tables(plan)["tests.csv"].splitlines() if line.startswith("touch-03")]
    (tmp_path / "tests.csv").write_text(
        "\n".join(empty[0] if line.startswith("touch-03") else line for line in lines) + "\n"
    )
    found = identify(data_of(read_campaign(tmp_path), build_probe(design).model, 0.0), ("E",))
    assert found.result == "ok" and any(note.startswith("touch-03: not used") for note in found.notes)


def test_the_page_shows_every_set_up(plan):
    page = plan_page(plan, "data/large").decode()
    seen = assert_whole(page)
    assert seen.seen["svg"] == len(plan.candidates) + 1  # and the chart
    for one in plan.candidates:
        assert one.name in page


# command


@pytest.fixture
def call(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)

    def call(*arguments: str, design: str = str(LARGE)) -> tuple[int, str, str]:
        status = run(["plan", design, *arguments])
        out, err = capsys.readouterr()
        return status, out, err

    return call


def test_the_command_writes_a_folder_and_never_replaces_measurements(call):
    status, out, _ = call("--minutes", "70", "--json", "--no-turn")
    document = json.loads(out)
    assert status == 0 and document["tests"][-1]["minutes_since_start"] <= 70
    folder = Path("data/large")
    assert {path.name for path in folder.iterdir()} >= {"campaign.toml", "tests.csv", "wrenches.csv", "plan.html"}
    assert (folder / "wrenches.csv").read_text().startswith("# frame: sensor\n")
    status, _, err = call("--minutes", "70")
    assert status == 2 and "--force" in err and len(err.splitlines()) == 1
    assert call("--minutes", "60", "--force")[0] == 0
    with (folder / "wrenches.csv").open("a") as file:
        file.write("hang-1,0,0,0,0,0,0,0\n")
    before = (folder / "wrenches.csv").read_bytes()
    status, _, err = call("--minutes", "60", "--force")
    assert status == 2 and "measured values" in err and (folder / "wrenches.csv").read_bytes() == before


def test_a_bench_without_instruments_gives_one_line(call):
    none = ("--no-stage", "--no-turn", "--weights-g", "", "--balance-g", "0", "--calipers-mm", "0")
    for arguments, words in ((none, "no test is possible"), (("--stage-mm", "0"), "--no-stage")):
        status, out, err = call(*arguments)
        assert status == 2 and not out and words in err and len(err.splitlines()) == 1 and not Path("data").exists()


def test_a_folder_of_others_is_not_replaced(call):
    Path("mine").mkdir()
    (Path("mine") / "thesis.txt").write_text("x")
    status, _, err = call("mine", "--force")
    assert status == 2 and "plan.json" in err and list(Path("mine").iterdir()) == [Path("mine/thesis.txt")]


@pytest.mark.parametrize("arguments", [("--minutes", "20"), ("--minutes", "nan"), ("--minutes", "-1"),
                                       ("--for", "E,densty"), ("--for", ""), ("--weights-g", "1,heavy"),
                                       ("--weights-g", "-1"), ("--stage-mm", "nan"), ("--cameras-mm", "50"),
                                       ("--held-out", "-1"), ("--balance-g", "-0.01")])  # fmt: skip
def test_a_bad_option_gives_one_line(call, arguments):
    status, out, err = call(*arguments)
    assert status == 2 and not out and len(err.splitlines()) == 1 and arguments[0] in err
    assert not Path("data").exists()


def test_a_sensor_that_the_design_does_not_name_is_listed_as_assumed(design, plan, tmp_path, bench):
    text = LARGE.read_text()
    start, end = text.index("[sensor]"), text.index("\n[", text.index("[sensor]"))
    (tmp_path / "a.toml").write_text(text[:start] + text[end:])
    named, unnamed = ({*one.assumptions} for one in (design, load_design(tmp_path / "a.toml")))
    assert unnamed - named == {"sensor.model", "sensor.calibration"}
    other = replace(bench, model=replace(bench.model, assumptions=tuple(unnamed)))
    assert any("sensor.calibration" in note for note in replace(plan, bench=other).notes)


def test_a_design_without_a_named_sensor_or_gravity_gives_one_line(call, tmp_path):
    """Noise and load limits of the sensor decide what is proposed; a default one may not bear it."""
    text = LARGE.read_text()
    start = text.index("[sensor]")
    bare, gravity = text[:start] + text[text.index("\n[", start) + 1 :], "gravity_base_m_s2 = [9.81, 0.0, 0.0]"
    assert gravity in text
    for changed, words in ((text.replace('model = "nano17"', 'model = "none"'), ""), (bare, "[sensor]"),
                           (text.replace(gravity, gravity.replace("9.81", "0.0")), "gravity")):  # fmt: skip
        Path("a.toml").write_text(changed)
        status, _, err = call(design="a.toml")
        assert status == 2 and words in err and len(err.splitlines()) == 1 and not Path("data").exists()


def test_hangs_lie_between_the_tests(plan, bench):
    """The bias walks no longer than over eight tests unseen, also in a long plan."""
    longer = make_plan(bench.model, 0.0, 160.0, ("E",), STAGE, 4)
    for one in (plan, longer):
        mounted = [test.set_up for test in one.candidates if test.test is not None]
        at = [i for i, kind in enumerate(mounted) if kind == "hang"]
        assert at[0] == 0 and at[-1] == len(mounted) - 1
        assert max(np.diff(at)) <= HANG_EVERY + 1
    assert sum(test.set_up == "hang" for test in longer.candidates) > 3
    assert longer.tests[-1].minutes <= 160.0


def test_proposed_touches_are_located(bench):
    """Each reading with noise and drift of one standard deviation is located, within the stated error."""
    rng, estimator = np.random.default_rng(3), Estimator(bench.model)
    touches = [one for one in bench.candidates() if one.set_up == "touch"]
    std = np.sqrt(np.diag(bench.model.noise_base()))
    drift = Tolerances.of(bench.model).drift_steps * math.sqrt(bench.model.averaging_samples)
    located = 0
    for one in touches:
        wrench = one.test.wrenches[0] + drift * std * rng.normal(size=6)
        located += estimator.estimate(wrench, one.test.gravity_base).ok
    assert located >= 0.98 * len(touches) and len(touches) > 30
    # the lightest touch near the tip, 5.4 mN at 138 mm, is not among them
    assert not any(one.mark > 0.9 * bench.model.rod.length and one.displacement < 10 * MM for one in touches)


def test_touches_of_an_arc_that_identify_cannot_solve_are_left_out():
    """The others determine E and the root."""
    arc = new(length_mm=150.0, base_d_mm=12.0, axis="arc", axis_bend_deg=60.0, sensor="nano17")
    found = planned(arc, 90.0, ("E", "root"), replace(STAGE, weights=(), turnable=False), 2)
    assert sum(one.set_up == "touch" for one in found.candidates) > 5
    assert all(one.std is not None for one in found.expected)


def test_calipers_and_identify_share_one_recommendation(design):
    """Where calipers determine the diameters, identify does not: note, sheet and property name the same parameters."""
    few = replace(Instruments(), stage=None, turnable=False)
    found = planned(design, 60.0, ("E", "diameters"), few, 0)
    assert found.identified == ("E",)
    assert "--for E " in checklist_text(found, "data") and any("--for E." in note for note in found.notes)
    without = planned(design, 60.0, ("E", "diameters"), replace(few, calipers=None), 0)
    assert without.identified == ("E", "diameters") and "--for E,diameters " in checklist_text(without, "data")
