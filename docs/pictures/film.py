"""Draw the film of the README: a probe presses on the edge of a card, and each reading shrinks the region of the edge.

By hand, it takes half a minute: `python docs/pictures/film.py`.
"""

from io import BytesIO
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Ellipse
from PIL import Image

import probedesign
from probedesign.core.statistics import ellipsoid_95
from probedesign.core.units import MM
from probedesign.rod.contact import solve_surface_force

OUT = Path(__file__).with_name("film.webp")
FRACTION, GRAVITY = 0.8, (9.81, 0.0, 0.0)
FORCES = (0.001, 0.002, 0.003, 0.004, 0.005)  #: Of the five readings [N].
RATE = 10  #: Frames a second.
APPROACH = 20.0 * MM  #: Distance of the base before the touch [m].
SIDE = [2, 1]  #: Axes of the picture: along the probe, and of the press.


def frames() -> list[Image.Image]:
    """Return the frames: the approach, and five readings at rest."""
    probe = probedesign.build_probe(probedesign.load_design("large"))
    estimator, s = probe.estimator(), FRACTION * probe.length
    forces = np.concatenate([[1e-5], *(np.linspace(a, b, 9)[1:] for a, b in zip((0.0, *FORCES), FORCES, strict=False))])
    wrenches, poses = probedesign.press_poses(probe.rod, GRAVITY, s, -np.pi / 2, forces)
    readings = [int(np.argmin(np.abs(forces - force))) for force in FORCES]
    bent = [probe.solve(GRAVITY) if force < 1e-4 else None for force in forces]
    pictures, region, text = [], None, "A soft probe, a force/torque sensor at its base, the edge of a card."
    for away in np.linspace(APPROACH, 0.0, 2 * RATE, endpoint=False):
        shift = np.array([0.0, away, 0.0])
        pictures.append(_frame(bent[0].p_base + poses[0, :3, 3] + shift, region, text))
    for k, force in enumerate(forces):
        shape = solve_surface_force(probe.rod, GRAVITY, s, -np.pi / 2, force).equilibrium
        line = shape.p_base + poses[k, :3, 3]
        text = f"It bends under {1e3 * force:.1f} mN."
        if k in readings:
            upto = readings[: readings.index(k) + 1]
            fused = estimator.fuse(wrenches[upto], poses[upto], gravity_world=GRAVITY)
            if fused.result == "ok":
                region = (fused.p_surface_world[SIDE], fused.cov_surface_world[np.ix_(SIDE, SIDE)])
                within = f"the edge is located within {1e3 * fused.rms:.1f} mm"
                text = f"{len(upto)} readings up to {1e3 * force:g} mN: {within}."
            else:
                text = "One reading of 1 mN is felt, and not located."
            pictures += [_frame(line, region, text)] * (2 * RATE)
        pictures.append(_frame(line, region, text))
    return pictures


def _frame(line: np.ndarray, region: tuple[np.ndarray, np.ndarray] | None, text: str) -> Image.Image:
    """Draw the centreline (n, 3) in the world [m], the 95 % ellipse of the edge, and a line of text."""
    figure, axes = plt.subplots(figsize=(6.4, 3.2), dpi=100)
    axes.plot(*line[:, SIDE].T / MM, color="#e0b458", lw=5, solid_capstyle="round")
    axes.plot(*line[0, SIDE] / MM, "s", color="#555555", ms=16)
    axes.plot([0.0, 0.0], [0.0, -60.0], color="#1a5fa8", lw=2)
    axes.plot(0.0, 0.0, ".", color="#1a5fa8", ms=8)
    if region is not None:
        half, turn = ellipsoid_95(region[1])
        angle = np.degrees(np.arctan2(turn[1, 0], turn[0, 0]))
        axes.add_patch(Ellipse(region[0] / MM, *2.0 * half / MM, angle=angle, color="#d1495b", alpha=0.35))
    axes.set(xlim=(-130.0, 45.0), ylim=(-40.0, 40.0), aspect="equal")
    axes.set_axis_off()
    axes.plot([20.0, 40.0], [31.0, 31.0], color="#555555", lw=2)
    axes.text(30.0, 33.0, "20 mm", ha="center", color="#555555")
    figure.text(0.5, 0.03, text, ha="center", fontsize=12)
    figure.subplots_adjust(0.0, 0.08, 1.0, 1.0)
    picture = BytesIO()
    figure.savefig(picture, facecolor="white")
    plt.close(figure)
    return Image.open(picture).convert("RGB")


if __name__ == "__main__":
    film = frames()
    film[0].save(OUT, save_all=True, append_images=film[1:], duration=1000 // RATE, loop=0, quality=60)
    print(f"wrote {OUT}: {len(film) / RATE:g} s, {OUT.stat().st_size / 1e3:.0f} kB")
