"""Output to the package `probedesign_ros`: the messages of a recording, as datagrams while the run lasts."""

import base64
import math
from collections.abc import Sequence
from time import monotonic

from probedesign.estimation.model import ProbeModel
from probedesign.live import Log
from probedesign.live.blocks import Block
from probedesign.live.outputs.sinks import UdpPublisher
from probedesign.live.processing.estimates import EstimateUpdate
from probedesign.live.recordings import schemas
from probedesign.live.recordings.messages import MessageEncoder
from probedesign.live.recordings.schemas import Bytes, Nanoseconds, Topic

SCHEME = "ros2:"
#: Topics that are recorded but not sent: raw readings at full rate, what only a replay needs, and meshes.
LEFT_OUT = (schemas.RAW.name, schemas.BLOCK.name, schemas.SCENE.name)
STATIC_PERIOD = 2.0  #: Interval at which the pose of the sensor is sent again, for a node that starts later [s].


class RosPublisher(MessageEncoder, UdpPublisher):
    """Sends each message of a recording, as a recording contains it, to a node of ROS 2.

    Frames begin with the name of the probe, since `base` is the robot's. A datagram is a JSON object with `schema`,
    `number`, `kind` "message", `topic`, `type`, and in `data` the message in CDR, base64. As with `UdpPublisher`, no
    receiver is required.
    """

    def __init__(self, address: str, models: Sequence[ProbeModel], log: Log) -> None:
        """Resolve the address of the node, `ros2://HOST:PORT`.

        Raises:
            InputError: the address is invalid, or the host is unknown.
        """
        UdpPublisher.__init__(self, address.replace(SCHEME, "udp:", 1), log)
        MessageEncoder.__init__(self, *models, frames=True)
        self._static_sent = dict.fromkeys(self._encoders, -math.inf)

    def is_wanted(self, topic: Topic) -> bool:
        """Return whether messages of a topic are sent."""
        return topic.name not in LEFT_OUT

    def add(self, topic: Topic, logged: Nanoseconds, data: Bytes, sequence: int = 0) -> None:
        """Send messages."""
        if not self.is_wanted(topic):
            return
        for message in data:
            text = base64.b64encode(message.tobytes()).decode()
            self._send({"kind": "message", "topic": topic.path, "type": topic.type, "data": text})

    def on_samples(self, block: Block) -> None:
        """Follow the source's clock; readings themselves are not sent."""
        MessageEncoder.on_samples(self, block)
        self.encode()
        encoder = self._encoders[block.probe]
        if encoder.clock_offset is not None and monotonic() - self._static_sent[block.probe] > STATIC_PERIOD:
            self._static_sent[block.probe] = monotonic()
            encoder.encode_static()

    def on_estimate(self, update: EstimateUpdate) -> None:
        """Send the messages of an estimate."""
        MessageEncoder.on_estimate(self, update)
        self.encode()

    def on_event(self, time: float, line: str) -> None:
        """Send an event."""
        MessageEncoder.on_event(self, time, line)
