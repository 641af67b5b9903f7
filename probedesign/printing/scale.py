"""Scale of the files to print: printed over drawn size, which compensates for the shrinkage of a resin."""

from probedesign.design import Design

AS_DRAWN = (1.0, 1.0, 1.0)


def print_scale(design: Design, part: str) -> tuple[float, float, float]:
    """Return the printed size over the drawn size, along x, y and z, of a printed part."""
    return design.print_.scale if part == "probe" else design.print_.rigid_scale


def is_compensated(design: Design) -> bool:
    """Return whether any part is printed in another size than drawn."""
    return any(print_scale(design, part) != AS_DRAWN for part in ("probe", "rigid parts"))


def scale_note(design: Design, part: str) -> str:
    """Return the note for a part's file; empty if the part is printed as drawn."""
    scale = print_scale(design, part)
    return "" if scale == AS_DRAWN else f" scaled {scale[0]:g} {scale[1]:g} {scale[2]:g}"
