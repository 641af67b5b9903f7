"""`tests.csv`: a row a test, what is known of each without a sensor."""

import difflib
import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from probedesign.campaigns.campaign import Test
from probedesign.campaigns.manifest import Manifest
from probedesign.campaigns.rows import Kind, Rows, read_rows
from probedesign.core.csv_tables import shown
from probedesign.frames import Array, pose
from probedesign.units import MM

FILE = "tests.csv"
FORCE = ("force_x_world", "force_y_world", "force_z_world")
CONTACT = ("contact_x_world", "contact_y_world", "contact_z_world")
PLACE = ("base_x_world", "base_y_world", "base_z_world")
TURN = ("base_rx_world", "base_ry_world", "base_rz_world")
KIND = Kind(
    "table of tests",
    {"test": "name", **dict.fromkeys(FORCE, "force"), "s_contact": "length", "std_s": "length",
     **dict.fromkeys(CONTACT, "length"), "std_contact": "length", "direction": "word", "tip_sag": "length",
     "std_sag": "length", **dict.fromkeys(PLACE, "length"), **dict.fromkeys(TURN, "angle")},
    ("test",),
    "test,force_x_world_N,force_y_world_N,force_z_world_N,s_contact_mm,std_s_mm,contact_x_world_mm,"
    "contact_y_world_mm,contact_z_world_mm,std_contact_mm,direction,tip_sag_mm,std_sag_mm,base_x_world_mm,"
    "base_y_world_mm,base_z_world_mm,base_rx_world_deg,base_ry_world_deg,base_rz_world_deg",
    {},
)  # fmt: skip
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}", re.ASCII)
WAYS = {"+x": (1.0, 0.0, 0.0), "-x": (-1.0, 0.0, 0.0), "+y": (0.0, 1.0, 0.0), "-y": (0.0, -1.0, 0.0)}
"""Directions of a push, in base axes."""


def read_tests(folder: Path, manifest: Manifest) -> list[Test]:
    """Read `tests.csv`.

    Returns:
        The tests, as yet without wrenches and markers.

    Raises:
        InputError: it is missing or says something wrong; one line.
    """
    rows = read_rows(folder / FILE, KIND)
    names = _names(rows)
    force, loaded = rows.whole(*FORCE)
    contact, seen = rows.whole(*CONTACT)
    poses = _poses(rows, manifest)
    s, sag = rows.numbers("s_contact", "tip_sag").T
    std_s = _spread(rows, ~np.isnan(s), "s_contact", "std_s")
    std_contact = _spread(rows, seen, "contact_x_world", "std_contact")
    std_sag = _spread(rows, ~np.isnan(sag), "tip_sag", "std_sag")
    words = rows.texts("direction")
    _check_places(rows, s)
    for i, word in enumerate(words):
        if word and word not in WAYS:
            ways = ", ".join(WAYS)
            rows.fail(
                i, f"direction = {shown(word)} is none of {ways} of the base; write one, or leave it empty"
            )
        if loaded[i] and not force[i].any() and (not np.isnan(s[i]) or seen[i]):
            rows.fail(
                i, f"{names[i]}: has a contact and force 0,0,0, which is a free probe; leave the force empty"
            )
    return [
        Test(name, poses[i], force[i] if loaded[i] else None, float(s[i]), float(std_s[i]),
                contact[i] if seen[i] else None, float(std_contact[i]), words[i], float(sag[i]), float(std_sag[i]))
        for i, name in enumerate(names)
    ]  # fmt: skip


def known_test(rows: Rows, names: dict[str, int]) -> list[int]:
    """Which test each row of another table is of.

    Raises:
        InputError: a row names no test of `tests.csv`.
    """
    found = []
    for row, name in enumerate(rows.texts("test")):
        if name not in names:
            near = difflib.get_close_matches(name, names, 1, 0.3)
            hint = f"did you mean {near[0]!r}?" if near else "add it there"
            rows.fail(row, f"test {name[:40]!r} is not in {FILE}; {hint}" if name else "names no test")
        found.append(names[name])
    return found


def _names(rows: Rows) -> list[str]:
    names = rows.texts("test")
    for row, name in enumerate(names):
        if not NAME.fullmatch(name):
            rows.fail(row, f"test {name[:40]!r} is no name; use letters, digits, - and _, at most 64")
    rows.once([(name,) for name in names], lambda row: f"test {names[row]}")
    return names


def _poses(rows: Rows, manifest: Manifest) -> list[Array]:
    """T_world_base of each row: its own, or that of `[base]`."""
    values, given = rows.whole(*PLACE, *TURN)
    base = manifest.base
    p, turn = np.array(base.p_world_mm) * MM, np.radians(base.rotation_world_deg)
    usual = pose(Rotation.from_rotvec(turn).as_matrix(), p)
    return [pose(Rotation.from_rotvec(v[3:]).as_matrix(), v[:3]) if yes else usual
            for v, yes in zip(values, given, strict=True)]  # fmt: skip


def _spread(rows: Rows, given: NDArray[np.bool_], what: str, name: str) -> Array:
    """Of a place, which is of no use without it; none is guessed."""
    place = rows.columns[what].name if what in rows.columns else what
    remedy = f"say in {name}_mm how well it is known"
    return rows.spread(name, given, f"{place} stands without a standard deviation; {remedy}")


def _check_places(rows: Rows, s: Array) -> None:
    for row in np.flatnonzero(s < 0.0)[:1]:
        rows.fail(int(row), f"{rows.columns['s_contact'].name} is negative; s counts from the base")
