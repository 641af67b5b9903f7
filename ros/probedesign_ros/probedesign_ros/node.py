"""Node that publishes the messages of a run of `probedesign live`, and forwards its services as commands.

Messages are those of a recording, with the same covariances and encoding; frames begin with the name of the probe, as
`base` is the robot's, and a further prefix may be added. Markers and the transform of the contact are made here of the
same messages. In a run with several probes the topics begin with the name of the probe.
"""

import json
import math
import re
import sys
import time

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, TransformStamped, WrenchStamped
from probedesign_msgs.msg import Contact
from probedesign_msgs.srv import Command
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message
from std_msgs.msg import Header, String
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import MarkerArray

from probedesign_ros.link import Commander, Receiver
from probedesign_ros.markers import contact_markers, no_contact, shape_markers
from probedesign_ros.parameters import PARAMETERS, checked

TOPICS = {
    "/probedesign/wrench": WrenchStamped,
    "/probedesign/contact": PoseWithCovarianceStamped,
    "/probedesign/contact_world": PoseWithCovarianceStamped,
    "/probedesign/base": PoseStamped,
    "/probedesign/state": Contact,
    "/probedesign/estimate": String,
    "/probedesign/event": String,
    "/probedesign/guard": String,
    "/probedesign/map": String,
    "/probedesign/next_touch": PoseStamped,
    "/tf": TFMessage,
    "/tf_static": TFMessage,
}
"""Topics of a recording that are published, and their types; the node has the topic's name in its own namespace."""
COMMANDS = {
    "tare": "tare",
    "mark": "mark",
    "start_recording": "start recording",
    "stop_recording": "stop recording",
    "reset": "reset",
    "stop": "stop",
}
"""Commands of a run by the name of their service."""
PROBE_TOPIC = re.compile(r"((?:/[A-Za-z]\w{0,79})?)(/probedesign/\w+)", re.ASCII)
"""Topic of a run: the name of the probe in a run with several, and the topic of `TOPICS`."""
MAX_PROBES = 16
STATUS_PERIOD = 5.0
"""Interval at which lost and malformed datagrams are reported [s]."""
DIAGNOSTICS_PERIOD = 1.0
"""Interval of /diagnostics [s]."""


class ProbeNode(Node):
    """Publishes what a run sends."""

    def __init__(self):
        super().__init__("probedesign")
        values = {name: checked(name, self._declared(name)) for name in PARAMETERS}
        self._stamped_here = self.get_parameter("use_sim_time").value
        self._prefix, self._world = values["frame_prefix"], values["world_frame"]
        self._contact_tf = values["publish_contact_tf"]
        self._receiver = Receiver(values["host"], values["port"])
        self._commander = Commander(values["control_host"], values["control_port"], values["control_timeout_s"])
        skipped = {"/tf": not values["publish_tf"], "/tf_static": not values["publish_sensor_tf"]}
        self._outputs = {
            topic: self._publisher(kind, topic) for topic, kind in TOPICS.items() if not skipped.get(topic)
        }
        self._transforms = self._outputs.get("/tf") or self._publisher(TFMessage, "/tf")
        self._markers = {"": self.create_publisher(MarkerArray, "~/markers", 10)}
        self._contacts, self._states, self._reported = {}, {}, {}
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._shapes = self.create_publisher(MarkerArray, "~/shapes", latched)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        # a service waits for the reply of the run, the topics go on meanwhile
        group = MutuallyExclusiveCallbackGroup()
        for name in COMMANDS:
            self.create_service(Trigger, f"~/{name}", self._service(name), callback_group=group)
        self.create_service(Command, "~/command", self._on_command, callback_group=group)
        self.create_timer(values["poll_period_s"], self.receive)
        self.create_timer(STATUS_PERIOD, self.report)
        self.create_timer(DIAGNOSTICS_PERIOD, self.diagnose)

    def _declared(self, name):
        """Declare a parameter, which accepts an integer for a float, and return its value."""
        default, text, low, high = PARAMETERS[name]
        descriptor = ParameterDescriptor(description=text, read_only=True, dynamic_typing=True)
        if type(default) is int:
            descriptor.integer_range = [IntegerRange(from_value=low, to_value=high, step=1)]
        elif type(default) is float:
            descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=high, step=0.0)]
        return self.declare_parameter(name, default, descriptor).value

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
            self._adapt(message)
            if topic == "/probedesign/map":
                try:
                    header = Header(stamp=self.get_clock().now().to_msg(), frame_id=self._world)
                    self._shapes.publish(shape_markers(header, json.loads(message.data)))
                except (ValueError, TypeError, KeyError, IndexError):
                    self._receiver.counts["malformed"] += 1
                    continue
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
            count = self._states.get(probe, (0, 0.0, None))[0]
            self._states[probe] = count + 1, time.monotonic(), message
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

    def _adapt(self, message):
        """Rename the frames, and stamp the message where the clock is that of a simulation."""
        for part in getattr(message, "transforms", [message]):
            if not hasattr(part, "header"):
                continue
            if self._stamped_here:
                part.header.stamp = self.get_clock().now().to_msg()
            in_world = part.header.frame_id == "world"
            part.header.frame_id = self._world if in_world else self._prefix + part.header.frame_id
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

    def diagnose(self):
        """Publish the state of each probe: stale without estimates, a warning if datagrams were lost."""
        counts, array = self._receiver.counts, DiagnosticArray()
        array.header.stamp = self.get_clock().now().to_msg()
        for probe, (count, arrival, state) in (self._states or {"": (0, -math.inf, None)}).items():
            stale = time.monotonic() - arrival > DIAGNOSTICS_PERIOD
            lost = counts["lost"] + counts["malformed"]
            level = DiagnosticStatus.STALE if stale else DiagnosticStatus.WARN if lost else DiagnosticStatus.OK
            text = "no estimate within a second" if stale else f"{lost} datagrams lost or malformed" if lost else "ok"
            values = {"estimates": count, "lost": counts["lost"], "malformed": counts["malformed"]}
            if state is not None:
                values |= {"result": state.result, "phase": state.phase, "frame": state.header.frame_id}
            array.status.append(DiagnosticStatus(
                level=level, name=f"probedesign: {probe.strip('/') or 'probe'}", message=text,
                hardware_id="probedesign",
                values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
            ))  # fmt: skip
        self._diagnostics.publish(array)

    def destroy_node(self):
        """Close the socket and destroy the node."""
        self._receiver.close()
        super().destroy_node()


def main(args=None):
    """Run the node until it is shut down."""
    rclpy.init(args=args)
    try:
        node = ProbeNode()
    except (ValueError, OSError) as error:  # a parameter, or a port in use
        rclpy.try_shutdown()
        sys.exit(f"probedesign_ros: {error}")
    executor = MultiThreadedExecutor(num_threads=2)
    executor.add_node(node)
    try:
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
