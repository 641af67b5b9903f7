"""Write the sheets of a drawing as SVG, PDF and DXF, and pictures as SVG: the same sheet gives the same bytes."""

import io
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from xml.etree import ElementTree as ET

import ezdxf
import reportlab
from ezdxf.document import Drawing
from ezdxf.enums import TextEntityAlignment
from ezdxf.layouts import Modelspace
from reportlab.lib.units import mm as MM_OF_PAPER
from reportlab.pdfbase import pdfmetrics
from reportlab.pdfbase.ttfonts import TTFont
from reportlab.pdfgen.canvas import Canvas

from probedesign.cad.drawing import (
    ARROW,
    DIMENSIONS,
    EXTENSION_BEYOND,
    EXTENSION_GAP,
    HATCH,
    HEIGHT,
    PENS,
    TEXT,
    WIDTH,
    XY,
    Arrowhead,
    Dimension,
    Hatching,
    Item,
    Pen,
    Ring,
    Sheet,
    Strokes,
    Text,
    number,
    width_of,
)

HATCH_APART = 1.6
"""Distance between two lines of a hatch [mm of paper]."""


def svg_bytes(sheet: Sheet) -> bytes:
    """Return a sheet as an SVG file."""
    svg = Svg(WIDTH, HEIGHT, unit="mm", title=sheet.title)
    for item in sheet.expanded():
        match item:
            case Strokes(pen, lines):
                svg.polylines(lines, pen.width, dash=_dash(pen))
            case Arrowhead(_, corners):
                svg.area([corners], "#000")
            case Hatching(loops):
                svg.hatched(loops)
            case Ring(pen, centre, r, white):
                fill = "#fff" if white else "none"
                svg.circle(centre, r, fill=fill, colour="#000", width=pen.width, dash=_dash(pen))
            case Text(at, words, size, anchor, turned, bold):
                svg.text(at, words, size, anchor, turned, bold)
    return bytes(svg)


def _dash(pen: Pen) -> str:
    return " ".join(f"{length:g}" for length in pen.dash)


# ---- PDF


REGULAR, BOLD = "Vera", "VeraBd"
"""Fonts that come with reportlab; a PDF contains the characters that it uses."""


def pdf_bytes(sheets: Sequence[Sheet], title: str) -> bytes:
    """Return sheets as the pages of one PDF file."""
    fonts = Path(reportlab.__file__).parent / "fonts"
    for name in (REGULAR, BOLD):
        pdfmetrics.registerFont(TTFont(name, str(fonts / f"{name}.ttf")))
    content = io.BytesIO()
    # invariant: without the time of writing
    canvas = Canvas(content, (WIDTH * MM_OF_PAPER, HEIGHT * MM_OF_PAPER), invariant=1, pageCompression=1)
    canvas.setTitle(title)
    canvas.setLineCap(1)
    for sheet in sheets:
        canvas.saveState()
        canvas.scale(MM_OF_PAPER, MM_OF_PAPER)
        canvas.setLineCap(1)
        for item in sheet.expanded():
            _draw_on_pdf(canvas, item)
        canvas.restoreState()
        canvas.showPage()
    canvas.save()
    return content.getvalue()


def _draw_on_pdf(canvas: Canvas, item: Item) -> None:
    match item:
        case Strokes(pen, lines):
            _pdf_pen(canvas, pen)
            canvas.drawPath(_pdf_path(canvas, lines, closed=False))
        case Arrowhead(_, corners):
            canvas.setFillGray(0.0)
            canvas.drawPath(_pdf_path(canvas, [corners]), stroke=0, fill=1)
        case Hatching(loops):
            canvas.saveState()
            canvas.clipPath(_pdf_path(canvas, loops), stroke=0, fill=0, fillMode=0)  # even-odd
            _pdf_pen(canvas, HATCH)
            canvas.drawPath(_pdf_path(canvas, _hatch_lines(loops), closed=False))
            canvas.restoreState()
        case Ring(pen, (x, y), r, white):
            _pdf_pen(canvas, pen)
            canvas.setFillGray(1.0)
            canvas.circle(x, HEIGHT - y, r, stroke=1, fill=int(white))
        case Text(at, words, size, anchor, turned, bold):
            canvas.saveState()
            canvas.setFillGray(0.0)
            canvas.setFont(BOLD if bold else REGULAR, 0.92 * size)  # Vera is wider than the fonts of the SVG
            canvas.translate(at[0], HEIGHT - at[1])
            canvas.rotate(90.0 if turned else 0.0)
            draw = {"start": canvas.drawString, "middle": canvas.drawCentredString, "end": canvas.drawRightString}
            draw[anchor](0.0, 0.0, words.replace("⌀", "Ø"))  # the font has the letter only
            canvas.restoreState()


def _pdf_pen(canvas: Canvas, pen: Pen) -> None:
    canvas.setStrokeGray(0.0)
    canvas.setLineWidth(pen.width)
    canvas.setDash(list(pen.dash))


def _pdf_path(canvas: Canvas, loops: Sequence[Sequence[XY]], closed: bool = True) -> object:
    path = canvas.beginPath()
    for loop in loops:
        path.moveTo(loop[0][0], HEIGHT - loop[0][1])
        for x, y in loop[1:]:
            path.lineTo(x, HEIGHT - y)
        if closed:
            path.close()
    return path


def _hatch_lines(loops: Sequence[Sequence[XY]]) -> list[list[XY]]:
    """Return lines at 45° across the bounding box of the loops."""
    x0, x1 = (f(x for loop in loops for x, _ in loop) for f in (min, max))
    y0, y1 = (f(y for loop in loops for _, y in loop) for f in (min, max))
    step, high = HATCH_APART * math.sqrt(2.0), y1 - y0
    first, last = math.floor(x0 / step), math.ceil((x1 + high) / step)
    return [[(k * step, y0), (k * step - high, y1)] for k in range(first, last + 1)]


# ---- DXF


DIMSTYLE, TEXT_STYLE = "PROBEDESIGN", "PROBEDESIGN"
CAPITALS = 0.72
"""Height of capitals, which is the size of a text in DXF, over the size of the font."""


def dxf_bytes(sheet: Sheet) -> bytes:
    """Return a sheet as a DXF file (AutoCAD 2010): the main views in millimetres of the part, each kind of line on its
    layer, dimensions as such."""
    fixed = ezdxf.options.write_fixed_meta_data_for_testing
    ezdxf.options.write_fixed_meta_data_for_testing = True  # no time of writing, no random identifier
    try:
        document = _dxf_document(sheet)
        for kind in sorted(document.entitydb.dxf_types_in_use()):  # ezdxf itself takes them in the order of a set
            document.classes.add_class(kind)
        text = io.StringIO()
        document.write(text)
    finally:
        ezdxf.options.write_fixed_meta_data_for_testing = fixed
    return text.getvalue().encode(document.output_encoding, "dxfreplace")


def _dxf_document(sheet: Sheet) -> Drawing:
    document = ezdxf.new("R2010", units=4)  # millimetres
    k = 1.0 / sheet.scale
    for pen in PENS:
        linetype = "CONTINUOUS"
        if pen.dash:
            linetype = f"{pen.layer}_LINE"
            signed = [k * length * (1.0 if i % 2 == 0 else -1.0) for i, length in enumerate(pen.dash)]
            document.linetypes.add(linetype, [sum(map(abs, signed)), *signed], description="chain line")
        document.layers.add(pen.layer, linetype=linetype, lineweight=round(100 * pen.width))
    document.styles.add(TEXT_STYLE, font="arial.ttf")
    style = document.dimstyles.add(DIMSTYLE)
    style.dxf.dimtxsty = TEXT_STYLE
    for key, value in {
        "dimtxt": CAPITALS * TEXT, "dimasz": ARROW, "dimexo": EXTENSION_GAP, "dimexe": EXTENSION_BEYOND, "dimgap": 0.6,
    }.items():  # fmt: skip
        style.dxf.set(key, k * value)
    style.dxf.dimlwd = style.dxf.dimlwe = round(100 * DIMENSIONS.width)
    style.dxf.dimtad, style.dxf.dimdec, style.dxf.dimzin, style.dxf.dimdsep = 1, 2, 8, ord(".")
    space = document.modelspace()
    for item in sheet.items:
        _draw_in_dxf(space, item, sheet.scale)
    return document


def _draw_in_dxf(space: Modelspace, item: Item, scale: float) -> None:
    def at(p: XY) -> XY:
        return round(p[0] / scale, 6), round((HEIGHT - p[1]) / scale, 6)

    match item:
        case Strokes(pen, lines):
            for line in lines:
                points = [at(p) for p in line]
                closed = len(points) > 2 and points[0] == points[-1]
                space.add_lwpolyline(points[:-1] if closed else points, close=closed,
                                     dxfattribs={"layer": pen.layer, "lineweight": round(100 * pen.width)})  # fmt: skip
        case Arrowhead(pen, corners):
            a, b, c = map(at, corners)
            space.add_solid([a, b, c, c], dxfattribs={"layer": pen.layer})
        case Hatching(loops):
            hatch = space.add_hatch(dxfattribs={"layer": HATCH.layer})
            hatch.set_pattern_fill("ANSI31", scale=HATCH_APART / scale / 3.175)  # the pattern's own spacing [mm]
            for loop in loops:
                hatch.paths.add_polyline_path([at(p) for p in loop], is_closed=True)
        case Ring(pen, centre, r):
            space.add_circle(at(centre), r / scale, dxfattribs={"layer": pen.layer})
        case Text(where, words, size, anchor, turned, _, pen):
            alignment = {"start": TextEntityAlignment.LEFT, "middle": TextEntityAlignment.CENTER,
                         "end": TextEntityAlignment.RIGHT}[anchor]  # fmt: skip
            text = space.add_text(
                _dxf_text(words), height=CAPITALS * size / scale, rotation=90.0 if turned else 0.0,
                dxfattribs={"layer": pen.layer, "style": TEXT_STYLE},
            )  # fmt: skip
            text.set_placement(at(where), align=alignment)
        case Dimension(a, b, feet, words):
            # the words around the value that the program measures
            shown = words.replace(number(item.value), "<>", 1)
            label = item.text
            half = CAPITALS / 2 * label.size
            dx, dy = (-half, 0.0) if item.upright else (0.0, -half)
            if label.anchor == "start":
                along = width_of(words, label.size) / 2
                dx, dy = (dx, dy - along) if item.upright else (dx + along, dy)
            space.add_linear_dim(
                base=at(a), p1=at(feet[0]), p2=at(feet[1]), angle=90.0 if item.upright else 0.0,
                location=at((label.at[0] + dx, label.at[1] + dy)), text=_dxf_text(shown), dimstyle=DIMSTYLE,
                override={"dimlfac": scale / item.scale}, dxfattribs={"layer": DIMENSIONS.layer},
            ).render()  # fmt: skip


def _dxf_text(words: str) -> str:
    """Return a text with the control codes of DXF for its symbols."""
    for symbol, code in (("⌀", "%%c"), ("°", "%%d"), ("±", "%%p")):
        words = words.replace(symbol, code)
    return words


FONT = "Helvetica, Arial, 'Liberation Sans', 'DejaVu Sans', sans-serif"


class Svg:
    """An SVG picture to which elements are added; x to the right, y down.

    Args:
        width, height: in `unit`, which is also the unit of every coordinate.
        unit: CSS unit, "mm" or "px".
        title: text alternative.
    """

    def __init__(self, width: float, height: float, unit: str, title: str) -> None:
        self.root = ET.Element(
            "svg",
            {
                "xmlns": "http://www.w3.org/2000/svg",
                "width": f"{_n(width)}{unit}",
                "height": f"{_n(height)}{unit}",
                "viewBox": f"0 0 {_n(width)} {_n(height)}",
                "font-family": FONT,
            },
        )
        ET.SubElement(self.root, "title").text = title
        self._add("rect", width=_n(width), height=_n(height), fill="#fff")

    def line(self, a: XY, b: XY, width: float, colour: str = "#000", dash: str = "") -> None:
        """Draw a straight line from a to b."""
        self.polylines([[a, b]], width, colour, dash)

    def polylines(self, lines: Iterable[Iterable[XY]], width: float, colour: str = "#000", dash: str = "") -> None:
        """Draw lines of one style as one element."""
        path = "".join("M" + "L".join(f"{_n(x)} {_n(y)}" for x, y in line) for line in lines)
        dashes = {"stroke-dasharray": dash} if dash else {}
        self._add("path", {"stroke-width": _n(width), "stroke-linecap": "round", **dashes},
                  d=path, fill="none", stroke=colour)  # fmt: skip

    def area(self, loops: Iterable[Iterable[XY]], fill: str) -> None:
        """Fill closed outlines; an outline inside another is a hole."""
        path = "".join("M" + "L".join(f"{_n(x)} {_n(y)}" for x, y in loop) + "Z" for loop in loops)
        self._add("path", {"fill-rule": "evenodd"}, d=path, fill=fill)

    def hatched(self, loops: Iterable[Iterable[XY]]) -> None:
        """Hatch closed outlines as cut material."""
        if self.root.find("defs") is None:
            pattern = ET.SubElement(ET.SubElement(self.root, "defs"), "pattern", {
                "id": "hatch", "width": "1.6", "height": "1.6",
                "patternUnits": "userSpaceOnUse", "patternTransform": "rotate(-45)",
            })  # fmt: skip
            ET.SubElement(pattern, "rect", {"width": "1.6", "height": "1.6", "fill": "#f3f5f7"})
            ET.SubElement(pattern, "path", {"d": "M0 0H1.6", "stroke": "#667", "stroke-width": "0.18"})
        self.area(loops, "url(#hatch)")

    def circle(
        self, centre: XY, r: float, fill: str = "none", colour: str = "none", width: float = 0.0, dash: str = ""
    ) -> None:
        """Draw a circle."""
        dashes = {"stroke-dasharray": dash} if dash else {}
        self._add("circle", {"stroke-width": _n(width), **dashes}, cx=_n(centre[0]), cy=_n(centre[1]), r=_n(r),
                  fill=fill, stroke=colour)  # fmt: skip

    def text(
        self, at: XY, words: str, size: float, anchor: str = "middle", turned: bool = False, bold: bool = False
    ) -> None:
        """Write text on a baseline at a point; `turned` reads from the right."""
        x, y = _n(at[0]), _n(at[1])
        how = {"font-size": _n(size), "text-anchor": anchor}
        how |= {"transform": f"rotate(-90 {x} {y})"} if turned else {}
        how |= {"font-weight": "bold"} if bold else {}
        self._add("text", how, x=x, y=y).text = words

    def image(self, x: float, y: float, width: float, height: float, png_base64: str) -> None:
        """Embed a PNG."""
        self._add("image", x=_n(x), y=_n(y), width=_n(width), height=_n(height),
                  href=f"data:image/png;base64,{png_base64}")  # fmt: skip

    def _add(self, tag: str, how: dict[str, str] | None = None, **more: str) -> ET.Element:
        return ET.SubElement(self.root, tag, {**(how or {}), **more})

    def __str__(self) -> str:
        """Return the element as text for an HTML page."""
        return ET.tostring(self.root, encoding="unicode")

    def __bytes__(self) -> bytes:
        """Return the content of an SVG file."""
        return b"<?xml version='1.0' encoding='utf-8'?>\n" + str(self).encode() + b"\n"


def _n(value: float) -> str:
    return f"{round(value, 3) + 0.0:g}"
