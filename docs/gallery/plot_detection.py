"""
What is felt
============

The smallest force that one reading detects with probability one half, along three probes of the paper.
"""

import matplotlib.pyplot as plt

import probedesign

places = [0.1 * k for k in range(2, 11)]
for name in ("large", "medium", "small"):
    probe = probedesign.build_probe(probedesign.load_design(name))
    detection = probe.predict(fractions=places, forces_N=(0.01,), directions=("+y",)).detection
    plt.semilogy([d.contact_fraction for d in detection], [d.detectable_force_mN for d in detection], "o-", label=name)
plt.xlabel("touched place, fraction of the length")
plt.ylabel("force that is felt [mN]")
plt.legend()
plt.show()
