"""State of the studio without its page: the design, its history, the touch, the pinned designs.

Every change passes through `Session.change`, which checks it as a design file is checked. Nothing here draws.
"""

import base64
import json
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from probedesign.core.errors import InputError
from probedesign.core.units import MM
from probedesign.design import Design, check_design
from probedesign.design.edit import as_new_print, tables_of, with_values
from probedesign.design.io import default_tip_d_mm, sensor_keys
from probedesign.design.schema import AXIS_KEYS
from probedesign.design.sensor_catalog import SENSORS
from probedesign.design.sensors import DEFAULT_SENSOR
from probedesign.prediction.predict import FORCES_N

MAX_STEPS = 200  #: Number of changes that can be undone.
MERGE_SECONDS = 1.0  #: Changes of the same key within this time are undone together: one drag of a slider.
DEFAULT_FORCES_MN = (2.0, 5.0, 10.0, 20.0, 50.0)  #: Contact forces whose errors are drawn at the start.
MAX_LINK = 1_000_000  #: Size of the state in a link, unpacked [bytes].
MAX_PINNED = 4  #: Number of pinned designs that a chart distinguishes beside the current one.
#: Gravity in base axes [m/s²] of the directions in which the probe points.
MOUNTINGS = {"horizontal": (9.81, 0.0, 0.0), "down": (0.0, 0.0, 9.81), "up": (0.0, 0.0, -9.81)}
INTERIOR_KNOTS = (0.25, 0.5, 0.75)  #: Fractions of the length of the diameters that a free profile adds.


#: Smallest and largest value of each number of a touch that is drawn.
TOUCH_RANGE = {"fraction": (0.05, 1.0), "angle_deg": (-180.0, 180.0), "force_mN": (0.5, 200.0)}


@dataclass(frozen=True)
class StudioTouch:
    """The touch that is drawn."""

    fraction: float = 0.8  #: arclength of the touched section over the length.
    angle_deg: float = 90.0  #: direction of the push about the tangent, from the section's x axis.
    force_mN: float = 10.0  #: normal force.


@dataclass(frozen=True)
class PinnedDesign:
    """A design kept for comparison."""

    label: str
    design: Design


@dataclass
class Session:
    """The state of one studio. All browser tabs share it."""

    design: Design  #: the current design; always valid.
    touch: StudioTouch = StudioTouch()  #: the touch that is drawn.
    forces_mN: tuple[float, ...] = DEFAULT_FORCES_MN  #: contact forces whose errors are drawn.
    pinned: list[PinnedDesign] = field(default_factory=list)  #: designs kept for comparison.
    refused: str = ""  #: why the last change was refused, in one line; empty if it was accepted.
    _undo: list[Design] = field(default_factory=list)
    _redo: list[Design] = field(default_factory=list)
    _last: tuple[str, float] = ("", 0.0)
    _beside: Design | None = None  # what `toggle` returns to

    def change(self, values: Mapping[str, Any], now: float) -> bool:
        """Change keys of the design; return whether the result is a valid design, which is then the current one.

        Args:
            values: new values by key of the design file, such as `probe.length_mm`.
            now: time of the change [s]; changes of the same keys shortly after each other are undone together.
        """
        try:
            changed = check_design(_with_keys(tables_of(self.design), values))
        except InputError as error:
            self.refused = str(error)
            return False
        self.refused = ""
        if changed != self.design:
            key = ",".join(sorted(values))
            if key != self._last[0] or now - self._last[1] > MERGE_SECONDS:
                self._undo = [*self._undo[-MAX_STEPS:], self.design]
            self._redo.clear()
            self._last = key, now
            self.design = changed
        return True

    def replace_design(self, design: Design) -> None:
        """Make another design the current one, as one step."""
        if design != self.design:
            self._undo = [*self._undo[-MAX_STEPS:], self.design]
            self._redo.clear()
            self._last, self.design, self.refused = ("", 0.0), design, ""

    def undo(self) -> bool:
        """Return to the design before the last change; return whether there was one."""
        return self._step(self._undo, self._redo)

    def redo(self) -> bool:
        """Repeat the change that was undone last; return whether there was one."""
        return self._step(self._redo, self._undo)

    def _step(self, source: list[Design], target: list[Design]) -> bool:
        if not source:
            return False
        target.append(self.design)
        self.design, self._last, self.refused = source.pop(), ("", 0.0), ""
        return True

    @property
    def former(self) -> Design | None:
        """Return the design before the last change; None at the start."""
        return self._undo[-1] if self._undo else None

    def toggle(self) -> bool:
        """Exchange the current design with the one that was pinned last; return whether one is pinned."""
        if not self.pinned:
            return False
        pinned, now = self.pinned[-1].design, self.design
        if now != pinned:
            self._beside = now
        elif self._beside is None:
            return False
        self.replace_design(pinned if now != pinned else self._beside or pinned)
        return True

    def pin(self) -> PinnedDesign | None:
        """Keep the current design for comparison; None if it is kept already."""
        if any(other.design == self.design for other in self.pinned):
            return None
        taken = {other.label for other in self.pinned}
        label = next(f"pin {n}" for n in range(1, len(taken) + 2) if f"pin {n}" not in taken)
        pin = PinnedDesign(label, self.design)
        self.pinned = [*self.pinned, pin][-MAX_PINNED:]
        return pin

    def unpin_last(self) -> None:
        """Drop the design that was pinned last, if any."""
        self.pinned = self.pinned[:-1]

    @property
    def link(self) -> str:
        """Return the whole state as text for the address of a page, which `open_link` reads."""
        state = {"design": tables_of(self.design), "touch": asdict(self.touch), "forces": self.forces_mN,
                 "pins": [tables_of(pin.design) for pin in self.pinned]}  # fmt: skip
        return base64.urlsafe_b64encode(zlib.compress(json.dumps(state).encode(), 9)).decode()

    def open_link(self, text: str) -> None:
        """Set the state to that of a link; the former design can be undone.

        Raises:
            InputError: the link is damaged, or a design in it is not valid; the state is as before.
        """
        try:
            unpacked = zlib.decompressobj().decompress(base64.urlsafe_b64decode(text), MAX_LINK)
            state = json.loads(unpacked)
            design, *pins = (check_design(tables) for tables in (state["design"], *state["pins"][:MAX_PINNED]))
            touch = StudioTouch(**{key: float(value) for key, value in state["touch"].items()})
            drawn = {round(1e3 * force, 6) for force in FORCES_N} & set(state["forces"])
            if not drawn or not all(low <= getattr(touch, key) <= high for key, (low, high) in TOUCH_RANGE.items()):
                raise ValueError("a touch or a force that is not drawn")
        except (ValueError, LookupError, TypeError, AttributeError, zlib.error, RecursionError) as error:
            raise InputError(f"the link is damaged: {' '.join(str(error).split())}") from None
        self.touch, self.forces_mN = touch, tuple(sorted(drawn))
        self.pinned = [PinnedDesign(f"pin {n}", pin) for n, pin in enumerate(pins, 1)]
        self.replace_design(design)


#: Keys that choose something by its name; others follow from them, unless they are given too.
_FIRST = ("probe.shape", "probe.section", "probe.axis", "material.resin", "sensor.model", "sensor.calibration",
          "mount.hold")  # fmt: skip
_LAST = "probe.profile_mm"
_ENDS = ("probe.length_mm", "probe.base_d_mm", "probe.tip_d_mm")


def _with_keys(data: dict[str, Any], values: Mapping[str, Any]) -> dict[str, Any]:
    before, order = data, {key: i for i, key in enumerate(_FIRST)}
    for key in sorted(values, key=lambda key: len(_FIRST) + (key == _LAST) if key not in order else order[key]):
        data = _with_key(data, key, values[key])
    return as_new_print(data, before)


def _with_key(data: dict[str, Any], key: str, value: Any) -> dict[str, Any]:
    """Return the tables of a design with one key changed, and the keys that follow from it."""
    wrong = (key in _FIRST and not isinstance(value, str)) or (key in _ENDS and not isinstance(value, float | int))
    if wrong or not isinstance(data.get(key.partition(".")[0]), dict):
        return with_values(data, {key: value})  # it or the check of the design refuses what is wrong
    match key:
        case "sensor.model":
            sensor = {k: v for k, v in data["sensor"].items() if k != "own"}
            return {**data, "sensor": sensor | sensor_keys(value)}
        case "sensor.calibration":
            sensor = data["sensor"]  # it stays if it has a calibration of this name
            described, known = sensor.get("own"), SENSORS.get(sensor.get("model", DEFAULT_SENSOR))
            names = [c["name"] for c in described["calibrations"]] if described else []
            if value in (names or ([c.name for c in known.calibrations] if known else [])):
                return {**data, "sensor": {**sensor, "calibration": value}}
            return {**data, "sensor": {k: v for k, v in sensor.items() if k != "own"} | sensor_keys(value)}
        case "probe.shape":
            return _with_shape(data, value)
        case "probe.section":
            ratios = {"hollow": {"bore_ratio": 0.5}, "elliptic": {"flatness": 0.7}}.get(value, {})
            probe = {k: v for k, v in data["probe"].items() if k not in ("bore_ratio", "flatness")}
            return {**data, "probe": {**probe, "section": value, **ratios}}
        case "probe.axis":
            old = {key: axis.start for key, axis in AXIS_KEYS.items()} | data["probe"]
            probe = {k: v for k, v in data["probe"].items() if k not in AXIS_KEYS} | {"axis": value}
            kept = {k: old[k] for k, axis in AXIS_KEYS.items() if value in axis.kinds}
            return {**data, "probe": probe | {k: v for k, v in kept.items() if v is not None}}
        case "material.youngs_modulus_mpa":  # chosen by hand: no longer what was identified
            return with_values(data, {key: value, "material.provenance.youngs_modulus_mpa": "assumed"})
        case "probe.length_mm" | "probe.base_d_mm" | "probe.tip_d_mm" if data["probe"].get("profile_mm"):
            return _with_profile_end(data, key, value)
    return with_values(data, {key: value})


def _with_shape(data: dict[str, Any], shape: str) -> dict[str, Any]:
    probe = {k: v for k, v in data["probe"].items() if k not in ("profile_mm", "tip_d_mm")}
    old = data["probe"]
    base, length = old["base_d_mm"], old["length_mm"]
    tip = old.get("tip_d_mm") or default_tip_d_mm(base)
    probe["shape"] = shape
    if shape != "cylinder":
        probe["tip_d_mm"] = tip
    if shape == "profile":
        between = [[round(f * length, 3), round(base + f * (tip - base), 3)] for f in INTERIOR_KNOTS]
        probe["profile_mm"] = [[0.0, base], *between, [length, tip]]
    return {**data, "probe": probe}


def _with_profile_end(data: dict[str, Any], key: str, value: float) -> dict[str, Any]:
    """Return a profile with another length, base or tip; its knots keep their fractions of the length."""
    profile = [list(knot) for knot in data["probe"]["profile_mm"]]
    if key == "probe.length_mm":
        scale = value / profile[-1][0]
        profile = [[round(s * scale, 3), d] for s, d in profile]
        profile[-1][0] = value
    else:
        profile[0 if key == "probe.base_d_mm" else -1][1] = value
    return with_values(data, {key: value, "probe.profile_mm": profile})


def with_knots(design: Design, diameters_mm: Mapping[int, float]) -> dict[str, Any]:
    """Return the change of interior diameters of a profile by index, for `Session.change`."""
    profile = [list(knot) for knot in design.probe.profile_mm or ()]
    for index, diameter in diameters_mm.items():
        profile[index][1] = round(diameter, 2)
    return {"probe.profile_mm": profile}


def mounting_of(gravity: Sequence[float]) -> str:
    """Return the name of the mounting direction, "other" for a gravity that has none."""
    return next((name for name, g in MOUNTINGS.items() if tuple(gravity) == g), "other")


def knots_of(design: Design) -> list[tuple[int, float, float]]:
    """Return index, arclength [m] and diameter [m] of the interior knots of a profile."""
    if design.probe.profile_mm is None:
        return []
    return [(i, s * MM, d * MM) for i, (s, d) in enumerate(design.probe.profile_mm)][1:-1]
