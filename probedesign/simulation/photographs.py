"""Photographs of a synthetic campaign: one of each test by each camera."""

from collections.abc import Callable
from pathlib import Path

from probedesign import vision as stereo
from probedesign.simulation.ground_truth import State
from probedesign.simulation.stereo_render import Look, render
from probedesign.simulation.stereo_rig import SIZE_PX, Sight


def take_photographs(
    sight: Sight, states: list[State], folder: Path, seed: int, tell: Callable[[str, float | None], None]
) -> None:
    """Render and write images/TEST-CAMERA.png.

    Raises:
        MissingDependencyError: OpenCV, which writes them, is not installed.
    """
    stereo.require()
    from probedesign.vision.picture import write_png

    folder.mkdir()
    total = len(states) * len(sight.cameras)
    for i, state in enumerate(states):
        tube, dots = sight.tube(state.equilibrium), sight.dots(state.equilibrium)
        for k, camera in enumerate(sight.cameras):
            number = i * len(sight.cameras) + k
            tell("photographs", number / total)
            picture = render(camera, tube, dots, SIZE_PX, Look(seed=seed * 1000 + number))
            write_png(folder / f"{state.name}-{camera.name}.png", picture)
