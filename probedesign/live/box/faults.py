"""What goes wrong on the wire: packets lost, late, twice, cut or made up. And what goes wrong with the box, when."""

import re
from dataclasses import dataclass, field, fields

import numpy as np

from probedesign.errors import InputError

EVENTS = ("stall", "restart", "stolen", "units", "saturate")
"""What can happen to the box, for a second or for good; `units`: somebody chooses another configuration."""


@dataclass
class Faults:
    """Parts of all packets that each fault befalls, and events at their times.

    Attributes:
        loss: never sent.
        reorder: sent after the one that follows.
        duplicate: sent twice.
        garbage: preceded by a datagram of random length and content, never as long as a record.
        short: cut.
        events: (time since the stream began [s], one of `EVENTS`).
        seed: of the chance.
    """

    loss: float = 0.0
    reorder: float = 0.0
    duplicate: float = 0.0
    garbage: float = 0.0
    short: float = 0.0
    events: list[tuple[float, str]] = field(default_factory=list)
    seed: int = 1
    _held: list[bytes] = field(default_factory=list, repr=False)

    def __post_init__(self) -> None:
        self._random = np.random.default_rng(self.seed)

    def through(self, packets: list[bytes]) -> list[bytes]:
        """The packets as they reach the wire, in order."""
        if not (self.loss or self.reorder or self.duplicate or self.garbage or self.short):
            return packets
        sent: list[bytes] = []
        for packet in packets:
            sent += self._befallen(packet)
        return sent

    def _befallen(self, packet: bytes) -> list[bytes]:
        loss, reorder, duplicate, garbage, short = self._random.random(5)
        if garbage < self.garbage:
            made_up = self._random.bytes(int(self._random.integers(0, 35)))
            return [made_up, packet]
        if loss < self.loss:
            return []
        if reorder < self.reorder and not self._held:
            self._held.append(packet)
            return []
        late, self._held = self._held, []
        if short < self.short:
            packet = packet[: int(self._random.integers(1, len(packet)))]
        return [packet] * (1 + (duplicate < self.duplicate)) + late


def parse_faults(texts: list[str], seed: int = 1) -> Faults:
    """Faults as the command line names them: `loss=0.01`, `restart@10`.

    Raises:
        InputError: one is unknown or its number is wrong.
    """
    rates = [f.name for f in fields(Faults) if f.type is float or f.type == "float"]
    said: dict[str, float] = {}
    events = []
    for text in texts:
        found = re.fullmatch(r"([a-z]+)([=@])(\d+\.?\d*|\.\d+)", text)
        name, sign, number = found.groups() if found else ("", "", "")
        if sign == "=" and name in rates and float(number) <= 1.0:
            said[name] = float(number)
        elif sign == "@" and name in EVENTS:
            events.append((float(number), name))
        else:
            raise InputError(
                f"--fault {text!r} must be one of {', '.join(rates)} as loss=0.01, a part of all packets, "
                f"or one of {', '.join(EVENTS)} as restart@10, seconds after the stream began"
            )
    return Faults(**said, events=sorted(events), seed=seed)  # type: ignore[arg-type]
