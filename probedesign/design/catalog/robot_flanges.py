"""Robot flanges: the ISO 9409-1 patterns to which the flange adapter is bolted."""

from dataclasses import dataclass

from probedesign.core.errors import unknown_name
from probedesign.core.units import MM


@dataclass(frozen=True)
class RobotFlange:
    """A flange pattern. Azimuths are measured from the dowel hole; lengths are in metres.

    Attributes:
        bolt_circle_d: of the tapped holes and of the dowel.
        bolt_azimuths_deg: of the tapped holes, from the dowel.
        bolt: thread name.
        bolt_clearance_d: through hole in the adapter.
        bolt_head_d: of a socket head screw (ISO 4762).
        max_bolt_entry: largest depth to which a screw may enter the robot.
        bolt_length: length of the stock screw for which the adapter is dimensioned.
        pin_slot: width and radial length of the slot for the dowel pin; zeros for none.
        spigot: diameter and height of the centring boss; zeros for none.
        face_d: diameter of the flange's face.
        source: of the numbers.
    """

    name: str
    bolt_circle_d: float
    bolt_azimuths_deg: tuple[float, ...]
    bolt: str
    bolt_clearance_d: float
    bolt_head_d: float
    max_bolt_entry: float
    bolt_length: float
    pin_slot: tuple[float, float]
    spigot: tuple[float, float]
    face_d: float
    source: str

    @property
    def pin_d(self) -> float:
        """Return the diameter of the dowel pin that fits the slot with 0.2 mm of play [m]; 0 without a slot."""
        return max(self.pin_slot[0] - 0.2 * MM, 0.0)


ROBOT_FLANGES = {
    f.name: f
    for f in (
        RobotFlange(
            name="iso-9409-1-50-4-m6",
            bolt_circle_d=50.0 * MM,
            bolt_azimuths_deg=(45.0, 135.0, 225.0, 315.0),
            bolt="M6",
            bolt_clearance_d=6.6 * MM,
            bolt_head_d=10.0 * MM,
            max_bolt_entry=6.0 * MM,
            bolt_length=12.0 * MM,
            pin_slot=(6.2 * MM, 9.0 * MM),
            spigot=(31.3 * MM, 4.0 * MM),
            face_d=63.0 * MM,
            source="ISO 9409-1-50-4-M6 (UR, Franka)",
        ),
        RobotFlange(
            name="iso-9409-1-31.5-4-m5",
            bolt_circle_d=31.5 * MM,
            bolt_azimuths_deg=(45.0, 135.0, 225.0, 315.0),
            bolt="M5",
            bolt_clearance_d=5.5 * MM,
            bolt_head_d=8.5 * MM,
            max_bolt_entry=6.0 * MM,  # assumed: thread depth of the M5 pattern is not in our sources
            bolt_length=12.0 * MM,
            pin_slot=(5.2 * MM, 8.0 * MM),  # assumed by analogy with the 50 mm pattern
            spigot=(19.8 * MM, 4.0 * MM),  # Ø20 H7 recess less 0.2 mm, as for the 50 mm pattern
            face_d=40.0 * MM,
            source="ISO 9409-1-31.5-4-M5",
        ),
    )
}


CUSTOM = "own"
"""Value of `mount.robot_flange` where the pattern is in the design file itself, in `[mount.flange]`."""
BOLTS = {
    "M4": (4.5 * MM, 7.0 * MM),
    "M5": (5.5 * MM, 8.5 * MM),
    "M6": (6.6 * MM, 10.0 * MM),
    "M8": (9.0 * MM, 13.0 * MM),
}
"""Clearance hole (ISO 273, medium) and head (ISO 4762) by thread."""


def custom_flange(
    bolt: str,
    circle_d: float,
    azimuths_deg: tuple[float, ...],
    max_entry: float,
    length: float,
    face_d: float,
    pin_slot: tuple[float, float] | None,
    spigot: tuple[float, float] | None,
) -> RobotFlange:
    """Return a pattern that is not in the catalog; arguments as the attributes of `RobotFlange` [m]."""
    none = (0.0, 0.0)
    return RobotFlange(
        CUSTOM, circle_d, azimuths_deg, bolt, *BOLTS[bolt], max_entry, length, pin_slot or none, spigot or none, face_d,
        "design file, mount.flange",
    )  # fmt: skip


def robot_flange_named(name: str) -> RobotFlange:
    """Return the flange of that name.

    Raises:
        InputError: no such flange.
    """
    try:
        return ROBOT_FLANGES[name]
    except KeyError:
        raise unknown_name("mount.robot_flange", name, [*ROBOT_FLANGES, CUSTOM]) from None
