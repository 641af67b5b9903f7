"""Node that publishes the messages of a run of `probedesign live`, and forwards its services as commands.

Messages are those of a recording, with the same covariances and encoding; frames begin with the name of the probe, as
`base` is the robot's, and a further prefix may be added. Markers and the transform of the contact are made here of the
same messages. In a run with several probes the topics begin with the name of the probe.
"""

import re

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, TransformStamped, WrenchStamped
from probedesign_msgs.msg import Contact
from probedesign_msgs.srv import Command
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message
from std_msgs.msg import String
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import MarkerArray

from probedesign_ros.link import Commander, Receiver
from probedesign_ros.markers import contact_markers, no_contact

TOPICS = {
    "/probedesign/wrench": WrenchStamped,
    "/probedesign/contact": PoseWithCovarianceStamped,
    "/probedesign/contact_world": PoseWithCovarianceStamped,
    "/probedesign/base": PoseStamped,
    "/probedesign/state": Contact,
    "/probedesign/estimate": String,
    "/probedesign/event": String,
    "/tf": TFMessage,
    "/tf_static": TFMessage,
}
"""Topics of a recording that are published, and their types; the node has the topic's name in its own namespace."""
COMMANDS = {
    "tare": "tare",
    "mark": "mark",
    "start_recording": "start recording",
    "stop_recording": "stop recording",
    "stop": "stop",
}
"""Commands of a run by the name of their service."""
PARAMETERS = {
    "host": "127.0.0.1",  # address on which the messages of the run arrive
    "port": 9001,
    "control_host": "127.0.0.1",  # address of the run's --control
    "control_port": 9002,
    "control_timeout_s": 1.0,
    "frame_prefix": "",
    "publish_tf": True,  # pose of the base in the world, if the robot does not publish it
    "publish_sensor_tf": True,
    "publish_contact_tf": True,
    "poll_period_s": 0.005,
}
PROBE_TOPIC = re.compile(r"((?:/[A-Za-z]\w{0,79})?)(/probedesign/\w+)", re.ASCII)
"""Topic of a run: the name of the probe in a run with several, and the topic of `TOPICS`."""
MAX_PROBES = 16
STATUS_PERIOD = 5.0
"""Interval at which lost and malformed datagrams are reported [s]."""


class ProbeNode(Node):
    """Publishes what a run sends."""

    def __init__(self):
        super().__init__("probedesign")
        values = {name: self.declare_parameter(name, value).value for name, value in PARAMETERS.items()}
        self._prefix = values["frame_prefix"]
        self._contact_tf = values["publish_contact_tf"]
        self._receiver = Receiver(values["host"], values["port"])
        self._commander = Commander(values["control_host"], values["control_port"], values["control_timeout_s"])
        skipped = {"/tf": not values["publish_tf"], "/tf_static": not values["publish_sensor_tf"]}
        self._outputs = {
            topic: self._publisher(kind, topic) for topic, kind in TOPICS.items() if not skipped.get(topic)
        }
        self._transforms = self._outputs.get("/tf") or self._publisher(TFMessage, "/tf")
        self._markers = {"": self.create_publisher(MarkerArray, "~/markers", 10)}
        self._contacts = {}
        self._reported = {}
        for name in COMMANDS:
            self.create_service(Trigger, f"~/{name}", self._service(name))
        self.create_service(Command, "~/command", self._on_command)
        self.create_timer(values["poll_period_s"], self.receive)
        self.create_timer(STATUS_PERIOD, self.report)

    def _publisher(self, kind, topic, probe=""):
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        name = topic if topic.startswith("/tf") else f"~{probe}/{topic.rpartition('/')[2]}"
        return self.create_publisher(kind, name, latched if topic == "/tf_static" else 10)

    def receive(self):
        """Publish everything that has arrived."""
        for recorded in self._receiver.messages():
            match = PROBE_TOPIC.fullmatch(recorded.topic)
            probe, topic = match.groups() if match else ("", recorded.topic)
            kind = TOPICS.get(topic)
            try:
                if kind is None or (probe not in self._markers and len(self._markers) > MAX_PROBES):
                    raise ValueError("unknown topic")
                message = deserialize_message(recorded.cdr, kind)
            except Exception:  # bytes from outside: rclpy raises errors of several kinds
                self._receiver.counts["malformed"] += 1
                continue
            self._add_prefix(message)
            if probe not in self._markers:
                self._markers[probe] = self.create_publisher(MarkerArray, f"~{probe}/markers", 10)
                names = [name for name in TOPICS if not name.startswith("/tf")]
                self._outputs |= {probe + name: self._publisher(TOPICS[name], name, probe) for name in names}
            if recorded.topic in self._outputs:
                self._outputs[recorded.topic].publish(message)
            self._on_message(probe, topic, message)

    def _on_message(self, probe, topic, message):
        """Make markers and the transform of the contact; a state follows the contact of the same time."""
        if topic == "/probedesign/contact":
            self._contacts[probe] = message
        elif topic == "/probedesign/state":
            contact = self._contacts.pop(probe, None)
            touched = message.result == Contact.OK and contact is not None
            self._markers[probe].publish(self._markers_of(contact, message) if touched else no_contact(message.header))
            if touched and self._contact_tf:
                self._publish_contact_frame(contact)
        elif topic == "/probedesign/event":
            self.get_logger().info(message.data)

    def _markers_of(self, contact, state):
        position = contact.pose.pose.position
        cov = np.array(contact.pose.covariance, dtype=float).reshape(6, 6)[:3, :3]
        force = (state.force.x, state.force.y, state.force.z)
        return contact_markers(contact.header, (position.x, position.y, position.z), cov, force)

    def _publish_contact_frame(self, contact):
        frame = TransformStamped(
            header=contact.header, child_frame_id=contact.header.frame_id.removesuffix("base") + "contact"
        )
        position, at = contact.pose.pose.position, frame.transform.translation
        at.x, at.y, at.z = position.x, position.y, position.z
        self._transforms.publish(TFMessage(transforms=[frame]))

    def _add_prefix(self, message):
        if not self._prefix:
            return
        for part in getattr(message, "transforms", [message]):
            if hasattr(part, "header") and part.header.frame_id != "world":
                part.header.frame_id = self._prefix + part.header.frame_id
            if hasattr(part, "child_frame_id"):
                part.child_frame_id = self._prefix + part.child_frame_id

    def _service(self, name):
        def call(request, response):
            response.success, response.message = self._commander.send(COMMANDS[name])
            return response

        return call

    def _on_command(self, request, response):
        response.accepted, response.text = self._commander.send(request.command, request.text)
        return response

    def report(self):
        """Report lost and malformed datagrams since the last report."""
        counts = {name: self._receiver.counts[name] for name in ("lost", "malformed")}
        if any(counts.values()) and counts != self._reported:
            self._reported = counts
            self.get_logger().warning(f"{counts['lost']} datagrams lost, {counts['malformed']} malformed")

    def destroy_node(self):
        """Close the socket and destroy the node."""
        self._receiver.close()
        super().destroy_node()


def main(args=None):
    """Run the node until it is shut down."""
    rclpy.init(args=args)
    node = ProbeNode()
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
