"""What an identification found, on one page: the numbers, how the readings lie about the fit, what goes together."""

import math

import numpy as np
from scipy.stats import chi2

from probedesign.identification.identification import Identification, Identified
from probedesign.pages.chart import COLOURS, DASHES, MARKS, Axis, Chart, Entry, span_of
from probedesign.reports.html_page import HtmlTable, Section, report_page

MOST_NAMES = 36
"""Of tests that stand legibly along an axis; of more, every second or third is named."""
KINDS = {"markers": "marker", "wrenches": "wrench", "touches": "place touched"}
_SIGNS = {kind: (colour, mark) for kind, colour, mark in zip(KINDS, COLOURS[1:], MARKS, strict=False)}
"""Of each kind in every figure."""
_AXES = ("x", "y", "z")
_SELF = "#dddddd"
"""Of a number beside itself."""


def identification_page(found: Identification) -> bytes:
    """The page.

    Args:
        found: the numbers.
    """
    about = [
        f"{found.data}: {found.tests} tests, {found.numbers} measured numbers for {found.unknowns} unknowns; "
        f"geometry {found.fingerprint}. Result: {found.result}{': ' if found.why else ''}{found.why}.",
        f"Intervals hold 95 %: {found.quantile:.3g} standard deviations. First that of the fit, with the design's "
        "dimensions taken as they are, as the frozen probe takes them; then with what the fit does not count, listed "
        f"below: a design gets that; then the fit's with {found.dimensions}, as of the material.",
        *found.doubts,
        *found.notes,
    ]
    sections = [_by_test(found), _normal(found)] if any(one.kind in KINDS for one in found.residuals) else []
    if any(one.kind == "markers" for one in found.residuals):
        sections.append(_along(found))
    if any(one.kind == "wrenches" for one in found.residuals):
        sections += [_wrenches(found, "forces"), _wrenches(found, "moments")]
    if len(found.correlated) > 1:
        sections.append(_correlation(found))
    after = [("How much the readings scatter", _noise(found)), ("What is not counted", _shifts(found))]
    if found.outliers:
        after.append(("Readings that noise does not explain", _outliers(found)))
    return report_page(f"{found.name}: identified", about, _table(found), sections, after)


def _table(found: Identification) -> HtmlTable:
    head = [
        "",
        "value",
        "95 % within",
        "with what is not counted",
        f"with {found.dimensions}",
        "design",
        "what it is",
    ]
    return HtmlTable(head, [_row(one) for one in found.found])


def _row(one: Identified) -> list[str]:
    design = f"{one.design:.4g} {one.unit}"
    if not one.identified:
        return [one.name, "not told", "", "", "", design, one.why]
    ends = ((one.low, one.high), (one.low_in_all, one.high_in_all), (one.low_of_print, one.high_of_print))
    return [
        one.name,
        f"{one.value:.4g} {one.unit}",
        *(f"{a:.4g} ... {b:.4g}" for a, b in ends),
        design,
        one.words,
    ]


def _by_test(found: Identification) -> Section:
    """Root mean square of each test's misfits by kind."""
    tests = list(dict.fromkeys(one.test for one in found.residuals if one.kind in KINDS))
    each = math.ceil(len(tests) / MOST_NAMES)
    x = Axis.named("", [test if i % each == 0 else "" for i, test in enumerate(tests)], upright=True)
    lines = {}
    for kind in KINDS:
        of = [[r.deviations for r in found.residuals if (r.kind, r.test) == (kind, test)] for test in tests]
        if any(of):
            lines[kind] = [math.sqrt(sum(d * d for d in own) / len(own)) if own else math.nan for own in of]
    most = max([v for line in lines.values() for v in line if math.isfinite(v)] + [2.0])
    chart = Chart(x, Axis("RMS misfit [standard deviations]", 0.0, 1.08 * most))
    for kind, line in lines.items():
        colour, mark = _SIGNS[kind]
        for place, value in enumerate(line, 1):
            if math.isfinite(value):
                chart.line([place], [value], colour, mark=mark)
        chart.legend.append(Entry(KINDS[kind], colour, "0 99", mark))
    chart.line([0.5, len(tests) + 0.5], [1.0, 1.0], "#666666", "4 4", name="what noise makes")
    caption = "Noise as stated, or as measured where it is more. Tests stand in the order of their table."
    return Section("Does any test stand apart?", caption, chart.svg())


def _normal(found: Identification) -> Section:
    """Distances against those that normal noise makes."""
    sizes = {"markers": 3, "wrenches": 6, "touches": 3}
    lines = {}
    for kind, k in sizes.items():
        far = sorted(r.deviations for r in found.residuals if r.kind == kind)
        if len(far) > 2:
            shares = (np.arange(len(far)) + 0.5) / len(far)
            lines[kind] = (np.sqrt(chi2.ppf(shares, k) / k).tolist(), far)
    most = max([v for x, y in lines.values() for v in (*x, *y)] + [2.0]) * 1.05
    chart = Chart(
        Axis("by normal noise [standard deviations]", 0.0, most),
        Axis("misfit [standard deviations]", 0.0, most),
    )
    chart.line([0.0, most], [0.0, most], "#666666", "4 4", name="normal noise")
    for kind, (x, y) in lines.items():
        colour, mark = _SIGNS[kind]
        for a, b in zip(x, y, strict=True):
            chart.line([a], [b], colour, mark=mark)
        chart.legend.append(Entry(KINDS[kind], colour, "0 99", mark))
    return Section("Is the noise as it was taken?", "On the line it is; above it at the right end lie outliers. "
                   "A little below is what the unknowns take up.", chart.svg())  # fmt: skip


def _along(found: Identification) -> Section:
    """Markers' residuals along the probe: mean over tests and its scatter."""
    rows = [one for one in found.residuals if one.kind == "markers" and one.s_mm is not None]
    places = sorted({one.s_mm for one in rows if one.s_mm is not None})
    means = {s: np.array([one.off for one in rows if one.s_mm == s]) for s in places}
    errors = {
        s: v.std(axis=0, ddof=1) / math.sqrt(len(v)) if len(v) > 1 else np.zeros(3) for s, v in means.items()
    }
    ends = [
        float(v)
        for s in places
        for v in (*(means[s].mean(0) - 2 * errors[s]), *(means[s].mean(0) + 2 * errors[s]))
    ]
    chart = Chart(
        Axis("s [mm]", *span_of(places, False)),
        Axis("measured - fitted, mean [mm]", *span_of([*ends, 0.0], False)),
    )
    for i, (axis, colour, dashes, mark) in enumerate(zip(_AXES, COLOURS[1:], DASHES, MARKS, strict=False)):
        y = [float(means[s].mean(0)[i]) for s in places]
        for s, at in zip(places, y, strict=True):
            e = 2.0 * float(errors[s][i])
            chart.line([s, s], [at - e, at + e], colour, width=1.0)
        chart.line(places, y, colour, dashes, mark, f"along world {axis}")
    caption = (
        "Mean over the tests, with two standard deviations of it. A bow that is plain in all tests says that the "
        "taper, the root or a camera is other than taken."
    )
    return Section("Is the shape right all along?", caption, chart.svg())


def _wrenches(found: Identification, what: str) -> Section:
    """Each reading's residual by channel: the forces, or the moments."""
    first, unit, size, letter = {"forces": (0, "mN", 1e3, "F"), "moments": (3, "µN·m", 1e6, "M")}[what]
    off = size * np.array([one.off[first : first + 3] for one in found.residuals if one.kind == "wrenches"])
    chart = Chart(
        Axis.named("", [f"{letter}{axis}" for axis in _AXES]),
        Axis(f"measured - fitted [{unit}]", *span_of([*off.ravel().tolist(), 0.0], False)),
    )
    chart.line([0.5, 3.5], [0.0, 0.0], "#666666", "4 4")
    colour, mark = _SIGNS["wrenches"]
    for channel in range(3):
        for i, value in enumerate(off[:, channel]):
            spread = 0.7 * (i / max(len(off) - 1, 1) - 0.5)
            chart.line([channel + 1 + spread], [float(value)], colour, mark=mark)
    return Section(f"And the {what}?", "At the base, from the first test at the left of each channel to the "
                   "last at its right: a slope is a drift.", chart.svg())  # fmt: skip


def _correlation(found: Identification) -> Section:
    """What goes together."""
    n, names = len(found.correlated), list(found.correlated)
    chart = Chart(Axis.named("", names), Axis.named("", names[::-1]))
    for i in range(n):
        for j in range(n):
            value = float(found.correlation[i, j])
            strength = round(255 * (1.0 - min(abs(value), 1.0)))
            fill = f"#ff{strength:02x}{strength:02x}" if value > 0 else f"#{strength:02x}{strength:02x}ff"
            fill = _SELF if i == j else fill
            chart.box((j + 0.5, j + 1.5), (n - i - 0.5, n - i + 0.5), fill, "#999")
            chart.text(j + 1.0, n - i, f"{value:.2f}", "#fff" if abs(value) > 0.6 and i != j else "#111")
    chart.legend += [Entry("too great together", "#ff0000"), Entry("one too great, one too small", "#0000ff"),
                     Entry("itself", _SELF)]  # fmt: skip
    return Section("What goes together?", "Correlation of the errors, the print's dimensions as designed but for those "
                   "asked for; near ±1 the tests tell a combination better than either.", chart.svg())  # fmt: skip


def _noise(found: Identification) -> HtmlTable:
    rows = [
        [KINDS[one.kind], f"{one.groups}", f"{one.scale:.3g}", f"{one.freedom:.0f}",
         "measured: more than stated" if one.measured else "as stated"]
        for one in found.noise
    ]  # fmt: skip
    return HtmlTable(["readings", "how many", "scatter over stated", "degrees of freedom", "taken"], rows)


def _shifts(found: Identification) -> HtmlTable:
    rows = [
        [cause, ", ".join(f"{one.of} {one.percent:+.2g} %" for one in of)]
        for cause, of in found.causes.items()
    ]
    rows.append(["creep between tests and use", "not known"])
    note = (
        "None of these is in the fit's interval. Each but creep is taken for one standard deviation, and the root of "
        "the sum of the squares of these and the fit's is what --write puts into [tolerances] and stiffness_spread."
    )
    return HtmlTable(["if it were so", "the number would be"], rows, note)


def _outliers(found: Identification) -> HtmlTable:
    rows = [[one.words, f"{one.deviations:.1f}"] for one in found.outliers]
    return HtmlTable(["reading", "standard deviations off"], rows, "They hardly counted.")
