"""The robot that moves the simulated base: tells its poses by UDP, as `live --pose udp://` hears them."""

import json
import socket
import threading
from collections.abc import Callable
from contextlib import suppress
from time import monotonic
from urllib.parse import urlsplit

import numpy as np

from probedesign.errors import InputError
from probedesign.frames import Array, pose, skew
from probedesign.live.netft_box.scene import Motion
from probedesign.live.poses.track import of_matrix
from probedesign.units import MM

PERIOD = 0.008
"""From one pose to the next [s], as of a robot's controller."""


class Robot:
    """Sends where the base is in a world whose z axis points up. Use it as a context manager."""

    def __init__(self, motion: Motion, gone: Callable[[], float], to: str) -> None:
        """Ready to send.

        Args:
            motion: of the base.
            gone: how long it has been on its way [s].
            to: HOST:PORT.

        Raises:
            InputError: that is no address.
        """
        self._motion, self._gone = motion, gone
        try:
            parts = urlsplit(f"//{to}")
            self._to = (socket.gethostbyname(parts.hostname) if parts.hostname else "", parts.port or 0)
        except (ValueError, OSError):
            self._to = ("", 0)
        if not all(self._to):
            raise InputError(f"--pose-to {to} must be HOST:PORT, as 127.0.0.1:30010")
        self._R = upright(motion.model.gravity_base)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._send, name="robot", daemon=True)

    def __enter__(self) -> "Robot":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()

    def datagram(self, time: float, gone: float) -> bytes:
        """What is sent at a time by the robot's clock [s], so long after the base began to move [s]."""
        p = self._R @ self._motion.p_world_base(np.array([gone]))[0]
        q = of_matrix(time, pose(self._R)).q
        said = zip(
            ("time_s", "x_mm", "y_mm", "z_mm", "qx", "qy", "qz", "qw"), (time, *p / MM, *q), strict=True
        )
        return json.dumps({"frame": "world", **{name: float(value) for name, value in said}}).encode()

    def _send(self) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
            while not self._ended.wait(PERIOD):
                with suppress(OSError):  # nobody listens yet, or no more
                    udp.sendto(self.datagram(monotonic(), self._gone()), self._to)


def upright(gravity_base: Array) -> Array:
    """R_world_base of a base that rests (3, 3): the shortest turn that brings gravity down along -z."""
    down = gravity_base / np.linalg.norm(gravity_base)
    axis, cosine = np.cross(down, (0.0, 0.0, -1.0)), -float(down[2])
    if cosine < -1.0 + 1e-9:  # it points up: half a turn about x
        return np.diag([1.0, -1.0, -1.0])
    K = skew(axis)
    return np.asarray(np.eye(3) + K + K @ K / (1.0 + cosine))
