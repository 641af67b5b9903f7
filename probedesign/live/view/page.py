"""What a covariance looks like."""

import math
import re
from collections.abc import Callable
from functools import partial

import numpy as np
import viser
import viser.transforms as tf
from websockets.asyncio import server

from probedesign.frames import Array
from probedesign.live.view.panel import Panel
from probedesign.live.view.scene import Charts, Setup, ellipsoid
from probedesign.live.view.snapshot import Moment, Place
from probedesign.live.view.status_text import events_html, touches_html, words_html

LOCAL = ("127.0.0.1", "localhost", "::1")


def own_page_only(host: str) -> None:
    """Refuse, in this whole process, WebSockets that a page of another origin opens; any page of the internet could,
    to a server on the browser's own machine, and press its buttons. A server that is open to the network has names
    that nobody here knows, and is left as it is.

    Args:
        host: that is listened on.
    """
    if host not in LOCAL:
        return
    names = "|".join(re.escape(f"[{name}]" if ":" in name else name) for name in LOCAL)
    server.serve = partial(server.serve, origins=[re.compile(rf"http://({names})(:\d+)?")])  # type: ignore[misc, assignment]


Ask = Callable[[str, str], None]

UNIT = 20.0
"""Of the scene in a metre: viser's lights, camera and shadows are made for things some units across."""
THINNEST = 0.9e-3
"""Half-axes of the ellipsoid are drawn no thinner [m], or it could not be seen."""
ARROW = 0.03
"""Length of the force's arrow [m]; how large the force is stands beside it."""
MARKED = 24
"""Earlier touches that are drawn."""

PROBE, CONTACT, SPREAD, OLD = (236, 148, 66), (150, 10, 30), (232, 72, 66), (150, 150, 150)
COLOURS = {
    "sensor": (60, 64, 72),
    "flange": PROBE,
    "clamp_ring": (112, 122, 136),
    "flange_adapter": (150, 158, 168),
}
METAL = (132, 142, 154)


class _Server(viser.ViserServer):
    """Without the tunnel to the internet that any client could ask for."""

    def request_share_url(self, verbose: bool = True) -> None:
        """There is none."""


class Page:
    """Shows one moment after the other to every browser that looks."""

    def __init__(self, setup: Setup, ask: Ask) -> None:
        """Listen, and show the free probe.

        Args:
            setup: what does not change.
            ask: takes what a person asks: a wish and its text.
        """
        self._setup, self._charts = setup, Charts()
        self._server = server = _Server(setup.host, setup.port, setup.title, verbose=False)
        server.gui.configure_theme(
            show_logo=False, show_share_button=False, control_width="large", brand_color=(38, 84, 124)
        )
        self._scene()
        self._panel = Panel(server, ask, setup.note, float(setup.tube.s[-1]))
        self._look()

    @property
    def url(self) -> str:
        """Where it is."""
        host = f"[{self._setup.host}]" if ":" in self._setup.host else self._setup.host
        return f"http://{host}:{self._server.get_port()}"

    def stop(self) -> None:
        """Close it."""
        self._server.stop()

    def show(self, moment: Moment) -> None:
        """All that there is to see of a moment, at once."""
        with self._server.atomic():
            self._show_probe(moment)
            self._show_place(moment)
            self._show_touches(moment.touches)
            self._panel.say(words_html(moment), events_html(moment), touches_html(moment.touches))
            if self._charts.add(moment.strip):
                self._panel.draw(self._charts)
        self._server.flush()

    def _scene(self) -> None:
        """Everything that can be seen, invisible where nothing is known yet."""
        scene, setup = self._server.scene, self._setup
        scene.set_up_direction("+z")
        scene.configure_default_lights(True, cast_shadow=True)
        self._base = scene.add_frame("/base", show_axes=False)
        for part in setup.parts:
            scene.add_mesh_simple(
                f"/base/{part.name}",
                UNIT * part.vertices,
                part.faces,
                color=COLOURS.get(part.name, METAL),
                flat_shading=True,
            )
        self._probe = scene.add_mesh_simple(
            "/base/probe",
            UNIT * setup.tube.vertices(setup.free),
            setup.tube.faces,
            color=PROBE,
            opacity=0.42,
            side="double",
        )
        self._contact = scene.add_icosphere(
            "/contact", UNIT * 1.5e-3, CONTACT, visible=False, cast_shadow=False
        )
        # Opaque: what is translucent inside of something translucent is drawn or not, as the camera has it.
        self._spread = scene.add_icosphere("/spread", 1.0, SPREAD, visible=False, cast_shadow=False)
        self._force = scene.add_arrows(
            "/force", np.zeros((1, 2, 3)), CONTACT, shaft_radius=UNIT * 0.6e-3, head_radius=UNIT * 1.6e-3,
            head_length=UNIT * 4e-3, visible=False,
        )  # fmt: skip
        self._label = scene.add_label("/said", "", anchor="bottom-center", visible=False)
        self._marks = [
            (
                scene.add_icosphere(f"/touch/{i}", UNIT * 1.5e-3, OLD, visible=False, cast_shadow=False),
                scene.add_label(f"/touch/{i}/number", "", font_screen_scale=0.8, visible=False),
            )
            for i in range(MARKED)
        ]

    def _look(self) -> None:
        """From the side of the free probe, somewhat from above, with a floor below it."""
        free, length = self._setup.free, float(self._setup.tube.s[-1])
        T = level(self._setup.gravity_base)
        self._base.wxyz = _wxyz(T)
        p = free.p_base @ T.T
        low = float(min(p[:, 2].min(), -0.04)) - 0.25 * length
        self._server.scene.add_grid(
            "/floor", UNIT * 0.6, UNIT * 0.6, cell_size=UNIT * 0.01, section_size=UNIT * 0.05,
            cell_color=(222, 226, 230), section_color=(190, 198, 206), plane_color=(250, 250, 251),
            plane_opacity=1.0, shadow_opacity=0.2, position=(0.0, 0.0, UNIT * low),
        )  # fmt: skip
        along = T[:, 2]
        middle = UNIT * (0.5 * (p[0] + p[-1]) - 0.02 * along)
        aside = np.cross(along, (0.0, 0.0, 1.0))
        aside = aside / np.linalg.norm(aside) if np.linalg.norm(aside) > 0.2 else np.array([0.0, -1.0, 0.0])
        camera = self._server.initial_camera
        camera.fov = math.radians(40.0)
        camera.look_at = middle
        camera.position = middle + UNIT * length * (2.3 * aside + np.array([0.0, 0.0, 0.8]) + 0.5 * along)

    def _show_probe(self, moment: Moment) -> None:
        """Bent as the answer has it; in grey as it was, where the answer does not tell."""
        T = self._pose(moment)
        self._base.wxyz, self._base.position = _wxyz(T[:3, :3]), UNIT * T[:3, 3]
        if moment.shape is not None:
            self._probe.vertices = (UNIT * self._setup.tube.vertices(moment.shape)).astype(np.float32)
        known = (moment.shape is not None and not moment.old) or not moment.result
        self._probe.color = PROBE if known else OLD

    def _pose(self, moment: Moment) -> Array:
        """Of the base in the scene: the world's, or with gravity downward where that is all there is."""
        if np.isfinite(moment.T_world_base).all():
            return moment.T_world_base
        T = np.eye(4)
        T[:3, :3] = level(moment.gravity_base)
        return T

    def _in_scene(self, place: Place) -> tuple[Array, Array]:
        """What carries the place's points into the scene: a rotation and an origin."""
        if place.in_world:
            return np.eye(3), np.zeros(3)
        T = self._base
        return np.asarray(tf.SO3(np.asarray(T.wxyz)).as_matrix(), dtype=float), np.asarray(T.position) / UNIT

    def _show_place(self, moment: Moment) -> None:
        """The contact, its 95 % and its force; the last one in grey and called old, when it is not of now."""
        place = moment.place
        shown = place is not None
        self._contact.visible = self._label.visible = shown
        self._spread.visible = self._force.visible = shown and not moment.old
        if place is None:
            return
        R, origin = self._in_scene(place)
        surface = R @ place.p_surface + origin
        half_axes, axes = ellipsoid(R @ place.cov @ R.T)
        self._contact.position = self._spread.position = UNIT * surface
        self._spread.scale = tuple(UNIT * np.maximum(half_axes, THINNEST))
        self._spread.wxyz = _wxyz(axes)
        force = R @ place.force
        strength = float(np.linalg.norm(force))
        tail = surface - ARROW * force / strength
        self._force.points = (UNIT * np.array([[tail, surface]])).astype(np.float32)
        self._contact.color = OLD if moment.old else CONTACT
        self._label.position = UNIT * tail
        told = f"s {1e3 * place.s:.1f} ± {1e3 * place.std_s:.1f} mm, {1e3 * strength:.1f} mN"
        self._label.text = f"old: {told}" if moment.old else told

    def _show_touches(self, touches: tuple[Place, ...]) -> None:
        """Where there was contact before, in grey, with its number."""
        for (mark, number), place in zip(self._marks, touches[-MARKED:], strict=False):
            R, origin = self._in_scene(place)
            mark.visible = number.visible = True
            mark.position, number.text = UNIT * (R @ place.p_surface + origin), f"{place.number}"


def level(gravity_base: Array) -> Array:
    """A rotation of the base that lets gravity point down, by the shortest way from upright, (3, 3)."""
    g = np.asarray(gravity_base, dtype=float)
    if not np.linalg.norm(g) > 0.0:
        return np.eye(3)
    up = -g / np.linalg.norm(g)  # world z in base axes
    side = np.array([1.0, 0.0, 0.0]) if abs(up[0]) < 0.9 else np.array([0.0, 0.0, 1.0])
    x = side - (side @ up) * up
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(up, x), up])


def _wxyz(R: Array) -> Array:
    found: Array = np.asarray(tf.SO3.from_matrix(R).wxyz)
    return found
