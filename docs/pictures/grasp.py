"""Draw the picture of docs/grasp.md from the folder where its steps ran: `python docs/pictures/grasp.py FOLDER`.

From above: the points that each finger touched with their 95 % regions, the edge, and both fingers closed on the card.
From the front: the same edge over the height of the card.
"""

import csv
import json
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Ellipse

from probedesign.core.statistics import ellipsoid_95
from probedesign.core.units import MM

CARD_MM, COLOURS = (63.5, 88.9), {"left": "#1f5fa8", "right": "#d9730d"}


def draw(folder: Path) -> None:
    """Write grasp.png beside this script."""
    with (folder / "found/points.csv").open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["result"] == "ok"]
    shapes = json.loads((folder / "found/shapes.json").read_text("utf-8"))["shapes"]
    grasp = json.loads((folder / "grasp.json").read_text("utf-8"))
    edge = max((shape for shape in shapes if shape["kind"] == "edge"), key=lambda shape: len(shape["touches"]))
    ends = np.array(edge["p_mm"]) + np.outer(edge["extent_mm"][0], edge["axes"][2])
    figure, (top, front) = plt.subplots(1, 2, figsize=(9.0, 4.2), width_ratios=(1.7, 1.0), layout="constrained")
    for axes, across, title in ((top, 1, "from above"), (front, 2, "from the front")):
        plane = [0, across]
        for row in rows:
            finger = row["touch_numbers"].split()[0]
            p = np.array([float(row[f"{axis}_world_mm"]) for axis in "xyz"])[plane]
            cov = np.array([[float(row[f"cov_world_{''.join(sorted('xyz'[i] + 'xyz'[j]))}_mm2"]) for j in plane]
                            for i in plane])  # fmt: skip
            half, turn = ellipsoid_95(cov)
            angle = np.degrees(np.arctan2(turn[1, 1], turn[0, 1]))
            axes.add_patch(
                Ellipse(
                    p[::-1] if across == 1 else p,
                    2 * half[1],
                    2 * half[0],
                    angle=90.0 - angle if across == 1 else angle,
                    color=COLOURS[finger],
                    alpha=0.15,
                )
            )
            axes.plot(*(p[::-1] if across == 1 else p), ".", color=COLOURS[finger], ms=4)
        axes.set_title(title, fontsize=10)
        axes.set_aspect("equal")
    for finger, axis in grasp["axes"].items():
        x, y, z = np.array(axis).T / MM
        top.plot(y, x, color=COLOURS[finger], lw=3, solid_capstyle="round", label=f"{finger} finger, closed")
        front.plot(np.interp(0.0, y, x), np.interp(0.0, y, z), "o", color=COLOURS[finger], ms=9)
    top.plot((0.0, CARD_MM[0]), (0.0, 0.0), color="#a08c5a", lw=2, label="card, the truth")
    front.plot((0.0, 0.0), (0.0, CARD_MM[1]), color="#a08c5a", lw=2)
    front.plot(ends[:, 0], ends[:, 2], color="#0b7a4b", lw=1.5, label=f"edge ± {edge['rms_mm']:.1f} mm")
    top.set(xlabel="y, along the fingers [mm]", ylabel="x [mm]", ylim=(-32.0, 32.0))
    front.set(xlabel="x [mm]", ylabel="z [mm]", xlim=(-25.0, 25.0))
    top.legend(fontsize=8, loc="upper right")
    front.legend(fontsize=8)
    figure.savefig(Path(__file__).with_name("grasp.png"), dpi=110)


if __name__ == "__main__":
    draw(Path(sys.argv[1]))
