"""The status word of a Net Box's records, in words. Axia sensors have another table.

Source: ATI, manual 9620-05-NET FT, the table of the system status code.
"""

HEALTHY = (0x00000000, 0x80010000)
"""The second: a monitor condition has been latched, which is no fault of the sample."""

SUMMARY, LATCHED, SATURATED = 1 << 31, 1 << 16, 1 << 17
HARMLESS = (*HEALTHY, LATCHED)

WORDS = {
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
    told = [words for bit, words in WORDS.items() if status >> bit & 1]
    return f"{', '.join(told) or 'unknown fault'} (status 0x{status:08x})"
