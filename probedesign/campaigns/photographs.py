"""The photographs of a campaign: the dots in each, made into `pixels.csv`."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from probedesign.campaigns.cameras import read_cameras
from probedesign.campaigns.campaign import Test
from probedesign.campaigns.detection_cache import Kept, key_of
from probedesign.campaigns.manifest import FILE as MANIFEST
from probedesign.campaigns.manifest import Manifest, read_manifest
from probedesign.campaigns.pixels_table import FILE, IMAGES
from probedesign.campaigns.tables import read_tests
from probedesign.errors import InputError
from probedesign.files import write_atomically
from probedesign.frames import Array
from probedesign.units import MM
from probedesign.vision.camera import Camera
from probedesign.vision.finder import Found, find_markers
from probedesign.vision.marker_sequence import Side
from probedesign.vision.triangulate import triangulate

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

    What is found is kept in the folder at once: after an interruption the next search goes on from there.

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
        KeyboardInterrupt: with how many photographs are kept.
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
    search = _Search(cameras, np.array(manifest.markers.s_mm) * MM, base_side, dark, Kept(folder), tell,
                     sum(map(len, taken)))  # fmt: skip
    seen = []
    for photographs in taken:
        try:
            seen.append(search.test(photographs))
        except InputError as error:
            if not skip:
                raise InputError(
                    f"{error} (--skip leaves out the tests whose photographs are refused)"
                ) from None
            seen.append(Seen(photographs, problem=str(error)))
        except KeyboardInterrupt:
            raise KeyboardInterrupt(f"interrupted{search.words_of_kept}") from None
    if all(one.problem for one in seen):
        raise InputError(seen[0].problem)
    return seen, (*notes, *search.notes)


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
    Kept(folder).remove()
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


@dataclass
class _Search:
    """The search through all photographs of a campaign.

    Attributes:
        cameras: that are calibrated.
        s: arclength of the dots [m], (m,).
        base_side: None where the cameras tell.
        dark: whether the dots are darker than the probe; either if None.
        kept: what was found before.
        tell: of the progress.
        total: how many photographs there are.
        at: how many were looked at.
    """

    cameras: list[Camera]
    s: Array
    base_side: Side | None
    dark: bool | None
    kept: Kept
    tell: Tell
    total: int
    at: int = 0

    @property
    def notes(self) -> tuple[str, ...]:
        """That not all photographs were looked at now."""
        used = self.kept.used
        return (f"{used} of {self.total} photographs were done before and taken over",) if used else ()

    @property
    def words_of_kept(self) -> str:
        """For one who interrupts."""
        done = len(self.kept)
        return f"; photographs kept: {done}; the same command goes on from there" if done else ""

    def test(self, photographs: tuple[Photograph, ...]) -> Seen:
        """The dots of one test, checked by the cameras' agreement if they are calibrated."""
        by_name = {camera.name: camera for camera in self.cameras}
        found = [self._photograph(one, by_name.get(one.camera)) for one in photographs]
        if not self.cameras:
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

    def _photograph(self, one: Photograph, camera: Camera | None) -> Found:
        """The dots of one photograph, found now or before."""
        self.tell(f"dots of {one.path.name}", self.at / self.total)
        self.at += 1
        if self.base_side is None:
            assert camera is not None, "read_cameras has all that the campaign names"
            base: Array | Side = camera.project(one.test.T_world_base[:3, 3])
        else:
            base = self.base_side
        key = key_of(one.path, self.s, base, self.dark)
        found = self.kept.get(key)
        if found is None:
            found = find_markers(one.path, self.s, base, self.dark)
            self.kept.add(key, found)
        return found
