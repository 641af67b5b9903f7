"""
Five touches of one point
=========================

The base presses on against one point. Each further reading reduces the error, because the displacement of the base
against the moment measures where the probe touches.
"""

import matplotlib.pyplot as plt

import probedesign

probe = probedesign.build_probe(probedesign.load_design("large"))
estimator, gravity = probe.estimator(), (9.81, 0.0, 0.0)
forces = [0.001, 0.002, 0.003, 0.004, 0.005]
for fraction in (0.5, 0.65, 0.8):
    wrenches, poses = probedesign.press_poses(probe.rod, gravity, fraction * probe.length, -1.57, forces)
    fused = [estimator.fuse(wrenches[:n], poses[:n], gravity_world=gravity) for n in range(2, 6)]
    plt.plot(range(2, 6), [1e3 * f.rms for f in fused], "o-", label=f"{fraction:g} L")
plt.xlabel("readings, 1 to 5 mN")
plt.ylabel("stated RMS error [mm]")
plt.xticks(range(2, 6))
plt.ylim(bottom=0.0)
plt.legend(title="touched at")
plt.show()
