"""Control points: places known in the world and seen in one picture, and what may be wrong with them."""

from dataclasses import dataclass
from typing import NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from probedesign.errors import InputError
from probedesign.frames import Array
from probedesign.units import MM
from probedesign.vision.camera import LINEAR

MAX_DISTORTION = 2
FLAT_PX = 3.0
"""Control points that leave a plane by less than this [px, RMS] lie in it as far as a click tells: three times a
click's error of about a pixel (assumed)."""


@dataclass(frozen=True)
class ControlPoints:
    """What one camera is calibrated from.

    Attributes:
        camera: its name.
        labels: names of the points (n,).
        points_world: [m], (n, 3).
        pixels: u right, v down [px], (n, 2).
    """

    camera: str
    labels: tuple[str, ...]
    points_world: Array
    pixels: Array

    def of(self, chosen: NDArray[np.bool_]) -> "ControlPoints":
        """Some of them."""
        labels = tuple(np.array(self.labels, dtype=object)[chosen])
        return ControlPoints(self.camera, labels, self.points_world[chosen], self.pixels[chosen])

    def named(self, chosen: NDArray[np.bool_]) -> str:
        """Some of them, as one says it."""
        labels = [label for label, yes in zip(self.labels, chosen, strict=True) if yes]
        more = f" and {len(labels) - 6} more" if len(labels) > 6 else ""
        return f"point{'' if len(labels) == 1 else 's'} {', '.join(labels[:6])}{more}"

    def fail(self, problem: str) -> NoReturn:
        """Raise the error of this camera's control points."""
        raise InputError(f"camera {self.camera}: {problem}")

    @property
    def off_plane_m(self) -> float:
        """How far the points leave the plane that fits them best [m, RMS]."""
        return float(self._extents[2])

    @property
    def pixels_per_m(self) -> float:
        """Size of the picture [px/m]."""
        spread = np.linalg.norm(self.pixels - self.pixels.mean(axis=0)) / np.sqrt(len(self.pixels))
        return float(spread / np.linalg.norm(self._extents[:2]))

    @property
    def _extents(self) -> Array:
        centred = self.points_world - self.points_world.mean(axis=0)
        return np.asarray(np.linalg.svd(centred, compute_uv=False) / np.sqrt(len(centred)))

    def check_flat(self, least_px: float) -> None:
        """Refuse points in one plane.

        Args:
            least_px: that they must leave it by, seen across [px].

        Raises:
            InputError: they do not.
        """
        if self.off_plane_m * self.pixels_per_m < least_px:
            self.fail(
                f"its {len(self.labels)} control points lie in one plane, to {self.off_plane_m / MM:.2g} mm; "
                "add points in front of it or behind"
            )


def least_points(distortion: int) -> int:
    """Fewest control points that tell a camera and leave at least one equation to check it by."""
    return (LINEAR + distortion) // 2 + 1


def control_points(
    camera: str, points_world: ArrayLike, pixels: ArrayLike, labels: tuple[str, ...] | None, distortion: int
) -> ControlPoints:
    """Control points that are fit to calibrate with.

    Args:
        camera: its name.
        points_world: [m], (n, 3).
        pixels: (n, 2).
        labels: names of the points; 1 ... n if None.
        distortion: coefficients that will be fitted.

    Raises:
        InputError: shapes that do not match, no finite number, too few, doubled or coplanar points.
    """
    world, image = np.asarray(points_world, dtype=float), np.asarray(pixels, dtype=float)
    if world.ndim != 2 or world.shape[1] != 3 or image.shape != (len(world), 2):
        raise InputError(
            f"camera {camera}: control points must be n x 3 and pixels n x 2, not {world.shape}, {image.shape}"
        )
    control = ControlPoints(camera, labels or tuple(str(i + 1) for i in range(len(world))), world, image)
    if distortion not in range(MAX_DISTORTION + 1):
        control.fail(f"{distortion} coefficients of distortion; choose 0, 1 or 2")
    bad = ~(np.isfinite(world).all(axis=1) & np.isfinite(image).all(axis=1))
    if bad.any():
        control.fail(f"control {control.named(bad)}: a coordinate is no finite number")
    if len(world) < least_points(distortion):
        bends = f" and {distortion} of distortion" if distortion else ""
        control.fail(
            f"{len(world)} control points are too few for 11 parameters{bends}; "
            f"at least {least_points(distortion)}, better 20"
        )
    _check_twins(control, world, "stand at one place in the world")
    _check_twins(control, image, "have the same pixel")
    control.check_flat(FLAT_PX)
    return control


def _check_twins(control: ControlPoints, places: Array, what: str) -> None:
    """Refuse two points with the very same numbers: a line copied."""
    _, first, inverse = np.unique(places, axis=0, return_index=True, return_inverse=True)
    twin = first[inverse] != np.arange(len(places))
    if twin.any():
        second = int(np.argmax(twin))
        pair = f"{control.labels[first[inverse][second]]} and {control.labels[second]}"
        control.fail(f"control points {pair} {what}; keep one")
