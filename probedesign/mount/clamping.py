"""Force that compresses the flange's lip until the ring rests on the wall, and the preload of the ring's screws.

The lip between ring and land is a thin pad of rubber, which bulges more than it is compressed. By Gent and Lindley a
pad that sticks to both plates has the apparent modulus E (1 + 2 S²), with S the loaded area over the area that is free
to bulge, and at a stretch λ of its height the pressure E (1 + 2 S²) (1/λ² - λ)/3. For a ring of width w and thickness
t, free at both edges, S = w/(2 t). Here soft resin lies beside both edges and impedes the bulging; S = (w + t)/(2 t),
as if the pad were wider by half its thickness on each side, reproduces finite elements (`python -m benchmarks clamp`).

Source: A. N. Gent, P. B. Lindley, The compression of bonded rubber blocks, Proc. Inst. Mech. Eng. 173, 111-122, 1959.
"""

import math
from dataclasses import dataclass
from typing import Any

from probedesign.core.units import MPA
from probedesign.design.catalog import SocketScrew
from probedesign.mount.flange_adapter import FlangeAdapter
from probedesign.mount.sensor_adapter import SensorAdapter
from probedesign.mount.tolerance_stack import tolerance_stacks

NUT_FACTOR = 0.2
"""Torque over preload and diameter, dry steel. Source: Shigley, Mechanical Engineering Design, table 8-15."""
RESIN_PRESSURE = 20.0 * MPA
"""Permanent pressure under a screw's head: a third of a rigid resin's strength of about 60 MPa (assumed; it creeps)."""
MODEL_RANGE = 0.7, 1.8
"""Finite elements over the formula for bases of 5 to 25 mm and the default lip (`python -m benchmarks clamp`): with
faces that slip and a flange that does not touch the recess's wall, and with faces that stick and a flange that moves
out to the wall. Up to 2.2 if it has no play there from the beginning."""
MODULUS_TOLERANCE = 0.3
"""Three standard deviations of E, relative: published fits for Elastic 50A lie between 2.3 and 3.15 MPa (assumed for
other resins)."""


def hand_torque(screw: SocketScrew, below_nut: float = math.inf) -> float:
    """Return the torque [N·m] that presses a head or a nut on its seat with `RESIN_PRESSURE`, one digit.

    Args:
        screw: the screw.
        below_nut: area on which a nut bears [m²]; infinite for a thread in metal.
    """
    below_head = math.pi / 4 * (screw.head_d**2 - screw.clearance_d**2)
    torque = NUT_FACTOR * RESIN_PRESSURE * min(below_head, below_nut) * screw.nominal_d
    digit = 10.0 ** math.floor(math.log10(torque))
    return float(f"{math.floor(torque / digit) * digit:.1g}")


def ring_torque(a: SensorAdapter) -> float:
    """Return the torque [N·m] of the ring's screws, which the resin below heads and nuts allows."""
    below_nut = math.sqrt(0.75) * a.options.nut.af**2 - math.pi / 4 * a.roof_hole_d**2
    return hand_torque(a.ring_screw, below_nut)


def pad_force(modulus: float, inner_d: float, outer_d: float, thickness: float, compression: float) -> float:
    """Return the force [N] that compresses a ring of rubber beside more rubber; zero without compression.

    Args:
        modulus: E [Pa].
        inner_d, outer_d: of the ring [m].
        thickness: uncompressed [m].
        compression: of the thickness [m].
    """
    width, stretch = (outer_d - inner_d) / 2, 1.0 - max(compression, 0.0) / thickness
    shape_factor = (width + thickness) / (2.0 * thickness)
    area = math.pi / 4 * (outer_d**2 - inner_d**2)
    return modulus * (1.0 + 2.0 * shape_factor**2) * (stretch**-2 - stretch) / 3.0 * area


@dataclass(frozen=True)
class ClampForce:
    """Force of the lip against the preload of the ring's screws [N].

    Attributes:
        nominal: force of the lip at the nominal compression.
        range: its range with the tolerances of compression, E and formula, taken as independent.
        preload: of all screws of the ring together, at the torque of the bill of materials.
        torque: of one screw [N·m].
        screws: their number.
    """

    nominal: float
    range: tuple[float, float]
    preload: float
    torque: float
    screws: int

    def as_record(self) -> dict[str, Any]:
        """Return the record of the manifest."""
        return {
            "lip_force_N": round(self.nominal, 1),
            "lip_force_range_N": [round(force, 1) for force in self.range],
            "preload_N": round(self.preload, 1),
            "torque_Nm": self.torque,
            "screws": self.screws,
            "closes": self.range[1] <= self.preload,
            "source": "computed, not measured: Gent and Lindley 1959 and finite elements for the lip; preload from the "
            f"torque with a nut factor of {NUT_FACTOR:g} (Shigley)",
        }


def clamp_force(a: SensorAdapter, plate: FlangeAdapter, modulus: float) -> ClampForce:
    """Return the force that closes the clamp.

    The range takes the compression at the root sum of squares of its tolerances. With more force than the preload the
    ring does not reach the wall: the lip is compressed less, and not evenly.

    Args:
        a, plate: of the mount.
        modulus: E of the probe's resin [Pa].
    """
    squeeze = next(stack for stack in tolerance_stacks(a, plate) if stack.name == "lip_squeeze")

    def force(compression: float) -> float:
        return pad_force(modulus, a.ring_bore_d, a.land_d, a.flange.thickness, compression)

    nominal = force(squeeze.nominal)
    least, greatest = (math.hypot(force(end) / nominal - 1.0, MODULUS_TOLERANCE) for end in squeeze.rss)
    low, high = MODEL_RANGE
    torque, screws = ring_torque(a), len(a.p_ring_screws)
    return ClampForce(
        nominal=nominal,
        range=(low * nominal * max(1.0 - least, 0.0), high * nominal * (1.0 + greatest)),
        preload=screws * torque / (NUT_FACTOR * a.ring_screw.nominal_d),
        torque=torque,
        screws=screws,
    )
