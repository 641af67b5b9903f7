"""
The bent probe
==============

The large probe, mounted sideways, under its own weight and under a force of 5 to 40 mN at 0.8 of its length.
"""

import matplotlib.pyplot as plt

import probedesign

probe = probedesign.build_probe(probedesign.load_design("large"))
s = 0.8 * probe.length
for force in (0.0, 0.005, 0.010, 0.020, 0.040):
    shape = probe.solve(s_contact=s, force_base=(0.0, force, 0.0))
    plt.plot(1e3 * shape.p_base[:, 2], 1e3 * shape.p_base[:, 1], label=f"{1e3 * force:g} mN")
    plt.plot(*1e3 * shape.p_at([s])[0, [2, 1]], "k.")
plt.xlabel("z [mm]")
plt.ylabel("y [mm]")
plt.axis("equal")
plt.legend(title="force")
plt.show()
