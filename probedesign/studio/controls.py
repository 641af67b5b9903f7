"""The controls of the studio: what they change is a request, and they show the state of the session."""

import threading
from collections.abc import Callable
from typing import Any

import viser

from probedesign.core.units import MM
from probedesign.design.catalog import RESINS
from probedesign.design.schema import AXIS_KEYS, AXIS_KINDS
from probedesign.design.sensor_catalog import SENSORS
from probedesign.mount import build_geometry, root_radii
from probedesign.prediction.predict import FORCES_N
from probedesign.studio.session import MOUNTINGS, TOUCH_RANGE, Session, knots_of, mounting_of

AXIS_SLIDERS = {key: axis.slider for key, axis in AXIS_KEYS.items() if axis.slider is not None}
MAX_FRICTION = 1.5  #: Friction at the end of its slider.
Move = Callable[[str, Any], None]  #: Receives the key of a change and its new value.


class DesignControls:
    """Controls of the design and of the touch. All browser tabs share them."""

    def __init__(self, gui: viser.GuiApi, session: Session, move: Move) -> None:
        """Remember where the controls are added; `move` receives their changes."""
        self._gui, self._session, self._move = gui, session, move
        self._start = _values(session)
        self._handles: dict[str, Any] = {}
        self._knot_sliders: list[Any] = []
        self._forces: list[Any] = []
        self._showing = threading.local()

    def add_probe(self) -> None:
        """Add the controls of the probe."""
        self._choice("probe.shape", "shape", ("cone", "cylinder", "profile"))
        self._slider("probe.length_mm", "length [mm]", 20.0, 250.0, 1.0)
        self._slider("probe.base_d_mm", "base diameter [mm]", 2.0, 20.0, 0.1)
        self._slider("probe.tip_d_mm", "tip diameter [mm]", 1.0, 12.0, 0.1)
        self._knots = self._gui.add_folder("profile: diameters between [mm]", visible=False)
        self._choice("probe.section", "section", ("round", "hollow", "elliptic"))
        self._slider("probe.bore_ratio", "bore over outer diameter", 0.1, 0.9, 0.01)
        self._slider("probe.flatness", "flatness, y over x", 0.2, 1.0, 0.01)
        listed = {kind for key, axis in AXIS_KEYS.items() if key not in AXIS_SLIDERS for kind in axis.kinds}
        self._choice("probe.axis", "axis", tuple(kind for kind in AXIS_KINDS if kind not in listed))
        for key, (label, low, high, step) in AXIS_SLIDERS.items():
            self._slider(f"probe.{key}", label, low, high, step)
        self._choice("probe.tip", "tip", ("blunt", "rounded"))
        self._choice("material.resin", "resin", tuple(RESINS))
        self._slider("material.youngs_modulus_mpa", "E [MPa]", 0.2, 10.0, 0.01)

    def add_bench(self) -> None:
        """Add the controls of the sensor, the mount and the forces that are drawn."""
        gui, session = self._gui, self._session
        self._choice("sensor.model", "sensor", tuple(SENSORS))
        self._choice("sensor.calibration", "calibration", _calibrations(session))
        samples = self._start["sensor.averaging_samples"]
        self._bind("sensor.averaging_samples", gui.add_slider("samples in one reading", 1, 1000, 1, samples))
        self._choice("mounting", "probe points", (*MOUNTINGS, "other"))
        gravity = session.design.mount.gravity_base_m_s2
        vector = gui.add_vector3("gravity in base axes [m/s²]", gravity, step=0.01)
        self._bind("mount.gravity_base_m_s2", vector, list)
        self._choice("mount.hold", "flange is held", ("clamped", "glued", "bonded"))
        self._slider("mount.root_rigid_radii", "root, rigid base radii", -0.5, 0.5, 0.01)
        self._slider("contact.friction", "friction", 0.0, MAX_FRICTION, 0.05)
        self._slider("contact.object_compliance_m_N", "object yields [m/N]", 0.0, 0.5, 0.005)
        gui.add_markdown("Forces whose errors are drawn:")
        self._forces = [gui.add_checkbox(f"{1e3 * f:g} mN", 1e3 * f in session.forces_mN) for f in FORCES_N]
        for box in self._forces:
            box.on_update(lambda _: self._choose_forces())

    def add_touch(self) -> None:
        """Add the controls of the touch that is drawn."""
        self._slider("touch.fraction", "place, fraction of the length", *TOUCH_RANGE["fraction"], 0.01)
        self._slider("touch.angle_deg", "direction [deg]", *TOUCH_RANGE["angle_deg"], 1.0)
        self._slider("touch.force_mN", "force [mN]", *TOUCH_RANGE["force_mN"], 0.5)

    def _bind(self, key: str, handle: Any, value: Callable[[Any], Any] = lambda value: value) -> None:
        self._handles[key] = handle

        def changed(_: Any) -> None:
            if not getattr(self._showing, "now", False):
                self._move(key, value(handle.value))

        handle.on_update(changed)

    def _choice(self, key: str, label: str, options: tuple[str, ...]) -> None:
        value = self._start[key]
        listed = tuple(dict.fromkeys((*options, value)))
        self._bind(key, self._gui.add_dropdown(label, listed, initial_value=value))

    def _slider(self, key: str, label: str, low: float, high: float, step: float) -> None:
        value = self._start[key]
        value = low if value is None else value  # hidden: the design does not use it
        self._bind(key, self._gui.add_slider(label, min(low, value), max(high, value), step, value))

    def _choose_forces(self) -> None:
        chosen = tuple(1e3 * f for f, box in zip(FORCES_N, self._forces, strict=True) if box.value)
        self._move("forces", chosen or (10.0,))

    def show(self, waiting: set[str]) -> None:
        """Set the controls to the state of the session; what a design does not use is hidden.

        Args:
            waiting: keys whose next value is known already; their controls are left alone.
        """
        session = self._session
        self._showing.now = True  # viser calls the handlers of a value that is set here in this thread
        try:
            if (options := _calibrations(session)) != self._handles["sensor.calibration"].options:
                self._handles["sensor.calibration"].options = options
            for key, value in _values(session).items():
                handle = self._handles[key]
                if handle.visible is (value is None):
                    handle.visible = value is not None  # hidden where the design does not use it
                if value is not None and key not in waiting and not session.refused:
                    _set(handle, value)
            self._show_knots()
        finally:
            self._showing.now = False

    def _show_knots(self) -> None:
        knots = knots_of(self._session.design)
        self._knots.visible = bool(knots)
        if len(knots) != len(self._knot_sliders):
            for handle in self._knot_sliders:
                handle.remove()
            with self._knots:
                self._knot_sliders = [
                    self._gui.add_slider(f"at {s / MM:.0f} mm", 1.0, 20.0, 0.1, min(max(d / MM, 1.0), 20.0))
                    for _, s, d in knots
                ]
            for slider, (index, _, _) in zip(self._knot_sliders, knots, strict=True):
                self._bind(f"knot.{index}", slider)
        for slider, (_, _, d) in zip(self._knot_sliders, knots, strict=True):
            _set(slider, d / MM)


def _values(session: Session) -> dict[str, Any]:
    """Return the value of each control; None where the design does not use it."""
    design, probe = session.design, session.design.probe
    plain = ("shape", "length_mm", "base_d_mm", "tip_d_mm", "section", "bore_ratio", "flatness", "axis", "tip")
    return {
        **{f"probe.{key}": getattr(probe, key) for key in (*plain, *AXIS_SLIDERS)},
        "material.resin": design.material.resin,
        "material.youngs_modulus_mpa": design.youngs_modulus.value / 1e6,
        "sensor.model": design.sensor_model.name,
        "sensor.calibration": design.calibration.name,
        "sensor.averaging_samples": design.sensor.averaging_samples,
        "mounting": mounting_of(design.mount.gravity_base_m_s2),
        "mount.gravity_base_m_s2": tuple(design.mount.gravity_base_m_s2),
        "mount.hold": design.mount.hold,
        "mount.root_rigid_radii": root_radii(design, build_geometry(design)),
        "contact.friction": min(design.friction.value, MAX_FRICTION),
        "contact.object_compliance_m_N": design.object_compliance.value,
        **{f"touch.{key}": value for key, value in vars(session.touch).items()},
    }


def _set(handle: Any, value: Any) -> None:
    """Set a control to a value; the range of a slider is extended to it."""
    if isinstance(handle, viser.GuiSliderHandle):
        if value > handle.max:
            handle.max = value
        if value < handle.min:
            handle.min = value
    if handle.value != value:
        handle.value = value


def _calibrations(session: Session) -> tuple[str, ...]:
    return tuple(calibration.name for calibration in session.design.sensor_model.calibrations)
