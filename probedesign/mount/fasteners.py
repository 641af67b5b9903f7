"""Dimensions of screws, nuts and pins, and their clearances in printed resin."""

from dataclasses import dataclass

from probedesign.core.units import MM


@dataclass(frozen=True)
class SocketScrew:
    """A socket head cap screw, ISO 4762; its shank is modelled as a cylinder of the thread's pitch diameter.

    Attributes:
        thread: its designation, such as "M2".
        head_d, head_height: of the head [m].
        socket_af, socket_depth: hexagon across flats and its depth [m].
        pitch_d: pitch diameter of the thread [m].
        key_length: long arm of its hexagon key, standard series [m].
        stock_mm: lengths in stock [mm].
    """

    thread: str
    head_d: float
    head_height: float
    socket_af: float
    socket_depth: float
    pitch_d: float
    key_length: float
    stock_mm: tuple[int, ...]


# Source: ISO 4762 (heads, sockets, lengths), ISO 724 (pitch diameters), ISO 2936 (keys).
M2 = SocketScrew("M2", 3.8 * MM, 2.0 * MM, 1.5 * MM, 1.0 * MM, 1.740 * MM, 46.5 * MM, (3, 4, 5, 6, 8, 10, 12))
M4 = SocketScrew("M4", 7.0 * MM, 4.0 * MM, 3.0 * MM, 2.0 * MM, 3.545 * MM, 66.0 * MM, (8, 10, 12, 16, 20, 25))
M5 = SocketScrew("M5", 8.5 * MM, 5.0 * MM, 4.0 * MM, 2.5 * MM, 4.480 * MM, 74.0 * MM, (8, 10, 12, 16, 20, 25))
M6 = SocketScrew(
    "M6", 10.0 * MM, 6.0 * MM, 5.0 * MM, 3.0 * MM, 5.350 * MM, 85.0 * MM, (10, 12, 16, 20, 25, 30)
)
M8 = SocketScrew(
    "M8", 13.0 * MM, 8.0 * MM, 6.0 * MM, 4.0 * MM, 7.188 * MM, 96.0 * MM, (12, 16, 20, 25, 30, 35)
)
SCREWS = {s.thread: s for s in (M2, M4, M5, M6, M8)}

M2_CLEARANCE_D = 2.4 * MM
M2_COUNTERBORE_D = M2.head_d + 0.4 * MM
M2_GRIP = 3.0 * MM
"""Resin under an M2 head; the stock M2×6 then enters the sensor by 3.0 mm."""
M2_LENGTH = 6.0 * MM
HEAD_SUNK = 0.2 * MM
"""A head lies this far below the face, so that it cannot dent the part that rests on it."""
M2_NUT_AF, M2_NUT_HEIGHT = 4.0 * MM, 1.6 * MM  # ISO 4032
NUT_PROTRUSION = 0.4 * MM  # one pitch of M2 beyond the nut
STEEL_DENSITY = 7900.0
"""Of screws, nuts and pins [kg/m³]. Source: stainless A2, any table; assumed."""
