"""Scale compensation: parts are printed larger than drawn, by what the print shrinks, and come out as drawn.

It touches the files to print and nothing else: not the mechanics, the fingerprint, the STEP file or the check
of the drawn parts.
"""

from probedesign.design import Design

AS_DRAWN = (1.0, 1.0, 1.0)


def scale_of(design: Design, part: str) -> tuple[float, float, float]:
    """Printed over drawn, along x, y and z, of one printed part."""
    return design.print_.scale if part == "probe" else design.print_.rigid_scale


def compensated(design: Design) -> bool:
    """Whether any part is printed in another size than drawn."""
    return any(scale_of(design, part) != AS_DRAWN for part in ("probe", "rigid parts"))


def scale_note(design: Design, part: str) -> str:
    """What the file of a part says of it; empty if the part is printed as drawn."""
    scale = scale_of(design, part)
    return "" if scale == AS_DRAWN else f" scaled {scale[0]:g} {scale[1]:g} {scale[2]:g}"
