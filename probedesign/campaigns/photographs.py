"""Photographs of a campaign: the markers detected in each, written to `pixels.csv`."""

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from probedesign.campaigns.campaign import Test
from probedesign.campaigns.manifest import FILE as MANIFEST
from probedesign.campaigns.manifest import Manifest, read_manifest
from probedesign.campaigns.reading import CONTROL_POINTS, IMAGES, PIXELS, PIXELS_SCHEMA, read_cameras, read_tests
from probedesign.core.errors import InputError
from probedesign.core.files import check_overwrite, write_atomically
from probedesign.core.units import MM
from probedesign.vision.camera import Camera
from probedesign.vision.markers import SUFFIXES, DetectedMarkers, ImageSide, find_markers, read_grey
from probedesign.vision.triangulate import triangulate

Progress = Callable[[str, float | None], None]


@dataclass(frozen=True)
class Photograph:
    """One photograph of a test."""

    test: Test  #: it shows.
    camera: str  #: name of the camera.
    path: Path  #: of the file.


@dataclass(frozen=True)
class PhotographedTest:
    """Markers of one test in all its photographs."""

    photographs: tuple[Photograph, ...]  #: one of each camera.
    found: tuple[DetectedMarkers, ...] = ()  #: markers in each.
    #: root mean square of the reprojection errors [px]; NaN if the cameras are not calibrated.
    residual_px: float = math.nan
    problem: str = ""  #: why it is left out; empty if it is not.

    @property
    def test(self) -> str:
        """Name of the test."""
        return self.photographs[0].test.name


def find_all(
    folder: Path, base_side: ImageSide | None, dark: bool | None, skip: bool, on_progress: Progress
) -> tuple[list[PhotographedTest], tuple[str, ...]]:
    """Detect the markers in all photographs of a campaign.

    Args:
        folder: of the campaign.
        base_side: side of the pictures where the base is; None to project the base with the calibrated cameras.
        dark: whether the dots are darker than the probe; None for either.
        skip: leave out a test whose photographs are refused, with the reason, instead of refusing all.
        on_progress: called with the step and the fraction done.

    Returns:
        Each test that has photographs, and notes on the cameras for the user.

    Raises:
        InputError: the campaign has no markers, cameras, base side or photographs, or one is refused.
    """
    manifest = read_manifest(folder)
    if manifest.markers is None or manifest.cameras is None:
        lacking = "[markers] with s_mm" if manifest.markers is None else "[cameras] with names"
        raise InputError(f"{folder / MANIFEST}: has no {lacking}, which the detection of markers needs")
    taken = _photographs(folder, manifest, read_tests(folder, manifest))
    calibrated = manifest.cameras.calibration or (folder / CONTROL_POINTS).exists()
    cameras, notes = read_cameras(folder, manifest) if base_side is None or calibrated else ([], ())
    by_name = {camera.name: camera for camera in cameras}
    s, total = np.array(manifest.markers.s_mm) * MM, sum(map(len, taken))
    progress = (number / total for number in itertools.count())
    sizes = {camera.name: (f"camera {camera.name} was calibrated for", camera.size_px) for camera in cameras}

    def detect(photograph: Photograph) -> DetectedMarkers:
        """Return the markers of one photograph."""
        path, name = photograph.path, photograph.camera
        on_progress(f"dots of {path.name}", next(progress))
        height, width = read_grey(path).shape
        if name not in sizes or sizes[name][1] is None:
            sizes[name] = f"{path.name} of the same camera has", (width, height)
        other, size = sizes[name]
        if size is not None and size != (width, height):
            raise InputError(f"{path}: has {width} x {height} px, but {other} {size[0]} x {size[1]}; take all with one "
                             "setting")  # fmt: skip
        base = base_side or by_name[name].project(photograph.test.T_world_base[:3, 3])
        return find_markers(path, s, base, dark)

    tests = []
    for photographs in taken:
        try:
            tests.append(_checked(photographs, tuple(map(detect, photographs)), by_name))
        except InputError as error:
            if not skip:
                hint = "(--skip leaves out the tests whose photographs are refused)"
                raise InputError(f"{error} {hint}") from None
            tests.append(PhotographedTest(photographs, problem=str(error)))
    if all(test.problem for test in tests):
        raise InputError(tests[0].problem)
    return tests, notes


def _checked(
    photographs: tuple[Photograph, ...], found: tuple[DetectedMarkers, ...], cameras: dict[str, Camera]
) -> PhotographedTest:
    """Return one test, its markers checked by triangulation if the cameras are calibrated."""
    if not cameras:
        return PhotographedTest(photographs, found)
    pixels, std_px = (np.array([getattr(markers, name) for markers in found]) for name in ("pixels", "std_px"))
    try:
        located = triangulate([cameras[photograph.camera] for photograph in photographs], pixels, std_px)
    except InputError as error:
        raise InputError(f"photographs of test {photographs[0].test.name}: {error}") from None
    return PhotographedTest(photographs, found, float(np.sqrt(np.nanmean(located.residual_px**2))))


def write_pixels(folder: Path, tests: list[PhotographedTest], force: bool) -> Path:
    """Write `pixels.csv`.

    Raises:
        InputError: it exists and `force` is not set, or it cannot be written.
    """
    path = folder / PIXELS
    check_overwrite(path, force)
    lines = [
        f"{test.test},{photograph.camera},{number},{u:.3f},{v:.3f},{std:.3f}"
        for test in tests
        for photograph, markers in zip(test.photographs, test.found, strict=bool(test.found))
        for number, ((u, v), std) in enumerate(zip(markers.pixels, markers.std_px, strict=True), 1)
    ]
    write_atomically(path, "\n".join([PIXELS_SCHEMA.like, *lines, ""]).encode())
    return path


def _photographs(folder: Path, manifest: Manifest, tests: list[Test]) -> list[tuple[Photograph, ...]]:
    """Return the photographs of each test that has any; refuse none, and those of one camera only."""
    images = folder / IMAGES
    assert manifest.cameras is not None  # checked by the caller
    if not images.is_dir():
        raise InputError(f"{images}: no such folder; put the photographs there as TEST-CAMERA.png")
    files = {path.name.lower(): path for path in sorted(images.iterdir()) if path.suffix.lower() in SUFFIXES}
    taken = []
    for test in tests:
        of_test: list[Photograph] = []
        for camera in manifest.cameras.names:
            names = (f"{test.name}-{camera}{suffix}".lower() for suffix in SUFFIXES)
            paths = [files[name] for name in names if name in files]
            if len(paths) > 1:
                raise InputError(f"{paths[1]}: a second photograph of test {test.name} by {camera}; keep one")
            of_test += [Photograph(test, camera, path) for path in paths]
        if len(of_test) == 1:
            lacking = f"camera {of_test[0].camera} only has a photograph of test {test.name}"
            raise InputError(f"{images}: {lacking}; two cameras must see it: add one or remove it")
        if of_test:
            taken.append(tuple(of_test))
    if not taken:
        example = f"{tests[0].name}-{manifest.cameras.names[0]}.png"
        raise InputError(f"{images}: no photograph is named after a test and a camera, as {example} would be")
    return taken
