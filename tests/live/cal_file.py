"""A calibration file of either version. Its numbers are made up."""

import numpy as np

from probedesign.live.sources.daq import CHANNELS

U = np.array(
    [  # N and N·mm of a volt about the tool face
        [0.1, 0.0, 0.3, 3.3, 0.2, -3.3],
        [0.0, -4.0, 0.0, 1.9, -0.1, 1.9],
        [3.7, 0.1, 3.8, 0.0, 3.7, -0.1],
        [0.4, -24.4, 20.9, 12.0, -21.4, 12.0],
        [-23.6, -0.7, 12.5, -20.0, 10.9, 19.7],
        [0.1, -14.8, -0.3, -14.3, 1.0, -14.3],
    ]
)
MAX = (25, 25, 35, 250, 250, 250)
SCALE = (11.0, 11.0, 6.0, 1.8, 1.8, 1.5)
DZ = 6.096


def text(version: str, transform: str = 'Dx="0" Dy="0" Dz="6.096" Rx="0" Ry="0" Rz="0"', units: str = "N-mm") -> str:
    inner = U.copy()  # about the transducer's own origin, DZ below the face
    inner[3] -= DZ * U[1]
    inner[4] += DZ * U[0]
    rows = [("Axis", inner * np.array(SCALE)[:, None], ' scale="{}"')]
    if version == "1.1":
        rows.append(("UserAxis", U, ""))
    axes = "".join(
        f'<{tag} Name="{name}" values=" {" ".join(map(repr, map(float, row)))} " max="{top}"{extra.format(scale)}/>\n'
        for tag, matrix, extra in rows
        for name, row, top, scale in zip(CHANNELS, matrix, MAX, SCALE, strict=True)
    )
    return (
        f'<?xml version="1.0" encoding="utf-8"?>\n<FTSensor Serial="FT1" NumGages="6" CalFileVersion="{version}">'
        f'<Calibration PartNumber="SI-25-0.25" ForceUnits="N" TorqueUnits="{units}" DistUnits="mm">{axes}'
        f"<BasicTransform {transform}/></Calibration></FTSensor>"
    )
