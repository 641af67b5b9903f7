"""Source `ros2://TOPIC` and poses `tf://WORLD/BASE`: opens them through a bridge process with rclpy.

The bridge runs in this program's Python if that has rclpy, and otherwise in the system's. In both cases it is a process
of its own, so that the callbacks of ROS 2 do not delay the estimates.
"""

import re
import subprocess
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar, get_args
from urllib.parse import unquote

from probedesign.core.csv_tables import Frame
from probedesign.core.errors import InputError, one_line
from probedesign.estimation.model import ProbeModel
from probedesign.live import Log
from probedesign.live.datagrams import Listener, Parsed
from probedesign.live.poses.base_poses import TimedPose
from probedesign.live.poses.pose_sources import parse_pose
from probedesign.live.recordings.schemas import ros_name
from probedesign.live.sources.replay import MomentUnit
from probedesign.live.sources.source import parse_parameters
from probedesign.live.sources.udp import MAX_RATE, PARAMETERS, UdpSource, parse_wrench
from probedesign.web import LOOPBACK

BRIDGE = Path(__file__).with_name("ros2_bridge.py")
#: Interpreters that may have rclpy where this one does not; ROS 2 installs it for the system's.
SYSTEM_PYTHONS = ("/usr/bin/python3", "python3")
PROBE_TIMEOUT = 20.0  #: Maximum time to import rclpy [s].
MAX_POSE_RATE = 2000.0  #: Maximum number of poses per second.
T = TypeVar("T")
TEXT_PARAMETERS = {"frame": get_args(Frame), "moment_unit": get_args(MomentUnit)}


def find_python(option: str) -> str:
    """Return the first interpreter that can import rclpy: this one, or the system's.

    Raises:
        InputError: there is none.
    """
    candidates = (sys.executable, *SYSTEM_PYTHONS)
    for python in candidates:
        with suppress(OSError, ValueError, subprocess.SubprocessError):
            command = [python, "-c", "import rclpy"]
            subprocess.run(command, capture_output=True, timeout=PROBE_TIMEOUT, stdin=subprocess.DEVNULL, check=True)
            return python
    raise InputError(f"{option}: {', '.join(candidates)} cannot import rclpy; source the set-up file of ROS 2")


class Bridge(Listener[T]):
    """Receives what a bridge process sends."""

    notes = ()

    def __init__(
        self,
        option: str,
        name: str,
        parse: Callable[[Mapping[str, Any]], Parsed[T]],
        max_rate: float,
        title: str,
        command: tuple[str, ...],
        after: tuple[str, ...] = (),
    ) -> None:
        """See `Listener`; `command` is the interpreter with the arguments before the address, `after` the others."""
        super().__init__(option, name, (LOOPBACK[0], 0), parse, max_rate, title)
        python, *before = command
        self._option = option
        self._command = [python, str(BRIDGE), *before, self.address[0], str(self.address[1]), *after]
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start to receive, and the process; Ctrl-C does not reach it."""
        super().start()
        self._process = subprocess.Popen(
            self._command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
            start_new_session=True,
        )  # fmt: skip

    def pop(self) -> list[tuple[float, T, int]]:
        """Return what came since the last call, see `Listener`.

        Raises:
            InputError: nothing came, and the process has ended.
        """
        values, process = super().pop(), self._process
        if not values and process is not None and process.poll() is not None:
            assert process.stderr is not None
            lines = process.stderr.read().decode(errors="replace").strip().splitlines()
            why = one_line(lines[-1], 200) if lines else f"exit status {process.returncode}"
            raise InputError(f"{self._option}: the bridge to ROS 2 has ended: {why}")
        return values

    def close(self) -> None:
        """End the process and the stream."""
        if self._process is not None:
            assert self._process.stdin is not None and self._process.stderr is not None
            self._process.kill()
            self._process.wait()
            self._process.stdin.close()
            self._process.stderr.close()
        super().close()


def open_ros2(model: ProbeModel, target: str, query: str, log: Log) -> UdpSource:
    """Open the source `ros2://TOPIC`, a topic of geometry_msgs/WrenchStamped; the probe's base frame is NAME/base.

    Raises:
        InputError: the topic or a parameter is invalid, or no interpreter has rclpy.
    """
    numbers, texts = parse_parameters("ros2:", query, PARAMETERS, TEXT_PARAMETERS)
    option = f"--source ros2:{target}"
    topic = target.strip("/")
    if not target.startswith("//") or not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*", topic):
        raise InputError(f"{option}: write ros2://TOPIC, as ros2://ft_sensor/wrench")
    command, unit = (find_python(option), "wrench", f"/{topic}"), texts["moment_unit"] or "Nm"
    bridge = Bridge(option, "wrenches", parse_wrench, MAX_RATE, f"topic /{topic} of ROS 2", command, (unit,))
    return UdpSource(model, bridge, log, texts["frame"], numbers["wait_s"], f"{ros_name(model.name)}/base")


def open_tf(target: str) -> Bridge[TimedPose]:
    """Open the poses `tf://WORLD/BASE`: frame BASE, the probe's base, in frame WORLD, through all frames in between.

    A slash in the name of a frame is written as %2F.

    Raises:
        InputError: the frames are not named, or no interpreter has rclpy.
    """
    option = f"--pose {target}"
    world, _, base = target.removeprefix("tf://").partition("/")
    if not target.startswith("tf://") or not world or not base or "/" in base:
        raise InputError(f"{option}: write tf://WORLD/BASE, as tf://world/probe_base")
    world, base = unquote(world), unquote(base)
    command = (find_python(option), "tf", world, base)
    poses = Bridge(option, "poses", parse_pose, MAX_POSE_RATE, f"TF of {base} in {world}", command)
    poses.start()
    return poses
