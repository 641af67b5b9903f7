"""The photographs of a campaign: the dots in each, made into `pixels.csv`."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from probedesign.campaign.cameras import read_cameras
from probedesign.campaign.campaign import Test
from probedesign.campaign.manifest import FILE as MANIFEST
from probedesign.campaign.manifest import Manifest, read_manifest
from probedesign.campaign.pixels_table import FILE, IMAGES
from probedesign.campaign.tests_table import read_tests
from probedesign.errors import InputError
from probedesign.files import write_atomically
from probedesign.frames import Array
from probedesign.stereo.camera import Camera
from probedesign.stereo.finder import Found, find_markers
from probedesign.stereo.row import Side
from probedesign.stereo.triangulate import triangulate
from probedesign.units import MM

KINDS = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")
HEADER = "test,camera,marker,u_px,v_px,std_px"
Tell = Callable[[str, float | None], None]


@dataclass(frozen=True)
class Photograph:
    """One picture of a test.

    Attributes:
        test: it is of.
        camera: name of the one that took it.
        path: of the file.
    """

    test: Test
    camera: str
    path: Path


@dataclass(frozen=True)
class Seen:
    """The dots of one test in all its photographs.

    Attributes:
        photographs: one of each camera.
        found: in each.
        residual_px: root mean square of what the cameras disagree by [px]; NaN if they are not calibrated.
        problem: why it is left out; empty if it is not.
    """

    photographs: tuple[Photograph, ...]
    found: tuple[Found, ...] = ()
    residual_px: float = math.nan
    problem: str = ""

    @property
    def test(self) -> str:
        """Its name."""
        return self.photographs[0].test.name


def find_all(
    folder: Path, base_side: Side | None, dark: bool | None, skip: bool, tell: Tell
) -> tuple[list[Seen], tuple[str, ...]]:
    """Find the dots in all photographs of a campaign.

    Args:
        folder: of the campaign.
        base_side: side of the pictures where the base is; where it is None, the cameras tell.
        dark: whether the dots are darker than the probe; either if None.
        skip: leave out a test whose photographs are refused, and say why, instead of refusing all.
        tell: of the progress.

    Returns:
        Each test that has photographs, and what a user should know of the cameras.

    Raises:
        InputError: the campaign says no markers, cameras or base side, has no photographs, or one is refused.
    """
    manifest = read_manifest(folder)
    if manifest.markers is None or manifest.cameras is None:
        lacking = "[markers] with s_mm" if manifest.markers is None else "[cameras] with names"
        raise InputError(
            f"{folder / MANIFEST}: has no {lacking}; the dots in photographs cannot be told without"
        )
    taken = _taken(folder, manifest, read_tests(folder, manifest))
    calibrated = base_side is None or (folder / "control_points.csv").exists()
    cameras, notes = read_cameras(folder, manifest) if calibrated else ([], ())
    seen = []
    for i, photographs in enumerate(taken):
        tell("dots", i / len(taken))
        try:
            seen.append(_seen(photographs, cameras, np.array(manifest.markers.s_mm) * MM, base_side, dark))
        except InputError as error:
            if not skip:
                raise InputError(
                    f"{error} (--skip leaves out the tests whose photographs are refused)"
                ) from None
            seen.append(Seen(photographs, problem=str(error)))
    if all(one.problem for one in seen):
        raise InputError(seen[0].problem)
    return seen, notes


def write_pixels(folder: Path, seen: list[Seen], force: bool) -> Path:
    """Write `pixels.csv`.

    Raises:
        InputError: one stands there and `force` is not said, or it cannot be written.
    """
    path = folder / FILE
    check_free(folder, force)
    lines = [
        f"{one.test},{photograph.camera},{number},{u:.3f},{v:.3f},{std:.3f}"
        for one in seen
        for photograph, found in zip(one.photographs, one.found, strict=bool(one.found))
        for number, ((u, v), std) in enumerate(zip(found.pixels, found.std_px, strict=True), 1)
    ]
    write_atomically(path, "\n".join([HEADER, *lines, ""]).encode())
    return path


def check_free(folder: Path, force: bool) -> None:
    """Refuse to replace pixels, which somebody may have clicked.

    Raises:
        InputError: some stand there and `force` is not said.
    """
    if (folder / FILE).exists() and not force:
        raise InputError(f"{folder / FILE}: exists already; add --force to replace it, or move it away")


def _taken(folder: Path, manifest: Manifest, tests: list[Test]) -> list[tuple[Photograph, ...]]:
    """The photographs of each test that has any.

    Raises:
        InputError: there are none, or of a test only one camera's.
    """
    images = folder / IMAGES
    assert manifest.cameras is not None, "asked before"
    if not images.is_dir():
        raise InputError(f"{images}: no such folder; put the photographs there as TEST-CAMERA.png")
    there = {path.name.lower(): path for path in sorted(images.iterdir()) if path.suffix.lower() in KINDS}
    taken = []
    for test in tests:
        of_test = []
        for camera in manifest.cameras.names:
            paths = [there[name] for k in KINDS if (name := f"{test.name}-{camera}{k}".lower()) in there]
            if len(paths) > 1:
                raise InputError(f"{paths[1]}: a second photograph of test {test.name} by {camera}; keep one")
            of_test += [Photograph(test, camera, path) for path in paths]
        if len(of_test) == 1:
            lacking = f"camera {of_test[0].camera} only has a photograph of test {test.name}"
            raise InputError(f"{images}: {lacking}; two cameras must see it: add one or take it away")
        if of_test:
            taken.append(tuple(of_test))
    if not taken:
        example = f"{tests[0].name}-{manifest.cameras.names[0]}.png"
        raise InputError(f"{images}: no photograph is named after a test and a camera, as {example} would be")
    return taken


def _seen(
    photographs: tuple[Photograph, ...],
    cameras: list[Camera],
    s: Array,
    base_side: Side | None,
    dark: bool | None,
) -> Seen:
    """The dots of one test, checked by the cameras' agreement if they are calibrated."""
    by_name = {camera.name: camera for camera in cameras}
    found = []
    for one in photographs:
        base = base_side or by_name[one.camera].project(one.test.T_world_base[:3, 3])
        found.append(find_markers(one.path, s, base, dark))
    if not cameras:
        return Seen(photographs, tuple(found))
    try:
        placed = triangulate(
            [by_name[one.camera] for one in photographs],
            np.array([one.pixels for one in found]),
            np.array([one.std_px for one in found]),
        )
    except InputError as error:
        raise InputError(f"photographs of test {photographs[0].test.name}: {error}") from None
    return Seen(photographs, tuple(found), float(np.sqrt(np.nanmean(placed.residual_px**2))))
