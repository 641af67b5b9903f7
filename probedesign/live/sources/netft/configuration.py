"""What a Net F/T box says of itself in `netftapi2.xml`: units, counts, the frame it reports in.

Source: ATI, manual 9620-05-NET FT, the chapter on system settings XML pages.
"""

import math
import re
import threading
from dataclasses import dataclass, fields
from functools import cached_property
from http.client import HTTPConnection, HTTPException
from time import monotonic

import numpy as np

from probedesign.errors import InputError, MissingDependencyError
from probedesign.frames import Array, pose, rotation_z, wrench_map
from probedesign.live.sources.netft.wire import PAGE

POUND_FORCE = 4.4482216152605  # exact, from the pound and standard gravity
KILOGRAM_FORCE = 9.80665  # exact
INCH, FOOT = 0.0254, 0.3048  # exact

FORCE_UNITS = {
    "n": 1.0, "kn": 1e3, "lbf": POUND_FORCE, "klbf": 1e3 * POUND_FORCE, "kgf": KILOGRAM_FORCE, "kg": KILOGRAM_FORCE,
}  # fmt: skip
TORQUE_UNITS = {
    "nm": 1.0, "nmm": 1e-3, "knm": 1e3, "lbfin": POUND_FORCE * INCH, "lbfft": POUND_FORCE * FOOT,
    "kgfcm": KILOGRAM_FORCE * 0.01, "kgcm": KILOGRAM_FORCE * 0.01,
}  # fmt: skip
LENGTH_UNITS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "in": INCH, "ft": FOOT}
ANGLE_UNITS = {"degrees": math.pi / 180.0, "deg": math.pi / 180.0, "radians": 1.0, "rad": 1.0}
"""To SI, by the unit's letters: boxes spell N-mm, N·mm and Nmm."""

MOST_TEXT = 128  # of one value


@dataclass(frozen=True)
class Configuration:
    """The active configuration of a box, in its own units; names of the page's tags in brackets.

    Attributes:
        product: [prodname].
        name: of the configuration [cfgnam].
        force_unit: [scfgfu].
        torque_unit: [scfgtu].
        counts_per_force: counts of one force unit [cfgcpf].
        counts_per_torque: counts of one torque unit [cfgcpt].
        ranges: largest reading of each channel, in those units [cfgmr].
        tool: displacement and rotation of the frame it reports in [cfgtfx].
        length_unit: of the displacement [scfgtdu].
        angle_unit: of the rotation [scfgtau].
        rate: records a second [comrdtrate].
        records: in a packet of buffered streaming [comrdtbsiz].
        filter: number of its low-pass filter, 0 for none [setuserfilter].
        bias: gauge counts that it takes off [setbias].
    """

    product: str
    force_unit: str
    torque_unit: str
    counts_per_force: float
    counts_per_torque: float
    name: str = ""
    ranges: tuple[float, ...] = ()
    tool: tuple[float, ...] = (0.0,) * 6
    length_unit: str = "mm"
    angle_unit: str = "degrees"
    rate: float = 7000.0
    records: float = 1.0
    filter: float = 0.0
    bias: tuple[float, ...] = (0.0,) * 6

    def __post_init__(self) -> None:
        """Raises InputError where a unit is unknown or a number cannot be meant."""
        for tag, value in (("cfgcpf", self.counts_per_force), ("cfgcpt", self.counts_per_torque)):
            if not value > 0.0:
                raise InputError(f"netftapi2.xml: {tag} = {value:g} must be positive")
        for tag, six in (("cfgtfx", self.tool), ("setbias", self.bias)):
            if len(six) != 6:
                raise InputError(f"netftapi2.xml: {tag} holds {len(six)} numbers, not 6")
        _ = self.to_sensor  # every unit is known or refused here

    @property
    def scale(self) -> Array:
        """SI of one count of each channel, (6,)."""
        force = unit_of("scfgfu", self.force_unit, FORCE_UNITS) / self.counts_per_force
        torque = unit_of("scfgtu", self.torque_unit, TORQUE_UNITS) / self.counts_per_torque
        return np.repeat([force, torque], 3)

    @property
    def counts_of_unit(self) -> Array:
        """Counts of one unit of each channel, (6,)."""
        return np.repeat([self.counts_per_force, self.counts_per_torque], 3)

    @property
    def T_sensor_tool(self) -> Array:
        """Pose of the frame that the box reports in, in the sensor's own, (4, 4).

        Displacement first, then rotation about x, the new y and the new z: as ATI's DAQ library turns; that
        the box does likewise is assumed.
        """
        length = unit_of("scfgtdu", self.length_unit, LENGTH_UNITS)
        angle = unit_of("scfgtau", self.angle_unit, ANGLE_UNITS)
        x, y, z = angle * np.asarray(self.tool[3:])
        R = _rotation_x(x) @ _rotation_y(y) @ rotation_z(z)
        return pose(R, length * np.asarray(self.tool[:3]))

    @cached_property
    def to_sensor(self) -> Array:
        """Carries counts to the wrench in the sensor's own frame [N, N·m], (6, 6)."""
        return np.asarray(wrench_map(self.T_sensor_tool) * self.scale)

    @property
    def notes(self) -> tuple[str, ...]:
        """What a user should know of it."""
        told = [
            f"{self.product} reads {self.force_unit} and {self.torque_unit}, {self.rate:g} records a second"
        ]
        if any(self.tool):
            shift = ", ".join(f"{value:g}" for value in self.tool)
            units = f"{self.length_unit}, {self.angle_unit}"
            told.append(f"the box holds a tool transform ({shift}; {units}): folded out")
        if any(self.bias):
            told.append(
                "the box holds a software bias: absolute loads and what is near the range are not known"
            )
        if self.filter:
            told.append(
                f"the box filters (setuserfilter {self.filter:g}): readings lag and are not independent"
            )
        return tuple(told)


TAGS = {
    "product": "prodname", "name": "cfgnam", "force_unit": "scfgfu", "torque_unit": "scfgtu",
    "counts_per_force": "cfgcpf", "counts_per_torque": "cfgcpt", "ranges": "cfgmr", "tool": "cfgtfx",
    "length_unit": "scfgtdu", "angle_unit": "scfgtau", "rate": "comrdtrate", "records": "comrdtbsiz",
    "filter": "setuserfilter", "bias": "setbias",
}  # fmt: skip
"""Of the page, by our name."""
NEEDED = ("scfgfu", "scfgtu", "cfgcpf", "cfgcpt")
ARRAYS = ("ranges", "tool", "bias")
WORDS = ("product", "name", "force_unit", "torque_unit", "length_unit", "angle_unit")


def parse_configuration(page: bytes) -> Configuration:
    """Read the page; nothing in it is trusted.

    Args:
        page: `netftapi2.xml`.

    Raises:
        InputError: it is no XML, declares entities, lacks a tag, doubles one or holds no number there.
        MissingDependencyError: defusedxml is not installed.
    """
    texts = _texts(page)
    missing = [tag for tag in NEEDED if tag not in texts]
    if missing:
        raise InputError(f"netftapi2.xml: has no {', '.join(missing)}; is this a Net F/T box?")
    said = {name: _value(name, tag, texts[tag]) for name, tag in TAGS.items() if tag in texts}
    return Configuration(**{"product": "Net F/T box"} | said)  # type: ignore[arg-type]  # by _value's kinds


def differences(before: Configuration, after: Configuration) -> list[str]:
    """What of a configuration is another now, each as `tag: before, now after`."""
    pairs = [(TAGS[f.name], getattr(before, f.name), getattr(after, f.name)) for f in fields(before)]
    return [f"{tag}: {_told(old)}, now {_told(new)}" for tag, old, new in pairs if old != new]


def _texts(page: bytes) -> dict[str, str]:
    """Text of every tag that we read."""
    try:
        from defusedxml.common import DefusedXmlException
        from defusedxml.ElementTree import ParseError, fromstring
    except ImportError:
        raise MissingDependencyError(
            "reading a Net F/T box needs defusedxml; install probedesign[live]"
        ) from None
    try:
        root = fromstring(page, forbid_dtd=True)
    except (ParseError, DefusedXmlException, ValueError, LookupError) as error:
        raise InputError(f"netftapi2.xml: is no XML that can be trusted: {type(error).__name__}") from None
    texts: dict[str, str] = {}
    for element in root.iter():
        if element.tag not in TAGS.values():
            continue
        text = (element.text or "").strip()
        if element.tag in texts or len(element) or len(text) > MOST_TEXT:
            raise InputError(f"netftapi2.xml: {element.tag} must stand there once, as a short text")
        texts[element.tag] = text
    return texts


def _value(name: str, tag: str, text: str) -> str | float | tuple[float, ...]:
    if name in WORDS:
        return " ".join("".join(c if c.isprintable() else " " for c in text).split())
    parts = [part for part in re.split(r"[;,\s]+", text) if part] if name in ARRAYS else [text]
    try:
        values = tuple(float(part) for part in parts)
    except ValueError:
        values = (math.nan,)
    if not all(map(math.isfinite, values)):
        raise InputError(f"netftapi2.xml: {tag} = {text[:40]!r} is no number")
    return values if name in ARRAYS else values[0]


def unit_of(tag: str, text: str, units: dict[str, float]) -> float:
    """What one of it is in SI."""
    letters = re.sub(r"[^a-z]", "", text.lower())
    if letters not in units:
        known = ", ".join(units)
        raise InputError(f"{tag} = {text[:40]!r} is no unit that is known; known: {known}")
    return units[letters]


def _told(value: object) -> str:
    return "; ".join(f"{v:g}" for v in value) if isinstance(value, tuple) else str(value)


def _rotation_x(angle: float) -> Array:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def _rotation_y(angle: float) -> Array:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


MAX_PAGE_BYTES = 65536
"""Of the page; a real one has some ten thousand."""
PAGE_TIMEOUT = 2.0
"""For the page [s]."""


def fetch_configuration(host: str, port: int) -> Configuration:
    """What the box says of itself now.

    Args:
        host: of the box.
        port: of its HTTP server.

    Raises:
        InputError: nobody answers, or not with a page of a Net F/T box.
    """
    return parse_configuration(fetch_page(host, port))


def fetch_page(host: str, port: int, patience: float = PAGE_TIMEOUT) -> bytes:
    """The page as it is.

    Args:
        host: of the box.
        port: of its HTTP server.
        patience: longest to wait [s].

    Raises:
        InputError: nobody answers, or not with a page.
    """
    address = f"http://{host}:{port}{PAGE}"
    connection = HTTPConnection(host, port, timeout=patience)
    try:
        connection.request("GET", PAGE, headers={"Connection": "close"})
        answer = connection.getresponse()
        page = b""
        deadline = monotonic() + patience
        while chunk := answer.read1(MAX_PAGE_BYTES + 1 - len(page)):
            page += chunk
            if len(page) > MAX_PAGE_BYTES or monotonic() > deadline:
                raise InputError(f"{address}: is too long or too slow for a Net F/T box")
    except (OSError, HTTPException, UnicodeError) as error:
        why = getattr(error, "strerror", None) or str(error) or type(error).__name__
        raise InputError(f"{address}: {why}; is the box on, and this its address and HTTP port?") from None
    finally:
        connection.close()
    if answer.status != 200:
        raise InputError(f"{address}: answers {answer.status}; is this a Net F/T box?")
    return page


class Watch:
    """Looks at the page now and then, for a configuration that changes while records stream.

    Attributes:
        changed: what is another now; empty as long as nothing is.
        period: of looking [s].
    """

    def __init__(self, host: str, port: int, first: Configuration, period: float) -> None:
        """Nothing runs yet.

        Args:
            host: of the box.
            port: of its HTTP server.
            first: what it said when it was opened.
            period: of looking [s].
        """
        self.changed: list[str] = []
        self.period = period
        self._host, self._port, self._first = host, port, first
        self._ended = threading.Event()

    def look(self) -> bool:
        """Look now; whether the page could be read."""
        try:
            page = fetch_page(self._host, self._port)
        except InputError:
            return False
        try:
            self.changed = differences(self._first, parse_configuration(page))
        except InputError as error:
            self.changed = [str(error)]
        return True

    def __enter__(self) -> "Watch":
        threading.Thread(target=self._watch, name="netft-watch", daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()

    def _watch(self) -> None:
        while not self._ended.wait(self.period) and not self.changed:
            self.look()
