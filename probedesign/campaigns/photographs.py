"""Photographs of a campaign: the markers detected in each, cached photograph by photograph, written to `pixels.csv`."""

import hashlib
import itertools
import json
import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from probedesign.campaigns.campaign import Test
from probedesign.campaigns.manifest import FILE as MANIFEST
from probedesign.campaigns.manifest import Manifest, read_manifest
from probedesign.campaigns.reading import IMAGES, PIXELS, calibration_exists, read_cameras, read_tests
from probedesign.core.errors import InputError
from probedesign.core.files import check_overwrite, write_atomically
from probedesign.core.frames import Array
from probedesign.core.units import MM
from probedesign.vision.camera import Camera
from probedesign.vision.markers import SUFFIXES, DetectedMarkers, Dot, ImageSide, find_markers, read_grey
from probedesign.vision.triangulate import triangulate

HEADER = "test,camera,marker,u_px,v_px,std_px"
CACHE = f"{PIXELS}.unfinished"
DETECTION_VERSION = 1  #: Version of the detection; a cache of another version is not used.
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

    Results are cached in the folder at once: after an interruption the next search continues from there.

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
        KeyboardInterrupt: with the number of cached photographs.
    """
    manifest = read_manifest(folder)
    if manifest.markers is None or manifest.cameras is None:
        lacking = "[markers] with s_mm" if manifest.markers is None else "[cameras] with names"
        raise InputError(f"{folder / MANIFEST}: has no {lacking}, which the detection of markers needs")
    taken = _photographs(folder, manifest, read_tests(folder, manifest))
    calibrated = base_side is None or calibration_exists(folder, manifest)
    cameras, notes = read_cameras(folder, manifest) if calibrated else ([], ())
    by_name = {camera.name: camera for camera in cameras}
    cache, s, total = DetectionCache(folder), np.array(manifest.markers.s_mm) * MM, sum(map(len, taken))
    progress = (number / total for number in itertools.count())
    first: dict[str, tuple[Path, tuple[int, ...]]] = {}

    def detect(photograph: Photograph) -> DetectedMarkers:
        """Return the markers of one photograph."""
        path, name = photograph.path, photograph.camera
        on_progress(f"dots of {path.name}", next(progress))
        width, height = size = read_grey(path).shape[::-1]
        stated = by_name[name].size_px if name in by_name else None
        if stated is not None and size != stated:
            raise InputError(f"{path}: has {width} x {height} px, but camera {name} was calibrated for {stated[0]} x "
                             f"{stated[1]}; take both with one setting")  # fmt: skip
        earlier, other = first.setdefault(name, (path, size))
        if size != other:
            raise InputError(f"{path}: has {width} x {height} px, but {earlier.name} of the same camera has "
                             f"{other[0]} x {other[1]}; take all with one setting")  # fmt: skip
        base = base_side or by_name[name].project(photograph.test.T_world_base[:3, 3])
        return cache.detect(path, s, base, dark)

    tests = []
    for photographs in taken:
        try:
            tests.append(_checked(photographs, tuple(map(detect, photographs)), by_name))
        except InputError as error:
            if not skip:
                hint = "(--skip leaves out the tests whose photographs are refused)"
                raise InputError(f"{error} {hint}") from None
            tests.append(PhotographedTest(photographs, problem=str(error)))
        except KeyboardInterrupt:
            done = len(cache)
            kept = f"; {done} photographs are cached, the same command continues from there" if done else ""
            raise KeyboardInterrupt(f"interrupted{kept}") from None
    if all(test.problem for test in tests):
        raise InputError(tests[0].problem)
    cached = (f"{cache.used} of {total} photographs were taken from the cache",) if cache.used else ()
    return tests, (*notes, *cached)


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
    check_free(folder, force)
    lines = [
        f"{test.test},{photograph.camera},{number},{u:.3f},{v:.3f},{std:.3f}"
        for test in tests
        for photograph, markers in zip(test.photographs, test.found, strict=bool(test.found))
        for number, ((u, v), std) in enumerate(zip(markers.pixels, markers.std_px, strict=True), 1)
    ]
    write_atomically(path, "\n".join([HEADER, *lines, ""]).encode())
    DetectionCache(folder).path.unlink(missing_ok=True)
    return path


def check_free(folder: Path, force: bool) -> None:
    """Refuse to replace `pixels.csv`, which may have been clicked by hand, without `force`."""
    check_overwrite(folder / PIXELS, force)


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


# cache of finished photographs


@dataclass
class DetectionCache:
    """Finished photographs of a campaign."""

    folder: Path  #: of the campaign.
    used: int = 0  #: number of results that were taken from the cache.
    _done: dict[str, DetectedMarkers] = field(init=False)

    def __post_init__(self) -> None:
        try:
            lines = self.path.read_text(encoding="utf-8").splitlines()
        except (OSError, ValueError):
            lines = []
        self._done = {}
        for line in lines:
            with suppress(ValueError, TypeError, KeyError):
                entry: dict[str, Any] = json.loads(line)
                rows = np.array(entry["dots"], dtype=float)
                if rows.ndim == 2 and rows.shape[1] == 7 and np.isfinite(rows).all():
                    dots = tuple(Dot(row[:2], float(row[2]), row[3:].reshape(2, 2)) for row in rows)
                    markers = DetectedMarkers(rows[:, :2], rows[:, 2], dots, bool(entry["dark"]))
                    self._done[str(entry["key"])] = markers

    @property
    def path(self) -> Path:
        """Path of the file."""
        return self.folder / CACHE

    def detect(self, photograph: Path, s: Array, base: Array | ImageSide, dark: bool | None) -> DetectedMarkers:
        """Return the markers of a photograph, see `find_markers`; appended to the file if it was not finished."""
        try:
            with photograph.open("rb") as file:
                content = hashlib.file_digest(file, "sha256").hexdigest()
        except OSError as error:
            raise InputError(f"{photograph}: cannot be read: {error.strerror}") from None
        arguments = json.dumps([DETECTION_VERSION, content, s.tolist(), np.asarray(base).tolist(), dark])
        key = hashlib.sha256(arguments.encode()).hexdigest()
        if key in self._done:
            self.used += 1
            return self._done[key]
        detected = find_markers(photograph, s, base, dark)
        dots = [[*dot.pixel, dot.std_px, *dot.shape.ravel()] for dot in detected.dots]
        line = json.dumps({"key": key, "dark": detected.dark, "dots": dots})
        try:
            with self.path.open("a", encoding="utf-8") as file:
                file.write(f"\n{line}\n")  # the newline in front ends an incomplete line
        except OSError as error:
            raise InputError(f"{self.path}: cannot be written: {error.strerror}") from None
        self._done[key] = detected
        return detected

    def __len__(self) -> int:
        return len(self._done)
