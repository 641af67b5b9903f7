"""Compliance of the probe's root in the exported mount, computed by finite elements."""

import math

from probedesign.geometry import ProbeGeometry

BONDED_FACE = 0.12
"""`root_rigid_radii` of a base that is bonded at s = 0 to something rigid (docs/decisions/0006)."""


def exported_root_radii(geometry: ProbeGeometry) -> float:
    """Return `root_rigid_radii` of a probe whose soft flange the exported ring clamps; negative, since it yields.

    -0.428 exp(-0.44 r₀/h) with h the flange's thickness: computed, not measured. Linear finite elements of full round
    bases Ø3 ... 25 mm at ν = 0.49, the lip fixed on both sides, the centre supported by the adapter without friction;
    the fit is within 0.003 of them; the assumptions leave an uncertainty of about 0.05 (docs/decisions/0006).

    Args:
        geometry: of the probe; bores and elliptic sections were not computed.
    """
    return -0.428 * math.exp(-0.44 * geometry.base_radius / geometry.flange.thickness)
