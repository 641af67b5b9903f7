"""The page of an identification: parameters, residuals, correlations."""

import math

import numpy as np

from probedesign.identification.result import Identification, Identified
from probedesign.reports.chart import COLOURS, DASHES, MARKS, Chart, ChartAxis, LegendEntry
from probedesign.reports.html_page import HtmlTable, ReportFigure, report_page

MAX_TEST_NAMES = 36  #: Maximum number of test names along an axis; of more tests, every second or third is named.
KINDS = {"markers": "marker", "wrenches": "wrench", "touches": "place touched"}
NOISE_KINDS = KINDS | {"places": "arclength of a load", "weights": "known load", "stiffness": "stiffness of a test",
                       "friction": "friction of a touch"}  # fmt: skip
#: Colour and marker of each kind of reading.
_SIGNS = {kind: (colour, mark) for kind, colour, mark in zip(KINDS, COLOURS[1:], MARKS, strict=False)}
_AXES = ("x", "y", "z")
#: Colour of the diagonal of the correlation matrix.
_SELF = "#dddddd"


def identification_page(fit: Identification) -> bytes:
    """Return the page of an identification."""
    about = [
        f"{fit.data}: {fit.tests} tests, {fit.numbers} measured values for {fit.unknowns} unknowns; "
        f"geometry {fit.fingerprint}. Result: {fit.result}{': ' if fit.why else ''}{fit.why}.",
        f"Intervals are 95 %: {fit.quantile:.3g} standard deviations. First with the design's dimensions, as the "
        "frozen probe uses them and as written to a design, including all errors of the bench; then with "
        f"{fit.dimensions}, as a property of the material.",
        *(f"Likely cause {rank}: {cause}." for rank, cause in enumerate(fit.likely_causes, 1)),
        *fit.notes,
    ]
    kinds = {residual.kind for residual in fit.residuals}
    sections = []
    if kinds & set(KINDS):
        caption = "Noise as stated, or as measured where that is larger. Tests are in the order of their table."
        sections.append(ReportFigure("Residuals by test", caption, residual_chart(fit).svg()))
    if "markers" in kinds:
        sections.append(_along(fit))
    if len(fit.correlated) > 1:
        sections.append(_correlation(fit))
    shares = [[cause, ", ".join(f"{share.of} {share.percent:.2g} %" for share in of)]
              for cause, of in fit.causes.items()]  # fmt: skip
    note = (
        "One standard deviation each, of the prior in [tolerances] where there is one; the squares add up to that of "
        "the number, which --write puts into [tolerances] and stiffness_spread."
    )
    budget = HtmlTable(["error source", "contribution to the parameter"], shares, note)
    after = [("Scatter of the readings", _noise(fit)), ("Error budget", budget)]
    if fit.outliers:
        rows = [outlier.words.split(": ", 1) for outlier in fit.outliers]
        outliers = HtmlTable(["reading", "distance from the fit"], rows, "Down-weighted in the fit.")
        after.append(("Outliers", outliers))
    return report_page(f"{fit.name}: identified", about, _table(fit), sections, after, verdict=verdict(fit))


def verdict(fit: Identification) -> str:
    """Return the result of an identification in one line: each number ± one standard deviation, and the design's."""
    if not fit.valid:
        return f"No number is identified: {fit.why or fit.result}."
    if not any(number.identified for number in fit.found):
        return "The tests determine none of the requested numbers."
    numbers = []
    for number in fit.found:
        unit = f" {number.unit}" if number.unit else ""
        if number.std is None:
            numbers.append(f"{number.name} {number.state}")
            continue
        note = f"design {number.design:.4g}{'' if number.identified else ', not observable'}"
        numbers.append(f"{number.name} {number.value:.4g} ± {number.std:.2g}{unit} ({note})")
    return ", ".join(numbers)


def _table(fit: Identification) -> HtmlTable:
    of_print = f"with {fit.dimensions}: value, 95 % interval"
    head = ["", "value", "95 % interval", of_print, "design", "change", "description"]
    return HtmlTable(head, [_row(number) for number in fit.found], worded=True)


def _row(number: Identified) -> list[str]:
    design = f"{number.design:.4g} {number.unit}"
    if not number.estimated:
        return [number.name, number.state, "", "", design, "", number.why]
    interval = f"{number.low:.4g} ... {number.high:.4g}"
    of_print = f"{number.value_of_print:.4g} {number.unit}".rstrip()
    of_print += f", {number.low_of_print:.4g} ... {number.high_of_print:.4g}"
    return [
        number.name,
        f"{number.value:.4g} {number.unit}",
        interval,
        of_print,
        design,
        number.change,
        number.why or number.words,
    ]


def residual_chart(fit: Identification) -> Chart:
    """Return the RMS of each test's normalised residuals by kind."""
    tests = list(dict.fromkeys(residual.test for residual in fit.residuals if residual.kind in KINDS))
    each = math.ceil(len(tests) / MAX_TEST_NAMES)
    x = ChartAxis.named("", [test if i % each == 0 else "" for i, test in enumerate(tests)], upright=True)
    lines = {}
    for kind in KINDS:
        of = [[r.deviations for r in fit.residuals if (r.kind, r.test) == (kind, test)] for test in tests]
        if any(of):
            lines[kind] = [math.sqrt(sum(d * d for d in each) / len(each)) if each else math.nan for each in of]
    high = max([v for line in lines.values() for v in line if math.isfinite(v)] + [2.0])
    chart = Chart(x, ChartAxis("RMS residual [standard deviations]", 0.0, 1.08 * high))
    for kind, line in lines.items():
        colour, mark = _SIGNS[kind]
        chart.points(range(1, len(tests) + 1), line, colour, mark, KINDS[kind])
    chart.line([0.5, len(tests) + 0.5], [1.0, 1.0], "#666666", "4 4", name="noise alone")
    return chart


def _along(fit: Identification) -> ReportFigure:
    rows = [residual for residual in fit.residuals if residual.kind == "markers" and residual.s_mm is not None]
    places = sorted({residual.s_mm for residual in rows if residual.s_mm is not None})
    each = [np.array([residual.off for residual in rows if residual.s_mm == s]) for s in places]
    means = np.array([v.mean(axis=0) for v in each]).reshape(-1, 3)
    scatter = [v.std(axis=0, ddof=1) / math.sqrt(len(v)) if len(v) > 1 else np.zeros(3) for v in each]
    margins = 2.0 * np.array(scatter).reshape(-1, 3)
    chart = Chart(
        ChartAxis.spanning("arclength s [mm]", places),
        ChartAxis.spanning(
            "mean residual, measured - fitted [mm]", [*(means - margins).flat, *(means + margins).flat, 0]
        ),
    )
    for i, (axis, colour, dashes, mark) in enumerate(zip(_AXES, COLOURS[1:], DASHES, MARKS, strict=False)):
        for s, at, margin in zip(places, means[:, i], margins[:, i], strict=True):
            chart.line([s, s], [at - margin, at + margin], colour, width=1.0)
        chart.line(places, means[:, i], colour, dashes, mark, f"along world {axis}")
    caption = (
        "Mean over the tests with two standard deviations of it. A curve common to all tests indicates that the "
        "taper, the root or a camera differs from its model."
    )
    return ReportFigure("Residuals along the probe", caption, chart.svg())


def _correlation(fit: Identification) -> ReportFigure:
    n, names = len(fit.correlated), list(fit.correlated)
    chart = Chart(ChartAxis.named("", names), ChartAxis.named("", names[::-1]))
    for i in range(n):
        for j in range(n):
            value = float(fit.correlation[i, j])
            strength = round(255 * (1.0 - min(abs(value), 1.0)))
            fill = f"#ff{strength:02x}{strength:02x}" if value > 0 else f"#{strength:02x}{strength:02x}ff"
            fill = _SELF if i == j else fill
            chart.cell(j + 1, n - i, f"{value:.2f}", fill, edge="#999")
    for name, colour in (("positive", "#ff0000"), ("negative", "#0000ff"), ("itself", _SELF)):
        chart.legend.append(LegendEntry(name, colour))
    return ReportFigure(
        "Correlation",
        "Correlation of the errors, with the print's dimensions as designed except those "
        "identified; near ±1 the tests determine a combination better than each.",
        chart.svg(),
    )


def _noise(fit: Identification) -> HtmlTable:
    rows = [
        [NOISE_KINDS[residual.kind], f"{residual.groups}", f"{residual.scale:.3g}", f"{residual.freedom:.0f}",
         "measured, larger than stated" if residual.measured else "as stated"]
        for residual in fit.noise
    ]  # fmt: skip
    return HtmlTable(["readings", "number", "scatter over stated", "degrees of freedom", "noise used"], rows)
