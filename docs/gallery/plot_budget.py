"""
Where the error comes from
==========================

The error sources of one reading of 20 mN at three places; the squares add up to that of the whole error.
"""

import matplotlib.pyplot as plt

import probedesign

probe = probedesign.build_probe(probedesign.load_design("large"))
places = (0.4, 0.6, 0.8)
conditions = probe.predict(fractions=places, forces_N=(0.02,), directions=("+y",)).conditions
names = sorted(conditions[-1].budget_mm, key=conditions[-1].budget_mm.get)[-8:]
for k, condition in enumerate(conditions):
    at = [j + 0.27 * (k - 1) for j in range(len(names))]
    plt.barh(at, [condition.budget_mm[name] for name in names], 0.25, label=f"{places[k]:g} L")
plt.yticks(range(len(names)), names)
plt.xlabel("RMS error of this source alone [mm]")
plt.legend(title="touched at")
plt.tight_layout()
plt.show()
