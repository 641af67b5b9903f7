"""Scale of the next print from the diameters of a printed coupon.

A coupon is printed unscaled. Its measured diameters m over the drawn ones d give the print's size k = Σ m d / Σ d² by
least squares, and 1/k is `scale_xy` of `[print]`, which compensates for the shrinkage. The tolerance of the next print
does not shrink with it, because one coupon does not show how much prints differ from each other.
"""

import re
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from probedesign.core.csv_tables import TableSchema, read_lines, read_rows
from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.core.units import MM
from probedesign.design.edit import Change
from probedesign.design.schema import SCALE_RANGE
from probedesign.identification.measured_diameters import READING_STD_MM

MIN_ROWS = 3
SCHEMA = TableSchema(
    what="table of a coupon's diameters",
    kinds={"part": "name", "s": "length", "drawn": "length", "diameter_x": "length", "diameter_y": "length"},
    required=("drawn", "diameter_x"),
    like="part,s_mm,drawn_mm,diameter_x_mm,diameter_y_mm",
    aliases={},
)


@dataclass(frozen=True)
class CouponScale:
    """Scale that compensates for the shrinkage of a coupon."""

    scale_xy: float  #: scale_xy, std: drawn over measured size, and its standard deviation.
    std: float
    #: offset_mm, offset_std_mm: by how much all diameters are wider, whatever their size, beside the scale; a scale
    #: does not remove it [mm].
    offset_mm: float
    offset_std_mm: float
    left_mm: float  #: largest deviation of a diameter from the scaled one [mm].
    rows: int  #: number of places with a reading.

    @property
    def has_offset(self) -> bool:
        """Return whether the offset exceeds two of its standard deviations."""
        return abs(self.offset_mm) > 2.0 * self.offset_std_mm

    def as_dict(self) -> dict[str, Any]:
        """Return plain data."""
        return asdict(self)


def is_coupon_sheet(path: Path) -> bool:
    """Return whether a file is the sheet of a coupon: its header has the column of drawn diameters."""
    if not path.is_file():
        return False
    lines = read_lines(path, SCHEMA.what, SCHEMA.like)
    return any(name.strip().startswith("drawn") for name in lines.header)


def read_coupon(path: Path, resin: str) -> tuple[Array, Array, Array]:
    """Read the sheet of a coupon.

    Args:
        path: of the sheet; a comment `# resin: NAME` states what the coupon was printed in.
        resin: name of the resin of the probe.

    Returns:
        Drawn and mean measured diameter of each place with a reading [mm], and its number of readings, (n,) each.

    Raises:
        InputError: the file cannot be used, is of another resin, or too few places have a reading.
    """
    rows = read_rows(path, SCHEMA)
    for number, line in rows.lines.comments:
        named = re.match(r"\s*#\s*resin\s*[:=]\s*(\S*)", line, re.IGNORECASE)
        if named and named[1] != resin:
            rows.lines.fail(
                number, f"the coupon is of {named[1]!r}, the design of {resin}; a shrinkage is that of one resin"
            )
    values = rows.numbers("drawn", "diameter_x", "diameter_y") / MM
    for row in np.flatnonzero(~(values[:, 0] > 0.0) | (values[:, 1:] <= 0.0).any(axis=1))[:1]:
        rows.fail(int(row), "drawn_mm and the diameters must be positive; leave what was not measured empty")
    count = np.isfinite(values[:, 1:]).sum(axis=1)
    read = count > 0
    if read.sum() < MIN_ROWS or len(set(values[read, 0])) < 2:
        raise InputError(
            f"{path}: {int(read.sum())} places with a reading; fill in at least {MIN_ROWS}, of two diameters"
        )
    return values[read, 0], np.nanmean(values[read, 1:], axis=1), count[read]


def fit_scale(drawn: Array, measured: Array, count: Array, calipers_std_mm: float) -> CouponScale:
    """Return the scale of the next print by weighted least squares.

    Args:
        drawn, measured: diameters of the coupon [mm], (n,).
        count: number of readings of each, (n,).
        calipers_std_mm: standard deviation of the error that all readings share [mm].

    Raises:
        InputError: the scale is out of the range of a shrinkage.
    """
    if not 0.0 <= calipers_std_mm <= 1.0:
        raise InputError(f"calipers_std_mm = {calipers_std_mm:g} must lie in 0 ... 1")
    weights = count / READING_STD_MM**2
    precision = float(weights @ drawn**2)
    size = float(weights @ (measured * drawn)) / precision
    if not SCALE_RANGE[0] <= 1.0 / size <= SCALE_RANGE[1]:
        raise InputError(
            f"the coupon is {size:.4g} times as large as drawn; allowed is 1/{SCALE_RANGE[1]:g} ... "
            f"1/{SCALE_RANGE[0]:g}: check the unit and the sheet"
        )
    residuals = measured - size * drawn
    A = np.column_stack([drawn, np.ones(len(drawn))]) * np.sqrt(weights)[:, None]
    (_, offset), *_ = np.linalg.lstsq(A, measured * np.sqrt(weights), rcond=None)
    # Readings that scatter more than stated count less (R. T. Birge, Physical Review 40 (1932) 207).
    scatter = max(1.0, float(np.sqrt(weights @ residuals**2 / (len(drawn) - 1))))
    shared = calipers_std_mm * float(weights @ drawn) / precision
    std = float(np.hypot(scatter / np.sqrt(precision), shared)) / size**2
    offset_std = float(np.hypot(np.sqrt(np.linalg.inv(A.T @ A)[1, 1]), calipers_std_mm))
    return CouponScale(1.0 / size, std, float(offset), offset_std, float(np.abs(residuals).max()), len(drawn))


def scale_changes(found: CouponScale, day: str) -> tuple[Change, ...]:
    """Return the change of a design by the scale of a coupon; `day` is for the comment."""
    note = f"measured {day} on a coupon, {found.rows} places: ± {found.std:.2g} (one standard deviation)"
    return (Change("print", "scale_xy", f"{found.scale_xy:.4f}", note),)
