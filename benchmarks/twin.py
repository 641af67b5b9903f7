"""The chain for MuJoCo against the rod: statics, first frequency, and time of a step."""

import math
from dataclasses import replace
from functools import partial

import mujoco
import numpy as np

from benchmarks.timing import format_seconds, interleaved, print_table
from probedesign.design.io import load_design
from probedesign.geometry import Axis
from probedesign.geometry.cross_section import CrossSection
from probedesign.probe import build_probe
from probedesign.rod.rod import natural_frequency
from probedesign.simulation.twin import twin_files
from tests.simulation.mujoco_statics import Twin

GRAVITY = ((9.81, 0.0, 0.0), (0.0, 0.0, 9.81), (0.0, 0.0, -9.81))
FORCES = ((0.01, 0.0, 0.0), (-0.03, 0.0, 0.0), (0.0, 0.05, 0.0), (0.0, -0.03, 0.03))
FRACTIONS = (0.5, 0.7, 0.9)
STEPS = 500  #: Of MuJoCo in a round.


def report() -> None:
    """Print the largest errors over all loads, and the times."""
    model = build_probe(load_design("large")).model
    rod, rows, steps = model.rod, [], {}
    axis = Axis.helix(rod.length, math.pi / 2.0)
    tube = CrossSection(bore_ratio=0.6).factors
    rods = {"straight": rod, "hollow, bore 0.6": replace(rod, factors=tube, finite_strain=False),
            "arc of 90°": replace(rod, rest_curvature=axis.rest_curvature(rod.s))}  # fmt: skip
    for links in (10, 14):
        for name, body in rods.items():
            moment = place = 0.0
            for gravity in GRAVITY:
                probe = replace(model, rod=body, gravity_base=np.array(gravity))
                twin = Twin(twin_files(probe, ["mjcf"], links)["large.xml"], body)
                for s in body.length * np.array(FRACTIONS):
                    for force in FORCES:
                        exact = body.solve(gravity, force, s)
                        p, wanted = twin.load(gravity, force, s), exact.wrench_base[3:]
                        error = twin.moment(p, force) - wanted
                        moment = max(moment, float(np.linalg.norm(error) / np.linalg.norm(wanted)))
                        place = max(place, float(np.linalg.norm(p - exact.p_contact_base)))
            frequency = twin.frequency(gravity) / natural_frequency(body, gravity) - 1.0
            rows.append(
                [name, str(links), f"{100 * moment:.2f} %", f"{1e3 * place:.2f} mm", f"{100 * frequency:.2f} %"]
            )
            steps[f"{name}, {links} links"] = partial(mujoco.mj_step, twin.model, twin.data, STEPS)
    times = interleaved(steps, 15)
    for row, seconds in zip(rows, times.values(), strict=True):
        row.append(format_seconds(seconds / STEPS))
    head = ["large probe", "links", "base moment", "touched point", "first frequency, upright", "a step"]
    print_table("MJCF against the rod, 10 to 50 mN at 0.5 to 0.9 L, three directions of gravity", head, rows)
