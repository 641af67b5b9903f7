"""Printers and their build volumes. Source: PreForm."""

from dataclasses import dataclass

from probedesign.core.errors import unknown_name
from probedesign.core.units import MM


@dataclass(frozen=True)
class Printer:
    """A printer.

    Attributes:
        name: as written in a design file.
        product: as PreForm names it.
        build_volume: x, y, z [m].
    """

    name: str
    product: str
    build_volume: tuple[float, float, float]


def _printer(name: str, product: str, *size_mm: float) -> Printer:
    x, y, z = (v * MM for v in size_mm)
    return Printer(name, product, (x, y, z))


PRINTERS = {
    p.name: p
    for p in (
        _printer("form-2", "Form 2", 145, 145, 175),
        _printer("form-3", "Form 3", 145, 145, 185),
        _printer("form-3l", "Form 3L", 336, 200, 300),
        _printer("form-4", "Form 4", 200, 125, 210),
        _printer("form-4l", "Form 4L", 353, 196, 350),
    )
}


def printer_named(name: str) -> Printer:
    """Return the printer of that name.

    Raises:
        InputError: no such printer.
    """
    try:
        return PRINTERS[name]
    except KeyError:
        raise unknown_name("print.printer", name, PRINTERS) from None
