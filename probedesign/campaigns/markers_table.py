"""`markers.csv`: where a reference saw the markers of each test in the world."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from probedesign.campaigns.campaign import Markers
from probedesign.campaigns.manifest import Manifest
from probedesign.campaigns.rows import Kind, Rows, read_rows
from probedesign.campaigns.tables import known_test
from probedesign.units import MM

FILE = "markers.csv"
PLACE = ("x_world", "y_world", "z_world")
KIND = Kind(
    "table of markers",
    {"test": "name", "marker": "number", **dict.fromkeys(PLACE, "length"), "std": "length"},
    ("test", "marker", *PLACE),
    "test,marker,x_world_mm,y_world_mm,z_world_mm,std_mm",
    {},
)


def read_markers(folder: Path, manifest: Manifest, tests: dict[str, int]) -> list[Markers | None]:
    """Read `markers.csv`, if there is one.

    Returns:
        The markers of each test; None where it has none.

    Raises:
        InputError: it says something wrong; one line.
    """
    path = folder / FILE
    if not path.exists():
        return [None] * len(tests)
    rows = read_rows(path, KIND)
    which, numbers = np.array(known_test(rows, tests)), marker_numbers(rows, manifest)
    names = rows.texts("test")
    rows.once(list(zip(names, numbers.tolist(), strict=True)),
              lambda row: f"test {names[row]}, marker {numbers[row] + 1}")  # fmt: skip
    said = manifest.markers.std_mm if manifest.markers is not None else None
    p, needed = rows.full(*PLACE), np.full(len(rows), said is None)
    std = rows.spread("std", needed, "no std_mm here, nor markers.std_mm in campaign.toml; say one of them")
    std = np.where(np.isnan(std), np.nan if said is None else said * MM, std)
    found: list[Markers | None] = []
    for test in range(len(tests)):
        own = np.flatnonzero(which == test)
        own = own[np.argsort(numbers[own])]
        cov = std[own, None, None] ** 2 * np.eye(3)
        found.append(Markers(numbers[own], p[own], cov, FILE) if len(own) else None)
    return found


def marker_numbers(rows: Rows, manifest: Manifest) -> NDArray[np.intp]:
    """Which marker each row is of, from 0.

    Raises:
        InputError: a number is none, or beyond the campaign's markers.
    """
    count = 0 if manifest.markers is None else len(manifest.markers.s_mm)
    if count == 0:
        rows.fail(0, "markers, and campaign.toml has no [markers]; write there s_mm, the arclength of each")
    texts = rows.texts("marker")
    for row, text in enumerate(texts):
        if not (text.isascii() and text.isdigit() and len(text) < 9):
            rows.fail(row, f"marker {text[:20]!r} is no number; marker 1 is the one nearest to the base")
        if not 1 <= int(text) <= count:
            rows.fail(row, f"marker {text} is beyond the list: markers.s_mm in campaign.toml has {count}")
    return np.array([int(text) - 1 for text in texts], dtype=np.intp)
