"""The pose of a known object and the next touch, with truth from meshes that the fit reads at another place."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from benchmarks.shapes import TouchedObject, draw_touches, object_of
from probedesign.cli.main import run
from probedesign.core import statistics
from probedesign.core.errors import InputError
from probedesign.core.frames import pose
from probedesign.mapping.known_object import KnownObject, ObjectPose, locate_object
from probedesign.mapping.next_touch import MAX_YIELD, presses_of, suggest
from probedesign.mapping.shapes import Shape, ShapeFit
from probedesign.simulation.simulated_run import base_rotation

GRAVITY = np.array([0.0, 0.0, -9.81])
STD, STD_ANGLE = 5e-3, math.radians(5.0)


@pytest.fixture(scope="module")
def box():
    return trimesh.creation.box((0.09, 0.06, 0.04))


def draw(box, n, rng):
    """Return touches of a box whose pose deviates from the first guess by its standard deviations, and both poses."""
    prior = ObjectPose.prior(pose(p=(0.0, 0.1, 0.05)), STD, STD_ANGLE)
    truth = prior.moved(np.concatenate([STD * rng.normal(size=3), STD_ANGLE * rng.normal(size=3)]))
    p, faces = trimesh.sample.sample_surface(box, n, seed=int(rng.integers(1000)))
    normals = box.face_normals[faces] @ truth.T_world_object[:3, :3].T
    touches, _ = draw_touches(TouchedObject(box, truth.to_world(p), normals, True), n, rng)
    return touches, prior, truth


def error(truth, found):
    turn = truth.T_world_object[:3, :3] @ found.T_world_object[:3, :3].T
    axis = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    return np.concatenate([truth.T_world_object[:3, 3] - found.T_world_object[:3, 3], axis])


def test_the_pose_of_a_box_lies_in_its_region(box):
    rng, of, inside = np.random.default_rng(2), KnownObject.of(box), 0
    for _ in range(10):
        touches, prior, truth = draw(box, 10, rng)
        found = locate_object(touches, of, prior)
        e = error(truth, found)
        inside += e @ np.linalg.solve(found.cov, e) <= statistics.max_chi2(6, 0.05)
        assert found.rms[0] < 0.8 * math.sqrt(3.0) * STD  # of three axes each touch measures one
        assert not found.contradicted  # of ten, one in a hundred times
    assert inside >= 7  # of 10 with a probability of 0.95 each, fewer happen once in 1000 times


def test_a_touch_far_from_the_object_is_left_out(box):
    touches, prior, _ = draw(box, 10, np.random.default_rng(3))
    p = touches.p.copy()
    p[4] += (0.0, 0.0, 0.08)
    assert "5" in locate_object(replace(touches, p=p), KnownObject.of(box), prior).left_out


def test_touches_of_another_object_contradict_the_mesh(box):
    touches, prior, _ = draw(box, 10, np.random.default_rng(3))
    sphere = locate_object(touches, KnownObject.of(trimesh.creation.icosphere(3, 0.035)), prior)
    assert sphere.contradicted and "contradict this object" in sphere.text
    assert "contradict" not in locate_object(touches, KnownObject.of(box), prior).text


def suggestion(estimator, goal, shapes=(), known=None, **options):
    Ts = np.array([pose(base_rotation(), p) for p in ((0.0, -0.1, 0.0), (0.02, -0.12, 0.1))])
    return suggest(estimator, Ts, GRAVITY, goal, shapes, known, **options)


def test_the_next_touch_on_an_object_is_reached_by_the_tip_and_improves_the_pose(estimator, box):
    of, prior = KnownObject.of(box), ObjectPose.prior(pose(p=(0.0, 0.1, 0.05)), STD, STD_ANGLE)
    best = suggestion(estimator, "pose", known=(of, prior))
    assert best.after < best.before
    # The free probe of the model touches the stated place from the stated pose.
    T = best.Ts_world_base[0]
    presses = presses_of(estimator, base_rotation().T @ GRAVITY, best.force)
    nearest = min(np.linalg.norm(T[:3, :3] @ press.contact + T[:3, 3] - best.x) for press in presses)
    assert nearest < 1e-3
    # The base moves against the normal for the firm press.
    moved = best.Ts_world_base[2, :3, 3] - T[:3, 3]
    assert moved @ best.normal < 0.0


def test_the_force_stays_small_on_an_object_that_may_be_soft(estimator, box):
    of, prior = KnownObject.of(box), ObjectPose.prior(pose(p=(0.0, 0.1, 0.05)), STD, STD_ANGLE)
    best = suggestion(estimator, "pose", known=(of, prior), force_limit=0.1)
    assert best.force * 2.0 * estimator.priors.object_compliance <= MAX_YIELD * (1.0 + 1e-9)


@pytest.fixture(scope="module")
def edge():
    """An edge near the base, from eight touches."""
    rng = np.random.default_rng(8)
    touches, _ = draw_touches(object_of("edge", rng), 8, rng)
    return replace(ShapeFit(touches).best_of("edge", touches, rng), p=np.zeros(3))


def test_the_stiffness_is_told_best_by_the_part_of_the_probe_that_bends_least(estimator, edge):
    """The compliance is what a press moves beyond the bending of the probe, which is least near the base."""
    best = suggestion(estimator, "stiffness", [edge], force_limit=0.02, std_compliance=0.03)
    assert best.unit == "m/N" and best.before == 0.03 and best.after < 0.9 * best.before
    assert best.s < 0.7 * estimator.model.rod.length
    with pytest.raises(InputError, match="needs --one-object"):
        suggestion(estimator, "stiffness", [edge])


def test_the_extent_of_an_edge_is_sought_beyond_its_ends(estimator, edge):
    best = suggestion(estimator, "extent", [edge])
    assert not edge.extent[0, 0] <= edge.places(best.x[None])[0, 0] <= edge.extent[0, 1]


def test_the_probe_stays_above_its_lowest_point_and_beside_the_shapes_of_the_map(estimator, edge):
    before = suggestion(estimator, "shapes", [edge])
    # a place beyond the touched part is worth its probability: the touch is at an end, not 25 mm beyond it
    assert edge.extent[0, 0] - 3e-3 <= edge.places(before.x[None])[0, 0] <= edge.extent[0, 1] + 3e-3
    # a plane between base and contact, as wide as the probe is long
    middle, along = before.axis_world[7], before.axis_world[8] - before.axis_world[6]
    along /= np.linalg.norm(along)
    across = np.linalg.svd(along[None])[2][1:]
    frame = np.column_stack([*across, along])
    wall = Shape(
        "plane", middle, frame, 0.0, 1e-9 * np.eye(len(edge.cov)), 0.1 * np.array([[-1.0, 1.0]] * 2), ("w",) * 9
    )
    after = suggestion(estimator, "shapes", [edge, wall])
    height = (after.axis_world - middle) @ along
    crosses = np.abs((after.axis_world - middle) @ across.T).max(axis=1) < 0.1
    assert not (crosses & (np.sign(height) != np.sign(height[0]))).any()
    lowest = min(
        0.0, *(p[2] for p in before.axis_world[:1])
    )  # the lowest base of the run is at 0; the probe hangs level
    assert after.axis_world[:, 2].min() > lowest - 0.02


def test_what_no_touch_improves_is_one_line(estimator, edge):
    with pytest.raises(InputError, match="no shape is known yet"):
        suggestion(estimator, "shapes")
    with pytest.raises(InputError, match="no touch that the base reaches improves"):
        suggestion(estimator, "shapes", [replace(edge, p=edge.p + 5.0)])


def test_explore_locates_an_object_and_suggests(probe, house, tmp_path, capsys):
    _, folder = house
    trimesh.creation.box((63.5, 63.5, 89.0)).export(tmp_path / "object.stl")
    command = ["explore", str(probe), f"{folder}/house.mcap", "--pose", f"{folder}/poses.csv", "--tare-s", "0.5:3.5",
               "--average", "36", "--out", str(tmp_path / "out"), "--suggest", "--goal", "pose"]  # fmt: skip
    assert run(command) == 2
    assert "--goal pose needs --object" in capsys.readouterr().err
    at = ["--object", str(tmp_path / "object.stl"), "--object-at=-30,32,45"]
    assert run([*command, *at]) == 0
    assert "next touch: (" in capsys.readouterr().out
    written = json.loads((tmp_path / "out/shapes.json").read_text())
    assert np.shape(written["suggestion"]["T_world_base"]["firm"]) == (4, 4)
    assert np.shape(written["object"]["cov"]) == (6, 6)
    # A goal that nothing improves ends in one line, and the map is written nevertheless.
    out = tmp_path / "map"
    assert run([*command[:-4], str(out), "--suggest", "--goal", "stiffness"]) == 2
    streams = capsys.readouterr()
    assert "needs --one-object" in streams.err.splitlines()[-1] and "point" in streams.out
    assert "needs --one-object" in json.loads((out / "shapes.json").read_text())["no_suggestion"]
