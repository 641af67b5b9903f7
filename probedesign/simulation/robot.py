"""The simulated robot that moves the base and sends its poses by UDP, for `live --pose udp://`."""

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
from probedesign.live.poses.track import pose_from_matrix
from probedesign.simulation.scenes import BaseMotion
from probedesign.units import MM

PERIOD = 0.008
"""Interval between poses [s], as of a robot controller."""


class SimulatedRobot:
    """Sends the pose of the base in a world whose z axis points up. Use it as a context manager."""

    def __init__(self, motion: BaseMotion, motion_time: Callable[[], float], target: str) -> None:
        """Resolve the receiver.

        Args:
            motion: motion of the base.
            motion_time: returns the time since the motion started [s].
            target: HOST:PORT.

        Raises:
            InputError: this is not an address.
        """
        self._motion, self._motion_time = motion, motion_time
        try:
            parts = urlsplit(f"//{target}")
            self._target = (socket.gethostbyname(parts.hostname) if parts.hostname else "", parts.port or 0)
        except (ValueError, OSError):
            self._target = ("", 0)
        if not all(self._target):
            raise InputError(f"--pose-to {target} must be HOST:PORT, as 127.0.0.1:30010")
        self._R = upright_rotation(motion.model.gravity_base)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._send, name="robot", daemon=True)

    def __enter__(self) -> "SimulatedRobot":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()

    def datagram(self, time: float, motion_time: float) -> bytes:
        """Return the datagram at a time by the robot's clock [s], `motion_time` after the motion started [s]."""
        p = self._R @ self._motion.p_world_base(np.array([motion_time]))[0]
        q = pose_from_matrix(time, pose(self._R)).q
        fields = zip(
            ("time_s", "x_mm", "y_mm", "z_mm", "qx", "qy", "qz", "qw"), (time, *p / MM, *q), strict=True
        )
        return json.dumps({"frame": "world", **{name: float(value) for name, value in fields}}).encode()

    def _send(self) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
            while not self._ended.wait(PERIOD):
                with suppress(OSError):  # there is no listener
                    udp.sendto(self.datagram(monotonic(), self._motion_time()), self._target)


def upright_rotation(gravity_base: Array) -> Array:
    """Return R_world_base of the base at rest (3, 3): the shortest rotation that turns gravity to -z."""
    down = gravity_base / np.linalg.norm(gravity_base)
    axis, cosine = np.cross(down, (0.0, 0.0, -1.0)), -float(down[2])
    if cosine < -1.0 + 1e-9:  # gravity points up: rotate by π about x
        return np.diag([1.0, -1.0, -1.0])
    K = skew(axis)
    return np.asarray(np.eye(3) + K + K @ K / (1.0 + cosine))
