"""Configuration of a Net F/T box, from its page `netftapi2.xml`: units, counts and reference frame.

The page is fetched over HTTP with bounds on size and time, and monitored for changes.

Source: ATI, manual 9620-05-NET FT, the chapter on system settings XML pages.
"""

import math
import re
import socket
import threading
from contextlib import suppress
from dataclasses import dataclass, fields
from functools import cached_property
from http.client import HTTPConnection, HTTPException
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from probedesign.core.errors import InputError, MissingDependencyError, one_line
from probedesign.core.frames import Array, pose, rotation_z, wrench_map
from probedesign.core.units import ANGLE_UNITS, FORCE_UNITS, LENGTH_UNITS, TORQUE_UNITS, unit_of
from probedesign.live.sources.netft_rdt import PAGE

MAX_TEXT = 128  # of one value
FILE = PAGE.removeprefix("/")


@dataclass(frozen=True)
class NetFTConfiguration:
    """Active configuration of a box, in its own units; tags of the page in brackets."""

    product: str  #: product name [prodname].
    force_unit: str  #: unit of force [scfgfu].
    torque_unit: str  #: unit of torque [scfgtu].
    counts_per_force: float  #: counts per force unit [cfgcpf].
    counts_per_torque: float  #: counts per torque unit [cfgcpt].
    ranges: tuple[float, ...] = ()  #: range of each channel, in those units [cfgmr].
    tool: tuple[float, ...] = (0.0,) * 6  #: displacement and rotation of the reported frame [cfgtfx].
    length_unit: str = "mm"  #: unit of the displacement [scfgtdu].
    angle_unit: str = "degrees"  #: unit of the rotation [scfgtau].
    rate: float = 7000.0  #: records per second [comrdtrate].
    filter: float = 0.0  #: number of the low-pass filter, 0 for none [setuserfilter].
    bias: tuple[float, ...] = (0.0,) * 6  #: gauge counts that the box subtracts [setbias].

    def __post_init__(self) -> None:
        for tag, value in (("cfgcpf", self.counts_per_force), ("cfgcpt", self.counts_per_torque)):
            if not value > 0.0:
                raise InputError(f"{FILE}: {tag} = {value:g} must be positive")
        for tag, six in (("cfgtfx", self.tool), ("setbias", self.bias)):
            if len(six) != 6:
                raise InputError(f"{FILE}: {tag} has {len(six)} numbers instead of 6")
        _ = self.to_sensor  # raises for an unknown unit

    @property
    def units(self) -> Array:
        """Unit of each channel in SI, (6,)."""
        force = unit_of("scfgfu", self.force_unit, FORCE_UNITS)
        return np.repeat([force, unit_of("scfgtu", self.torque_unit, TORQUE_UNITS)], 3)

    @property
    def T_sensor_tool(self) -> Array:
        """Pose of the reported frame in the sensor frame, (4, 4).

        Displacement first, then rotation about x, the new y and the new z, as in ATI's DAQ library; that the box uses
        the same convention is assumed.
        """
        length = unit_of("scfgtdu", self.length_unit, LENGTH_UNITS)
        angle = unit_of("scfgtau", self.angle_unit, ANGLE_UNITS)
        x, y, z = angle * np.asarray(self.tool[3:])
        (c, s), (d, t) = (math.cos(x), math.sin(x)), (math.cos(y), math.sin(y))
        about_x = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
        about_y = np.array([[d, 0.0, t], [0.0, 1.0, 0.0], [-t, 0.0, d]])
        return pose(about_x @ about_y @ rotation_z(z), length * np.asarray(self.tool[:3]))

    @cached_property
    def to_sensor(self) -> Array:
        """Matrix from counts to the wrench in the sensor frame [N, N·m], (6, 6)."""
        counts_of_unit = np.repeat([self.counts_per_force, self.counts_per_torque], 3)
        return np.asarray(wrench_map(self.T_sensor_tool) * (self.units / counts_of_unit))

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user."""
        notes = [f"{self.product} reports {self.force_unit} and {self.torque_unit} at {self.rate:g} records/s"]
        if any(self.tool):
            shift = ", ".join(f"{value:g}" for value in self.tool)
            units = f"{self.length_unit}, {self.angle_unit}"
            notes.append(f"the box has a tool transform ({shift}; {units}): compensated")
        if any(self.bias):
            notes.append("the box has a software bias: loads and the distance to the range limit are unknown")
        if self.filter:
            notes.append(f"the box filters (setuserfilter {self.filter:g}): readings are delayed, correlated")
        return tuple(notes)


#: Tags of the page, by attribute name.
TAGS = {
    "product": "prodname", "force_unit": "scfgfu", "torque_unit": "scfgtu", "counts_per_force": "cfgcpf",
    "counts_per_torque": "cfgcpt", "ranges": "cfgmr", "tool": "cfgtfx", "length_unit": "scfgtdu",
    "angle_unit": "scfgtau", "rate": "comrdtrate", "filter": "setuserfilter", "bias": "setbias",
}  # fmt: skip
REQUIRED_TAGS = ("scfgfu", "scfgtu", "cfgcpf", "cfgcpt")


def parse_configuration(page: bytes) -> NetFTConfiguration:
    """Return the configuration on the page `netftapi2.xml`, whose content is not trusted.

    Raises:
        InputError: it is not XML, declares entities, or a tag is missing, duplicated or not a number.
        MissingDependencyError: defusedxml is not installed.
    """
    texts: dict[str, str] = {}
    for element in parse_xml(page, FILE).iter():
        if element.tag in TAGS.values():
            text = (element.text or "").strip()
            if element.tag in texts or len(element) or len(text) > MAX_TEXT:
                raise InputError(f"{FILE}: {element.tag} must occur once, as a short text")
            texts[element.tag] = text
    missing = [tag for tag in REQUIRED_TAGS if tag not in texts]
    if missing:
        raise InputError(f"{FILE}: has no {', '.join(missing)}; is this a Net F/T box?")
    values = {f.name: _value(f.type, tag, texts[tag])
              for f in fields(NetFTConfiguration) if (tag := TAGS[f.name]) in texts}  # fmt: skip
    return NetFTConfiguration(**{"product": "Net F/T box"} | values)  # type: ignore[arg-type]  # the types are those of _value


def _value(kind: object, tag: str, text: str) -> str | float | tuple[float, ...]:
    if kind is str:
        return " ".join("".join(c if c.isprintable() else " " for c in text).split())
    parts = [text] if kind is float else [part for part in re.split(r"[;,\s]+", text) if part]
    try:
        values = tuple(float(part) for part in parts)
    except ValueError:
        values = (math.nan,)
    if not all(map(math.isfinite, values)):
        raise InputError(f"{FILE}: {tag} = {text[:40]!r} is not a number")
    return values[0] if kind is float else values


def differences(before: NetFTConfiguration, after: NetFTConfiguration) -> list[str]:
    """Return the changes between two configurations, each as `tag: before, now after`."""

    def text(value: object) -> str:
        return "; ".join(f"{v:g}" for v in value) if isinstance(value, tuple) else str(value)

    pairs = [(tag, getattr(before, name), getattr(after, name)) for name, tag in TAGS.items()]
    return [f"{tag}: {text(old)}, now {text(new)}" for tag, old, new in pairs if old != new]


def parse_xml(content: bytes, file: str | Path) -> Element:
    """Return the root of an XML document, which is not trusted; `file` is for messages.

    Raises:
        InputError: it is not XML, or declares entities.
        MissingDependencyError: defusedxml is not installed.
    """
    try:
        from defusedxml.common import DefusedXmlException
        from defusedxml.ElementTree import ParseError, fromstring
    except ImportError:
        raise MissingDependencyError.of_extra(f"reading {file}", "defusedxml", "live") from None
    try:
        root: Element = fromstring(content, forbid_dtd=True)
    except (ParseError, DefusedXmlException, ValueError, LookupError) as error:
        raise InputError(f"{file}: not valid or safe XML: {type(error).__name__}") from None
    return root


MAX_PAGE_BYTES = 65536  #: Maximum size of the page [bytes]; about ten thousand are usual.
PAGE_TIMEOUT = 2.0  #: Maximum time to fetch the page [s].


def fetch_page(host: str, port: int, timeout: float = PAGE_TIMEOUT) -> bytes:
    """Fetch the page within a timeout [s], whatever the other side sends and at whatever pace.

    Raises:
        InputError: there is no response, or it is not a page.
    """
    address = f"http://{host}:{port}{PAGE}"
    connection = HTTPConnection(host, port, timeout=timeout)
    late = threading.Event()

    def give_up() -> None:  # a timeout of the socket alone limits each byte, not all of them
        late.set()
        with suppress(OSError):  # it may just have been closed
            link.shutdown(socket.SHUT_RDWR)

    deadline = threading.Timer(timeout, give_up)
    deadline.daemon = True
    try:
        connection.connect()
        link = connection.sock
        deadline.start()
        connection.request("GET", PAGE, headers={"Connection": "close"})
        response = connection.getresponse()  # whose headers are limited by http.client
        page = response.read(MAX_PAGE_BYTES + 1)
    except (OSError, HTTPException, UnicodeError, ValueError) as error:
        why = getattr(error, "strerror", None) or str(error) or type(error).__name__
        why = f"no complete response within {timeout:g} s" if late.is_set() else one_line(why)
        raise InputError(f"{address}: {why}; is the box on, and this its address and HTTP port?") from None
    finally:
        deadline.cancel()
        connection.close()
    if late.is_set() or len(page) > MAX_PAGE_BYTES:
        raise InputError(f"{address}: too long or too slow for the page of a Net F/T box")
    if response.status != 200:
        raise InputError(f"{address}: HTTP status {response.status}; is this a Net F/T box?")
    return page


class ConfigurationMonitor:
    """Fetches the page in a thread, periodically [s] and on request, to detect a configuration that changes.

    Attributes:
        changed: the changes; empty if there are none.
        read: number of the last request that preceded a page that was read.
    """

    def __init__(self, host: str, port: int, first: NetFTConfiguration, period: float) -> None:
        self.changed: list[str] = []
        self.period, self._host, self._port, self._initial = period, host, port, first
        self.read = self._requests = 0
        self._ended, self._wake = threading.Event(), threading.Event()

    def request(self) -> int:
        """Fetch the page as soon as possible; return the number of this request."""
        self._requests += 1
        self._wake.set()
        return self._requests

    def __enter__(self) -> "ConfigurationMonitor":
        threading.Thread(target=self._poll, name="netft-watch", daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._wake.set()

    def _poll(self) -> None:
        while not self.changed:
            self._wake.wait(self.period)
            self._wake.clear()
            if self._ended.is_set():
                return
            request = self._requests
            try:
                page = fetch_page(self._host, self._port)
            except InputError:
                continue
            try:
                self.changed = differences(self._initial, parse_configuration(page))
            except InputError as error:
                self.changed = [str(error)]
            self.read = request
