"""The force that closes the clamp, the preload of the ring's screws, and the bending of the ring; see `lip`."""

import math
from dataclasses import dataclass
from typing import Any

from probedesign.core.units import MM, MPA
from probedesign.design.catalog import SocketScrew
from probedesign.mount.flange_adapter import FlangeAdapter
from probedesign.mount.lip import MAX_BENDING_SHARE, pad_force
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


@dataclass(frozen=True)
class ClampForce:
    """Force of the lip against the preload of the ring's screws [N]."""

    nominal: float  #: force of the lip at the nominal compression.
    range: tuple[float, float]  #: its range with the tolerances of compression, E and formula, taken as independent.
    preload: float  #: of all screws of the ring together, at the torque of the bill of materials.
    torque: float  #: of one screw [N·m].
    screws: int  #: their number.
    #: of the ring's inner edge at the nominal force, with the rim clamped and simply supported [m].
    bending: tuple[float, float]
    squeeze: float  #: nominal compression of the lip between rigid parts [m].

    @property
    def bending_share(self) -> float:
        """Return the ring's bending, the mean of both supports, over the compression of the lip."""
        return sum(self.bending) / 2.0 / self.squeeze

    def as_record(self) -> dict[str, Any]:
        """Return the record of the manifest."""
        return {
            "lip_force_N": round(self.nominal, 1),
            "lip_force_range_N": [round(force, 1) for force in self.range],
            "preload_N": round(self.preload, 1),
            "torque_Nm": self.torque,
            "screws": self.screws,
            "ring_bending_mm": [round(bending / MM, 3) for bending in self.bending],
            "closes": self.range[1] <= self.preload and self.bending_share <= MAX_BENDING_SHARE * (1.0 + 1e-9),
            "source": "computed, not measured: Gent and Lindley 1959 and finite elements for the lip; Roark's formulas "
            f"for the ring; preload from the torque with a nut factor of {NUT_FACTOR:g} (Shigley)",
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
        bending=a.ring_bending(nominal),
        squeeze=squeeze.nominal,
    )
