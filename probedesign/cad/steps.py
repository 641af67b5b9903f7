"""The order in which the parts go together: what moves in each step, and what is told to the hands."""

from dataclasses import dataclass

from probedesign.cad.screws import ScrewUse
from probedesign.units import MM

UP, DOWN = 1, -1


@dataclass(frozen=True)
class Move:
    """Parts that come together onto another one.

    Attributes:
        parts: names.
        onto: the part that they are drawn away from.
        side: the side of it that they come from, UP or DOWN along the sensor's z.
    """

    parts: tuple[str, ...]
    onto: str
    side: int


@dataclass(frozen=True)
class Step:
    """One thing to do.

    Attributes:
        text: what.
        moves: of this step's parts, each onto what is there or moved before it.
        apart: done on the bench: what was put together before is not shown.
        seen_from_below: how its picture is taken.
    """

    text: str
    moves: tuple[Move, ...]
    apart: bool = False
    seen_from_below: bool = False

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of all that moves."""
        return tuple(name for move in self.moves for name in move.parts)


EXPLOSION = (
    Move(("flange_adapter",), "sensor", DOWN),
    Move(("mounting_screws",), "flange_adapter", DOWN),
    Move(("robot_bolts",), "flange_adapter", UP),
    Move(("dowel_pins",), "sensor", UP),
    Move(("sensor_adapter",), "dowel_pins", UP),
    Move(("ring_nuts",), "sensor_adapter", DOWN),
    Move(("sensor_adapter_screws",), "sensor_adapter", UP),
    Move(("probe",), "sensor_adapter_screws", UP),
    Move(("clamp_ring",), "probe", UP),
    Move(("ring_screws",), "clamp_ring", UP),
)
"""All parts drawn away from the sensor, in the order of assembly."""


def steps_of(screws: list[ScrewUse], pin_d: float) -> list[Step]:
    """The steps, with the screws that each one takes; pin_d: of the robot's dowel pin [m], 0 if it has none."""
    of = {use.name: f"{len(use.points)} {use.screw.thread}x{use.length / MM:g}" for use in screws}
    pin = f", its own {pin_d / MM:g} mm dowel pin in the slot" if pin_d > 0.0 else ""
    return [
        Step("screw the flange adapter to the sensor's mounting side from below: "
             f"{of['mounting_screws']}, never longer",
             (EXPLOSION[0], EXPLOSION[1])),
        Step(f"bolt the flange adapter to the robot: {of['robot_bolts']} from above{pin}",
             (EXPLOSION[2],)),
        Step("press M2 nuts into the four pockets of the sensor adapter and the 2 mm dowel pins into its underside",
             (Move(("ring_nuts",), "sensor_adapter", DOWN), Move(("dowel_pins",), "sensor_adapter", DOWN)),
             apart=True, seen_from_below=True),
        Step("screw the sensor adapter to the tool side from above through its recess: "
             f"{of['sensor_adapter_screws']}, never longer",
             (Move(("sensor_adapter", "ring_nuts", "dowel_pins"), "sensor", UP),
              Move(("sensor_adapter_screws",), "sensor_adapter", UP))),
        Step("lay the flange into the recess, its hole over the peg: peg and the flat on the rim are at +X",
             (Move(("probe",), "sensor_adapter", UP),)),
        Step(f"slip the clamp ring over the tip and screw it down with {of['ring_screws']} until it sits on "
             "the wall", (EXPLOSION[8], EXPLOSION[9])),
    ]  # fmt: skip
