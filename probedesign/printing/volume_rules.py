"""Does it stand in the printer? Upright, on its raft and supports."""

from probedesign.printer import PRINTERS, Printer
from probedesign.printing.limits import BUILD_VOLUME, HEIGHT_ABOVE_RAFT, RAFT_MARGIN, RAFT_THICKNESS
from probedesign.printing.rule import Finding
from probedesign.units import MM

STAND = RAFT_THICKNESS + HEIGHT_ABOVE_RAFT


def probe_fits(printer: Printer, width: float, below: float, length: float, scale_z: float) -> list[Finding]:
    """Width and height of a probe in a printer.

    Args:
        printer: of the design.
        width: of flange and body, as printed [mm].
        below: flange, as drawn [mm].
        length: of the flexible part, as drawn [mm].
        scale_z: printed over drawn.
    """
    height = scale_z * (below + length) + STAND
    longest = (_height(printer) - STAND) / scale_z - below
    remedy = f"the longest for a {printer.name} is {int(longest)} mm"
    return [
        _across("probe", printer, width, height),
        _upright("probe", printer, width, height, remedy if longest > 0 else ""),
    ]


def part_fits(part: str, printer: Printer, width: float, height: float) -> list[Finding]:
    """Width and height [mm] of another part, as printed."""
    height += STAND
    return [_across(part, printer, width, height), _upright(part, printer, width, height, "")]


def _across(part: str, printer: Printer, width: float, height: float) -> Finding:
    room = _platform(printer)
    return BUILD_VOLUME.at_most(
        part, "width with its raft", width + 2 * RAFT_MARGIN, room, _taken_by(width, height)
    )


def _upright(part: str, printer: Printer, width: float, height: float, remedy: str) -> Finding:
    larger = _taken_by(width, height)
    told = "; ".join(filter(None, (remedy, larger)))
    return BUILD_VOLUME.at_most(part, "height with its supports", height, _height(printer), told)


def _taken_by(width: float, height: float) -> str:
    """The smallest printer that takes a part."""
    for printer in sorted(PRINTERS.values(), key=_volume):
        if width + 2 * RAFT_MARGIN <= _platform(printer) and height <= _height(printer):
            return f"a {printer.name} takes it"
    return "no printer known here takes it"


def _platform(printer: Printer) -> float:
    return min(printer.build_volume[:2]) / MM


def _height(printer: Printer) -> float:
    return printer.build_volume[2] / MM


def _volume(printer: Printer) -> float:
    x, y, z = printer.build_volume
    return x * y * z
