"""Assembly order: what is mounted in each step, and exploded views of all parts and of each step."""

import base64
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from probedesign.cad.render import OrthographicCamera, RenderBody, fit_view, png_bytes, render_bodies, render_png
from probedesign.cad.solids import ScrewGroup
from probedesign.core.svg import Anchor, Canvas
from probedesign.core.units import MM
from probedesign.design.sensors import DowelPattern

UP, DOWN = 1, -1


@dataclass(frozen=True)
class Move:
    """Parts that are mounted onto another part."""

    parts: tuple[str, ...]  #: names.
    onto: str  #: the part that they are moved away from.
    side: int  #: UP or DOWN along the sensor's z.


@dataclass(frozen=True)
class AssemblyStep:
    """One step of the assembly."""

    text: str  #: the instruction.
    moves: tuple[Move, ...]  #: of this step's parts, each onto a part that is present or moved before it.
    on_bench: bool = False  #: whether it is done on the bench, so that earlier parts are not shown.
    seen_from_below: bool = False  #: whether its picture is taken from below.

    @property
    def parts(self) -> tuple[str, ...]:
        """Return the names of all parts that are mounted."""
        return tuple(name for move in self.moves for name in move.parts)


EXPLOSION = (
    Move(("centring_pins",), "sensor", DOWN),
    Move(("flange_adapter",), "centring_pins", DOWN),
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
"""All parts moved away from the sensor, in the order of assembly."""


def explosion(names: Collection[str]) -> tuple[Move, ...]:
    """Return the moves of an assembly with these parts: a robot flange may leave no room for the centring pins."""
    if "centring_pins" in names:
        return EXPLOSION
    return (Move(("flange_adapter",), "sensor", DOWN), *EXPLOSION[2:])


def assembly_steps(
    screws: list[ScrewGroup], dowels: DowelPattern, pin_d: float, centring_pins: int, glued: bool = False
) -> list[AssemblyStep]:
    """Return the steps of the assembly.

    Args:
        screws: of the assembly.
        dowels: of the sensor's tool face.
        pin_d: diameter of the robot's dowel pin [m], 0 if there is none.
        centring_pins: number of pins around the sensor's body.
        glued: whether the flange's underside is glued.
    """
    centred = (
        f"press the {centring_pins} centring pins into the flange adapter as deep as they go, set the sensor "
        "between them with its cable over the pocket, and "
        if centring_pins
        else ""
    )
    plate = explosion(("centring_pins",) if centring_pins else ())[: 2 if centring_pins else 1]
    film = "spread a thin film of flexible cyanoacrylate on the land only, none in groove and notch or on screw heads, "
    glue = film if glued else ""
    nut = next(use.screw.thread for use in screws if use.name == "ring_screws")
    of = {use.name: f"{len(use.points)} {use.screw.thread}x{use.length / MM:g}" for use in screws}
    pin = f", its own {pin_d / MM:g} mm dowel pin in the slot" if pin_d > 0.0 else ""
    return [
        AssemblyStep(f"{centred}screw the flange adapter to the sensor's mounting side from below: "
             f"{of['mounting_screws']}, never longer",
             (*plate, Move(("mounting_screws",), "flange_adapter", DOWN))),
        AssemblyStep(f"bolt the flange adapter to the robot: {of['robot_bolts']} from above{pin}; tie the cable to the "
             "plate through the two slots, with a slack loop before the tie",
             (Move(("robot_bolts",), "flange_adapter", UP),)),
        AssemblyStep(f"press the {dowels.diameter / MM:g} mm dowel pins into the underside of the sensor adapter, and "
             f"slide {nut} nuts into its four slots from the side; they lie on the slots' floors as long as the "
             "adapter is upright",
             (Move(("ring_nuts",), "sensor_adapter", DOWN), Move(("dowel_pins",), "sensor_adapter", DOWN)),
             on_bench=True, seen_from_below=True),
        AssemblyStep("screw the sensor adapter to the tool side from above through its recess: "
             f"{of['sensor_adapter_screws']}, never longer",
             (Move(("sensor_adapter", "ring_nuts", "dowel_pins"), "sensor", UP),
              Move(("sensor_adapter_screws",), "sensor_adapter", UP))),
        AssemblyStep(f"{glue}lay the flange into the recess, its hole over the peg: peg and the flat on the rim are "
             "at +X",
             (Move(("probe",), "sensor_adapter", UP),)),
        AssemblyStep("slip the clamp ring over the tip, with an even gap around the probe, and screw it down with "
             f"{of['ring_screws']} until it sits on the wall",
             (Move(("clamp_ring",), "probe", UP), Move(("ring_screws",), "clamp_ring", UP))),
    ]  # fmt: skip


GAP = 8.0
"""Distance between exploded parts [mm]."""
EXPLODED_SIZE, STEP_SIZE = (560, 1300), (360, 320)
ABOVE = 25.0
"""Length of the probe that a step's picture shows above all other parts [mm]."""
FIXED_PART = "sensor"
LABEL_WIDTH, LINE = 285.0, 19.0
"""Width of the label column, and line spacing of a label [px]."""
FROM_ABOVE, FROM_BELOW = OrthographicCamera(), OrthographicCamera(elevation_deg=-28.0)

Bodies = Mapping[str, RenderBody]


@dataclass(frozen=True)
class PartLabel:
    """The label of a part."""

    number: int  #: in the bill of materials.
    lines: tuple[str, str]  #: its name and its description.


def exploded_bodies(bodies: Bodies, moves: Iterable[Move], seat: float) -> dict[str, RenderBody]:
    """Return the bodies with each move's parts translated away from their assembled position.

    Args:
        bodies: all in their places.
        moves: each onto a body that is fixed or moved before.
        seat: z up to which the probe counts [mm]: the ring is drawn around the probe, not beyond its tip.
    """
    lifts = dict.fromkeys(bodies, 0.0)
    for move in moves:
        spans = [bodies[name].span for name in move.parts]
        bottom, top = bodies[move.onto].span
        if move.onto == "probe":
            top = seat
        away = bottom - GAP - max(s[1] for s in spans) if move.side == DOWN else top + GAP - min(s[0] for s in spans)
        lifts |= dict.fromkeys(move.parts, lifts[move.onto] + away)
    return {name: body.translated(lifts[name]) for name, body in bodies.items()}


def step_pictures(bodies: Bodies, steps: Sequence[AssemblyStep], seat: float) -> list[bytes]:
    """Return a PNG of each step: its parts on their way, and the parts mounted before in a paler colour."""
    pictures, there = [], [FIXED_PART]
    for step in steps:
        onto = [move.onto for move in step.moves if move.onto not in step.parts]
        before = [name for name in (onto if step.on_bench else there) if name not in step.parts]
        shown = {name: bodies[name].faded() for name in dict.fromkeys(before)}
        shown |= {name: bodies[name] for name in step.parts}
        exploded = exploded_bodies(shown, step.moves, seat)
        camera = FROM_BELOW if step.seen_from_below else FROM_ABOVE
        below = max(body.span[1] for name, body in exploded.items() if name != "probe") + ABOVE
        pictures.append(render_png(list(exploded.values()), STEP_SIZE, camera, below))
        if not step.on_bench:
            there += [name for name in step.parts if name not in there]
    return pictures


def exploded_svg(bodies: Bodies, labels: Mapping[str, PartLabel], title: str, seat: float) -> Canvas:
    """Return the exploded view of all parts with their labels.

    Args:
        bodies: all at their assembled positions.
        labels: of each body.
        title: text alternative.
        seat: as for `exploded_bodies`.
    """
    exploded = exploded_bodies(bodies, explosion(bodies), seat)
    names = list(exploded)
    view = fit_view(list(exploded.values()), FROM_ABOVE, EXPLODED_SIZE)
    pixels, owners = render_bodies(list(exploded.values()), view)
    width, height = view.size
    svg = Canvas(width + 2 * LABEL_WIDTH, height, unit="px", title=title)
    picture = base64.b64encode(png_bytes(pixels)).decode()
    svg.add("image", x=LABEL_WIDTH, y=0.0, width=width, height=height, href=f"data:image/png;base64,{picture}")
    order = sorted(names, key=lambda name: _middle(owners, names.index(name)))
    for side in (0, 1):  # alternating left and right, from the top
        column = order[side::2]
        anchors = [_anchor(owners, names.index(name), side) for name in column]
        heights = _spread([y for _, y in anchors], 3.2 * LINE, height)
        for name, anchor, y in zip(column, anchors, heights, strict=True):
            _label(svg, labels[name], anchor, y, side, width)
    return svg


def _middle(owners: NDArray[np.int16], who: int) -> float:
    rows = np.nonzero((owners == who).any(axis=1))[0]
    return float(rows.mean()) if len(rows) else 0.0


def _anchor(owners: NDArray[np.int16], who: int, side: int) -> tuple[float, float]:
    """Return a visible pixel of a body, slightly inside its left or right edge."""
    rows, columns = np.nonzero(owners == who)
    if len(rows) == 0:
        return owners.shape[1] / 2, owners.shape[0] / 2
    edge = np.quantile(columns, 0.06 if side == 0 else 0.94)
    i = int(np.argmin(np.abs(columns - edge) + 0.5 * np.abs(rows - np.median(rows))))
    return float(columns[i]), float(rows[i])


def _spread(wanted: Sequence[float], spacing: float, height: float) -> list[float]:
    """Return heights near the wanted ones, at least `spacing` apart, inside the picture."""
    order = np.argsort(wanted, kind="stable")
    placed = np.array(wanted, dtype=float)
    lowest = spacing / 2
    for i in order:
        placed[i] = lowest = max(lowest, placed[i])
        lowest += spacing
    highest = height - spacing / 2
    for i in order[::-1]:
        placed[i] = highest = min(highest, placed[i])
        highest -= spacing
    return [float(y) for y in placed]


def _label(svg: Canvas, label: PartLabel, anchor: tuple[float, float], y: float, side: int, width: float) -> None:
    inner = LABEL_WIDTH - 8.0 if side == 0 else LABEL_WIDTH + width + 8.0
    outward = -1.0 if side == 0 else 1.0
    svg.polylines([[(LABEL_WIDTH + anchor[0], anchor[1]), (inner, y)]], 1.2, "#444")
    svg.circle((LABEL_WIDTH + anchor[0], anchor[1]), 3.2, fill="#444")
    svg.circle((inner + 15 * outward, y), 14.0, fill="#fff", colour="#222", width=1.4)
    svg.text((inner + 15 * outward, y + 5.5), str(label.number), 15.0, bold=True)
    name, what = label.lines
    x = inner + 36 * outward
    anchored: Anchor = "end" if side == 0 else "start"
    svg.text((x, y - 2.0), name, 15.5, anchor=anchored, bold=True)
    svg.text((x, y - 2.0 + LINE), what, 13.0, anchor=anchored)
