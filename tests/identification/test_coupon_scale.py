"""The scale of the next print from a coupon: exact readings, coverage, refusals, and the change of a design."""

from pathlib import Path

import numpy as np
import pytest

from probedesign.cli.main import run
from probedesign.core.errors import InputError
from probedesign.design import load_design
from probedesign.identification.measured_print import fit_scale, read_coupon
from probedesign.mount import build_geometry

DRAWN = np.array([12.0, 9.5, 7.0, 4.5, 2.0, 7.0, 7.0, 7.0])
ACROSS = np.zeros(len(DRAWN), dtype=bool)
HEAD = "part,s_mm,drawn_mm,diameter_x_mm,diameter_y_mm"
DESIGN = """schema = 1
name = "p"
[probe]
length_mm = 150.0
base_d_mm = 12.0
tip_d_mm = 2.0
"""


def sheet(folder: Path, measured: np.ndarray) -> Path:
    """Return the sheet with one empty cell, which is not needed."""
    rows = [f"coupon_steps,4,{d:g},{m:.3f},{m:.3f}" for d, m in zip(DRAWN, measured, strict=True)]
    rows[1] = rows[1].rpartition(",")[0] + ","
    path = folder / "filled.csv"
    path.write_text("\n".join(["# coupons", HEAD, *rows]) + "\n", "utf-8")
    return path


def test_a_shrunk_coupon_gives_the_scale_that_restores_the_drawn_size(tmp_path: Path) -> None:
    found = fit_scale(*read_coupon(sheet(tmp_path, 0.985 * DRAWN), "elastic-50a"), 0.0)
    assert found.scale_xy * 0.985 == pytest.approx(1.0, abs=1e-4)  # the sheet has micrometres
    assert found.left_mm < 1e-3 and found.offset_mm == 0.0 and found.scale_z is None


def test_the_stated_uncertainty_covers_the_scale() -> None:
    """Readings of 0.03 mm, a common error of the calipers of 0.02 mm: deviations over the stated ones are normal."""
    rng, off, offsets = np.random.default_rng(2), [], []
    count = np.full(len(DRAWN), 2)
    for _ in range(1000):
        errors = rng.normal(0.0, 0.03 / np.sqrt(2), len(DRAWN)) + rng.normal(0.0, 0.02)
        found = fit_scale(DRAWN, 0.98 * DRAWN + errors, count, ACROSS, 0.02)
        off.append((found.scale_xy - 1.0 / 0.98) / found.std)
        offsets.append(found.offset_mm != 0.0)
    # Both are widened where readings happen to scatter more: not above 1; 1000 draws know a deviation to 2 %.
    assert 0.85 < np.std(off) < 1.07
    assert np.mean(offsets) < 0.07


@pytest.mark.parametrize("offset", [0.12, -0.12])
def test_scale_and_offset_make_the_next_tip_as_wide_as_drawn(offset: float) -> None:
    """A print came out as 0.985 d + offset; the scale alone would make the tip of 2 mm several per cent wide."""
    lengths = np.array([40.0, 70.0])
    found = fit_scale(
        np.append(DRAWN, lengths), np.append(0.985 * DRAWN + offset, 0.99 * lengths), np.full(len(DRAWN) + 2, 2),
        np.append(ACROSS, [True, True]), 0.02,
    )  # fmt: skip
    assert found.offset_mm == pytest.approx(offset, abs=1e-9) and found.scale_z == pytest.approx(1.0 / 0.99, abs=1e-9)
    file_d = found.scale_xy * (2.0 - found.offset_mm)  # as `printed_mesh` writes it
    assert 0.985 * file_d + offset == pytest.approx(2.0, abs=1e-9)
    assert found.std_z is not None and 2e-4 < found.std_z < 2e-3


@pytest.mark.parametrize("measured", [0.5 * DRAWN, 10.0 * DRAWN, -DRAWN])
def test_another_part_is_refused(tmp_path: Path, measured: np.ndarray) -> None:
    with pytest.raises(InputError):
        fit_scale(*read_coupon(sheet(tmp_path, measured), "elastic-50a"), 0.02)


def test_an_empty_sheet_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "coupon.csv"
    path.write_text(f"{HEAD}\ncoupon_steps,4,12,,\ncoupon_rod,4,7,6.9,6.9\n", "utf-8")
    with pytest.raises(InputError, match="at least 3"):
        read_coupon(path, "elastic-50a")


def test_a_coupon_of_another_resin_is_refused(tmp_path: Path) -> None:
    path = sheet(tmp_path, 0.985 * DRAWN)
    path.write_text(path.read_text("utf-8").replace("# coupons", "# resin: elastic-50a"), "utf-8")
    assert len(read_coupon(path, "elastic-50a")[0]) == len(DRAWN)
    with pytest.raises(InputError, match="silicone-40a"):
        read_coupon(path, "silicone-40a")


def test_the_command_writes_the_scale_and_leaves_the_geometry(tmp_path: Path, capsys) -> None:
    path = tmp_path / "p.toml"
    path.write_text(DESIGN, "utf-8")
    before = load_design(path)
    assert run(["measured", str(path), str(sheet(tmp_path, 0.985 * DRAWN))]) == 0
    after = load_design(path)
    assert after.print_.scale_xy == pytest.approx(1.0 / 0.985, abs=2e-4)
    assert build_geometry(after).fingerprint == build_geometry(before).fingerprint
    assert after.tolerances == before.tolerances and not after.probe.measured
    assert run(["measured", str(path), str(sheet(tmp_path, 0.99 * DRAWN))]) == 2  # was measured before
    assert "--force" in capsys.readouterr().err
    assert load_design(path) == after
    assert run(["measured", str(path), str(sheet(tmp_path, 0.99 * DRAWN)), "--force"]) == 0
    assert load_design(path).print_.scale_xy == pytest.approx(1.0 / 0.99, abs=2e-4)
