"""Shapes from touches drawn on the surfaces of meshes, with the truth from the meshes."""

import numpy as np
import pytest

from benchmarks.shapes import draw_touches, errors_of, object_of
from probedesign.core import statistics
from probedesign.mapping.shapes import KINDS, ShapeFit, TouchSet, missing


@pytest.mark.parametrize("kind", KINDS)
def test_twelve_touches_tell_the_kind_of_shape(kind):
    rng = np.random.default_rng(3)
    drawn = [draw_touches(object_of(kind, rng), 12, rng)[0] for _ in range(3)]
    kinds = [ShapeFit(touches).of_one(np.arange(12), rng).kind for touches in drawn]
    assert kinds.count(kind) >= 2  # a corner and a tip differ by the spread of 12 forces alone


def test_an_edge_has_no_plane_beside_it_that_nobody_touched():
    """One of twelve touches is by the tip and agrees with a face, too, but it might have been any of them."""
    rng = np.random.default_rng(0)
    touches, _ = draw_touches(object_of("edge", rng), 12, rng)
    assert [shape.kind for shape in ShapeFit(touches).shapes()] == ["edge"]


@pytest.mark.parametrize("kind", ["plane", "edge", "cylinder"])
def test_the_regions_of_a_shape_hold(kind):
    rng, inside = np.random.default_rng(4), 0
    for _ in range(12):
        touches, truth = draw_touches(object_of(kind, rng), 9, rng)
        shape = ShapeFit(touches).best_of(kind, touches, rng)
        inside += errors_of(shape, truth) <= statistics.max_chi2(len(KINDS[kind].free), 0.05)
    assert inside >= 9  # of 12 with a probability of 0.95 each, fewer happen once in 400 times


def test_two_edges_of_a_box_stay_two_edges_and_a_lone_touch_is_no_shape():
    rng = np.random.default_rng(5)
    box = object_of("edge", rng)
    touches, _ = draw_touches(box, 8, rng)
    other, _ = draw_touches(box, 9, rng)
    cov = np.zeros((17, 3, 17, 3))
    cov[:8, :, :8], cov[8:, :, 8:] = touches.cov, other.cov
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    cov[8:, :, 8:] = np.einsum("ab,ibjc,dc->iajd", turn, other.cov, turn)
    moved = other.p @ turn.T + (0.0, 0.0, 0.1)
    moved[8] += 0.08
    both = type(touches)(
        np.concatenate([touches.p, moved]), cov, np.concatenate([touches.force, other.force @ turn.T]),
        np.concatenate([touches.tangent, other.tangent @ turn.T]), np.concatenate([touches.beyond, other.beyond]),
        tuple(str(i) for i in range(1, 18)),
    )  # fmt: skip
    shapes = ShapeFit(both).shapes()
    assert [shape.kind for shape in shapes] == ["edge", "edge"]
    assert {frozenset(shape.touches) for shape in shapes} == {
        frozenset(map(str, range(1, 9))), frozenset(map(str, range(9, 17)))
    }  # fmt: skip
    assert missing(both, shapes).startswith("no shape: touch 17;")


@pytest.mark.parametrize("n", [1, 2])
def test_too_few_touches_are_no_shape(n):
    rng = np.random.default_rng(6)
    touches, _ = draw_touches(object_of("plane", rng), n, rng)
    assert ShapeFit(touches).shapes() == []
    assert "a plane 3, an edge 3" in missing(touches, [])


@pytest.mark.parametrize("sides", [(1.0, 1.0), (1.0, -1.0)])
def test_an_edge_bounds_the_plane_of_two_touches_of_the_sheet_behind_it(sides):
    rng, n, std = np.random.default_rng(7), 6, 0.3e-3
    p = np.array([(0, 0, 10), (0, 0, 30), (0, 0, 55), (0, 0, 75), (0, 20, 25), (0, 55, 60)]) * 1e-3
    c, s = np.cos(np.radians(45.0)), np.sin(np.radians(12.0))
    probe = [(c, c, 0.0), (-c, c, 0.0)] * 2  # directions of the probe at the edge, which lies along z
    tangent = np.array([*probe, *[(-s * side, np.cos(np.radians(12.0)), 0.0) for side in sides]])
    force = np.array(
        [*[(b - 2.0 * c * (a > 0.0), -c, 0.0) for a, b, _ in probe], *[(side, 0.0, 0.0) for side in sides]]
    )
    cov = np.einsum("ij,ab->iajb", np.eye(n), std**2 * np.eye(3))
    beyond = np.array([0.01] * 4 + [0.0] * 2)
    labels = tuple(str(i) for i in range(1, n + 1))
    shapes = ShapeFit(TouchSet(p + std * rng.normal(size=(n, 3)), cov, force, tangent, beyond, labels)).shapes()
    plane, edge = sorted(shapes, key=lambda shape: shape.kind, reverse=True)
    assert (edge.kind, edge.touches) == ("edge", ("1", "2", "3", "4"))
    assert (plane.kind, plane.rim) == ("plane", edge.touches)
    # Two touches of 0.3 mm, 20 and 55 mm behind the edge, leave less than 2° of tilt.
    assert np.degrees(np.arccos(abs(plane.frame[0, 2]))) < 2.0
