"""How firmly the exported flange holds the probe, as computed; nobody has measured it."""

import math

from probedesign.geometry import ProbeGeometry


def exported_root_radii(geometry: ProbeGeometry) -> float:
    """`root_rigid_radii` of a probe whose soft flange the exported clamp ring holds: negative, it yields.

    -0.428 exp(-0.44 r₀/h), h the flange's thickness: computed, not measured. Linear finite elements of full round
    bases Ø3 ... 25 mm at ν = 0.49, the lip held on both sides, the middle resting on the adapter without friction;
    the fit is within 0.003 of them, what the assumptions leave open is about 0.05 (docs/decisions/0006).

    Args:
        geometry: of the probe; bores and flattened sections were not computed.
    """
    return -0.428 * math.exp(-0.44 * geometry.base_radius / geometry.flange.thickness)
