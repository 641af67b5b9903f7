"""Poses of the base from a robot's own controller: Universal Robots (`ur://HOST`) and Franka (`franka://HOST`).

The pose is that of the tool centre point in the robot's base frame: set the probe's base frame as the tool centre point
(UR), or as the end effector frame (Franka). Neither connection commands a motion.

Source: the docstrings of ur_rtde 1.6.5 and franky-control 2.0.0. Neither has been tried with a robot.
"""

import threading
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from time import monotonic, sleep

from probedesign.core.errors import InputError, MissingDependencyError, one_line
from probedesign.live import split_address
from probedesign.live.datagrams import Handover
from probedesign.live.poses.base_poses import TimedPose, timed_pose

#: Interval at which a controller's newest state is read [s]: the period of an e-Series controller, 500 Hz.
POLL_PERIOD = 0.002
RETRY_PERIOD = 1.0  #: Interval between attempts to connect again [s].
MAX_TRIES = 10  #: Maximum number of attempts to read a pose and its time from the same state.

Reader = Callable[[], TimedPose]  #: Returns the newest pose; raises any exception if the connection is lost.


class RobotPoses:
    """Polls a controller in a thread and connects again when the connection is lost; see `PoseStream`.

    Attributes:
        counts: number of poses taken, invalid ones, and connections lost.
    """

    def __init__(self, title: str, connect: Callable[[], Reader], period: float = POLL_PERIOD) -> None:
        """Connect and start to poll.

        Raises:
            InputError: the controller cannot be reached.
        """
        self.title, self.notes = title, ("the pose is that of the robot's tool centre point",)
        self.counts: Counter[str] = Counter()
        self._connect, self._period = connect, period
        self._queue, self._messages = Handover[tuple[float, TimedPose, int]](), Handover[str]()
        self._ended = threading.Event()
        try:
            self._reader: Reader | None = connect()
        except MissingDependencyError:
            raise
        except Exception as error:
            raise InputError(f"--pose {title}: {_reason(error)}") from None
        self._session = 1
        self._thread = threading.Thread(target=self._poll, name="robot poses", daemon=True)
        self._thread.start()

    def pop(self) -> list[tuple[float, TimedPose, int]]:
        """Return the poses since the last call; see `PoseStream`."""
        return self._queue.take()

    def pop_messages(self) -> list[str]:
        """Return the messages to the user since the last call."""
        return self._messages.take()

    def close(self) -> None:
        """Stop polling; the connection ends with the thread."""
        self._ended.set()
        self._thread.join(RETRY_PERIOD)

    @property
    def summary(self) -> str:
        """The counts in one line."""
        others = [f"{count} {kind}" for kind, count in self.counts.items() if kind != "taken"]
        return ", ".join([f"{self.counts['taken']} poses", *others])

    def _poll(self) -> None:
        last: float | None = None
        while not self._ended.is_set():
            started = monotonic()
            if self._reader is None:
                last = None
                if not self._ended.wait(RETRY_PERIOD):
                    with suppress(Exception):  # the loss has been reported
                        self._reader = self._connect()
                        self._session += 1
                        self._messages.append(f"{self.title}: connected again")
                continue
            try:
                pose = self._reader()
            except InputError as error:  # a pose that is not one
                self.counts["invalid"] += 1
                if self.counts["invalid"] == 1:
                    self._messages.append(f"{self.title}: {error}")
            except Exception as error:
                self.counts["connections lost"] += 1
                self._messages.append(f"{self.title}: {_reason(error)}; connecting again")
                self._reader = None
                continue
            else:
                if last is not None and pose.time < last:
                    self._session += 1  # the controller has restarted
                if pose.time != last:
                    last = pose.time
                    self.counts["taken"] += 1
                    self._queue.append((monotonic(), pose, self._session))
            sleep(max(0.0, started + self._period - monotonic()))


def _reason(error: Exception) -> str:
    return one_line(str(error), 200) or type(error).__name__


def _host(target: str, scheme: str) -> str:
    host, port = split_address(target, scheme) or ("", None)
    if not host or port is not None:
        raise InputError(f"--pose {target}: write {scheme}://HOST")
    return host


def open_ur(target: str) -> RobotPoses:
    """Open `ur://HOST`: the actual pose of the tool centre point by RTDE, with the controller's time.

    Raises:
        InputError: the address is invalid, or the controller cannot be reached.
        MissingDependencyError: ur_rtde is not installed.
    """
    host = _host(target, "ur")
    try:
        from rtde_receive import RTDEReceiveInterface
    except ImportError:
        raise MissingDependencyError.of_extra("--pose ur://", "ur-rtde", "ur") from None
    from scipy.spatial.transform import Rotation

    def connect() -> Reader:
        robot = RTDEReceiveInterface(host)

        def read() -> TimedPose:
            if not robot.isConnected():
                raise ConnectionError("the connection is lost")
            for _ in range(MAX_TRIES):  # separate calls: repeated if the state has been updated between them
                time, values = robot.getTimestamp(), robot.getActualTCPPose()
                if robot.getTimestamp() == time:
                    break
            else:
                raise InputError("the controller's state changes faster than it is read")
            turn = Rotation.from_rotvec(values[3:])
            return timed_pose(time, values[:3], turn.as_quat().tolist())

        return read

    return RobotPoses(f"ur://{host}", connect)


def open_franka(target: str) -> RobotPoses:
    """Open `franka://HOST`: the measured pose of the end effector by FCI, with the robot's time.

    One program can use the FCI of a robot: this one cannot read it while another one moves it.

    Raises:
        InputError: the address is invalid, or the robot cannot be reached.
        MissingDependencyError: franky is not installed.
    """
    host = _host(target, "franka")
    try:
        import franky
    except ImportError:
        raise MissingDependencyError.of_extra("--pose franka://", "franky-control", "franka") from None

    def connect() -> Reader:
        # reading has no deadline, so no kernel for real time is required
        robot = franky.Robot(host, realtime_config=franky.RealtimeConfig.Ignore)

        def read() -> TimedPose:
            state = robot.state
            pose = state.O_T_EE
            return timed_pose(state.time.to_sec(), list(pose.translation), list(pose.quaternion))

        return read

    return RobotPoses(f"franka://{host}", connect)
