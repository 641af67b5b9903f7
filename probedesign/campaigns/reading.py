"""Reading a campaign: every table of its folder, checked against the others and against the probe."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from probedesign.campaigns.cameras import PIXELS, read_pixels
from probedesign.campaigns.campaign import Campaign, Markers, Weighing
from probedesign.campaigns.checks import check_agreement, check_marker_order, check_plausible
from probedesign.campaigns.manifest import FILE as MANIFEST
from probedesign.campaigns.manifest import Manifest, read_manifest
from probedesign.campaigns.tables import (
    MARKERS,
    TESTS,
    base_pose,
    read_markers,
    read_tests,
    read_wrenches,
)
from probedesign.core.errors import InputError
from probedesign.core.units import GRAM, MM
from probedesign.estimation.model import ProbeModel


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
    wrenches, frame, assumptions = read_wrenches(folder, names)
    markers, notes = _markers(folder, manifest, names)
    marker_s, marker_side = np.zeros(0), None
    if manifest.markers is not None:
        marker_s, side = np.array(manifest.markers.s_mm) * MM, manifest.markers.side_deg
        marker_side = None if side is None else float(np.radians(side))
    std_base = manifest.base.std_mm * MM
    for test, seen in zip(tests, markers, strict=True):
        if seen is not None:
            where = f"{folder / seen.file}: test {test.name}"
            check_marker_order(where, seen, marker_s, marker_side, test.T_world_base[:3, 3], std_base)
    weighing = manifest.weighing
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
            replace(test, wrenches=readings, frame=frame, markers=seen)
            for test, readings, seen in zip(tests, wrenches, markers, strict=True)
        ),
        weighing=None
        if weighing is None
        else Weighing(GRAM * weighing.mass_g, GRAM * weighing.std_g, weighing.of),
        folder=folder,
        notes=(*notes, *assumptions),
    )


def _markers(
    folder: Path, manifest: Manifest, tests: dict[str, int]
) -> tuple[list[Markers | None], tuple[str, ...]]:
    """Return the markers of each test, from cameras or another reference, and notes."""
    measured = read_markers(folder, manifest, tests)
    located, notes = read_pixels(folder, manifest, tests)
    for name, test in tests.items():
        if measured[test] is not None and located[test] is not None:
            raise InputError(
                f"{folder}: test {name} has markers in {MARKERS} and in {PIXELS}; keep one of them"
            )
    return [a or b for a, b in zip(measured, located, strict=True)], notes


def check_probe(campaign: Campaign, model: ProbeModel) -> None:
    """Refuse a campaign of another probe, or with values that this probe cannot produce.

    Args:
        campaign: the data.
        model: of the probe it is used for.

    Raises:
        InputError: the fingerprints or the names differ; a place is beyond the tip; or values are in another unit.
    """
    _check_identity(campaign, model)
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


def _check_identity(campaign: Campaign, model: ProbeModel) -> None:
    where = f"{campaign.folder}: these data are of another probe"
    fingerprint, name = campaign.fingerprint, model.name
    if fingerprint is not None and fingerprint != model.fingerprint:
        raise InputError(f"{where}: fingerprint {fingerprint}, not {model.fingerprint} of {name}")
    if campaign.name == name:
        return
    if fingerprint is not None:
        both = f"probe = {campaign.name!r}, and fingerprint {fingerprint} is that of {name!r}"
        raise InputError(f"{campaign.folder / MANIFEST}: {both}; correct the one that is wrong")
    raise InputError(
        f"{where}: {campaign.name!r}, not {name!r}; if it is the same, correct probe in campaign.toml"
    )
