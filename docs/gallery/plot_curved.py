"""
A curved probe
==============

The error of one reading of 5 mN at 0.8 of the length, over the direction of the force, of an arc; the straight probe of
the same diameters does not locate such a touch.
"""

import matplotlib.pyplot as plt
import numpy as np

import probedesign
from probedesign.prediction.predict import errors_over_directions

design = probedesign.new(length_mm=150.0, base_d_mm=8.0, tip_d_mm=2.0, axis="arc", axis_bend_deg=90.0)
over = errors_over_directions(probedesign.build_probe(design).estimator(), (0.8,), (0.005,))[0]
angles = np.linspace(0.0, 2.0 * np.pi, len(over.errors_mm) + 1)
axes = plt.subplot(projection="polar")
axes.plot(angles, [*over.errors_mm, over.errors_mm[0]], "o-")
axes.set_title(f"RMS error [mm], median {over.median_error_mm:.2g} mm")
plt.show()
