"""
Error along the probe
=====================

The predicted error of one reading, by all error sources, before anything is printed.
"""

import matplotlib.pyplot as plt

import probedesign

probe = probedesign.build_probe(probedesign.load_design("large"))
places = [0.1 * k for k in range(2, 11)]
prediction = probe.predict(fractions=places, forces_N=(0.01, 0.02, 0.05), directions=("+y",))
for force in (0.01, 0.02, 0.05):
    rows = [c for c in prediction.conditions if c.force_N == force and c.predicted_error_mm is not None]
    plt.plot(
        [c.contact_fraction for c in rows], [c.predicted_error_mm for c in rows], "o-", label=f"{1e3 * force:g} mN"
    )
plt.xlabel("touched place, fraction of the length")
plt.ylabel("RMS error [mm]")
plt.ylim(bottom=0.0)
plt.legend(title="force")
plt.show()
