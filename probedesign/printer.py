"""Printers as data: what fits into them. Source: PreForm's build volumes."""

import difflib
from dataclasses import dataclass

from probedesign.errors import InputError
from probedesign.units import MM


@dataclass(frozen=True)
class Printer:
    """Build volume of one printer, x, y, z [m]."""

    name: str
    build_volume: tuple[float, float, float]

    def fits_upright(self, width: float, height: float) -> bool:
        """Whether a round part of that width stands upright in it, all in [m]."""
        x, y, z = self.build_volume
        return width <= min(x, y) and height <= z


def _printer(name: str, *size_mm: float) -> Printer:
    x, y, z = (v * MM for v in size_mm)
    return Printer(name, (x, y, z))


PRINTERS = {
    p.name: p
    for p in (
        _printer("form-2", 145, 145, 175),
        _printer("form-3", 145, 145, 185),
        _printer("form-3l", 336, 200, 300),
        _printer("form-4", 200, 125, 210),
        _printer("form-4l", 353, 196, 350),
    )
}


def printer_named(name: str) -> Printer:
    """The printer of that name.

    Raises:
        InputError: no such printer.
    """
    try:
        return PRINTERS[name]
    except KeyError:
        near = difflib.get_close_matches(name.lower(), PRINTERS, 1, 0.0)[0]
        raise InputError(
            f"print.printer: unknown '{name}'; nearest is '{near}'; known: {', '.join(sorted(PRINTERS))}"
        ) from None
