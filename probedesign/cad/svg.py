"""SVG pictures: lines, areas and text. Numbers are rounded, so equal pictures are equal bytes."""

from collections.abc import Iterable
from xml.etree import ElementTree as ET

XY = tuple[float, float]
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

    def polylines(
        self, lines: Iterable[Iterable[XY]], width: float, colour: str = "#000", dash: str = ""
    ) -> None:
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
        self,
        centre: XY,
        r: float,
        fill: str = "none",
        colour: str = "none",
        width: float = 0.0,
        dash: str = "",
    ) -> None:
        """Draw a circle."""
        dashes = {"stroke-dasharray": dash} if dash else {}
        self._add("circle", {"stroke-width": _n(width), **dashes}, cx=_n(centre[0]), cy=_n(centre[1]), r=_n(r),
                  fill=fill, stroke=colour)  # fmt: skip

    def text(
        self,
        at: XY,
        words: str,
        size: float,
        anchor: str = "middle",
        turned: bool = False,
        bold: bool = False,
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
