"""
Sag by orientation
==================

How far the tip of the large probe sinks under its own weight, by the angle between its axis and the vertical. Pointing
up, it is a column under its own weight.
"""

import matplotlib.pyplot as plt
import numpy as np

import probedesign

probe = probedesign.build_probe(probedesign.load_design("large"))
angles = np.linspace(0.0, 180.0, 37)
sag = []
for angle in np.radians(angles):
    gravity = 9.81 * np.array([np.sin(angle), 0.0, np.cos(angle)])  # 0: the probe hangs, along +z
    tip = probe.solve(gravity_base=gravity).p_at([probe.length])[0]
    sag.append(1e3 * np.linalg.norm(tip - [0.0, 0.0, probe.length]))
plt.plot(angles, sag)
plt.xlabel("angle from hanging (0) to upright (180) [deg]")
plt.ylabel("displacement of the tip [mm]")
plt.xticks(range(0, 181, 30))
plt.show()
