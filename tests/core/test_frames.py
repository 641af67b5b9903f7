"""Test frames: group axioms and invariance of the power of a wrench."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from probedesign.core.frames import inverse, is_pose, pose, rotation_under_gravity, rotation_z, skew, wrench_map

EXACT = 1e-12  #: Tolerance for values of order one after a few dozen roundings in double precision.

vectors = arrays(float, 3, elements=st.floats(-1.0, 1.0))
angles = st.sampled_from([0.0, 1e-9, 1e-4, 1.0, 3.0])  # near identity on purpose


@st.composite
def poses(draw):
    axis = draw(vectors)
    norm = np.linalg.norm(axis)
    axis = axis / norm if norm > 1e-3 else np.array([0.0, 0.0, 1.0])
    return pose(Rotation.from_rotvec(axis * draw(angles)).as_matrix(), draw(vectors))


@given(poses(), poses(), poses())
def test_poses_are_a_group(T_a_b, T_b_c, T_c_d):
    assert np.allclose(T_a_b @ inverse(T_a_b), np.eye(4), atol=EXACT)
    assert np.allclose(inverse(T_a_b) @ T_a_b, np.eye(4), atol=EXACT)
    assert np.allclose(inverse(T_a_b @ T_b_c), inverse(T_b_c) @ inverse(T_a_b), atol=EXACT)
    assert np.allclose((T_a_b @ T_b_c) @ T_c_d, T_a_b @ (T_b_c @ T_c_d), atol=EXACT)
    assert is_pose(T_a_b @ T_b_c)


@given(poses(), poses())
def test_wrench_maps_follow_the_poses(T_a_b, T_b_c):
    assert np.allclose(wrench_map(T_a_b) @ wrench_map(T_b_c), wrench_map(T_a_b @ T_b_c), atol=EXACT)
    assert np.allclose(wrench_map(inverse(T_a_b)), np.linalg.inv(wrench_map(T_a_b)), atol=1e-10)


@given(poses(), vectors, vectors, vectors, vectors)
def test_power_is_the_same_in_every_frame(T_a_b, force_b, moment_b, v_b, w_b):
    """A rigid body moves with twist (v at b's origin, w); the load's power must not depend on the frame."""
    R, p = T_a_b[:3, :3], T_a_b[:3, 3]
    wrench_a = wrench_map(T_a_b) @ np.concatenate([force_b, moment_b])
    w_a = R @ w_b
    v_a = R @ v_b - np.cross(w_a, p)  # of the body's point at a's origin
    power_b = force_b @ v_b + moment_b @ w_b
    assert wrench_a @ np.concatenate([v_a, w_a]) == pytest.approx(power_b, abs=EXACT)


@given(poses(), vectors, vectors)
def test_a_force_at_a_point_maps_with_its_point(T_a_b, force_b, p_b):
    """The wrench of a force is [F; p × F] in either frame."""
    force_a, p_a = T_a_b[:3, :3] @ force_b, (T_a_b @ np.append(p_b, 1.0))[:3]
    in_frame_b = np.concatenate([force_b, np.cross(p_b, force_b)])
    in_frame_a = np.concatenate([force_a, np.cross(p_a, force_a)])
    assert np.allclose(wrench_map(T_a_b) @ in_frame_b, in_frame_a, atol=EXACT)


@given(vectors, vectors)
def test_skew_is_the_cross_product(a, b):
    assert np.allclose(skew(a) @ b, np.cross(a, b), atol=EXACT)
    assert np.array_equal(skew(a), -skew(a).T)


def test_rotation_z_turns_x_to_y():
    assert np.allclose(rotation_z(np.pi / 2) @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=EXACT)
    assert np.allclose(rotation_z(0.3), Rotation.from_rotvec([0.0, 0.0, 0.3]).as_matrix(), atol=EXACT)


@pytest.mark.parametrize("gravity", [(9.81, 0, 0), (0, 0, 9.81), (0, 0, -9.81), (3.0, -4.0, 5.0)])
def test_gravity_points_down_in_the_world(gravity):
    R = rotation_under_gravity(np.array(gravity, dtype=float))
    assert np.allclose(R @ R.T, np.eye(3), atol=EXACT) and np.linalg.det(R) > 0.0
    assert np.allclose(R @ gravity, [0.0, 0.0, -np.linalg.norm(gravity)], atol=10.0 * EXACT)


@pytest.mark.parametrize(
    "T",
    [
        np.diag([1.0, 1.0, -1.0, 1.0]),  # a reflection
        np.diag([1.001, 1.001, 1.001, 1.0]),  # a scale: millimetres for metres look like this
        np.full((4, 4), np.nan),
        np.eye(3),
        pose(p=[np.inf, 0.0, 0.0]),
        pose().T + np.eye(4, k=-1) * 0.1,
    ],
)
def test_what_is_no_pose(T):
    assert not is_pose(T)


def test_a_pose_written_with_seven_digits_is_one():
    T = pose(Rotation.from_rotvec([0.3, -1.2, 0.7]).as_matrix(), [1.0, 2.0, 3.0])
    assert is_pose(np.round(T, 7))
