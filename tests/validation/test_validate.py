"""Made-up campaigns: what they hold, and what a frozen probe makes of them."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from probedesign.campaigns import read_campaign
from probedesign.cli.main import run
from probedesign.core.errors import InputError
from probedesign.design import check_design, load_design
from probedesign.estimation.estimator import Estimator
from probedesign.prediction.predict import predict_touch
from probedesign.probe import build_probe
from probedesign.reports.validation_page import estimated_contact, known_contact, validation_page
from probedesign.simulation.campaign_folder import make_campaign
from probedesign.simulation.ground_truth import CampaignPlan
from probedesign.validation.validate import coverage_of, tare_weights, validate
from tests.reports.test_pages import assert_whole

DESIGNS = Path(__file__).parents[2] / "designs"


@pytest.fixture(scope="module")
def large():
    return build_probe(load_design("large")).model


@pytest.fixture(scope="module")
def made(large, tmp_path_factory):
    """A campaign of a drawn print, seen by cameras; its folder."""
    return make_campaign(large, tmp_path_factory.mktemp("made") / "data", CampaignPlan(seed=3)).folder


@pytest.fixture(scope="module")
def found(large, made):
    return validate(Estimator(large), read_campaign(made))


@pytest.fixture(scope="module")
def exact(large, tmp_path_factory):
    """A print as designed, at the stated pose; its folder."""
    folder = tmp_path_factory.mktemp("exact") / "data"
    return make_campaign(large, folder, CampaignPlan(seed=4, exact=True, marker_noise=1e-3)).folder


def test_the_same_seed_makes_the_same_campaign(large, made, tmp_path):
    again = make_campaign(large, tmp_path / "again", CampaignPlan(seed=3)).folder
    for name in ("campaign.toml", "tests.csv", "wrenches.csv", "pixels.csv", "control_points.csv", "truth.json"):
        assert (again / name).read_bytes() == (made / name).read_bytes()
    other = make_campaign(large, tmp_path / "other", CampaignPlan("stage", 5, 2.0e6, 0.7e6)).folder
    assert (other / "wrenches.csv").read_bytes() != (made / "wrenches.csv").read_bytes()
    truth = json.loads((other / "truth.json").read_text())  # the moduli that were named
    assert truth["youngs_modulus_mpa"] == pytest.approx(2.0, rel=1e-12)
    assert truth["shear_modulus_mpa"] == pytest.approx(0.7, rel=1e-12)


def test_readings_have_the_noise_of_the_sensor(large, exact):
    """For an exact print, truth and reading differ by noise alone, with the sensor's standard deviation."""
    truth = json.loads((exact / "truth.json").read_text())["tests"]
    off = np.concatenate([t.wrenches - truth[t.name]["wrench_sensor"] for t in read_campaign(exact).tests])
    z = off / np.repeat([large.noise.force, large.noise.moment], 3)
    assert len(z) == 75
    # 450 numbers: their standard deviation errs by 1/√900 = 3 %, four of those; their mean by 1/√450, four of those.
    assert z.std() == pytest.approx(1.0, abs=0.13) and abs(z.mean()) < 0.19


def test_an_exact_print_is_off_by_the_reference_alone(large, exact):
    # The bench of an exact print has no friction.
    found = validate(Estimator(large).with_friction(0.0), read_campaign(exact), exact=True)
    free = [trial for trial in found.tests if trial.kind == "free"]
    # 14 markers, 1 mm on each axis: 42 numbers, RMS √3 mm ± 11 %, four of those; the base is at the stated pose.
    assert [t.shape_rms for t in free] == pytest.approx([math.sqrt(3.0) * 1e-3] * 2, rel=0.44)
    strong = [trial for trial in found.tests if trial.kind == "touch" and trial.force > 0.05]
    assert len(strong) >= 4 and all(trial.result == "ok" and trial.contact_error.size < 4e-3 for trial in strong)
    # Of 18 squares, six touches of three: once in a thousand campaigns the mean is lower.
    assert chi2(18).ppf(1e-3) / 18.0 < found.coverage.nees_ratio < found.coverage.nees_high


def test_rms_is_equation_6(found):
    for trial in found.tests:
        if trial.shape is None:
            assert math.isnan(trial.shape_rms) and not len(trial.markers_hat)
            continue
        squares = [(p - q) @ (p - q) for p, q in zip(trial.markers_hat, trial.markers_base, strict=True)]
        assert trial.shape_rms == pytest.approx(math.sqrt(sum(squares) / len(squares)), rel=1e-12)


def test_the_table_is_ordered_as_the_papers_and_is_complete(found, made):
    rows = found.rows()
    assert {row["test"] for row in rows} == {test.name for test in read_campaign(made).tests}
    touches = [row for row in rows if row["kind"] == "touch"]
    fractions = [row["contact_fraction"] or 2.0 for row in touches]
    assert [round(f, 2) for f in fractions] == sorted(round(f, 2) for f in fractions)
    for row in rows:
        assert tuple(row) == tuple(rows[0])
        if row["result"] != "ok":
            assert row["contact_error_mm"] is None
        else:
            assert row["shape_rms_percent"] == pytest.approx(row["shape_rms_mm"] / 1.5)  # of 150 mm
    notes = "\n".join(found.notes)
    assert all(f"{trial.test.name} ({trial.kind}): {trial.result}" in notes for trial in found.unexpected)


def test_a_wrong_modulus_shows_in_the_coverage(large, tmp_path):
    """E is a fifth lower than in the file, on a stage: no ellipsoid of noise alone includes that."""
    plan = CampaignPlan("stage", 2, youngs_modulus=0.8 * large.rod.youngs_modulus)
    folder = make_campaign(large, tmp_path / "data", plan).folder
    found = validate(Estimator(large), read_campaign(folder), exact=True)
    assert found.coverage.nees_ratio > found.coverage.nees_high or len(found.unexpected) > 4
    assert found.coverage.verdict == "too_small"
    lost = sum(trial.kind == "touch" and not trial.measured for trial in found.tests)
    assert lost == 0 or any(line.startswith(f"{lost} more touches were not located") for line in found.coverage.words)


def test_coverage_over_prints(tmp_path):
    """A dozen drawn prints of the small probe on a stage, whose reference is much better.

    Touches of one print err together: counted as 36 squares for 12 prints, their mean errs by √(2/36) = 0.24, four of
    those; of 84 touches 80 lie within, and 72 where one print of twelve misses with all its seven.
    """
    model = build_probe(load_design("small")).model
    misses = []
    for seed in range(12):
        folder = make_campaign(model, tmp_path / "data", CampaignPlan("stage", seed), force=True).folder
        found = validate(Estimator(model), read_campaign(folder))
        misses += [trial.contact_error for trial in found.tests if trial.measured]
    assert len(misses) == 84
    assert np.mean([miss.nees / 3 for miss in misses]) == pytest.approx(1.0, abs=0.96)
    assert sum(miss.within_95 for miss in misses) >= 72


def test_weights_are_located_by_the_method_that_takes_them(found):
    """A thread's load is a dead load on the centreline, of any direction."""
    weights = [trial for trial in found.tests if trial.kind == "weight"]
    located = [trial for trial in weights if trial.result == "ok"]
    # The two tares lie half an hour apart: the bias walks by a step of the resolution, and 5 and 10 mN are too light.
    # What is lighter than 10.25 standard deviations of the force, some 30 mN, has an interval and no point.
    assert sum(trial.result in ("ok", "interval_only") for trial in weights) >= 2 and located
    assert len(weights) == 4 and {trial.method for trial in weights} == {"force_moment"}
    assert all(trial.contact_error.within_95 and trial.shape_rms < 2e-3 for trial in located)
    assert not any(trial.measured for trial in weights)
    line_end = f"{len(located)} of {len(located)} weights lie within their 95 % interval"
    assert any(line.endswith(line_end) for line in found.coverage.words)


def test_coverage_of_weights_over_prints(large, tmp_path):
    """The heaviest weight of twenty drawn prints, which alone has a point: of 20 squares the mean errs by √(2/20) =
    0.32 by chance, four of those; 19 lie within, and 15 where one print in six misses."""
    misses = []
    for seed in range(20):
        folder = make_campaign(large, tmp_path / "data", CampaignPlan(seed=seed, marker_noise=1e-3), force=True).folder
        campaign = read_campaign(folder)
        loads = replace(campaign, tests=tuple(test for test in campaign.tests if test.force_world is not None))
        misses += [
            t.contact_error for t in validate(Estimator(large), loads).tests
            if t.kind == "weight" and t.force > 0.008 and t.contact_error is not None
        ]  # fmt: skip
    assert len(misses) >= 19  # one in five hundred is called inconsistent
    assert np.mean([miss.nees for miss in misses]) == pytest.approx(1.0, abs=1.28)
    assert sum(miss.within_95 for miss in misses) >= 0.77 * len(misses)


def test_predicted_errors_are_those_of_predict(found, large):
    """The prediction is that of `predict` for the same touch; there is none for weights, which have no friction."""
    for trial in found.tests:
        if trial.kind != "touch" or trial.result != "ok":  # the place of a touch that is too light is not known
            assert math.isnan(trial.predicted)
            continue
        predicted = predict_touch(Estimator(large), trial.fraction, trial.force, trial.test.direction)
        assert 1e3 * trial.predicted == pytest.approx(predicted.predicted_error_mm)
    assert sum(row["predicted_error_mm"] is not None for row in found.rows()) >= 6  # those of more than some 30 mN


def test_a_missing_push_direction_is_that_of_the_force(found, large, made):
    campaign = read_campaign(made)
    without = replace(campaign, tests=tuple(replace(test, direction="") for test in campaign.tests))
    again = {t.test.name: t for t in validate(Estimator(large), without).tests}
    assert all(again[t.test.name].push_direction == t.test.direction for t in found.tests if t.kind == "touch")
    assert {t.push_direction for t in again.values() if t.kind == "weight"} == {"+x"}  # gravity's in a horizontal mount
    assert {t.push_direction for t in again.values() if t.kind == "free"} == {""}


def test_a_weight_is_drawn_where_it_is_known_to_act(found):
    trial = next(t for t in found.tests if t.kind == "weight")
    assert np.linalg.norm(known_contact(trial) - estimated_contact(trial)) == pytest.approx(
        trial.contact_error.size, rel=1e-2
    )


def test_small_and_empty_samples_are_reported(found):
    assert found.coverage.verdict == "too_few"
    none = coverage_of([], False)
    assert none.touches == 0 and none.verdict == "not_judged" and not none.words


@pytest.mark.parametrize(("ratio", "verdict"), [(0.2, "too_few"), (0.02, "conservative"), (30.0, "too_small")])
def test_a_few_touches_are_judged_by_an_extreme_ratio_alone(found, ratio, verdict):
    """Three touches, 9 degrees of freedom: 1.8 and less has a chance of 0.6 %, 0.18 and less of one in a million."""
    three = [one for one in found.tests if one.measured][:3]
    scaled = [
        replace(one, contact_error=replace(one.contact_error, error=one.contact_error.error * math.sqrt(
            ratio * 3 / one.contact_error.nees))) for one in three
    ]  # fmt: skip
    coverage = coverage_of(scaled, False)
    assert coverage.touches == 3 and coverage.nees_ratio == pytest.approx(ratio)
    assert coverage.verdict == verdict


def test_a_hang_in_another_pose_is_tared_by_the_others(large, exact):
    """The bias of the sensor, 20 standard deviations of a reading, is in all hangs; the probe is 0.5 % heavier."""
    campaign = read_campaign(exact)
    bias = 20.0 * np.sqrt(np.diag(large.noise_base()))
    tests = [replace(one, wrenches=one.wrenches_base(large) + bias, frame="base") for one in campaign.tests]
    hang = next(one for one in tests if one.free)
    T = hang.T_world_base.copy()
    T[:3, :3] = T[:3, :3] @ [[-1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]]
    turned = replace(hang, name="turned-01", T_world_base=T)
    reading = 1.005 * Estimator(large).free(turned.gravity_base).wrench_base + bias
    turned = replace(turned, wrenches=np.tile(reading, (5, 1)))
    found = validate(Estimator(large), replace(campaign, tests=(*tests, turned)))
    one = next(one for one in found.tests if one.test.name == "turned-01")
    assert one.result == "no_contact" and one.tares > 0
    assert one not in found.unexpected


def test_a_missing_tare_is_noted(large, made):
    campaign = read_campaign(made)
    tests = tuple(replace(t, wrenches=np.zeros((0, 6))) if t.free else t for t in campaign.tests)
    found = validate(Estimator(large), replace(campaign, tests=tests))
    assert any("were not tared" in note for note in found.notes)
    assert {t.result for t in found.tests if t.kind == "free"} == {"no_reading"}
    assert all(not math.isnan(t.shape_rms) for t in found.tests if t.kind == "free")


def test_incomparable_data_are_refused(large, made):
    campaign = read_campaign(made)
    bare = tuple(replace(t, markers=None, p_contact_world=None, s_contact=math.nan) for t in campaign.tests)
    with pytest.raises(InputError, match="no test has markers, a contact or s_contact_mm"):
        validate(Estimator(large), replace(campaign, tests=bare))
    mute = tuple(replace(t, wrenches=np.zeros((0, 6))) for t in campaign.tests)
    with pytest.raises(InputError, match=r"has no wrenches\.csv"):
        validate(Estimator(large), replace(campaign, tests=mute))
    with pytest.raises(InputError, match="data are of another probe: fingerprint"):
        validate(Estimator(build_probe(load_design("small")).model), campaign)


def test_the_page_draws_every_test_and_is_self_contained(found):
    page = validation_page(found).decode()
    seen = assert_whole(page)
    assert seen.seen["svg"] == len(found.tests) + 2  # two of errors
    for trial in found.tests:
        assert f"<td>{trial.test.name}</td>" in page


def test_a_design_that_hangs_straight_down_has_a_campaign_too(tmp_path):
    design = load_design("small").model_dump(by_alias=True)
    design["mount"]["gravity_base_m_s2"] = (0.0, 0.0, 9.81)
    model = build_probe(check_design(design)).model
    folder = make_campaign(model, tmp_path / "data", CampaignPlan(seed=1, marker_noise=5e-4)).folder
    campaign = read_campaign(folder)
    np.testing.assert_allclose(campaign.T_world_base[:3, 2], [0.0, 0.0, -1.0], atol=1e-5)  # written to a µdegree
    assert all(trial.result == "ok" for trial in validate(Estimator(model), campaign).tests if trial.force > 0.05)


# commands


@pytest.fixture
def call(capsys):
    def call(*arguments) -> tuple[int, str, str]:
        status = run([str(argument) for argument in arguments])
        return (status, *capsys.readouterr())

    return call


def test_existing_campaigns_are_not_overwritten(call, tmp_path, monkeypatch):
    design = tmp_path / "small.toml"
    design.write_bytes((DESIGNS / "small.toml").read_bytes())
    assert load_design(design).name == "small"
    data = tmp_path / "data"
    assert call("campaign", design, data, "--stage")[0] == 0
    before = (data / "wrenches.csv").read_bytes()
    status, out, err = call("campaign", design, data, "--stage", "--seed", "1")
    assert (status, out) == (2, "") and "exists already; --force replaces it" in err
    assert (data / "wrenches.csv").read_bytes() == before
    assert call("campaign", design, data, "--stage", "--seed", "1", "--force")[0] == 0
    assert (data / "wrenches.csv").read_bytes() != before
    (data / "truth.json").unlink()  # then it may be somebody's own
    status, _, err = call("campaign", design, data, "--stage", "--force")
    assert status == 2 and "has no truth.json, so it is not a synthetic campaign" in err
    assert sorted(p.name for p in tmp_path.iterdir()) == ["data", "small.toml"]


@pytest.mark.parametrize(("options", "message"), [
    (["--readings", "0"], "--readings 0 must lie in 1 ... 1000"),
    (["--marker-noise-mm", "-1"], "--marker-noise-mm -1 must lie in"),
    (["--marker-noise-mm", "nan"], "--marker-noise-mm nan must lie in"),
    (["--youngs-modulus-mpa", "0"], "--youngs-modulus-mpa 0 must lie in"),
    (["--stage", "--marker-noise-mm", "1"], "--stage has no markers"),
    (["--seed", "-1"], "--seed -1 must not be negative"),
])  # fmt: skip
def test_invalid_options_are_one_line(call, tmp_path, options, message):
    design = DESIGNS / "small.toml"
    status, out, err = call("campaign", design, tmp_path / "data", *options)
    assert (status, out, err.count("\n")) == (2, "", 1) and message in err
    assert not (tmp_path / "data").exists()


def test_validate_as_json_is_one_document_and_refusals_one_line(call, made, tmp_path):
    bundle = tmp_path / "large.probe.json"
    design = DESIGNS / "large.toml"
    assert call("deploy", design, "--out", bundle)[0] == 0
    status, out, _ = call("validate", bundle, made, "--out", tmp_path / "out", "--json")
    document = json.loads(out)
    assert status == 0 and len(document["tests"]) == 15 and document["coverage"]["touches"] > 5
    assert {p.name for p in (tmp_path / "out").iterdir()} == {f"validation.{end}" for end in ("csv", "html", "json")}
    for arguments in ((bundle, tmp_path), (made / "tests.csv", made)):
        status, out, err = call("validate", *arguments)
        assert (status, out, err.count("\n")) == (2, "", 1) and "Traceback" not in err


def test_the_markers_of_a_flattened_probe_lie_on_its_surface(tmp_path):
    """A print as designed, seen all but exactly from obliquely: what is left of the shape is the sensor's noise, a
    tenth of what the surface of a round section would be off by (1.8 mm)."""
    design = load_design("large")
    probe = design.probe.model_copy(update={"section": "elliptic", "flatness": 0.5})
    model = build_probe(design.model_copy(update={"probe": probe})).model
    folder = make_campaign(model, tmp_path / "flat", CampaignPlan(seed=4, exact=True, marker_noise=1e-6)).folder
    free = [trial for trial in validate(Estimator(model), read_campaign(folder)).tests if trial.kind == "free"]
    assert free and max(trial.shape_rms for trial in free) < 0.2e-3


def test_a_walking_bias_is_interpolated_between_its_tares():
    """100,000 random walks of unit variance a second: the interpolated tare is off by the stated variance, and less
    than the mean of all tares is."""
    rng, times, at = np.random.default_rng(5), np.array([0.0, 40.0, 100.0]), 60.0
    every = np.array([0.0, 40.0, 60.0, 100.0])
    walks = np.cumsum(rng.normal(size=(100_000, 4)) * np.sqrt(np.diff(every, prepend=0.0)), axis=1)
    weights, walked = tare_weights(at, times)
    off = walks[:, 2] - walks[:, [0, 1, 3]] @ weights
    # the variance of 100,000 squares is known within half a percent
    assert np.var(off) == pytest.approx(walked, rel=0.02) and np.var(off) < np.var(
        walks[:, 2] - walks[:, [0, 1, 3]].mean(axis=1)
    )
    assert tare_weights(130.0, times)[1] == 30.0 and tare_weights(-5.0, times)[0].tolist() == [1.0, 0.0, 0.0]
    assert tare_weights(math.nan, times)[0] == pytest.approx(np.full(3, 1.0 / 3.0))
