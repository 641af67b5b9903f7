"""Reading a campaign: every table of its folder, checked against the others."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from probedesign.campaigns.agreement import check_agreement
from probedesign.campaigns.campaign import Campaign, Markers, Test, Weighing
from probedesign.campaigns.checks import check_plausible
from probedesign.campaigns.manifest import FILE as MANIFEST
from probedesign.campaigns.manifest import Manifest, read_manifest
from probedesign.campaigns.markers_table import FILE as MARKERS
from probedesign.campaigns.markers_table import read_markers
from probedesign.campaigns.order import check_order
from probedesign.campaigns.pixels_table import FILE as PIXELS
from probedesign.campaigns.pixels_table import read_pixels
from probedesign.campaigns.tables import FILE as TESTS
from probedesign.campaigns.tables import read_tests
from probedesign.campaigns.wrenches_table import read_wrenches
from probedesign.errors import InputError
from probedesign.estimation.model import ProbeModel
from probedesign.frames import Array, pose
from probedesign.units import GRAM, MM


def read_campaign(path: str | Path) -> Campaign:
    """Read the folder that a laboratory filled; see docs/measurements.md.

    Args:
        path: of the folder.

    Raises:
        InputError: something is missing or wrong; one line that names file, line and remedy.
    """
    folder = Path(path)
    manifest = read_manifest(folder)
    rows = read_tests(folder, manifest)
    names = {row.name: i for i, row in enumerate(rows)}
    wrenches, frame, assumed = read_wrenches(folder, names)
    markers, notes = _seen(folder, manifest, names)
    marker_s, side = _markers_of(manifest)
    for row, seen in zip(rows, markers, strict=True):
        if seen is not None:
            std = manifest.base.std_mm * MM
            check_order(
                f"{folder / seen.file}: test {row.name}", seen, marker_s, side, row.T_world_base[:3, 3], std
            )
    tests = tuple(
        replace(row, wrenches=read, frame=frame, markers=seen)
        for row, read, seen in zip(rows, wrenches, markers, strict=True)
    )
    return _campaign(folder, manifest, marker_s, side, tests, (*notes, *assumed))


def _seen(
    folder: Path, manifest: Manifest, tests: dict[str, int]
) -> tuple[list[Markers | None], tuple[str, ...]]:
    """The markers of each test, from cameras or another reference, and notes."""
    told = read_markers(folder, manifest, tests)
    placed, notes = read_pixels(folder, manifest, tests)
    for name, test in tests.items():
        if told[test] is not None and placed[test] is not None:
            raise InputError(
                f"{folder}: test {name} has markers in {MARKERS} and in {PIXELS}; keep one of them"
            )
    return [a or b for a, b in zip(told, placed, strict=True)], notes


def check_probe(campaign: Campaign, model: ProbeModel) -> None:
    """Refuse a campaign of another probe, or one that no such probe can give.

    Args:
        campaign: the data.
        model: of the probe it is used for.

    Raises:
        InputError: the fingerprints or the names differ; a place is beyond the tip; or values are in another unit.
    """
    _check_same(campaign, model)
    name, length = model.name, model.rod.length
    for number, s in enumerate(campaign.marker_s, 1):
        if s > length * (1.0 + 1e-9):
            beyond = f"marker {number} at s = {s / MM:g} mm is beyond the tip of {name} at {length / MM:g} mm"
            raise InputError(f"{campaign.folder / MANIFEST}: {beyond}; correct markers.s_mm in campaign.toml")
    for test in campaign.tests:
        if test.s_contact > length * (1.0 + 1e-9):
            beyond = (
                f"s_contact_mm = {test.s_contact / MM:g} is beyond the tip of {name} at {length / MM:g} mm"
            )
            raise InputError(f"{campaign.folder / TESTS}: test {test.name}: {beyond}; a wrong unit?")
    check_plausible(campaign, model)
    check_agreement(campaign, model)


def _check_same(campaign: Campaign, model: ProbeModel) -> None:
    where = f"{campaign.folder}: these data are of another probe"
    told, name = campaign.fingerprint, model.name
    if told is not None and told != model.fingerprint:
        raise InputError(f"{where}: fingerprint {told}, not {model.fingerprint} of {name}")
    if campaign.name == name:
        return
    if told is not None:
        both = f"probe = {campaign.name!r}, and fingerprint {told} is that of {name!r}"
        raise InputError(f"{campaign.folder / MANIFEST}: {both}; correct the one that is wrong")
    raise InputError(
        f"{where}: {campaign.name!r}, not {name!r}; if it is the same, correct probe in campaign.toml"
    )


def _markers_of(manifest: Manifest) -> tuple[Array, float | None]:
    """Arclengths [m] and side [rad] of the markers."""
    if manifest.markers is None:
        return np.zeros(0), None
    side = manifest.markers.side_deg
    return np.array(manifest.markers.s_mm) * MM, None if side is None else float(np.radians(side))


def _campaign(
    folder: Path,
    manifest: Manifest,
    marker_s: Array,
    side: float | None,
    tests: tuple[Test, ...],
    notes: tuple[str, ...],
) -> Campaign:
    base, weighed = manifest.base, manifest.weighing
    R = Rotation.from_rotvec(np.radians(base.rotation_world_deg)).as_matrix()
    return Campaign(
        name=manifest.probe,
        fingerprint=manifest.fingerprint,
        T_world_base=pose(R, np.array(base.p_world_mm) * MM),
        std_base=base.std_mm * MM,
        std_tilt=float(np.radians(base.std_deg)),
        gravity_world=np.array(manifest.gravity.world_m_s2),
        marker_s=marker_s,
        marker_side=side,
        tests=tests,
        weighing=None
        if weighed is None
        else Weighing(GRAM * weighed.mass_g, GRAM * weighed.std_g, weighed.of),
        folder=folder,
        notes=notes,
    )
