"""SVG by elements: texts are escaped and numbers are short, so that equal drawings have equal bytes.

`element` returns one element as text, `Canvas` collects those of one picture; x points to the right, y down.
"""

from collections.abc import Iterable
from html import escape
from typing import Literal

FONT = "Helvetica, Arial, 'Liberation Sans', 'DejaVu Sans', sans-serif"
Anchor = Literal["start", "middle", "end"]
Line = Iterable[Iterable[float]]  #: Points (x, y) of a polyline.


def number(value: float) -> str:
    """Return a coordinate to the hundredth of its unit."""
    return f"{round(float(value), 2) + 0.0:.8g}"


def element(tag: str, *children: str, text: str = "", **attributes: float | str | None) -> str:
    """Return an element.

    Args:
        tag: its name.
        children: elements inside it.
        text: words inside it, to be escaped.
        attributes: `stroke_width` is the attribute stroke-width; None leaves it out.
    """
    given = "".join(
        f' {name.replace("_", "-")}="{escape(value) if isinstance(value, str) else number(value)}"'
        for name, value in attributes.items()
        if value is not None
    )
    inside = escape(text, quote=False) + "".join(children)
    return f"<{tag}{given}>{inside}</{tag}>" if inside else f"<{tag}{given}/>"


def path_data(lines: Iterable[Line], closed: bool = False) -> str:
    """Return polylines as the data of one path."""
    end = "Z" if closed else ""
    return "".join("M" + "L".join(f"{number(x)} {number(y)}" for x, y in line) + end for line in lines)


class Canvas:
    """A picture to which elements are added.

    Args:
        width, height: in `unit`, which is also the unit of every coordinate.
        unit: CSS unit, "mm" or "px"; empty for a picture that fills the width of its page.
        title: text alternative.
        paper: colour of the background; none if empty.
    """

    def __init__(self, width: float, height: float, unit: str = "", title: str = "", paper: str = "#fff") -> None:
        self.width, self.height, self.unit, self.title = width, height, unit, title
        self.elements: list[str] = []
        if paper:
            self.add("rect", width=width, height=height, fill=paper)

    def add(self, tag: str, *children: str, text: str = "", **attributes: float | str | None) -> None:
        """Add an element; the arguments are those of `element`."""
        self.elements.append(element(tag, *children, text=text, **attributes))

    def polylines(
        self, lines: Iterable[Line], width: float, colour: str = "#000", dashes: str = "", **attributes: str
    ) -> None:
        """Draw lines of one style."""
        self.add("path", d=path_data(lines), fill="none", stroke=colour, stroke_width=width, stroke_linecap="round",
                 stroke_dasharray=dashes or None, **attributes)  # fmt: skip

    def area(self, loops: Iterable[Line], fill: str, **attributes: str) -> None:
        """Fill closed outlines; an outline inside another is a hole."""
        self.add("path", d=path_data(loops, closed=True), fill=fill, fill_rule="evenodd", **attributes)

    def circle(
        self, centre: Iterable[float], radius: float, fill: str = "none", colour: str = "none", width: float = 1.0,
        dashes: str = "", **attributes: str,
    ) -> None:  # fmt: skip
        """Draw a circle, with an outline of a colour and a width."""
        x, y = centre
        self.add("circle", cx=x, cy=y, r=radius, fill=fill, stroke=colour, stroke_width=width,
                 stroke_dasharray=dashes or None, **attributes)  # fmt: skip

    def text(
        self, at: Iterable[float], words: str, size: float, anchor: Anchor = "middle", turned: bool = False,
        bold: bool = False, **attributes: str,
    ) -> None:  # fmt: skip
        """Write words on a baseline at a point; `turned` reads from the right."""
        x, y = at
        turn = f"rotate(-90 {number(x)} {number(y)})" if turned else None
        self.add("text", text=words, x=x, y=y, font_size=size, text_anchor=anchor, transform=turn,
                 font_weight="bold" if bold else None, **attributes)  # fmt: skip

    def __str__(self) -> str:
        size = {name: f"{number(value)}{self.unit}" for name, value in (("width", self.width), ("height", self.height))}
        title = [element("title", text=self.title)] if self.title else []
        return element("svg", *title, *self.elements, xmlns="http://www.w3.org/2000/svg", **(size if self.unit else {}),
                       viewBox=f"0 0 {number(self.width)} {number(self.height)}", font_family=FONT)  # fmt: skip

    def __bytes__(self) -> bytes:
        return f"<?xml version='1.0' encoding='utf-8'?>\n{self}\n".encode()
