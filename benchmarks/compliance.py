"""Which presses learn how far an object yields: stated error and compliance, by place, force and schedule.

`python -m benchmarks compliance`
"""

import math

import numpy as np

from benchmarks.timing import print_table
from probedesign.core.frames import Array, pose
from probedesign.core.units import MM
from probedesign.design.io import load_design
from probedesign.probe import build_probe
from tests.estimation.true_touches import TrueTouch, settle, sources_of

GRAVITY = np.array([9.81, 0.0, 0.0])  #: In the world [m/s²]: the probe is horizontal unless the base is turned.
TRUE_COMPLIANCE = 0.05  #: Of the object [m/N].
#: Name, arclength over length of each touch, force of the last one [N], and rotation of the base at each touch about
#: the axis of gravity [rad], which turns the probe in the horizontal plane.
SCHEDULES: tuple[tuple[str, tuple[float, ...], float, tuple[float, ...]], ...] = (
    ("five touches at 0.5 L, up to 5 mN", (0.5,) * 5, 0.005, (0.0,) * 5),
    ("five touches at 0.5 L, up to 20 mN", (0.5,) * 5, 0.02, (0.0,) * 5),
    ("five touches at 0.8 L, up to 5 mN", (0.8,) * 5, 0.005, (0.0,) * 5),
    ("five touches at 0.8 L, up to 20 mN", (0.8,) * 5, 0.02, (0.0,) * 5),
    ("three at 0.8 L and three at 0.5 L, up to 5 mN", (0.8, 0.8, 0.8, 0.5, 0.5, 0.5), 0.005, (0.0,) * 6),
    ("three at 0.8 L and three at 0.5 L, up to 20 mN", (0.8, 0.8, 0.8, 0.5, 0.5, 0.5), 0.02, (0.0,) * 6),
    ("three at 0.8 L, base turned by 60°, three more, up to 5 mN", (0.8,) * 6, 0.005, (0, 0, 0, 1.05, 1.05, 1.05)),
)


def _press(touch: TrueTouch, turn: float) -> tuple[Array, Array]:
    """Return the wrench at the base, (6,), and the pose of the base, (4, 4), of a touch of the origin at rest."""
    c, s = math.cos(turn), math.sin(turn)
    R = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    now = -TRUE_COMPLIANCE * R @ touch.force
    return touch.wrench, pose(R, now - R @ touch.p_surface)


def report() -> None:
    """Print stated error of the point and compliance for each schedule and each prior."""
    probe = build_probe(load_design("large"))
    estimator, sources = probe.estimator(), sources_of(probe.model, GRAVITY)
    rows = []
    for name, places, force, turns in SCHEDULES:
        last = len(places) // len(dict.fromkeys(zip(places, turns, strict=True)))
        presses = []
        for k, (place, turn) in enumerate(zip(places, turns, strict=True)):
            y = np.array([place * probe.length, -0.5 * math.pi, force * (k % last + 1) / last, 0.0, 0.0])
            if (touch := settle(sources, y)) is not None:
                presses.append(_press(touch, turn))
        wrenches, poses = (np.array(part) for part in zip(*presses, strict=True))
        for prior in (0.0, 0.05, 0.2):
            fused = estimator.fuse(wrenches, poses, GRAVITY, object_compliance=prior)
            low, high = fused.object_compliance_interval_95 / MM
            error = float(np.linalg.norm(fused.p_surface_world)) / MM
            rows.append([name, f"{prior:g}", fused.result, f"{fused.rms / MM:.2f}", f"{error:.2f}",
                         f"{low:.0f} to {high:.0f}"])  # fmt: skip
    title = f"The object yields by {TRUE_COMPLIANCE / MM:g} mm/N; readings without noise, all error sources counted"
    print_table(title, ["presses", "prior m/N", "result", "stated RMS mm", "error mm", "compliance mm/N, 95 %"], rows)
