"""The axis of a print from points of its outline: exact recovery, coverage, what is not determined, and refusals."""

from pathlib import Path

import numpy as np
import pytest

from probedesign.cli.main import run
from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.design import Design, load_design, parse_design
from probedesign.design.io import write_design
from probedesign.geometry import Axis
from probedesign.identification.measured_print import OutlinePoints, fit_axis
from probedesign.mount import build_geometry
from probedesign.probe import build_probe

CONE = "length_mm = 150.0\nbase_d_mm = 12.0\ntip_d_mm = 2.0\n"
ARC = f'{CONE}axis = "arc"\naxis_bend_deg = 90.0\naxis_azimuth_deg = -90.0\n'
HELIX = f'{CONE}axis = "helix"\naxis_bend_deg = 215.0\naxis_turns = 1.0\n'
BEFORE_MM = 1.0


def text_of(probe: str) -> str:
    return f'schema = 1\nname = "p"\n[probe]\n{probe}'


def design_of(probe: str) -> Design:
    return parse_design(text_of(probe))


def outline_of(
    design: Design, bow_mm: tuple[float, float], factor: float = 1.0, count: int = 24, std_mm: float = 0.3,
    noise: np.random.Generator | None = None,
) -> OutlinePoints:  # fmt: skip
    """Points on two sides of a print whose axis has that bow and that factor on its curvature."""
    g = build_geometry(design)
    added = 2e-3 / g.length**2 * np.array(bow_mm)
    T = Axis(g.axis.s, factor * g.axis.curvature + added).frames(s := np.linspace(0.05, 0.98, count) * g.length)
    side = np.where(np.arange(count) % 2, 0.4, 0.4 + np.pi) + 0.3 * np.arange(count)
    r = g.radius_at(s)[:, None]
    p = T[:, :3, 3] + r * (np.cos(side)[:, None] * T[:, :3, 0] + np.sin(side)[:, None] * T[:, :3, 1])
    p = 1e3 * p if noise is None else 1e3 * p + noise.normal(0.0, std_mm, p.shape)
    return OutlinePoints(p, np.full(count, std_mm), tuple(f"row {i}" for i in range(count)))


@pytest.mark.parametrize(("probe", "factor"), [(CONE, 1.0), (ARC, 1.0), (HELIX, 1.02)])
def test_exact_points_show_the_axis(probe: str, factor: float) -> None:
    design = design_of(probe)
    found = fit_axis(design, outline_of(design, (2.0, -1.2), factor, 80, 0.01), BEFORE_MM)
    np.testing.assert_allclose(found.bow_mm, (2.0, -1.2), atol=0.01)  # the section of a taper is not its normal
    assert found.rms_mm < 0.005 and found.scale == 1.0
    assert found.factor == pytest.approx(factor, abs=1e-4)
    assert (found.factor_std > 0.0) == (probe == HELIX)  # of an arc it is a bow


def test_another_bend_of_an_arc_is_a_bow() -> None:
    """4 % less of 90° over 150 mm: κ L²/2 = 4.712 mm away from the plane of bending, towards +y here."""
    design = design_of(ARC)
    found = fit_axis(design, outline_of(design, (0.0, 0.0), 0.96, 40, 0.05), BEFORE_MM)
    np.testing.assert_allclose(found.bow_mm, (0.0, 0.04 * np.pi / 2.0 * 75.0), atol=0.02)


@pytest.mark.parametrize("probe", [CONE, ARC])
def test_one_photograph_shows_the_bow_in_its_plane_only(probe: str) -> None:
    design = design_of(probe)  # the arc bends in the plane of y and z
    g = build_geometry(design)
    T, r = g.axis.frames(s := np.linspace(0.05, 0.98, 40) * g.length), g.radius_at(s)[:, None]
    p = 1e3 * (T[:, :3, 3] + np.where(np.arange(40) % 2, 1.0, -1.0)[:, None] * r * T[:, :3, 1])
    with pytest.raises(InputError, match="in one plane only"):
        fit_axis(design, OutlinePoints(p, np.full(40, 0.1), ("row",) * 40), BEFORE_MM)


@pytest.mark.slow
@pytest.mark.parametrize("probe", [ARC, HELIX])
def test_the_stated_deviation_covers_the_error(probe: str) -> None:
    """Of 24 errors, within 1.96 standard deviations in the worse direction: at least 95 %, four sigma below it 77 %."""
    design, draw, inside = design_of(probe), np.random.default_rng(5), list[Array]()
    for _ in range(12):
        bow = draw.normal(0.0, 1.0, 2)
        found = fit_axis(design, outline_of(design, (bow[0], bow[1]), noise=draw), 9.0)
        inside.append(np.abs(np.array(found.bow_mm) - bow) < 1.96 * found.bow_std_mm)
    assert np.mean(inside) > 0.77


def test_the_command_writes_the_axis_which_rod_and_tolerance_follow(tmp_path: Path) -> None:
    path, points = tmp_path / "p.toml", tmp_path / "points.csv"
    write_design(text_of(HELIX), path)
    design = load_design(path)
    p = outline_of(design, (4.0, -3.0), 0.98, 60, 0.05, np.random.default_rng(3)).p_mm
    points.write_text("x_mm,y_mm,z_mm,std_mm\n" + "".join(f"{x:.3f},{y:.3f},{z:.3f},0.05\n" for x, y, z in p))
    assert run(["measured", str(path), "--axis", str(points)]) == 0
    written = load_design(path)
    g = build_geometry(design)
    added = 2e-3 / g.length**2 * np.array([4.0, -3.0])
    true = Axis(g.axis.s, 0.98 * g.axis.curvature + added).frames([g.length])[0, :3, 3]
    tip = build_probe(written).axis.frames([g.length])[0, :3, 3]
    assert np.linalg.norm(tip - true) < 0.5e-3 < 2e-3 < np.linalg.norm(g.axis.frames([g.length])[0, :3, 3] - true)
    assert written.tolerances.bow_mm is not None and written.tolerances.bow_mm < 0.5
    assert written.probe.axis_bend_deg == pytest.approx(0.98 * 215.0, rel=5e-3)


@pytest.mark.parametrize(("change", "why"), [
    (lambda o: OutlinePoints(o.p_mm[:3], o.std_mm[:3], o.places), "row 0: 3 points .* at least 4"),
    (lambda o: OutlinePoints(25.4 * o.p_mm, o.std_mm, o.places),
     "row .* mm from the surface of the design; check the unit"),
    (lambda o: OutlinePoints(o.p_mm + np.outer(np.arange(24) == 5, [9, 4, 4]), o.std_mm, o.places),
     "row 5: .* other points"),
    (lambda o: OutlinePoints(o.p_mm[:5], 3.0 * o.std_mm[:5], o.places),
     "determine the bow to ± .* already; measure more"),
])  # fmt: skip
def test_points_that_do_not_show_this_axis_are_refused(change, why: str) -> None:  # type: ignore[no-untyped-def]
    design = design_of(ARC)
    with pytest.raises(InputError, match=why):
        fit_axis(design, change(outline_of(design, (0.0, 0.0))), BEFORE_MM)
