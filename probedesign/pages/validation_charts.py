"""Charts of a validation: shapes and forces as the paper's figures 3 to 6, errors beside what was stated."""

import math
from collections.abc import Sequence

import numpy as np

from probedesign.estimation.model import ProbeModel
from probedesign.frames import Array
from probedesign.pages.chart import COLOURS, Axis, Chart, Entry, span_of
from probedesign.rod.equilibrium import Equilibrium
from probedesign.units import MILLINEWTON, MM, N_MM
from probedesign.validation.validated_test import ValidatedTest

MEASURED, ESTIMATED, CONTACT = COLOURS[0], COLOURS[1], COLOURS[2]
POINTS = 80
_Z = "z, along the undeformed axis [mm]"


def draw_sizes(trials: Sequence[ValidatedTest]) -> bytes:
    """Measured against stated error; an SVG."""
    told = [
        (trial, trial.contact_error.expected / MM, trial.contact_error.size / MM)
        for trial in trials
        if trial.contact_error is not None
    ]
    low, high = span_of([value for _, *pair in told for value in pair], True)
    chart = Chart(
        Axis("stated error, RMS [mm]", low, high, log=True), Axis("measured error [mm]", low, high, log=True)
    )
    chart.line([low, high], [low, high], "#888", "5 2", name="equal")
    for kind, colour, mark in (("touch", ESTIMATED, "o"), ("weight", CONTACT, "d")):
        here = [(x, y) for trial, x, y in told if trial.kind == kind]
        for x, y in here:
            chart.line([x], [y], colour, mark=mark)
        if here:
            chart.legend.append(Entry(kind, colour, "0 99", mark))
    return chart.svg()


def draw_squares(trials: Sequence[ValidatedTest]) -> bytes:
    """Sorted squares against the quantiles of their χ²; an SVG."""
    from scipy.stats import chi2

    misses = [trial.contact_error for trial in trials if trial.counts and trial.contact_error is not None]
    scaled = sorted(miss.nees / miss.dof for miss in misses)
    dof = misses[0].dof if misses else 3
    ranks = [(i + 0.5) / len(scaled) for i in range(len(scaled))]
    expected = [float(chi2.ppf(rank, dof)) / dof for rank in ranks]
    high = max([*scaled, *expected, 1.0]) * 1.1
    chart = Chart(Axis("if all is true", 0.0, high), Axis("square over its number of axes", 0.0, high))
    chart.line([0.0, high], [0.0, high], "#888", "5 2", name="all is true")
    chart.line(expected, scaled, ESTIMATED, mark="o", name="touches")
    return chart.svg()


def draw_inner(shape: Equilibrium, what: str) -> bytes:
    """Internal force or moment along the probe; an SVG."""
    s, values = inner(shape, what)
    unit = "force [mN]" if what == "force" else "moment [N·mm]"
    chart = Chart(
        Axis("arclength s [mm]", 0.0, float(s[-1]) / MM), Axis(unit, *span_of(values.ravel().tolist(), False))
    )
    for i, (axis, dashes) in enumerate(zip("xyz", ("", "7 4", "2 3"), strict=True)):
        chart.line((s / MM).tolist(), values[:, i].tolist(), COLOURS[i + 1], dashes, name=axis)
    return chart.svg()


def inner(shape: Equilibrium, what: str) -> tuple[Array, Array]:
    """Arclengths [m], (k,), and internal force [mN] or moment [N·mm] there, on both sides of the contact, (k, 3)."""
    length = float(shape.s[-1])
    s = np.linspace(0.0, length, POINTS)
    contact = shape.s_contact
    if shape.load[0:3].any() and 0.0 < contact < length:
        s = np.sort(np.concatenate([s, [contact, contact + 1e-9]]))
    values = shape.n_at(s) / MILLINEWTON if what == "force" else shape.states_at(s)[:, 3:6] / N_MM
    return s, np.asarray(values)


def across_of(trial: ValidatedTest) -> int:
    """The axis that is drawn beside z: the one that the probe leaves more, 0 for x, 1 for y; x of a free probe."""
    if trial.test.direction[1:] in ("x", "y"):
        return "xy".index(trial.test.direction[1:])
    if trial.shape is None or trial.kind == "free":
        return 0
    return int(np.argmax(np.abs(trial.shape.load[0:2])))


def centreline(trial: ValidatedTest) -> Array:
    """Of the shape [m], (k, 3); empty without one."""
    if trial.shape is None:
        return np.zeros((0, 3))
    return trial.shape.p_at(np.linspace(0.0, float(trial.shape.s[-1]), POINTS))


def outline(trial: ValidatedTest, model: ProbeModel) -> Array:
    """Of the shape as seen from the side, base, flank, tip and the other flank [m], (2 k, 3); empty without one."""
    if trial.shape is None:
        return np.zeros((0, 3))
    across, s = across_of(trial), np.linspace(0.0, float(trial.shape.s[-1]), POINTS)
    radius = np.interp(s, model.rod.s, model.rod.radius) * model.cross_section.reach(across * math.pi / 2.0)
    aside = radius[:, None] * trial.shape.R_at(s)[:, :, across]
    line = trial.shape.p_at(s)
    return np.concatenate([line + aside, (line - aside)[::-1]])


def contact_told(trial: ValidatedTest) -> Array | None:
    """The contact as estimated [m], (3,): of the axis where only s is known to compare with, else of the surface."""
    if trial.estimate is None or not trial.estimate.ok:
        return None
    on_axis = trial.contact_base is None and not math.isnan(trial.test.s_contact)
    return trial.estimate.p_contact_base if on_axis else trial.estimate.p_surface_base


def place_known(trial: ValidatedTest) -> Array | None:
    """Where along the shape's axis the force is known to act [m], (3,); None where it is not known."""
    if trial.shape is None or math.isnan(trial.test.s_contact):
        return None
    return np.asarray(trial.shape.p_at(np.array([trial.test.s_contact]))[0])


def draw_shape(trial: ValidatedTest, model: ProbeModel) -> bytes:
    """Measured markers and contact, estimated outline, centreline and contact, from the side; an SVG."""
    across = across_of(trial)
    line, body = centreline(trial), outline(trial, model)
    estimate = contact_told(trial)
    contacts = [p[None] for p in (trial.contact_base, estimate) if p is not None]
    points = np.concatenate([body, trial.markers_on_axis, *contacts, np.zeros((1, 3))]) / MM
    x, y = (
        Axis(words, *span_of(points[:, i].tolist(), False))
        for words, i in ((_Z, 2), (f"{'xy'[across]} [mm]", across))
    )
    chart = Chart(x, y, square=True, down=across == 0)
    if len(body):
        chart.area([(float(p[2]) / MM, float(p[across]) / MM) for p in body], ESTIMATED, 0.15)
    seen = trial.markers_on_axis / MM
    if len(seen):
        chart.line(seen[:, 2].tolist(), seen[:, across].tolist(), MEASURED, "7 4", "x", "measured", 1.4)
    if len(line):
        chart.line(
            (line[:, 2] / MM).tolist(),
            (line[:, across] / MM).tolist(),
            ESTIMATED,
            name="estimated",
            width=2.4,
        )
    for p, colour, mark, name in ((estimate, CONTACT, "s", "contact, estimated"),
                                  (trial.contact_base, MEASURED, "o", "contact, measured"),
                                  (place_known(trial), MEASURED, "d", "s of the contact, known")):  # fmt: skip
        if p is not None:
            chart.line([float(p[2]) / MM], [float(p[across]) / MM], colour, mark=mark)
            chart.legend.append(Entry(name, colour, "0 99", mark))
    return chart.svg()
