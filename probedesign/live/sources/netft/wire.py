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


HEALTHY = (0x00000000, 0x80010000)
"""The second: a monitor condition has been latched, which is no fault of the sample."""

SUMMARY, LATCHED, SATURATED = 1 << 31, 1 << 16, 1 << 17
HARMLESS = (*HEALTHY, LATCHED)

FAULTS = {
    30: "processor or memory error",
    29: "digital board error",
    28: "analogue board error",
    27: "serial link error",
    26: "program memory error",
    25: "halted by a wrong configuration",
    24: "settings are not valid",
    23: "configuration does not fit the calibration",
    22: "network failure",
    21: "CAN failure",
    20: "RDT failure",
    19: "EtherNet/IP failure",
    18: "DeviceNet failure",
    17: "transducer saturated or A/D error",
    14: "watchdog",
    13: "stack",
    12: "EEPROM failure",
    11: "flash failure",
    10: "analogue board watchdog",
    9: "gauge excitation current too high",
    8: "gauge excitation current too low",
    7: "artificial ground out of range",
    6: "supply too high",
    5: "supply too low",
    4: "no data from the transducer",
    3: "reference voltage or power",
    2: "temperature",
    1: "HTTP failure",
}
"""By bit; 31 sums up and 16 is no fault."""


def fault_of(status: int) -> str:
    """What is wrong with a record of that status; nothing if it is healthy."""
    if status in HARMLESS:
        return ""
    told = [words for bit, words in FAULTS.items() if status >> bit & 1]
    return f"{', '.join(told) or 'unknown fault'} (status 0x{status:08x})"
