"""Tests of the map: common errors are counted once, vague touches remain separate."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from probedesign.estimation.fusion_state import HALF_NORMAL
from probedesign.mapping.contact_map import build_map, map_document, map_lines, touch_numbers
from probedesign.mapping.explore import joint_map
from probedesign.mapping.touch_point import NEVER_SETTLED, RESULT_MEANINGS, ConditionalPoint, LocatedTouch
from tests.mapping.synthetic_touches import BY_STIFFNESS, STD_E, conditional_point, touch


def test_errors_of_the_base_do_not_average_out():
    """Over a hundred touches of one point independent errors shrink by ten, those of base and stiffness not at all."""
    contact_map = build_map([touch(i, (0, 0, 0), 0.2e-3) for i in range(100)], STD_E)
    (point,) = contact_map.points
    common = np.diag([0.05e-3**2, 0.05e-3**2 + (0.01 * 0.05) ** 2, 0.05e-3**2])
    assert point.cov_world == pytest.approx(common + (0.02e-3) ** 2 * np.eye(3), rel=1e-9, abs=1e-20)
    assert len(point.touches) == 100


def test_one_point_with_two_lever_arms_makes_the_stiffness_observable():
    """The errors are proportional to the lever arm, so their difference is: 0.5 mm for 1 % of stiffness."""
    off = 0.01
    first, second = touch(1, -off * BY_STIFFNESS, 1e-6), touch(2, -2.0 * off * BY_STIFFNESS, 1e-6, lever=2.0)
    contact_map = build_map([first, second], STD_E)
    (point,) = contact_map.points
    # (1e-6)²·2 over (0.05)² of the difference leaves 3e-5 of the stiffness; the base's offset stays as it is.
    assert np.log(contact_map.stiffness) == pytest.approx(off, abs=1e-4)
    assert contact_map.std_stiffness < 1e-4
    assert point.p_world == pytest.approx(np.zeros(3), abs=2e-5)


def test_the_error_sources_of_two_probes_are_their_own():
    """A point far from a second probe's keeps its uncertainty, and one that both touch has that of a mean."""
    alone = build_map([touch(1, (0, 0, 0), 0.02e-3)], STD_E).points[0].cov_world
    runs = {name: SimpleNamespace(touches=[touch(1, (x, 0, 0), 0.02e-3)], min_separation=5e-3,
                                  priors=SimpleNamespace(youngs_modulus=STD_E, object_compliance=0.0))
            for name, x in (("left", 0.0), ("right", 0.0))}  # fmt: skip
    (both,) = joint_map(runs).points
    assert both.cov_world == pytest.approx(0.5 * alone, rel=1e-9, abs=1e-20)
    assert touch_numbers(both) == "left 1, right 1"
    runs["right"].touches[:] = [touch(1, (0.1, 0, 0), 0.02e-3)]
    apart = joint_map(runs)
    assert [touch_numbers(point) for point in apart.points] == ["left 1", "right 1"]
    assert apart.points[0].cov_world == pytest.approx(alone, rel=1e-9, abs=1e-20)
    runs["left"].touches += [touch(4, (0.0, 0.0, 0.0), 0.02e-3), touch(2, (0.1, 0.0, 0.0), 0.02e-3)]
    runs["right"].touches[:] = [touch(3, (0.0, 0.0, 0.0), 0.02e-3), touch(1, (0.1, 0.0, 0.0), 0.02e-3)]
    assert [touch_numbers(point) for point in joint_map(runs).points] == [
        "left 1, right 3, left 4", "right 1, left 2"]  # in order of time  # fmt: skip
    runs["right"].touches[:] = [LocatedTouch(SimpleNamespace(number=1, start=2.0), NEVER_SETTLED)]
    assert "touch right 1 at 2.00 s" in " ".join(map_lines(joint_map(runs)))
    assert map_document(apart)["stiffness_factor"] is None  # each has its own


def test_touches_are_compared_by_their_independent_errors():
    """Common errors, although far larger, neither separate two touches of one point nor join two points."""
    same = [touch(1, (0, 0, 0), 0.1e-3), touch(2, (0.15e-3, 0, 0), 0.1e-3)]
    separate = [touch(1, (0, 0, 0), 0.01e-3), touch(2, (0.15e-3, 0, 0), 0.01e-3)]
    assert len(build_map(same, STD_E).points) == 1
    assert len(build_map(separate, STD_E).points) == 2  # 10 of their standard deviations apart, of the base's only two


def test_vague_touches_are_not_fused():
    """Two touches with errors of 5 mm agree with each other, and with many other points."""
    vague = [touch(1, (0, 0, 0), 5e-3), touch(2, (1e-3, 0, 0), 5e-3)]
    assert len(build_map(vague, STD_E).points) == 2
    accurate = [touch(1, (0, 0, 0), 0.5e-3), touch(2, (1e-3, 0, 0), 0.5e-3)]
    assert (
        len(build_map(accurate, STD_E).points) == 1 and len(build_map(accurate, STD_E, min_separation=0.0).points) == 2
    )


def test_the_order_of_touches_does_not_matter():
    rng = np.random.default_rng(3)
    p = rng.normal(0.0, 0.3e-3, (9, 3)) + np.outer(np.arange(9) % 3, (0.01, 0.0, 0.0))
    touches = [touch(i, p[i], 0.3e-3, 1 + i % 2) for i in range(9)]
    maps = [build_map(order, STD_E) for order in (touches, touches[::-1])]
    places = [np.array(sorted(point.p_world.tolist() for point in contact_map.points)) for contact_map in maps]
    assert places[0].shape == (3, 3)
    assert places[0] == pytest.approx(places[1], abs=1e-12)


def test_touches_that_were_not_located_are_listed_by_result():
    lost = [LocatedTouch(SimpleNamespace(number=n, start=float(n)), NEVER_SETTLED) for n in (2, 5)]
    (line,) = map_lines(build_map(lost, STD_E))
    assert "touch 2 at 2.00 s, 5 at 5.00 s: never_settled" in line and RESULT_MEANINGS[NEVER_SETTLED] in line


@pytest.mark.parametrize(("n_located", "n_warnings"), [(2, 1), (4, 0)])
def test_more_inconsistent_touches_than_located_ones_give_a_warning(n_located, n_warnings):
    lost = [LocatedTouch(SimpleNamespace(number=n, start=float(n)), "inconsistent") for n in (10, 11, 12)]
    located = [touch(n, (0.05 * n, 0.0, 0.0), 1e-3) for n in range(n_located)]
    warnings = map_document(build_map([*located, *lost], STD_E))["doubts"]
    assert len(warnings) == n_warnings and all(line.startswith("3 touches") for line in warnings)


def test_probes_of_one_object_share_its_compliance():
    """Two probes with information 3 on it each leave a variance of 1/(1 + 3 + 3), and their mean value of it."""
    points = []
    for number, value in enumerate((0.4, 0.6)):
        point = conditional_point((0.1 * number, 0.0, 0.0), 1e-3)
        B = np.column_stack([point.sensitivity, [0.0, 1e-3, 0.0]])
        information, vector = np.zeros((5, 5)), np.zeros(5)
        information[4, 4], vector[4] = 3.0, 3.0 * value
        one = ConditionalPoint(point.mean, B, point.cov, information, vector, (*point.names, "object"))
        points.append(replace(touch(number + 1, (0, 0, 0), 1e-3), point=one))
    explorations = {
        name: SimpleNamespace(touches=[each], priors=SimpleNamespace(youngs_modulus=STD_E, object_compliance=0.05),
                              min_separation=5e-3)
        for name, each in zip(("left", "right"), points, strict=True)
    }  # fmt: skip
    both = joint_map(explorations)
    mean, std = 0.05 * np.array(HALF_NORMAL)
    assert both.object_compliance == pytest.approx(mean + std * 3.0 / 7.0, rel=1e-9)
    assert both.std_object_compliance == pytest.approx(std / np.sqrt(7.0), rel=1e-9)
    assert len(both.common) == 2 * len(conditional_point((0, 0, 0), 1e-3).names) + 1
