"""Forwards a topic or a transform of a ROS 2 system as datagrams; runs in any Python that has rclpy.

This script uses nothing but the standard library and ROS 2, because the Python of a ROS 2 system is usually another one
than that of probedesign. It ends when its standard input is closed.

    ros2_bridge.py wrench TOPIC HOST PORT UNIT      geometry_msgs/WrenchStamped; UNIT of its moments is Nm or Nmm
    ros2_bridge.py tf WORLD BASE HOST PORT          transform of frame BASE in frame WORLD
"""

import json
import os
import socket
import sys
import threading
from contextlib import suppress
from typing import Any

QUEUED = 1000  # wrenches that wait for the bridge
TF_RATE_HZ = 200.0  # at which the newest transform is looked up; robots publish at 50 ... 1000 Hz


def seconds(stamp: Any) -> float:
    """Return a time stamp [s]."""
    return float(stamp.sec + 1e-9 * stamp.nanosec)


class Sender:
    """Sends objects as JSON datagrams, numbered from 1; what the system does not accept is dropped."""

    def __init__(self, host: str, port: str) -> None:
        self._receiver = (host, int(port))
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._number = 0

    def send(self, **values: Any) -> None:
        """Send one object."""
        self._number += 1
        with suppress(OSError):
            self._socket.sendto(json.dumps(dict(values, sequence=self._number)).encode(), self._receiver)


def forward_wrench(node: Any, topic: str, host: str, port: str, unit: str) -> None:
    """Forward each wrench of a topic; a time stamp of zero means that the publisher sets none."""
    from geometry_msgs.msg import WrenchStamped
    from rclpy.qos import QoSProfile, ReliabilityPolicy

    sender = Sender(host, port)

    def forward(message: Any) -> None:
        force, moment, time = message.wrench.force, message.wrench.torque, seconds(message.header.stamp)
        values = {"fx_N": force.x, "fy_N": force.y, "fz_N": force.z, "frame": message.header.frame_id}
        values.update({"mx_" + unit: moment.x, "my_" + unit: moment.y, "mz_" + unit: moment.z})
        sender.send(**values, **({"time_s": time} if time else {}))

    # best effort: it receives from reliable publishers too; the usual depth of 5 is 0.7 ms of a Net F/T box
    profile = QoSProfile(depth=QUEUED, reliability=ReliabilityPolicy.BEST_EFFORT)
    node.create_subscription(WrenchStamped, topic, forward, profile)


def forward_transform(node: Any, world: str, base: str, host: str, port: str) -> None:
    """Forward each new transform."""
    from rclpy.time import Time
    from tf2_ros import Buffer, TransformException, TransformListener

    sender, buffer, last = Sender(host, port), Buffer(), [(0, 0)]
    node.transforms = TransformListener(buffer, node)  # the node keeps it alive

    def forward() -> None:
        try:
            newest = buffer.lookup_transform(world, base, Time())
        except TransformException:
            return  # not known yet
        stamp, p, q = newest.header.stamp, newest.transform.translation, newest.transform.rotation
        if last[0] == (stamp.sec, stamp.nanosec):
            return
        last[0] = (stamp.sec, stamp.nanosec)
        sender.send(time_s=seconds(stamp), x_m=p.x, y_m=p.y, z_m=p.z, qx=q.x, qy=q.y, qz=q.z, qw=q.w, frame=world)

    node.create_timer(1.0 / TF_RATE_HZ, forward)


def main(kind: str, *arguments: str) -> None:
    """Forward until standard input is closed."""
    import rclpy

    def end_with_parent() -> None:
        while os.read(0, 4096):  # not sys.stdin, whose lock would be held at exit
            pass
        os._exit(0)

    threading.Thread(target=end_with_parent, daemon=True).start()
    rclpy.init(args=[])
    node = rclpy.create_node(f"probedesign_{kind}_bridge")
    forward: Any = {"wrench": forward_wrench, "tf": forward_transform}[kind]
    forward(node, *arguments)
    rclpy.spin(node)


if __name__ == "__main__":
    main(*sys.argv[1:])
