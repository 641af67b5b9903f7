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
from probedesign.studio.session import MOUNTINGS, Session, knots_of, mounting_of

AXIS_SLIDERS = {key: axis.slider for key, axis in AXIS_KEYS.items() if axis.slider is not None}
MAX_FRICTION = 1.5  #: Friction at the end of its slider.
Move = Callable[[str, Any], None]  #: Receives the key of a change and its new value.


class DesignControls:
    """Controls of the design and of the touch. All browser tabs share them."""

    def __init__(self, gui: viser.GuiApi, session: Session, move: Move) -> None:
        """Remember where the controls are added; `move` receives their changes."""
        self._gui, self._session, self._move = gui, session, move
        self._handles: dict[str, Any] = {}
        self._knot_sliders: list[Any] = []
        self._forces: list[Any] = []
        self._showing = threading.local()

    def add_probe(self) -> None:
        """Add the controls of the probe."""
        gui, design, probe = self._gui, self._session.design, self._session.design.probe
        self._choice("probe.shape", "shape", ("cone", "cylinder", "profile"), probe.shape)
        self._slider("probe.length_mm", "length [mm]", 20.0, 250.0, 1.0, probe.length_mm)
        self._slider("probe.base_d_mm", "base diameter [mm]", 2.0, 20.0, 0.1, probe.base_d_mm)
        self._slider("probe.tip_d_mm", "tip diameter [mm]", 1.0, 12.0, 0.1, probe.tip_d_mm or probe.base_d_mm)
        self._knots = gui.add_folder("profile: diameters between [mm]", visible=False)
        self._choice("probe.section", "section", ("round", "hollow", "elliptic"), probe.section)
        self._slider("probe.bore_ratio", "bore over outer diameter", 0.1, 0.9, 0.01, probe.bore_ratio or 0.5)
        self._slider("probe.flatness", "flatness, y over x", 0.2, 1.0, 0.01, probe.flatness or 0.7)
        listed = {kind for key, axis in AXIS_KEYS.items() if key not in AXIS_SLIDERS for kind in axis.kinds}
        axes = dict.fromkeys([*(kind for kind in AXIS_KINDS if kind not in listed), probe.axis])
        self._choice("probe.axis", "axis", tuple(axes), probe.axis)
        for key, (label, low, high, step) in AXIS_SLIDERS.items():
            self._slider(f"probe.{key}", label, low, high, step, getattr(probe, key) or 0.0)
        self._choice("probe.tip", "tip", ("blunt", "rounded"), probe.tip)
        self._choice(
            "material.resin", "resin", tuple(dict.fromkeys((*RESINS, design.material.resin))), design.material.resin
        )
        self._slider("material.youngs_modulus_mpa", "E [MPa]", 0.2, 10.0, 0.01, design.youngs_modulus.value / 1e6)

    def add_bench(self) -> None:
        """Add the controls of the sensor, the mount and the forces that are drawn."""
        gui, design = self._gui, self._session.design
        sensor = design.sensor_model
        self._choice("sensor.model", "sensor", tuple(dict.fromkeys((sensor.name, *SENSORS))), sensor.name)
        self._choice("sensor.calibration", "calibration", _calibrations(self._session), design.calibration.name)
        self._bind(
            "sensor.averaging_samples",
            gui.add_slider("samples in one reading", 1, 1000, 1, design.sensor.averaging_samples),
        )
        gravity = design.mount.gravity_base_m_s2
        self._choice("mounting", "probe points", (*MOUNTINGS, "other"), mounting_of(gravity))
        vector = gui.add_vector3("gravity in base axes [m/s²]", gravity, step=0.01)
        self._bind("mount.gravity_base_m_s2", vector, list)
        self._choice("mount.hold", "flange is held", ("clamped", "glued", "bonded"), design.mount.hold)
        root = root_radii(design, build_geometry(design))
        self._slider("mount.root_rigid_radii", "root, rigid base radii", -0.5, 0.5, 0.01, root)
        self._slider("contact.friction", "friction", 0.0, MAX_FRICTION, 0.05, min(design.friction.value, MAX_FRICTION))
        yielding = design.object_compliance.value
        self._slider("contact.object_compliance_m_N", "object yields [m/N]", 0.0, 0.5, 0.005, yielding)
        gui.add_markdown("Forces whose errors are drawn:")
        shown = self._session.forces_mN
        self._forces = [gui.add_checkbox(f"{1e3 * f:g} mN", 1e3 * f in shown) for f in FORCES_N]
        for box in self._forces:
            box.on_update(lambda _: self._choose_forces())

    def add_touch(self) -> None:
        """Add the controls of the touch that is drawn."""
        touch = self._session.touch
        self._slider("touch.fraction", "place, fraction of the length", 0.05, 1.0, 0.01, touch.fraction)
        self._slider("touch.angle_deg", "direction [deg]", -180.0, 180.0, 1.0, touch.angle_deg)
        self._slider("touch.force_mN", "force [mN]", 0.5, 200.0, 0.5, touch.force_mN)

    def _bind(self, key: str, handle: Any, value: Callable[[Any], Any] = lambda value: value) -> None:
        """Connect a control to a key of the design or of the touch."""
        self._handles[key] = handle

        def changed(_: Any) -> None:
            if not getattr(self._showing, "now", False):
                self._move(key, value(handle.value))

        handle.on_update(changed)

    def _choice(self, key: str, label: str, options: tuple[str, ...], value: str) -> None:
        self._bind(key, self._gui.add_dropdown(label, options, initial_value=value))

    def _slider(self, key: str, label: str, low: float, high: float, step: float, value: float) -> None:
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
        design, probe = session.design, session.design.probe
        values = {
            "probe.shape": probe.shape, "probe.length_mm": probe.length_mm, "probe.base_d_mm": probe.base_d_mm,
            "probe.tip_d_mm": probe.tip_d_mm, "probe.section": probe.section, "probe.bore_ratio": probe.bore_ratio,
            "probe.flatness": probe.flatness, "probe.axis": probe.axis,
            **{f"probe.{key}": getattr(probe, key) for key in AXIS_SLIDERS},
            "probe.tip": probe.tip, "material.resin": design.material.resin,
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
        }  # fmt: skip
        self._showing.now = True  # viser calls the handlers of a value that is set here in this thread
        try:
            if (options := _calibrations(session)) != self._handles["sensor.calibration"].options:
                self._handles["sensor.calibration"].options = options
            for key, value in values.items():
                handle = self._handles[key]
                if handle.visible is (value is None):
                    handle.visible = value is not None  # hidden where the design does not use it
                if value is not None and key not in waiting and not session.refused:
                    _set(handle, value)
            self._show_knots()
        finally:
            self._showing.now = False

    def _show_knots(self) -> None:
        """Show a slider for each interior diameter of a profile."""
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
