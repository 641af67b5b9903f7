"""
One reading
===========

The touched point that one reading of 20 mN gives, with the 95 % ellipse of all error sources and that of the sensor's
noise alone, seen from the side.
"""

import matplotlib.pyplot as plt
import numpy as np

import probedesign
from probedesign.core.statistics import ellipsoid_95

probe = probedesign.build_probe(probedesign.load_design("large"))
gravity = (9.81, 0.0, 0.0)
touch = probedesign.solve_frictionless(probe.rod, gravity, s_contact=0.09, angle=np.pi / 2, magnitude=0.02)
around = np.linspace(0.0, 2.0 * np.pi, 100)
circle = np.array([np.cos(around), np.sin(around)])
shape = touch.equilibrium.p_base
plt.plot(1e3 * shape[:, 2], 1e3 * shape[:, 1], "k", lw=3, label="probe")
for name, estimator in {"all error sources": probe.estimator(), "noise alone": probe.estimator(exact=True)}.items():
    c = estimator.estimate(touch.equilibrium.wrench_base, gravity_base=gravity)
    half_axes, axes = ellipsoid_95(c.cov_surface_base[np.ix_([2, 1], [2, 1])])
    ellipse = c.p_surface_base[[2, 1], None] + axes * half_axes @ circle
    plt.plot(*1e3 * ellipse, label=f"{name}: {1e3 * np.sqrt(np.trace(c.cov_surface_base)):.1f} mm RMS")
plt.xlabel("z [mm]")
plt.ylabel("y [mm]")
plt.axis("equal")
plt.legend()
plt.show()
