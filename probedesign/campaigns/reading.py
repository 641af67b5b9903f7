"""Reading a campaign: the tables of its folder, each checked against the others, and its markers located."""

import difflib
import itertools
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from probedesign.campaigns.campaign import (
    MARKERS,
    PUSH_DIRECTIONS,
    TESTS,
    WRENCHES,
    Campaign,
    Markers,
    Test,
    Use,
    Weighing,
)
from probedesign.campaigns.checks import check_marker_order
from probedesign.campaigns.manifest import FILE as MANIFEST
from probedesign.campaigns.manifest import CamerasTable, Manifest, read_manifest
from probedesign.core.csv_tables import WRENCH, WRENCH_ALIASES, WRENCH_KINDS, Frame, TableRows, TableSchema, read_rows
from probedesign.core.errors import InputError, quoted
from probedesign.core.frames import Array, pose
from probedesign.core.units import GRAM, MM
from probedesign.vision.calibrate import calibrate, locate
from probedesign.vision.camera import Camera
from probedesign.vision.camera_files import read_camera_files
from probedesign.vision.triangulate import MIN_STD_PX, triangulate

CONTROL_POINTS = "control_points.csv"
POSITION, PIXEL = ("x_world", "y_world", "z_world"), ("u", "v")
LENGTH = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
CONTROL_POINTS_SCHEMA = TableSchema(
    "table of control points",
    {"point": "name", **dict.fromkeys(POSITION, "length"), "camera": "name", **dict.fromkeys(PIXEL, "pixel")},
    ("point", *POSITION, "camera", *PIXEL),
    "point,x_world_mm,y_world_mm,z_world_mm,camera,u_px,v_px",
    {},
)
#: Name, control points [m], pixels and labels of one camera in; the camera out.
Fit = Callable[[str, Array, Array, Sequence[str]], Camera]

FORCE = ("force_x_world", "force_y_world", "force_z_world")
CONTACT = ("contact_x_world", "contact_y_world", "contact_z_world")
BASE_POSITION = ("base_x_world", "base_y_world", "base_z_world")
BASE_ROTATION = ("base_rx_world", "base_ry_world", "base_rz_world")
TESTS_SCHEMA = TableSchema(
    "table of tests",
    {"test": "name", **dict.fromkeys(FORCE, "force"), "s_contact": "length", "std_s": "length",
     **dict.fromkeys(CONTACT, "length"), "std_contact": "length", "direction": "word", "tip_sag": "length",
     "std_sag": "length", **dict.fromkeys(BASE_POSITION, "length"), **dict.fromkeys(BASE_ROTATION, "angle"),
     "use": "word"},
    ("test",),
    "test,force_x_world_N,force_y_world_N,force_z_world_N,s_contact_mm,std_s_mm,contact_x_world_mm,"
    "contact_y_world_mm,contact_z_world_mm,std_contact_mm,direction,tip_sag_mm,std_sag_mm,base_x_world_mm,"
    "base_y_world_mm,base_z_world_mm,base_rx_world_deg,base_ry_world_deg,base_rz_world_deg,use",
    {},
)  # fmt: skip
WRENCHES_SCHEMA = TableSchema(
    "table of wrenches",
    {"test": "name", "time": "time", **WRENCH_KINDS},
    ("test", *WRENCH),
    "test,time_s,Fx_N,Fy_N,Fz_N,Mx_Nm,My_Nm,Mz_Nm",
    {"t": "time", "timestamp": "time", **WRENCH_ALIASES},
)
MARKERS_SCHEMA = TableSchema(
    "table of markers",
    {"test": "name", "marker": "number", **dict.fromkeys(POSITION, "length"), "std": "length"},
    ("test", "marker", *POSITION),
    "test,marker,x_world_mm,y_world_mm,z_world_mm,std_mm",
    {},
)
USES: dict[str, Use] = {"": "", "identify": "identify", "validate": "validate"}
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}", re.ASCII)
PIXELS, IMAGES = "pixels.csv", "images"
PIXELS_SCHEMA = TableSchema(
    "table of pixels",
    {"test": "name", "camera": "name", "marker": "number", **dict.fromkeys(PIXEL, "pixel"), "std": "pixel"},
    ("test", "camera", "marker", *PIXEL),
    "test,camera,marker,u_px,v_px,std_px",
    {},
)


def read_campaign(path: str | Path) -> Campaign:
    """Read the data folder of a campaign; see docs/measurements.md.

    Args:
        path: of the folder.

    Raises:
        InputError: something is missing or wrong; one line that names file, line and remedy.
    """
    folder = Path(path)
    manifest = read_manifest(folder)
    tests = read_tests(folder, manifest)
    names = {test.name: i for i, test in enumerate(tests)}
    wrenches, times, frame, assumptions = read_wrench_table(folder, names)
    markers, notes = _markers(folder, manifest, names)
    marker_s, side = np.zeros(0), None
    if manifest.markers is not None:
        marker_s, side = np.array(manifest.markers.s_mm) * MM, manifest.markers.side_deg
    marker_side = None if side is None else float(np.radians(side))
    std_base = manifest.base.std_mm * MM
    for test, seen in zip(tests, markers, strict=True):
        if seen is not None:
            where = f"{folder / seen.file}: test {test.name}"
            check_marker_order(where, seen, marker_s, marker_side, test.T_world_base[:3, 3], std_base)
    table = manifest.weighing
    return Campaign(
        name=manifest.probe,
        fingerprint=manifest.fingerprint,
        T_world_base=base_pose(manifest),
        std_base=std_base,
        std_tilt=float(np.radians(manifest.base.std_deg)),
        gravity_world=np.array(manifest.gravity.world_m_s2),
        marker_s=marker_s,
        marker_side=marker_side,
        tests=tuple(
            replace(test, wrenches=readings, time=time, frame=frame, markers=seen)
            for test, readings, time, seen in zip(tests, wrenches, times, markers, strict=True)
        ),
        weighing=None if table is None else Weighing(GRAM * table.mass_g, GRAM * table.std_g, table.of),
        folder=folder,
        notes=(*notes, *assumptions),
    )


def _markers(folder: Path, manifest: Manifest, tests: dict[str, int]) -> tuple[list[Markers | None], tuple[str, ...]]:
    measured = read_markers(folder, manifest, tests)
    located, notes = read_pixels(folder, manifest, tests)
    for name, test in tests.items():
        if measured[test] is not None and located[test] is not None:
            raise InputError(f"{folder}: test {name} has markers in {MARKERS} and in {PIXELS}; keep one of them")
    return [a or b for a, b in zip(measured, located, strict=True)], notes


# tables


def read_tests(folder: Path, manifest: Manifest) -> list[Test]:
    """Read `tests.csv`; wrenches and markers are in other tables.

    Raises:
        InputError: it is missing or invalid; one line.
    """
    rows = read_rows(folder / TESTS, TESTS_SCHEMA)
    names = rows.texts("test")
    for row, name in enumerate(names):
        if not NAME.fullmatch(name):
            rows.fail(row, f"test {name[:40]!r} is not a valid name; use letters, digits, - and _, at most 64")
    rows.check_unique([(name,) for name in names], lambda row: f"test {names[row]}")
    force, loaded = rows.all_or_none(*FORCE)
    contact, seen = rows.all_or_none(*CONTACT)
    moved, has_pose = rows.all_or_none(*BASE_POSITION, *BASE_ROTATION)
    s, sag = rows.numbers("s_contact", "tip_sag").T
    std_s = _std(rows, ~np.isnan(s), "s_contact", "std_s")
    std_contact = _std(rows, seen, "contact_x_world", "std_contact")
    std_sag = _std(rows, ~np.isnan(sag), "tip_sag", "std_sag")
    directions, uses = rows.texts("direction"), rows.texts("use")
    for row in np.flatnonzero(s < 0.0)[:1]:
        rows.fail(int(row), f"{rows.columns['s_contact'].name} is negative; s counts from the base")
    for i, direction in enumerate(directions):
        if direction and direction not in PUSH_DIRECTIONS:
            allowed = ", ".join(PUSH_DIRECTIONS)
            rows.fail(i, f"direction = {quoted(direction)} is none of {allowed} of the base; write one, or leave "
                         "it empty")  # fmt: skip
        if uses[i] not in USES:
            rows.fail(i, f"use = {quoted(uses[i])} is none of identify, validate; write one, or leave it empty "
                         "for both")  # fmt: skip
        if loaded[i] and not force[i].any() and (not np.isnan(s[i]) or seen[i]):
            rows.fail(i, f"{names[i]}: has a contact and force 0,0,0, which is a free probe; leave the force empty")
    gravity, usual = np.array(manifest.gravity.world_m_s2), base_pose(manifest)
    poses = [pose(Rotation.from_rotvec(v[3:]).as_matrix(), v[:3]) if is_given else usual
             for v, is_given in zip(moved, has_pose, strict=True)]  # fmt: skip
    return [
        Test(name, poses[i], gravity, force[i] if loaded[i] else None, float(s[i]), float(std_s[i]),
             contact[i] if seen[i] else None, float(std_contact[i]), directions[i], float(sag[i]), float(std_sag[i]),
             use=USES[uses[i]])
        for i, name in enumerate(names)
    ]  # fmt: skip


def base_pose(manifest: Manifest) -> Array:
    """Return T_world_base of `[base]`, (4, 4)."""
    R = Rotation.from_rotvec(np.radians(manifest.base.rotation_world_deg)).as_matrix()
    return pose(R, np.array(manifest.base.p_world_mm) * MM)


def _std(rows: TableRows, given: NDArray[np.bool_], what: str, name: str) -> Array:
    column = rows.columns[what].name if what in rows.columns else what
    return rows.std(name, given, f"{column} has no standard deviation; give it in {name}_mm")


def indices_of_tests(rows: TableRows, names: dict[str, int]) -> NDArray[np.intp]:
    """Return the index of the test of each row of another table; refuse a test that `tests.csv` does not have."""
    indices = []
    for row, name in enumerate(rows.texts("test")):
        if name not in names:
            near = difflib.get_close_matches(name, names, 1, 0.3)
            hint = f"did you mean {near[0]!r}?" if near else "add it there"
            rows.fail(row, f"test {name[:40]!r} is not in {TESTS}; {hint}" if name else "names no test")
        indices.append(names[name])
    return np.array(indices, dtype=np.intp)


def read_wrench_table(folder: Path, tests: dict[str, int]) -> tuple[list[Array], list[float], Frame, tuple[str, ...]]:
    """Return readings of each test [N, N·m], (n, 6), the mean time of each [s], their frame, and notes on assumptions,
    from `wrenches.csv` if any.

    Raises:
        InputError: the table is invalid; one line.
    """
    path = folder / WRENCHES
    if not path.exists():
        return [np.zeros((0, 6)) for _ in tests], [np.nan] * len(tests), "base", ()
    rows = read_rows(path, WRENCHES_SCHEMA)
    frame = rows.lines.frame or "sensor"
    which = indices_of_tests(rows, tests)
    wrench = rows.required(*WRENCH)
    time, names = rows.numbers("time")[:, 0], rows.texts("test")
    keys: list[tuple[object, ...]] = [
        (name, i if np.isnan(t) else t) for i, (name, t) in enumerate(zip(names, time.tolist(), strict=True))
    ]
    rows.check_unique(keys, lambda row: f"test {names[row]} at {time[row]:g} s")
    note = f"{WRENCHES}: names no frame, the sensor's is assumed; its first line should be `# frame: sensor` or `base`"
    of_tests = [which == i for i in range(len(tests))]
    return (
        [wrench[of_test] for of_test in of_tests],
        _test_times(rows, time, which, of_tests),
        frame,
        () if rows.lines.frame else (note,),
    )


def _test_times(
    rows: TableRows, time: Array, which: NDArray[np.intp], of_tests: list[NDArray[np.bool_]]
) -> list[float]:
    """Return the mean time of each test [s]; NaN for those without, and for all if time begins anew in each test."""
    given = np.flatnonzero(np.isfinite(time))
    t, first = time[given], np.flatnonzero(np.diff(which[given]) != 0) + 1  # of the rows of a test
    # with single readings, all may be at 0 s
    anew = len(first) > 0 and bool((t[first] == t[0]).all() or (t[first] < t[first - 1]).all())
    for last, row in itertools.pairwise(given):
        if time[row] < time[last] and (not anew or which[row] == which[last]):
            rows.fail(int(row), f"{rows.columns['time'].name} runs backward, from {time[last]:g} s to "
                                f"{time[row]:g} s; use one clock and keep the rows in the order of time")  # fmt: skip
    times = [time[of_test & np.isfinite(time)] for of_test in of_tests]
    return [float(of_test.mean()) if len(of_test) and not anew else np.nan for of_test in times]


def read_markers(folder: Path, manifest: Manifest, tests: dict[str, int]) -> list[Markers | None]:
    """Return the markers of each test by a reference other than the campaign's cameras, from `markers.csv` if any.

    Raises:
        InputError: the table is invalid; one line.
    """
    path = folder / MARKERS
    if not path.exists():
        return [None] * len(tests)
    rows = read_rows(path, MARKERS_SCHEMA)
    which, numbers = indices_of_tests(rows, tests), marker_numbers(rows, manifest)
    names = rows.texts("test")
    rows.check_unique(list(zip(names, numbers.tolist(), strict=True)),
                      lambda row: f"test {names[row]}, marker {numbers[row] + 1}")  # fmt: skip
    default = manifest.markers.std_mm if manifest.markers is not None else None
    p, needed = rows.required(*POSITION), np.full(len(rows), default is None)
    std = rows.std("std", needed, "no std_mm here, nor markers.std_mm in campaign.toml; give one of them")
    std = np.where(np.isnan(std), np.nan if default is None else default * MM, std)
    markers: list[Markers | None] = []
    for test in range(len(tests)):
        of_test = np.flatnonzero(which == test)
        of_test = of_test[np.argsort(numbers[of_test])]
        cov = std[of_test, None, None] ** 2 * np.eye(3)
        markers.append(Markers(numbers[of_test], p[of_test], cov, MARKERS) if len(of_test) else None)
    return markers


def marker_numbers(rows: TableRows, manifest: Manifest) -> NDArray[np.intp]:
    """Return the index of the marker of each row, from 0; refuse what is not the number of a marker of the campaign."""
    count = 0 if manifest.markers is None else len(manifest.markers.s_mm)
    if count == 0:
        rows.fail(0, "has markers, but campaign.toml has no [markers]; add s_mm, the arclength of each")
    texts = rows.texts("marker")
    for row, text in enumerate(texts):
        if not (text.isascii() and text.isdigit() and len(text) < 9):
            rows.fail(row, f"marker {text[:20]!r} is not a number; marker 1 is the one nearest to the base")
        if not 1 <= int(text) <= count:
            rows.fail(row, f"marker {text} is beyond the list: markers.s_mm in campaign.toml has {count}")
    return np.array([int(text) - 1 for text in texts], dtype=np.intp)


# cameras


def read_pixels(
    folder: Path, manifest: Manifest, tests: dict[str, int]
) -> tuple[list[Markers | None], tuple[str, ...]]:
    """Return the markers of each test, located by cameras from `pixels.csv` if any, and notes, each one line.

    Raises:
        InputError: the table is invalid, or the cameras contradict each other; one line.
    """
    path = folder / PIXELS
    if not path.exists():
        note = f"{IMAGES}/ has photographs, but there is no {PIXELS}; run `probedesign markers {folder}`"
        without = (folder / IMAGES).is_dir() and not (folder / MARKERS).exists()
        return [None] * len(tests), (note,) if without else ()
    rows = read_rows(path, PIXELS_SCHEMA)
    which, numbers = indices_of_tests(rows, tests), marker_numbers(rows, manifest)
    names, known = rows.texts("test"), () if manifest.cameras is None else manifest.cameras.names
    of_camera = camera_names(rows, known)
    rows.check_unique(list(zip(names, of_camera, numbers.tolist(), strict=True)),
                      lambda i: f"test {names[i]}, camera {of_camera[i]}, marker {numbers[i] + 1}")  # fmt: skip
    uv, std = rows.required(*PIXEL), rows.std("std", np.zeros(len(rows), dtype=bool), "")
    cameras, notes = read_cameras(folder, manifest)
    order = [camera.name for camera in cameras]
    for row, ((u, v), name) in enumerate(zip(uv, of_camera, strict=True)):
        width, height = cameras[order.index(name)].size_px or (np.inf, np.inf)
        if not (-0.5 <= u <= width - 0.5 and -0.5 <= v <= height - 0.5):
            rows.fail(row, f"pixel {u:g}, {v:g} lies outside the pictures of {width} x {height} px that camera {name} "
                           "was calibrated for; was the photograph scaled?")  # fmt: skip
    camera_index = np.array([order.index(name) for name in of_camera])
    markers: list[Markers | None] = [None] * len(tests)
    for name, test in tests.items():
        of_test = which == test
        if of_test.any():
            try:
                markers[test] = _located(cameras, camera_index[of_test], numbers[of_test], uv[of_test], std[of_test])
            except InputError as error:
                raise InputError(f"{path}: test {name}: {error}") from None
    return markers, notes


def _located(
    cameras: list[Camera], which: NDArray[np.intp], numbers: NDArray[np.intp], uv: Array, std: Array
) -> Markers:
    seen = np.unique(numbers)
    column = np.searchsorted(seen, numbers)
    pixels = np.full((len(cameras), len(seen), 2), np.nan)
    pixels[which, column] = uv
    std_px = np.tile([[max(camera.std_px, MIN_STD_PX)] for camera in cameras], (1, len(seen)))
    given = ~np.isnan(std)
    std_px[which[given], column[given]] = std[given]
    located = triangulate(cameras, pixels, std_px, [str(number + 1) for number in seen])
    return Markers(seen, located.p_world, located.cov_world, PIXELS)


# calibration of the cameras: by a box of control points, or by files of other programs


def read_cameras(folder: Path, manifest: Manifest) -> tuple[list[Camera], tuple[str, ...]]:
    """Return the cameras that `[cameras]` names, calibrated, in that order, and notes for the user, each one line.

    Calibration files that state no poses in the world are completed by `control_points.csv`.

    Raises:
        InputError: there are none, or what they are calibrated from is missing or invalid; one line.
    """
    table = manifest.cameras
    if table is None:
        raise InputError(f'{folder / MANIFEST}: has no [cameras]; add there names = ["left", "right"]')
    path = folder / CONTROL_POINTS
    if not table.calibration:
        if not path.exists():
            raise InputError(f"{path}: is missing; cameras are calibrated from it, or from cameras.calibration")
        return _by_control_points(
            path, table, lambda name, world, uv, labels: calibrate(name, world, uv, table.distortion or 0, labels)
        )
    unit = None if table.length_unit is None else LENGTH[table.length_unit]
    base = np.array(manifest.base.p_world_mm) * MM
    paths = [folder / name for name in table.calibration]
    stated = read_camera_files(paths, table.names, table.reprojection_px, unit, base)
    if stated.in_world and path.exists():
        raise InputError(f"{folder}: has {CONTROL_POINTS} and poses in the files of cameras.calibration; keep one")
    if stated.in_world:
        return list(stated.cameras), stated.notes
    if not path.exists():
        raise InputError(f"{folder / MANIFEST}: the calibration files state no poses in the world; add "
                         f"{CONTROL_POINTS} with at least 6 points that each camera sees")  # fmt: skip
    known = {camera.name: camera for camera in stated.cameras}
    cameras, notes = _by_control_points(
        path, table, lambda name, world, uv, labels: locate(known[name], world, uv, labels)
    )
    return cameras, (*stated.notes, *notes)


def _by_control_points(path: Path, table: CamerasTable, fit: Fit) -> tuple[list[Camera], tuple[str, ...]]:
    rows = read_rows(path, CONTROL_POINTS_SCHEMA)
    names, labels = camera_names(rows, table.names), rows.texts("point")
    rows.check_unique(list(zip(names, labels, strict=True)), lambda row: f"camera {names[row]}, point {labels[row]}")
    world, pixels = rows.required(*POSITION), rows.required(*PIXEL)
    cameras, notes = [], []
    for name in table.names:
        of_camera = np.flatnonzero(np.array(names) == name)
        if not len(of_camera):
            raise InputError(f"{path}: has no point of camera {name}")
        try:
            camera = fit(name, world[of_camera], pixels[of_camera], [labels[i] for i in of_camera])
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
        outliers = f"; outliers left out: {', '.join(camera.outliers)}" if camera.outliers else ""
        notes.append(f"camera {name}: {len(of_camera)} control points, residual {camera.std_px:.2g} px{outliers}")
        cameras.append(camera)
    return cameras, tuple(notes)


def camera_names(rows: TableRows, known: Sequence[str]) -> list[str]:
    """Return the name of the camera of each row; refuse one that `[cameras]` does not have."""
    names = rows.texts("camera")
    for row, name in enumerate(names):
        if name not in known:
            rows.fail(row, f"camera {name[:40]!r} is not in cameras.names of campaign.toml, which has "
                           f"{', '.join(known) or 'none'}")  # fmt: skip
    return names
