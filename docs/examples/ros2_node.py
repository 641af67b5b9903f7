"""Brings `probedesign live … --publish udp://127.0.0.1:9000` into ROS 2: python3 ros2_node.py

Needs rclpy, geometry_msgs and std_msgs of a sourced ROS 2, and nothing of probedesign.
"""

import json
import socket

import rclpy
from geometry_msgs.msg import PoseWithCovarianceStamped, Vector3Stamped
from rclpy.node import Node
from rclpy.time import Time
from std_msgs.msg import String

MM = 1e-3
LARGE = 1e6  # rad²: the contact has no orientation


class Contacts(Node):
    """Publishes the contact (only where there is one), its force, and the result of every estimate."""

    def __init__(self):
        super().__init__("probedesign")
        port = self.declare_parameter("port", 9000).value
        self.frame = self.declare_parameter("frame_id", "probe_base").value
        self.contact = self.create_publisher(PoseWithCovarianceStamped, "~/contact", 10)
        self.force = self.create_publisher(Vector3Stamped, "~/force", 10)
        self.result = self.create_publisher(String, "~/result", 10)
        self.receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.receiver.bind(("127.0.0.1", port))
        self.receiver.setblocking(False)
        self.create_timer(0.002, self.drain)

    def drain(self):
        """Everything that has come."""
        while True:
            try:
                message = json.loads(self.receiver.recv(65535))
            except BlockingIOError:
                return
            if message["kind"] == "estimate":
                self.publish(message)
            else:
                self.get_logger().info(message["event"])

    def publish(self, message):
        self.result.publish(String(data=message["result"]))
        if message["result"] != "ok":
            return
        read = message["received_unix_s"] or message["sent_unix_s"]  # replays and simulations receive nothing
        stamp = Time(nanoseconds=int(read * 1e9)).to_msg()
        contact, force = PoseWithCovarianceStamped(), Vector3Stamped()
        contact.header.stamp = force.header.stamp = stamp
        contact.header.frame_id = force.header.frame_id = self.frame
        for axis in "xyz":
            setattr(contact.pose.pose.position, axis, message[f"p_contact_base_{axis}_mm"] * MM)
            setattr(force.vector, axis, message[f"force_base_{axis}_N"])
        covariance = [0.0] * 36
        for i, a in enumerate("xyz"):
            for j, b in enumerate("xyz"):
                covariance[6 * i + j] = message[f"cov_contact_base_{min(a, b)}{max(a, b)}_mm2"] * MM**2
            covariance[7 * (i + 3)] = LARGE
        contact.pose.covariance = covariance
        self.contact.publish(contact)
        self.force.publish(force)


if __name__ == "__main__":
    rclpy.init()
    rclpy.spin(Contacts())
