"""
Thick or thin
=============

Five fused touches of up to 5 mN at 0.8 of the length, for probes of 150 mm with other base diameters. On a rigid object
the thick probe is better; an object that yields is located best by a probe that is softer than the object.
"""

import matplotlib.pyplot as plt

import probedesign

diameters = (6.0, 7.0, 8.0, 10.0, 12.0, 14.0)
for compliance, name in ((0.0, "rigid object"), (0.05, "object that yields, 0.05 m/N")):
    errors = []
    for base_d_mm in diameters:
        design = probedesign.new(length_mm=150.0, base_d_mm=base_d_mm, tip_d_mm=2.0)
        contact = design.contact.model_copy(update={"object_compliance_m_N": compliance})
        probe = probedesign.build_probe(design.model_copy(update={"contact": contact}))
        errors.append(probe.predict(fractions=(0.8,), forces_N=(0.005,)).fused_headline.predicted_error_mm)
    plt.plot(diameters, errors, "o-", label=name)
plt.xlabel("base diameter [mm]")
plt.ylabel("RMS error, worst direction [mm]")
plt.ylim(bottom=0.0)
plt.legend()
plt.show()
