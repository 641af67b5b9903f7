"""RDT: what goes over UDP between the box and its client. Big-endian.

Source: ATI, Net F/T Sensor System, installation and operation manual 9620-05-NET FT, the chapter on RDT.
"""

import struct
from typing import NamedTuple

import numpy as np

RDT_PORT = 49152
HTTP_PORT = 80
PAGE = "/netftapi2.xml"

SAMPLES_PER_SECOND = 7000
"""Of the box itself, whatever it sends; `ft_sequence` counts them. The rate of records is this over a whole number."""
MOST_RECORDS = 40
"""In one packet of buffered streaming."""

STOP, REALTIME, BUFFERED, RESET_LATCH, BIAS = 0x0000, 0x0002, 0x0003, 0x0041, 0x0042
"""Commands that the box hears."""

HEADER = 0x1234
REQUEST = struct.Struct(">HHI")
RECORD = struct.Struct(">III6i")
RECORDS = np.dtype([("rdt", ">u4"), ("ft", ">u4"), ("status", ">u4"), ("counts", ">i4", 6)])
"""The same record, for many at once."""


class Request(NamedTuple):
    """What a client asks for.

    Attributes:
        command: one of the above.
        records: how many; 0 for no end.
    """

    command: int
    records: int = 0

    def packed(self) -> bytes:
        """Its eight bytes."""
        return REQUEST.pack(HEADER, self.command, self.records)


def parse_request(datagram: bytes) -> Request | None:
    """The request that a datagram holds; None if it holds none."""
    if len(datagram) != REQUEST.size:
        return None
    header, command, count = REQUEST.unpack(datagram)
    return Request(command, count) if header == HEADER else None
