"""Parts drawn apart along the axis: all of them with their names, or those of one step of the assembly."""

import base64
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from probedesign.cad.picture import Body, Camera, photographed, png_bytes, preview, view_of
from probedesign.cad.steps import DOWN, EXPLOSION, Move, Step
from probedesign.cad.svg import Svg

GAP = 8.0
"""Between parts drawn apart [mm]."""
EXPLODED_SIZE, STEP_SIZE = (560, 1300), (360, 320)
ABOVE = 25.0
"""Of a probe, what a step's picture shows above all else in it [mm]."""
STANDING = "sensor"
LABEL_WIDTH, LINE = 285.0, 19.0
"""Room beside the picture, and from one line of a label to the next [px]."""
FROM_ABOVE, FROM_BELOW = Camera(), Camera(elevation_deg=-28.0)

Bodies = Mapping[str, Body]


@dataclass(frozen=True)
class Label:
    """What stands beside a part.

    Attributes:
        number: in the bill of materials.
        lines: its name, then what it is.
    """

    number: int
    lines: tuple[str, str]


def moved_apart(bodies: Bodies, moves: Iterable[Move], seat: float) -> dict[str, Body]:
    """The bodies with each move's parts drawn away from where they belong.

    Args:
        bodies: all in their places.
        moves: each onto a body that stays, or that an earlier move took away.
        seat: z that the probe counts up to [mm]: what slips over it is drawn around it, not beyond its tip.
    """
    lifts = dict.fromkeys(bodies, 0.0)
    for move in moves:
        spans = [bodies[name].span for name in move.parts]
        bottom, top = bodies[move.onto].span
        if move.onto == "probe":
            top = seat
        away = (
            bottom - GAP - max(s[1] for s in spans)
            if move.side == DOWN
            else top + GAP - min(s[0] for s in spans)
        )
        lifts |= dict.fromkeys(move.parts, lifts[move.onto] + away)
    return {name: body.lifted(lifts[name]) for name, body in bodies.items()}


def step_pictures(bodies: Bodies, steps: Sequence[Step], seat: float) -> list[bytes]:
    """A PNG of each step: what it moves, on its way, beside what is there already, paler."""
    pictures, there = [], [STANDING]
    for step in steps:
        onto = [move.onto for move in step.moves if move.onto not in step.parts]
        before = [name for name in (onto if step.apart else there) if name not in step.parts]
        shown = {name: bodies[name].paled() for name in dict.fromkeys(before)}
        shown |= {name: bodies[name] for name in step.parts}
        apart = moved_apart(shown, step.moves, seat)
        camera = FROM_BELOW if step.seen_from_below else FROM_ABOVE
        below = max(body.span[1] for name, body in apart.items() if name != "probe") + ABOVE
        pictures.append(preview(list(apart.values()), STEP_SIZE, camera, below))
        if not step.apart:
            there += [name for name in step.parts if name not in there]
    return pictures


def exploded_svg(bodies: Bodies, labels: Mapping[str, Label], title: str, seat: float) -> Svg:
    """All parts drawn apart, each with its label.

    Args:
        bodies: all in their places.
        labels: of each body.
        title: for those who cannot see it.
        seat: as for `moved_apart`.
    """
    apart = moved_apart(bodies, EXPLOSION, seat)
    names = list(apart)
    view = view_of(list(apart.values()), FROM_ABOVE, EXPLODED_SIZE)
    pixels, owners = photographed(list(apart.values()), view)
    width, height = view.size
    svg = Svg(width + 2 * LABEL_WIDTH, height, unit="px", title=title)
    svg.image(LABEL_WIDTH, 0.0, width, height, base64.b64encode(png_bytes(pixels)).decode())
    order = sorted(names, key=lambda name: _middle(owners, names.index(name)))
    for side in (0, 1):  # left and right in turn, from the top
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
    """A pixel of a body that is seen, a little in from its left or right edge."""
    rows, columns = np.nonzero(owners == who)
    if len(rows) == 0:
        return owners.shape[1] / 2, owners.shape[0] / 2
    edge = np.quantile(columns, 0.06 if side == 0 else 0.94)
    i = int(np.argmin(np.abs(columns - edge) + 0.5 * np.abs(rows - np.median(rows))))
    return float(columns[i]), float(rows[i])


def _spread(wanted: Sequence[float], apart: float, height: float) -> list[float]:
    """Heights near the wanted ones, at least so far apart, inside the picture."""
    order = np.argsort(wanted, kind="stable")
    placed = np.array(wanted, dtype=float)
    lowest = apart / 2
    for i in order:
        placed[i] = lowest = max(lowest, placed[i])
        lowest += apart
    highest = height - apart / 2
    for i in order[::-1]:
        placed[i] = highest = min(highest, placed[i])
        highest -= apart
    return [float(y) for y in placed]


def _label(svg: Svg, label: Label, anchor: tuple[float, float], y: float, side: int, width: float) -> None:
    inner = LABEL_WIDTH - 8.0 if side == 0 else LABEL_WIDTH + width + 8.0
    outward = -1.0 if side == 0 else 1.0
    svg.line((LABEL_WIDTH + anchor[0], anchor[1]), (inner, y), width=1.2, colour="#444")
    svg.circle((LABEL_WIDTH + anchor[0], anchor[1]), 3.2, fill="#444")
    svg.circle((inner + 15 * outward, y), 14.0, fill="#fff", colour="#222", width=1.4)
    svg.text((inner + 15 * outward, y + 5.5), str(label.number), 15.0, bold=True)
    name, what = label.lines
    x, anchored = inner + 36 * outward, "end" if side == 0 else "start"
    svg.text((x, y - 2.0), name, 15.5, anchor=anchored, bold=True)
    svg.text((x, y - 2.0 + LINE), what, 13.0, anchor=anchored)
