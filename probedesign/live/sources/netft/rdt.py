"""RDT: the protocol of the box over UDP (big-endian), and its status codes.

Source: ATI, Net F/T Sensor System, installation and operation manual 9620-05-NET FT, the chapter on RDT and the table
of the system status code. ATI, F/T Sensor, Ethernet Axia, manuals 9610-05-Ethernet Axia-09, tables 4.7 and 4.9, and
9620-05-C-Ethernet Axia-02, table 5.7: an Axia has the same protocol, but another table.
"""

import struct
from typing import NamedTuple

import numpy as np

RDT_PORT = 49152
HTTP_PORT = 80
PAGE = "/netftapi2.xml"

#: Sampling rate of the box, independent of the record rate, counted by `ft_sequence`. The record rate is an integer
#: fraction of it.
SAMPLES_PER_SECOND = 7000
MAX_RECORDS = 40  #: Maximum number of records in a packet of buffered streaming.

STOP, REALTIME, BUFFERED, RESET_LATCH, BIAS = 0x0000, 0x0002, 0x0003, 0x0041, 0x0042  #: Commands to the box.

HEADER = 0x1234
REQUEST = struct.Struct(">HHI")
RECORD = struct.Struct(">III6i")
#: The record as an array type.
RECORDS = np.dtype([("rdt", ">u4"), ("ft", ">u4"), ("status", ">u4"), ("counts", ">i4", 6)])


class Request(NamedTuple):
    """Request of a client: a command, and a number of records; 0 is unlimited."""

    command: int
    records: int = 0

    def packed(self) -> bytes:
        """Return the request as eight bytes."""
        return REQUEST.pack(HEADER, self.command, self.records)


def parse_request(datagram: bytes) -> Request | None:
    """Return the request in a datagram; None if it is not a request."""
    if len(datagram) != REQUEST.size:
        return None
    header, command, count = REQUEST.unpack(datagram)
    return Request(command, count) if header == HEADER else None


#: The second value: a monitor condition has been latched, which is not a fault of the sample.
HEALTHY = (0x00000000, 0x80010000)

SUMMARY, LATCHED, SATURATED = 1 << 31, 1 << 16, 1 << 17
HARMLESS = (*HEALTHY, LATCHED)


class StatusTable(NamedTuple):
    """Meaning of the status word of one kind of sensor."""

    kind: str  #: the kind, for messages.
    texts: dict[int, str]  #: faults by bit; bit 31 is the summary.
    harmless: tuple[int, ...]  #: status words that are not faults of the sample.


NET_BOX = StatusTable(
    "Net Box",
    {
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
    },
    HARMLESS,
)
#: Bit 3 is no error by the manual, but readings are not reliable meanwhile.
AXIA = StatusTable(
    "Axia",
    {
        30: "force or torque out of range",
        29: "calibration checksum error",
        28: "simulated error",
        27: "gauge out of range",
        7: "calibration not accessible",
        5: "other error",
        3: "busy with a change of its settings; the reading may be affected",
        2: "broken gauge",
        1: "supply voltage out of range",
        0: "temperature out of range",
    },
    (0, LATCHED),
)


def fault_of(status: int, table: StatusTable = NET_BOX) -> str:
    """Return the fault of a status word; empty without one."""
    if status in table.harmless:
        return ""
    texts = [text for bit, text in table.texts.items() if status >> bit & 1]
    return f"{', '.join(texts) or 'unknown fault'} (status 0x{status:08x})"
