"""Mistakes in a data folder that may explain a contradiction: each is undone by a change of the tests.

Mistakes of columns are undone in the frame of wrenches.csv, where they were made: a sign of Fy at the sensor is one of
Fy and Mx about the base.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations, pairwise
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from probedesign.core.csv_tables import Frame
from probedesign.core.frames import Array
from probedesign.identification.parameters import CHANNELS, CommonParameters
from probedesign.identification.residuals import MeasuredTest

MIN_TURN_DEG = 5.0
"""Angle between gravity as read and as stated from which on a free test may hang in another pose: poses are known far
better (assumed)."""
WEIGHT_SHARE = 0.2
"""Relative difference of a reading from the weight of the free probe up to which it may be that weight in another pose
(assumed: masses, gains and drifts are known better)."""

Change = Callable[[MeasuredTest], MeasuredTest]


class Mistake(NamedTuple):
    """A mistake in the data folder."""

    name: str  #: sign, unit, frame, mount, camera, marker, exchange or pose.
    words: str  #: what is likely wrong, and what to check.
    change: Change  #: undoes it in a test.
    choices: int = 1  #: number of mistakes of this kind among which it was selected.


def mistakes(
    common: CommonParameters, tests: Sequence[MeasuredTest], pairs: Sequence[tuple[str, str]] = ()
) -> Iterator[Mistake]:
    """Yield mistakes that these tests may contain.

    Args:
        common: the parameters of the campaign, with the frame of wrenches.csv.
        tests: of the campaign.
        pairs: names of tests whose readings may be exchanged.
    """
    if any(test.wrench_base is not None for test in tests):
        yield from _of_wrenches(common)
        of = {test.name: test for test in tests}
        for a, b in pairs:
            words = f"exchange: the readings of {a} and {b}; check wrenches.csv, or their places in tests.csv"
            other = {a: of[b], b: of[a]}
            yield Mistake(
                "exchange", words, partial(_with_readings_of, common, other), len(tests) * (len(tests) - 1) // 2
            )
        yield from _of_poses(common, tests)
    for degrees in (90.0, 180.0, 270.0):
        words = f"mount: base rotated by {degrees:g} degrees about its axis; check rotation_world_deg"
        yield Mistake("mount", words, partial(_rotated_base, common, degrees=degrees))
    words = "mount: inverse rotation of the base; check rotation_world_deg"
    yield Mistake("mount", words, partial(_inverse_base, common))
    if any(np.any(test.force_world) for test in tests if test.force_world is not None):
        words = "sign: known forces with the opposite sign; check tests.csv"
        yield Mistake("sign", words, partial(_known, factor=-1.0))
        yield Mistake("unit", "unit: known forces in mN; check tests.csv", partial(_known, factor=1e-3))
    if any(len(test.marker_s) or test.p_touch_world is not None for test in tests):
        yield from _of_reference(tests)


def _of_wrenches(common: CommonParameters) -> Iterator[Mistake]:
    for which, size in _signs().items():
        words = f"sign: {which} with the opposite sign; check the columns of wrenches.csv"
        yield Mistake("sign", words, partial(_scaled, common, factors=size))
    for which, size in _units().items():
        words = f"unit: {which}; check the columns of wrenches.csv"
        yield Mistake("unit", words, partial(_scaled, common, factors=size))
    for degrees in (90.0, 180.0, 270.0):
        words = f"mount: wrenches rotated by {degrees:g} degrees about z; check frame and clocking of the sensor"
        yield Mistake("mount", words, partial(_rotated_wrench, common, degrees=degrees))
    actual: Frame = "base" if common.frame == "sensor" else "sensor"
    words = f"frame: wrenches.csv states '# frame: {common.frame}', but its values are those of '# frame: {actual}'"
    yield Mistake("frame", words, partial(_in_frame, replace(common, frame=actual), common))


def _of_poses(common: CommonParameters, tests: Sequence[MeasuredTest]) -> Iterator[Mistake]:
    """Yield free tests whose reading is the weight of the probe in another pose of the base."""
    free = [test for test in tests if test.free and test.wrench_base is not None]
    for test in free:
        gravity = gravity_read(common, test)
        if gravity is not None:
            change = partial(_turned, common, gravity={test.name: gravity})
            yield Mistake("pose", f"pose: {pose_words(test)}", change, len(free))


def pose_words(test: MeasuredTest) -> str:
    """Return what to do about a free test that hung in another pose."""
    return (
        f"{test.name} hung in another orientation than its pose states; write the six columns "
        "base_x_world_mm ... base_rz_world_deg of this test in tests.csv"
    )


def gravity_read(common: CommonParameters, test: MeasuredTest) -> Array | None:
    """Return the gravity in base axes by which a free test's reading is the weight of probe and flange [m/s²], (3,);
    None if it is not such a weight, or as the pose states."""
    stated, model, wrench = test.gravity_base, common.model, test.wrench_base
    size = float(np.linalg.norm(stated))
    if size == 0.0 or wrench is None:
        return None
    R = model.T_sensor_base[:3, :3]
    force = R.T @ model.to_sensor(wrench, stated)[:3]  # with the weight between base and sensor
    free = model.rod.solve(stated)
    if not free.ok:
        return None
    weight = R.T @ model.to_sensor(free.wrench_base, stated)[:3]
    read, known = float(np.linalg.norm(force)), float(np.linalg.norm(weight))
    cosine = float(force @ weight) / max(read * known, 1e-300)
    if abs(read / known - 1.0) > WEIGHT_SHARE or cosine > np.cos(np.radians(MIN_TURN_DEG)):
        return None
    return np.asarray(size * force / read)


def _of_reference(tests: Sequence[MeasuredTest]) -> Iterator[Mistake]:
    for factor, which in ((1e3, "small"), (1e-3, "large")):
        words = f"unit: places of the reference a thousand times too {which}; check the columns in mm"
        yield Mistake("unit", words, partial(_resized, factor=factor))
    for axis in range(3):
        words = f"camera: {'xyz'[axis]} mirrored; check which camera is which, and the control points"
        matrix = np.diag(np.where(np.arange(3) == axis, -1.0, 1.0))
        yield Mistake("camera", words, partial(_placed, matrix=matrix))
    for i, j in combinations(range(3), 2):
        words = f"camera: {'xyz'[i]} and {'xyz'[j]} exchanged; check the control points"
        yield Mistake("camera", words, partial(_placed, matrix=np.eye(3)[_swapped(3, i, j)]))
    numbers = sorted({number for test in tests for number in test.marker_numbers})
    for i, j in pairwise(numbers):
        words = f"marker: {i} and {j} exchanged; check their numbers"
        yield Mistake("marker", words, partial(_renamed, names={i: j, j: i}))
    if len(numbers) > 2:
        backwards = dict(zip(numbers, numbers[::-1], strict=True))
        words = "marker: numbered from the tip; check their numbers"
        yield Mistake("marker", words, partial(_renamed, names=backwards))
        for shift, which in ((1, "low"), (-1, "high")):
            words = f"marker: all numbers too {which} by 1; check s_mm"
            yield Mistake("marker", words, partial(_shifted, shift=shift))


def _signs() -> dict[str, Array]:
    both = np.repeat([-1.0, 1.0], 3)
    signs = {"all wrenches": -np.ones(6), "forces": both, "moments": -both}
    return signs | {name: 1.0 - 2.0 * np.eye(6)[i] for i, name in enumerate(CHANNELS)}


def _units() -> dict[str, Array]:
    units = {}
    for which, one in (("forces", np.repeat([1.0, 0.0], 3)), ("moments", np.repeat([0.0, 1.0], 3))):
        units[f"{which} a thousand times too large"] = 10.0 ** (-3.0 * one)
        units[f"{which} a thousand times too small"] = 10.0 ** (3.0 * one)
    units["moments ten times too small"] = np.repeat([1.0, 10.0], 3)
    units["moments ten times too large"] = np.repeat([1.0, 0.1], 3)
    return units


def columns(common: CommonParameters, test: MeasuredTest) -> Array:
    """Return the wrench of a test in the frame of wrenches.csv [N, N·m], (6,)."""
    assert test.wrench_base is not None
    if common.frame == "base":
        return test.wrench_base
    return common.model.to_sensor(test.wrench_base, test.gravity_base)


def _with_columns(common: CommonParameters, test: MeasuredTest, values: Array) -> MeasuredTest:
    """Return the test with other values in the frame of wrenches.csv."""
    wrench = values if common.frame == "base" else common.model.to_base(values, test.gravity_base)
    return replace(test, wrench_base=wrench)


def _scaled(common: CommonParameters, test: MeasuredTest, factors: Array) -> MeasuredTest:
    if test.wrench_base is None:
        return test
    return _with_columns(common, test, factors * columns(common, test))


def _rotated_wrench(common: CommonParameters, test: MeasuredTest, degrees: float) -> MeasuredTest:
    if test.wrench_base is None:
        return test
    R = Rotation.from_rotvec([0.0, 0.0, np.radians(degrees)])
    return _with_columns(common, test, R.apply(columns(common, test).reshape(2, 3)).ravel())


def _in_frame(actual: CommonParameters, stated: CommonParameters, test: MeasuredTest) -> MeasuredTest:
    """Return the test with its values taken in another frame than stated."""
    return test if test.wrench_base is None else _with_columns(actual, test, columns(stated, test))


def _with_readings_of(common: CommonParameters, others: Mapping[str, MeasuredTest], test: MeasuredTest) -> MeasuredTest:
    """Return the test with the readings of another one."""
    other = others.get(test.name)
    if other is None:
        return test
    return replace(_with_columns(common, test, columns(common, other)), cov_wrench=other.cov_wrench)


def exchanged(common: CommonParameters, a: MeasuredTest, b: MeasuredTest) -> tuple[MeasuredTest, MeasuredTest]:
    """Return two tests with their readings exchanged."""
    others = {a.name: b, b.name: a}
    return _with_readings_of(common, others, a), _with_readings_of(common, others, b)


def _posed(common: CommonParameters, test: MeasuredTest, T_world_base: Array) -> MeasuredTest:
    """Return the test in another pose of the base, with the readings that wrenches.csv has."""
    posed = replace(test, T_world_base=T_world_base)
    if test.wrench_base is None or common.frame == "base":
        return posed
    return _with_columns(common, posed, columns(common, test))


def _turned(common: CommonParameters, test: MeasuredTest, gravity: Mapping[str, Array]) -> MeasuredTest:
    """Return the test in the pose in which gravity in base axes is that of its name, by the smallest rotation."""
    if test.name not in gravity:
        return test
    size = float(np.linalg.norm(test.gravity_base))
    stated, read = test.gravity_base / size, gravity[test.name] / size
    axis = np.cross(stated, read)
    sine, cosine = float(np.linalg.norm(axis)), float(stated @ read)
    if sine < 1e-9:  # opposite: about any axis across
        axis = np.cross(stated, np.eye(3)[int(np.argmin(np.abs(stated)))])
    axis = axis / np.linalg.norm(axis)
    turn = Rotation.from_rotvec(axis * np.arctan2(sine, cosine)).as_matrix()  # takes `stated` to `read`
    T = test.T_world_base.copy()
    T[:3, :3] = T[:3, :3] @ turn.T
    return _posed(common, test, T)


def _rotated_base(common: CommonParameters, test: MeasuredTest, degrees: float) -> MeasuredTest:
    T = test.T_world_base.copy()
    T[:3, :3] = T[:3, :3] @ Rotation.from_rotvec([0.0, 0.0, np.radians(degrees)]).as_matrix()
    return _posed(common, test, T)


def _inverse_base(common: CommonParameters, test: MeasuredTest) -> MeasuredTest:
    T = test.T_world_base.copy()
    T[:3, :3] = T[:3, :3].T
    return _posed(common, test, T)


def _known(test: MeasuredTest, factor: float) -> MeasuredTest:
    return test if test.force_world is None else replace(test, force_world=factor * test.force_world)


def _placed(test: MeasuredTest, matrix: Array) -> MeasuredTest:
    """Return the test with its places mapped about the base."""
    origin = test.T_world_base[:3, 3]
    touch = test.p_touch_world
    return replace(
        test,
        p_markers_world=origin + (test.p_markers_world - origin) @ matrix.T,
        p_touch_world=None if touch is None else origin + matrix @ (touch - origin),
    )


def _resized(test: MeasuredTest, factor: float) -> MeasuredTest:
    touch = test.p_touch_world
    return replace(
        test, p_markers_world=factor * test.p_markers_world, p_touch_world=None if touch is None else factor * touch
    )


def _swapped(n: int, i: int, j: int) -> list[int]:
    order = list(range(n))
    order[i], order[j] = j, i
    return order


def _renamed(test: MeasuredTest, names: dict[int, int]) -> MeasuredTest:
    """Return the test with markers that are measured under other numbers."""
    where = {number: i for i, number in enumerate(test.marker_numbers)}
    order = [where.get(names.get(number, number), i) for i, number in enumerate(test.marker_numbers)]
    return replace(test, p_markers_world=test.p_markers_world[order], cov_markers=test.cov_markers[order])


def _shifted(test: MeasuredTest, shift: int) -> MeasuredTest:
    """Return the test with the arclength of each marker that of its neighbour; that of the last one is extrapolated."""
    s = test.marker_s
    if len(s) < 2:
        return test
    end = 2.0 * s[-1] - s[-2] if shift > 0 else max(2.0 * s[0] - s[1], 0.0)
    return replace(test, marker_s=np.append(s[1:], end) if shift > 0 else np.append(end, s[:-1]))
