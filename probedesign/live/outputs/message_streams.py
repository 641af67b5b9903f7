"""Sinks that send the messages of a recording while the run lasts.

They go to Foxglove and PlotJuggler by the WebSocket protocol of Foxglove, and as datagrams to `probedesign_ros`.
"""

import base64
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from time import monotonic, time_ns
from typing import Any

import numpy as np

from probedesign.core.errors import InputError, require
from probedesign.estimation.model import ProbeModel
from probedesign.live import Log, split_address
from probedesign.live.blocks import Block
from probedesign.live.outputs.recording import BackgroundWriter
from probedesign.live.outputs.sinks import UdpPublisher
from probedesign.live.poses.base_poses import pose_from_matrix
from probedesign.live.processing.estimates import EstimateUpdate
from probedesign.live.recordings import schemas
from probedesign.live.recordings.messages import MessageEncoder
from probedesign.live.recordings.schemas import Bytes, Nanoseconds, Topic
from probedesign.web import LOOPBACK

DEFAULT_ADDRESS = ("127.0.0.1", 8765)  #: Host and port that Foxglove proposes.
#: Period in which messages are sent [s]; with the gathering of the thread, a message is up to 0.1 s old.
FLUSH_PERIOD = 0.05
MAX_QUEUED_READINGS = 16_384  #: Maximum number of readings that wait for the server: 2 s at 7000 per second.


def parse_foxglove_address(text: str) -> tuple[str, int]:
    """Return host and port of `HOST:PORT`, `HOST` or `:PORT`; what is missing is that of `DEFAULT_ADDRESS`.

    Raises:
        InputError: the text is no address.
    """
    address = split_address(f"ws://{text}", "ws")
    if address is None or address[1] == 0 or not text.isprintable() or " " in text:
        raise InputError(f"--foxglove {text}: write HOST:PORT, as 127.0.0.1:8765, with a port of 1 ... 65535")
    host, port = address
    return host or DEFAULT_ADDRESS[0], port or DEFAULT_ADDRESS[1]


class FoxgloveServer(MessageEncoder):
    """Server of all topics; messages that nobody subscribed to are not encoded.

    Clients can only read: the server offers no services and no parameters, and takes no messages.

    Attributes:
        url: address of the server.
        readings: 0; a server keeps nothing (see `RecordingFile`).
    """

    readings = 0

    def __init__(self, models: Sequence[ProbeModel], address: tuple[str, int]) -> None:
        """Start the server for the probes of a run.

        Raises:
            InputError: the address cannot be used.
            MissingDependencyError: the package is not installed.
        """
        require("foxglove", "--foxglove", "foxglove", "foxglove-sdk")
        import foxglove
        from foxglove import websocket

        static = self.encode_static

        class Listener(websocket.ServerListener):
            """Sends the static transform to every new subscriber, in a thread of the server: nothing is kept."""

            def on_subscribe(self, client: websocket.Client, channel: websocket.ChannelView) -> None:
                """Send it where it is subscribed."""
                if channel.topic == schemas.TF_STATIC.name:
                    static()

        super().__init__(*models)
        context = self._context = foxglove.Context()  # channels live as long as it
        self._channels = {
            topic.path: foxglove.Channel(
                topic.path,
                schema=foxglove.Schema(name=topic.type, encoding="ros2msg", data=schemas.definition(topic.type)),
                message_encoding="cdr",
                metadata=topic.metadata,
                context=context,
            )
            for topic in self.topics
        }
        host, port = address
        try:
            self._server = foxglove.start_server(
                name="probedesign " + ", ".join(f"{model.name} {model.fingerprint}" for model in models),
                host=host,
                port=port,
                context=context,
                server_listener=Listener(),
            )
        except Exception as error:  # the package raises its own type for each reason
            reason = " ".join(str(error).split())
            raise InputError(f"--foxglove {host}:{port}: {reason}; use a free port of this machine") from None
        self.url = f"ws://{f'[{host}]' if ':' in host else host}:{self._server.port}"

    def add(self, topic: Topic, logged: Nanoseconds, data: Bytes, sequence: int = 0) -> None:
        """Send messages; see `MessageEncoder`."""
        channel = self._channels[topic.path]
        if channel.has_sinks():
            for time, message in zip(logged.tolist(), data, strict=True):
                channel.log(message.tobytes(), log_time=time)

    def is_wanted(self, topic: Topic) -> bool:
        """Return whether somebody subscribed to a topic."""
        return self._channels[topic.path].has_sinks()

    def pass_on(self, call: str, *data: Any) -> None:
        """Encode data if somebody listens; see `MessageEncoder`."""
        if any(channel.has_sinks() for channel in self._channels.values()):
            super().pass_on(call, *data)

    def flush(self) -> None:
        """Send what is buffered."""
        self.encode()

    def close(self) -> None:
        """Send what is buffered, and stop the server."""
        self.encode()
        self._server.stop()


class FoxgloveSink(BackgroundWriter):
    """Sink of a run that feeds a `FoxgloveServer` from a thread of its own; nothing waits for a client.

    Attributes:
        url: address of the server.
    """

    def __init__(self, models: Sequence[ProbeModel], address: tuple[str, int], log: Log) -> None:
        """Start server and thread; see `FoxgloveServer`."""
        server = FoxgloveServer(models, address)
        self.url, local = server.url, address[0] in LOOPBACK
        log(f"foxglove: {server.url}, {'this machine only' if local else 'readable by anyone in the network'}")
        super().__init__(server, "foxglove", log, MAX_QUEUED_READINGS, FLUSH_PERIOD, cause="the server")


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
        UdpPublisher.__init__(self, address, log, scheme="ros2")
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

    def send_map(self, document: Mapping[str, Any]) -> None:
        """Send shapes and next touch of `explore`, the latter also as the pose of the base."""
        now = np.array([time_ns()])
        self.add(schemas.MAP, now, schemas.texts([json.dumps(document)]))
        if "suggestion" in document:
            best = document["suggestion"]
            at = pose_from_matrix(0.0, np.array(best["T_world_base"]["contact"]))
            topic = replace(schemas.NEXT_TOUCH, probe=best["probe"])
            self.add(topic, now, schemas.stamped("world", now, [[*at.p, *at.q]]))

    def on_event(self, time: float, line: str) -> None:
        """Send an event."""
        MessageEncoder.on_event(self, time, line)
