"""
How soft is what I touch
========================

An object of 33 N/m is pressed at one place of the probe, and at two. The stiffness of the object is a result, with its
95 % interval; presses at one place cannot tell it from the stiffness of the probe.
"""

import matplotlib.pyplot as plt
import numpy as np

import probedesign

probe = probedesign.build_probe(probedesign.load_design("large"))
gravity, forces, true = (9.81, 0.0, 0.0), (0.002, 0.004, 0.006), 0.03
presses = [
    probedesign.press_poses(probe.rod, gravity, fraction * probe.length, -1.57, forces, object_compliance=true)
    for fraction in (0.8, 0.5)
]
estimator, results = probe.estimator(), {}
results["0.8 L"] = estimator.fuse(*presses[0], gravity_world=gravity)
results["0.8 L and 0.5 L"] = estimator.fuse(*map(np.concatenate, zip(*presses, strict=True)), gravity_world=gravity)
for k, result in enumerate(results.values()):
    low, high = result.object_compliance_interval_95
    plt.plot([1e3 * low, 1e3 * high], [k, k], lw=6, alpha=0.5)
    plt.plot(1e3 * result.object_compliance, k, "ko")
plt.axvline(1e3 * true, color="0.5", ls="--")
plt.yticks(range(len(results)), results)
plt.ylim(-0.5, 1.5)
plt.xlabel("compliance of the object [mm/N]")
plt.tight_layout()
plt.show()
