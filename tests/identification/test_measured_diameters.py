"""Diameters from calipers: limits of the least squares, coverage, refusals, and the change of a design."""

from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from probedesign.cli.main import run
from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.design import Design, load_design, parse_design
from probedesign.design.edit import as_new_print, tables_of
from probedesign.design.io import render_design, write_design
from probedesign.estimation.model import Tolerances
from probedesign.frozen_probe import _model_of, freeze
from probedesign.identification.measured_print import PRINT_SCALE_STD, Calipers, covering, fit_diameters, read_calipers
from probedesign.mount import build_geometry
from probedesign.probe import build_probe

CONE = "length_mm = 150.0\nbase_d_mm = 12.0\ntip_d_mm = 2.0"
CYLINDER = 'shape = "cylinder"\nlength_mm = 80.0\nbase_d_mm = 6.0'
PROFILE = (
    'shape = "profile"\nlength_mm = 120.0\nbase_d_mm = 12.0\n'
    "profile_mm = [[0, 12], [40, 13], [60, 7], [80, 7], [120, 2]]"
)
PRIOR = Tolerances()


def design_of(probe: str = CONE, more: str = "") -> Design:
    return parse_design(f'schema = 1\nname = "p"\n[probe]\n{probe}\n{more}')


def readings(s: Array, d: Array, std: float = 0.03) -> Calipers:
    return Calipers(s, d, np.full(len(s), std), tuple(f"row {i}" for i in range(len(s))))


def test_many_exact_readings_determine_the_knots() -> None:
    s = np.linspace(1.0, 149.0, 60)
    found = fit_diameters(design_of(), PRIOR, readings(s, np.interp(s, [0, 150], [12.1, 2.04]), 1e-4), 0.0)
    assert np.allclose(found.measured, [12.1, 2.04], atol=1e-3)  # a design gets micrometres
    assert max(found.after) < 1e-3


def test_readings_of_the_drawn_size_confirm_it_and_shrink_the_tolerance() -> None:
    s = np.array([10.0, 75.0, 140.0])
    found = fit_diameters(design_of(), PRIOR, readings(s, np.interp(s, [0, 150], [12.0, 2.0])))
    assert np.allclose(found.measured, found.drawn)
    # Base and tip differ by the scale of the print as well, so the scatter of each may exceed the print's.
    assert np.hypot(*found.after) < np.hypot(*found.before) / 2


def test_poor_readings_leave_the_prior() -> None:
    s = np.array([10.0, 140.0])
    found = fit_diameters(design_of(), PRIOR, readings(s, np.interp(s, [0, 150], [12.1, 2.1]), 100.0))
    assert np.allclose(found.measured, found.drawn, atol=1e-3)
    common, scale = np.full(2, PRIOR.diameter_mm), PRINT_SCALE_STD * np.array([12.0, 2.0])
    prior = np.outer(common, common) + np.outer(scale, scale) + PRIOR.diameter_scatter_mm**2 * np.eye(2)
    assert found.after == pytest.approx(covering(prior), rel=1e-3)


def test_error_of_the_calipers_is_a_floor() -> None:
    s = np.linspace(1.0, 149.0, 300)
    found = fit_diameters(design_of(), PRIOR, readings(s, np.interp(s, [0, 150], [12.0, 2.0])), 0.02)
    # with one common error the mean cannot be better than 0.02 and the prior together
    together = PRIOR.diameter_mm**2 + PRIOR.diameter_scatter_mm**2 / 2
    floor = 1.0 / np.sqrt(1.0 / 0.02**2 + 1.0 / together)
    assert found.std.min() > 0.99 * floor


def test_scattered_readings_widen_their_uncertainty() -> None:
    s, signs = np.linspace(5.0, 145.0, 20), np.tile([0.15, -0.15], 10)
    tidy = fit_diameters(design_of(), PRIOR, readings(s, np.interp(s, [0, 150], [12.0, 2.0])))
    rough = fit_diameters(design_of(), PRIOR, readings(s, np.interp(s, [0, 150], [12.0, 2.0]) + signs))
    assert tidy.scale == 1.0 and rough.scale == pytest.approx(5.0, rel=0.1)  # 0.15 over 0.03, two knots fitted
    assert (rough.std > tidy.std).all()


def errors_of(
    probe: str, reach: float, count: int, scale_std: float = 0.0, scale: float = 0.0, wrong: float = 0.0
) -> tuple[Array, Array]:
    """Errors of the diameters of prints drawn from the priors [mm], and whether they are within 1.96 standard
    deviations, (n, K); of seven stations to a fraction of the length, two readings each, without refused sheets.

    Prints have a scale, readings a fraction that is wrong by 0.5 mm (standard deviation).
    """
    design, rng = design_of(probe), np.random.default_rng(5)
    knots, drawn = (np.array(x) for x in zip(*design.probe.blunt_mm, strict=True))
    s, cylinder = np.repeat(np.linspace(0.05, reach, 7) * design.probe.length_mm, 2), design.probe.shape == "cylinder"
    common, found = np.maximum(PRIOR.diameter_mm, PRIOR.diameter_share * drawn), []
    for _ in range(count):
        each = 0.0 if cylinder else rng.normal(size=len(knots))
        true = (1.0 + scale + scale_std * rng.normal()) * drawn + common * rng.normal()
        true = true + PRIOR.diameter_scatter_mm * each
        own = np.hypot(0.03, PRIOR.diameter_scatter_mm) if cylinder else 0.03
        y = np.interp(s, knots, true) + 0.02 * rng.normal() + own * rng.normal(size=len(s))
        y += np.where(rng.random(len(s)) < wrong, 0.5 * rng.normal(size=len(s)), 0.0)
        with suppress(InputError):
            fit = fit_diameters(design, PRIOR, readings(s, y))
            found.append((fit.measured - true, np.abs(fit.measured - true) < 1.96 * fit.std))
    errors, inside = zip(*found, strict=True)
    return np.array(errors), np.array(inside)


@pytest.mark.parametrize("probe", [CONE, CYLINDER, PROFILE])
def test_intervals_cover_true_diameters(probe: str) -> None:
    """Prints and readings drawn from the priors, and of one scale, measured along the probe or near its base alone."""
    _, inside = errors_of(probe, 0.95, 200)
    # 200 prints with correlated knots: ±0.03 is two standard deviations; a scale that only widens adds a little
    assert 0.92 < inside.mean() < 0.99
    for reach, scale in ((0.95, -0.02), (0.95, 0.02), (0.4, -0.02), (0.4, 0.0), (0.4, 0.02)):
        _, inside = errors_of(probe, reach, 100, scale=scale)
        assert len(inside) >= 97  # beyond four standard deviations: about one print in 300 is refused
        # A scale of two standard deviations is a bad draw: 90 % is wanted, less 0.04 for 100 correlated prints.
        assert inside.mean() > 0.86


@pytest.mark.parametrize("probe", [CONE, CYLINDER, PROFILE])
def test_sheets_with_outliers_are_fitted_and_the_intervals_cover(probe: str) -> None:
    """5 % of the readings are off by 0.5 mm (standard deviation)."""
    errors, inside = errors_of(probe, 0.95, 600, scale_std=PRINT_SCALE_STD, wrong=0.05)
    # Of the profile's five knots each is determined by few readings: its RMS without outliers is 26 um, of which 20 um
    # are the error that all readings share. 600 sheets determine a coverage of 95 % to ±0.9 %.
    assert 1e3 * np.sqrt(np.mean(errors**2)) < 28.5 and len(errors) >= 0.975 * 600
    assert 0.92 < inside.mean() < 0.98


def test_diameters_beyond_the_calipers_follow_the_measured_ones() -> None:
    s = np.linspace(5.0, 60.0, 6)
    found = fit_diameters(design_of(), PRIOR, readings(s, 0.985 * np.interp(s, [0, 150], [12.0, 2.0]), 0.01))
    base, tip = found.measured / found.drawn - 1.0
    assert base == pytest.approx(-0.015, abs=3e-3)
    assert abs(0.985 * 2.0 - found.measured[1]) < found.std[1] and tip < -0.01
    assert found.prior_scale == 1.0


def test_readings_that_contradict_the_prior_widen_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Knots that deviate by 0.2 mm to both sides in turn are no scale, no offset, and no scatter of 0.025 mm."""
    design = design_of(PROFILE)
    knots, drawn = (np.array(x) for x in zip(*design.probe.blunt_mm, strict=True))
    s, true = np.linspace(2.0, 118.0, 30), drawn + 0.2 * np.array([1.0, -1.0, 1.0, -1.0, 1.0])
    found = fit_diameters(design, PRIOR, readings(s, np.interp(s, knots, true)))
    assert found.scale == 1.0 and found.prior_scale > 3.0
    assert (np.abs(found.measured - true) < 1.96 * found.std).all()
    path, calipers = tmp_path / "p.toml", tmp_path / "calipers.csv"
    write_design(render_design(design), path)
    rows = zip(s, np.interp(s, knots, true), strict=True)
    calipers.write_text("s_mm,diameter_mm\n" + "".join(f"{x:.2f},{d:.4f}\n" for x, d in rows))
    assert run(["measured", str(path), str(calipers)]) == 0
    (note,) = [line for line in capsys.readouterr().out.splitlines() if "note:" in line]
    assert f"{found.prior_scale:.1f}" in note


def test_a_dropped_reading_is_named_and_the_fit_is_that_of_the_others(tmp_path: Path) -> None:
    s = np.repeat(np.linspace(10.0, 140.0, 7), 2)
    d = np.interp(s, [0, 150], [12.0, 2.0])
    wrong = d.copy()
    wrong[5] += 0.4
    path = tmp_path / "c.csv"
    rows = "".join(f"{s[i]:g},{wrong[i]:.3f},{wrong[i + 1]:.3f}\n" for i in range(0, 14, 2))
    path.write_text(f"s_mm,diameter_mm,diameter_y_mm\n{rows}")
    found = fit_diameters(design_of(), PRIOR, read_calipers(path, design_of()))
    assert len(found.dropped) == 1 and found.readings == 13 and f"c.csv:4: {wrong[5]:.3f}"[:-1] in found.dropped[0]
    assert np.allclose(found.measured, found.drawn, atol=1.1e-3)  # the sheet has micrometres, and so has a design


def test_covering_is_no_smaller_and_exact_where_it_can_be() -> None:
    a, b = covering(0.3**2 * np.ones((4, 4)) + 0.1**2 * np.eye(4))
    assert (a, b) == pytest.approx((0.3, 0.1), rel=1e-4)
    rng = np.random.default_rng(0)
    for K in (2, 3, 7):
        X = rng.normal(size=(K, K))
        a, b = covering(X @ X.T)
        gap = np.linalg.eigvalsh(a**2 * np.ones((K, K)) + b**2 * np.eye(K) - X @ X.T)
        assert gap[0] > -1e-9 * gap[-1]  # round-off


@pytest.mark.parametrize(
    ("content", "named"),
    [
        ("s_mm,diameter_mm\n75,nan\n", "nan"),
        ("s_mm,diameter_mm\n75,\n", "empty"),
        ("s_mm,diameter_inch\n75,0.27\n", "inch"),
        ("s_mm,diameter_mm,colour\n75,7.0,red\n", "colour"),
        ("s_mm,diameter_mm\n75,0.7\n", "0.7 mm"),  # written in centimetres
        ("s_mm,diameter_mm\n75,8.0\n", "8 mm"),  # of another probe
        ("s_mm,diameter_mm\n75,-7.0\n", "positive"),
        ("s_mm,diameter_mm\n151,2.0\n", "flank"),
        ("s_mm,diameter_mm,std_mm\n75,7.0,0\n", "standard deviation"),
        ("# fingerprint: 0123456789ab\ns_mm,diameter_mm\n75,7.0\n", "0123456789ab"),
        ("s_mm,diameter_mm\n", "no rows"),
        ("", "empty"),
    ],
)
def test_unusable_readings_are_refused_and_nothing_is_written(
    content: str, named: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, calipers = tmp_path / "p.toml", tmp_path / "calipers.csv"
    write_design(render_design(design_of()), path)
    before = path.read_bytes()
    calipers.write_text(content)
    assert run(["measured", str(path), str(calipers)]) == 2
    message = capsys.readouterr().err
    assert named in message and message.count("\n") == 1
    assert path.read_bytes() == before and sorted(p.name for p in tmp_path.iterdir()) == ["calipers.csv", "p.toml"]


def test_readings_on_a_rounding_or_a_fillet_are_refused(tmp_path: Path) -> None:
    design = design_of(f'{CONE}\ntip = "rounded"\nbase_fillet_mm = 2.0')
    path = tmp_path / "calipers.csv"
    for s in (0.5, 149.9):
        path.write_text(f"s_mm,diameter_mm\n{s},7.0\n")
        with pytest.raises(InputError, match="flank"):
            read_calipers(path, design)


@pytest.mark.parametrize("probe", [CONE, CYLINDER, PROFILE])
def test_measured_design_has_the_diameters_and_a_smaller_budget(probe: str, tmp_path: Path) -> None:
    design, path, calipers = design_of(probe), tmp_path / "p.toml", tmp_path / "calipers.csv"
    write_design(render_design(design), path)
    geometry = build_geometry(design)
    s = np.linspace(0.1, 0.9, 5) * design.probe.length_mm
    rows = "".join(f"{x:.2f},{2e3 * float(geometry.radius_at(x * 1e-3)) + 0.06:.4f}\n" for x in s)
    calipers.write_text(f"# fingerprint: {geometry.fingerprint}\ns_mm,diameter_mm\n{rows}")
    out = tmp_path / "measured.toml"
    assert run(["measured", str(path), str(calipers), "--out", str(out)]) == 0
    assert load_design(path) == design  # the drawn design stays
    changed = load_design(out)
    assert set(changed.probe.measured) >= {"base_d_mm"}
    before, after = build_probe(design), build_probe(changed)
    shift = 2e3 * (after.geometry.radius - before.geometry.radius)
    assert ((shift > 0.02) & (shift < 0.0605)).all()  # [mm], between the drawn size and the readings
    assert after.tolerances.diameter_mm < 0.5 * before.tolerances.diameter_mm
    touch = {"fractions": [0.8], "forces_N": [0.02], "directions": ["+y"]}
    budgets = [p.predict(**touch).conditions[0].budget_mm["diameter"] for p in (before, after)]
    assert budgets[1] < 0.5 * budgets[0]
    # the same readings again are of the former geometry, and without it they would count twice
    assert run(["measured", str(out), str(calipers)]) == 2
    calipers.write_text(f"s_mm,diameter_mm\n{rows}")
    once = out.read_bytes()
    assert run(["measured", str(out), str(calipers), "--force"]) == 2 and out.read_bytes() == once


def test_tolerances_of_the_user_are_kept_without_force(tmp_path: Path) -> None:
    path, calipers = tmp_path / "p.toml", tmp_path / "calipers.csv"
    write_design(render_design(design_of(more="[tolerances]\ndiameter_mm = 0.05\n")), path)
    before = path.read_bytes()
    calipers.write_text("s_mm,diameter_mm\n75,7.03\n")
    assert run(["measured", str(path), str(calipers)]) == 2 and path.read_bytes() == before
    assert run(["measured", str(path), str(calipers), "--force"]) == 0
    assert "diameter_mm = 0.05" in path.read_text()  # as a comment
    assert load_design(path).tolerances.diameter_mm < 0.05


def test_identified_E_keeps_the_measured_stiffness(tmp_path: Path) -> None:
    path, calipers = tmp_path / "p.toml", tmp_path / "calipers.csv"
    more = (
        '[material]\nyoungs_modulus_mpa = 2.0\n[material.provenance]\nyoungs_modulus_mpa = "identified"\n'
        "[tolerances]\nyoungs_modulus_by_diameter = -4.0\n"
    )
    write_design(render_design(design_of(more=more)), path)
    calipers.write_text("s_mm,diameter_mm\n10,11.42\n75,7.09\n")
    assert run(["measured", str(path), str(calipers)]) == 2  # E was identified
    assert run(["measured", str(path), str(calipers), "--force"]) == 0
    changed = load_design(path)
    d = changed.probe.base_d_mm
    assert d > 12.03 and changed.youngs_modulus.value * d**4 == pytest.approx(2e6 * 12.0**4, rel=1e-3)


def test_a_measured_bow_bends_rod_and_frozen_probe_and_leaves_the_error_of_measuring(tmp_path: Path) -> None:
    path = tmp_path / "p.toml"
    path.write_text(f'schema = 1\nname = "p"\n[probe]\n{CONE}\n')
    assert run(["measured", str(path), "--bow-mm", "1.5", "-0.8"]) == 0
    design = load_design(path)
    assert (design.probe.bow_mm, design.probe.measured, design.tolerances.bow_mm) == ((1.5, -0.8), ("bow_mm",), 0.2)
    probe = build_probe(design)
    loaded = _model_of(freeze(probe.model))
    for rod in (probe.rod, loaded.rod):
        # The arc's rise is κ L²/2 but for (2 w/L)²/12 of it.
        np.testing.assert_allclose(rod.solve().p_at(0.15)[:2], [1.5e-3, -0.8e-3], rtol=1e-4)
    assert loaded.tolerances is not None and loaded.tolerances.bow_mm == 0.2
    # What is printed is as drawn.
    assert probe.geometry.fingerprint == build_geometry(design_of()).fingerprint


def test_the_mass_of_a_bent_print_lies_along_its_arc() -> None:
    straight, bent = (build_probe(design_of(CONE + more)) for more in ("", "\nbow_mm = [3.0, -1.0]"))
    s = np.linspace(0.0, 0.15, 20_001)
    area = np.interp(s, [0.0, 0.15], [6e-3, 1e-3]) ** 2
    # On an arc x is κ s²/2 but for (κ s)²/12 of it, z is s but for (κ s)²/6 of it: 1e-4 with κ L = 0.042.
    # The outer side of a bend weighs more: a slice's centre is r²/(4R) away from the centreline.
    aside = (area @ (s**2 - area / 2.0)) / area.sum() / 0.15**2
    np.testing.assert_allclose(bent.p_base_com[:2], [3e-3 * aside, -1e-3 * aside], rtol=3e-4)
    assert np.isclose(bent.p_base_com[2], straight.p_base_com[2], rtol=3e-4) and bent.mass == straight.mass


def test_a_bow_that_is_measured_again_replaces_the_former_on_request_and_stays_beside_diameters(tmp_path: Path) -> None:
    path, calipers = tmp_path / "p.toml", tmp_path / "calipers.csv"
    path.write_text(f'schema = 1\nname = "p"\n[probe]\n{CONE}\n')
    calipers.write_text("s_mm,diameter_mm,std_mm\n10,11.35,\n140,2.7,\n")
    assert run(["measured", str(path), "--bow-mm", "1.5", "-0.8", "--bow-std-mm", "0.3"]) == 0
    assert run(["measured", str(path), str(calipers)]) == 0
    assert run(["measured", str(path), "--bow-mm", "1", "0"]) == 2
    assert run(["measured", str(path), "--bow-mm", "1", "0", "--force"]) == 0
    probe = load_design(path).probe
    assert probe.bow_mm == (1.0, 0.0) and probe.measured == ("bow_mm", "base_d_mm", "tip_d_mm")
    tables = as_new_print(tables_of(load_design(path)))
    assert "bow_mm" not in tables["probe"] and "bow_mm" not in tables["tolerances"]


BAD_BOWS = [
    (["--bow-mm", "nan", "0"], "smaller than the length"), (["--bow-mm", "150", "0"], "smaller than the length"),
    (["--bow-mm", "1", "0", "--bow-std-mm", "-0.1"], "--bow-std-mm -0.1"), ([], "--bow-mm X Y"),
]  # fmt: skip


@pytest.mark.parametrize(("options", "message"), BAD_BOWS)
def test_a_bow_that_is_none_is_refused_in_one_line(
    options: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "p.toml"
    path.write_text(f'schema = 1\nname = "p"\n[probe]\n{CONE}\n')
    before = path.read_bytes()
    assert run(["measured", str(path), *options]) == 2
    error = capsys.readouterr().err.strip()
    assert message in error and "\n" not in error and path.read_bytes() == before
