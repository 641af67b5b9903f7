"""Tables of a campaign: `tests.csv`, `wrenches.csv` and `markers.csv`."""

import difflib
import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from probedesign.campaigns.campaign import Markers, Test
from probedesign.campaigns.manifest import Manifest
from probedesign.core.csv_tables import (
    WRENCH,
    WRENCH_ALIASES,
    WRENCH_KINDS,
    Frame,
    TableRows,
    TableSchema,
    read_rows,
    shown,
)
from probedesign.core.frames import Array, pose
from probedesign.core.units import MM

TESTS, WRENCHES, MARKERS = "tests.csv", "wrenches.csv", "markers.csv"
FORCE = ("force_x_world", "force_y_world", "force_z_world")
CONTACT = ("contact_x_world", "contact_y_world", "contact_z_world")
BASE_POSITION = ("base_x_world", "base_y_world", "base_z_world")
BASE_ROTATION = ("base_rx_world", "base_ry_world", "base_rz_world")
POSITION = ("x_world", "y_world", "z_world")
TESTS_SCHEMA = TableSchema(
    "table of tests",
    {"test": "name", **dict.fromkeys(FORCE, "force"), "s_contact": "length", "std_s": "length",
     **dict.fromkeys(CONTACT, "length"), "std_contact": "length", "direction": "word", "tip_sag": "length",
     "std_sag": "length", **dict.fromkeys(BASE_POSITION, "length"), **dict.fromkeys(BASE_ROTATION, "angle")},
    ("test",),
    "test,force_x_world_N,force_y_world_N,force_z_world_N,s_contact_mm,std_s_mm,contact_x_world_mm,"
    "contact_y_world_mm,contact_z_world_mm,std_contact_mm,direction,tip_sag_mm,std_sag_mm,base_x_world_mm,"
    "base_y_world_mm,base_z_world_mm,base_rx_world_deg,base_ry_world_deg,base_rz_world_deg",
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
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}", re.ASCII)
PUSH_DIRECTIONS = {
    "+x": (1.0, 0.0, 0.0),
    "-x": (-1.0, 0.0, 0.0),
    "+y": (0.0, 1.0, 0.0),
    "-y": (0.0, -1.0, 0.0),
}
"""Unit vectors in base axes."""


def read_tests(folder: Path, manifest: Manifest) -> list[Test]:
    """Read `tests.csv`.

    Returns:
        The tests, without wrenches and markers.

    Raises:
        InputError: it is missing or invalid; one line.
    """
    rows = read_rows(folder / TESTS, TESTS_SCHEMA)
    names = rows.texts("test")
    for row, name in enumerate(names):
        if not NAME.fullmatch(name):
            rows.fail(
                row, f"test {name[:40]!r} is not a valid name; use letters, digits, - and _, at most 64"
            )
    rows.check_unique([(name,) for name in names], lambda row: f"test {names[row]}")
    force, loaded = rows.all_or_none(*FORCE)
    contact, seen = rows.all_or_none(*CONTACT)
    poses = _poses(rows, manifest)
    s, sag = rows.numbers("s_contact", "tip_sag").T
    std_s = _std(rows, ~np.isnan(s), "s_contact", "std_s")
    std_contact = _std(rows, seen, "contact_x_world", "std_contact")
    std_sag = _std(rows, ~np.isnan(sag), "tip_sag", "std_sag")
    directions = rows.texts("direction")
    for row in np.flatnonzero(s < 0.0)[:1]:
        rows.fail(int(row), f"{rows.columns['s_contact'].name} is negative; s counts from the base")
    for i, direction in enumerate(directions):
        if direction and direction not in PUSH_DIRECTIONS:
            allowed = ", ".join(PUSH_DIRECTIONS)
            rows.fail(i, f"direction = {shown(direction)} is none of {allowed} of the base; write one, or leave "
                         "it empty")  # fmt: skip
        if loaded[i] and not force[i].any() and (not np.isnan(s[i]) or seen[i]):
            rows.fail(
                i, f"{names[i]}: has a contact and force 0,0,0, which is a free probe; leave the force empty"
            )
    gravity = np.array(manifest.gravity.world_m_s2)
    return [
        Test(name, poses[i], gravity, force[i] if loaded[i] else None, float(s[i]), float(std_s[i]),
             contact[i] if seen[i] else None, float(std_contact[i]), directions[i], float(sag[i]), float(std_sag[i]))
        for i, name in enumerate(names)
    ]  # fmt: skip


def _poses(rows: TableRows, manifest: Manifest) -> list[Array]:
    """Return T_world_base of each row: its own, or that of `[base]`."""
    values, given = rows.all_or_none(*BASE_POSITION, *BASE_ROTATION)
    usual = base_pose(manifest)
    return [pose(Rotation.from_rotvec(v[3:]).as_matrix(), v[:3]) if own else usual
            for v, own in zip(values, given, strict=True)]  # fmt: skip


def base_pose(manifest: Manifest) -> Array:
    """Return T_world_base of `[base]`, (4, 4)."""
    R = Rotation.from_rotvec(np.radians(manifest.base.rotation_world_deg)).as_matrix()
    return pose(R, np.array(manifest.base.p_world_mm) * MM)


def _std(rows: TableRows, given: NDArray[np.bool_], what: str, name: str) -> Array:
    """Return the standard deviation of a quantity, which is required where that is given; none is assumed."""
    column = rows.columns[what].name if what in rows.columns else what
    return rows.std(name, given, f"{column} has no standard deviation; give it in {name}_mm")


def indices_of_tests(rows: TableRows, names: dict[str, int]) -> list[int]:
    """Return the index of the test of each row of another table.

    Raises:
        InputError: a row names no test of `tests.csv`.
    """
    found = []
    for row, name in enumerate(rows.texts("test")):
        if name not in names:
            near = difflib.get_close_matches(name, names, 1, 0.3)
            hint = f"did you mean {near[0]!r}?" if near else "add it there"
            rows.fail(row, f"test {name[:40]!r} is not in {TESTS}; {hint}" if name else "names no test")
        found.append(names[name])
    return found


def read_wrenches(folder: Path, tests: dict[str, int]) -> tuple[list[Array], Frame, tuple[str, ...]]:
    """Read `wrenches.csv`, if there is one.

    Args:
        folder: of the data.
        tests: index of each test by name.

    Returns:
        Readings of each test [N, N·m], (n, 6), their frame, and notes on assumptions, a line each.

    Raises:
        InputError: it is invalid; one line.
    """
    path = folder / WRENCHES
    if not path.exists():
        return [np.zeros((0, 6)) for _ in tests], "base", ()
    rows = read_rows(path, WRENCHES_SCHEMA)
    frame = rows.lines.frame
    which = np.array(indices_of_tests(rows, tests))
    wrench = rows.required(*WRENCH)
    time, names = rows.numbers("time")[:, 0], rows.texts("test")
    keys: list[tuple[object, ...]] = [
        (name, i if np.isnan(t) else float(t)) for i, (name, t) in enumerate(zip(names, time, strict=True))
    ]
    rows.check_unique(keys, lambda row: f"test {names[row]} at {time[row]:g} s")
    note = f"{WRENCHES}: names no frame, the sensor's is assumed; its first line should be `# frame: sensor` or `base`"
    return [wrench[which == i] for i in range(len(tests))], frame, () if rows.lines.names_frame else (note,)


def read_markers(folder: Path, manifest: Manifest, tests: dict[str, int]) -> list[Markers | None]:
    """Read `markers.csv`, if there is one: positions by a reference other than the campaign's cameras.

    Returns:
        The markers of each test; None where it has none.

    Raises:
        InputError: it is invalid; one line.
    """
    path = folder / MARKERS
    if not path.exists():
        return [None] * len(tests)
    rows = read_rows(path, MARKERS_SCHEMA)
    which, numbers = np.array(indices_of_tests(rows, tests)), marker_numbers(rows, manifest)
    names = rows.texts("test")
    rows.check_unique(list(zip(names, numbers.tolist(), strict=True)),
                      lambda row: f"test {names[row]}, marker {numbers[row] + 1}")  # fmt: skip
    default = manifest.markers.std_mm if manifest.markers is not None else None
    p, needed = rows.required(*POSITION), np.full(len(rows), default is None)
    std = rows.std("std", needed, "no std_mm here, nor markers.std_mm in campaign.toml; give one of them")
    std = np.where(np.isnan(std), np.nan if default is None else default * MM, std)
    found: list[Markers | None] = []
    for test in range(len(tests)):
        own = np.flatnonzero(which == test)
        own = own[np.argsort(numbers[own])]
        cov = std[own, None, None] ** 2 * np.eye(3)
        found.append(Markers(numbers[own], p[own], cov, MARKERS) if len(own) else None)
    return found


def marker_numbers(rows: TableRows, manifest: Manifest) -> NDArray[np.intp]:
    """Return the index of the marker of each row, from 0.

    Raises:
        InputError: one is not a number, or beyond the campaign's markers.
    """
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
