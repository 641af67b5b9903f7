"""`wrenches.csv`: what the sensor read in each test, its bias removed."""

from pathlib import Path

import numpy as np

from probedesign.campaigns.rows import Kind, read_rows
from probedesign.campaigns.tables import known_test
from probedesign.core.columns import WRENCH, WRENCH_ALIASES, WRENCH_KINDS
from probedesign.core.csv_tables import Frame
from probedesign.frames import Array

FILE = "wrenches.csv"
KIND = Kind(
    "table of wrenches",
    {"test": "name", "time": "time", **WRENCH_KINDS},
    ("test", *WRENCH),
    "test,time_s,Fx_N,Fy_N,Fz_N,Mx_Nm,My_Nm,Mz_Nm",
    {"t": "time", "timestamp": "time", **WRENCH_ALIASES},
)


def read_wrenches(folder: Path, tests: dict[str, int]) -> tuple[list[Array], Frame, tuple[str, ...]]:
    """Read `wrenches.csv`, if there is one.

    Args:
        folder: of the data.
        tests: place of each test by name.

    Returns:
        Readings of each test [N, N·m], (n, 6), the frame they are told in, and what was assumed, a line each.

    Raises:
        InputError: it says something wrong; one line.
    """
    path = folder / FILE
    if not path.exists():
        return [np.zeros((0, 6)) for _ in tests], "base", ()
    rows = read_rows(path, KIND)
    frame = rows.table.frame
    which = np.array(known_test(rows, tests))
    wrench = rows.full(*WRENCH)
    time, names = rows.numbers("time")[:, 0], rows.texts("test")
    keys: list[tuple[object, ...]] = [
        (name, i if np.isnan(t) else float(t)) for i, (name, t) in enumerate(zip(names, time, strict=True))
    ]
    rows.once(keys, lambda row: f"test {names[row]} at {time[row]:g} s")
    assumed = f"{FILE}: names no frame, the sensor's is assumed; its first line should be `# frame: sensor` or `base`"
    return (
        [wrench[which == i] for i in range(len(tests))],
        frame,
        () if rows.table.names_frame else (assumed,),
    )
