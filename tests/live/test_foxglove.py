"""Messages for Foxglove, PlotJuggler and rosbag2: in a recording and from the live server, read by other programs."""

import json
import math
import re
import socket
import struct
import time
from collections import defaultdict
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability, QosHistory, QosReliability
from rosbags.rosbag2.metadata import parse_qos
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from probedesign.core.errors import InputError, MissingDependencyError
from probedesign.estimation.estimate import RESULTS, Estimate
from probedesign.live.blocks import WrenchReading
from probedesign.live.outputs.message_streams import FoxgloveServer, FoxgloveSink, parse_foxglove_address
from probedesign.live.poses.base_poses import pose_from_matrix
from probedesign.live.processing.chain import ProcessingOptions
from probedesign.live.processing.estimates import EstimateUpdate, bent_shape
from probedesign.live.recordings import schemas
from probedesign.live.recordings.mcap_write import McapRecorder
from probedesign.live.run import estimate_stream
from probedesign.live.sources.rosbag import read_bag_poses
from probedesign.live.sources.sim import SimulatedSource
from tests.live.mcap_files import block, messages_of, write, write_estimate

LAYOUT = Path(__file__).parents[2] / "docs" / "examples" / "foxglove-layout.json"


@pytest.fixture(scope="module")
def updates(estimator):
    """Free, then a touch: what the recording and the server are fed with."""
    sim = SimulatedSource(estimator.model, "speed=max&rate_hz=10&seconds=5")
    found = list(estimate_stream(estimator, sim, ProcessingOptions(), print))
    assert {"ok", "no_contact"} <= {each.estimate.result for each in found}
    return found


@pytest.fixture(scope="module")
def recorded(model, updates, tmp_path_factory):
    """A recording of the updates, their poses, and the wall clock around it [ns]."""
    path, T = tmp_path_factory.mktemp("foxglove") / "r.mcap", np.eye(4)
    T[:3, 3] = [0.1, 0.2, 0.3]
    before = time.time_ns()
    file = McapRecorder(path, model)
    file.on_samples(block(0, 7))
    for update in updates:
        file.on_estimate(update)
        file.on_pose(pose_from_matrix(update.reading.time, T))
    file.close()
    return path, before, time.time_ns()


@pytest.fixture(scope="module")
def decoded(recorded):
    """All messages of the recording by topic, as rosbags reads them by the definitions in the file."""
    found = defaultdict(list)
    with AnyReader([recorded[0]]) as reader:
        for connection, logged, data in reader.messages():
            found[connection.topic].append((logged, reader.deserialize(data, connection.msgtype)))
    return found


def stamp(message) -> int:
    at = getattr(message, "header", message)
    at = getattr(at, "stamp", getattr(at, "timestamp", None))
    return at.sec * 10**9 + at.nanosec


# state


def test_the_numbers_of_an_estimate_are_plotted_with_its_result(decoded, updates):
    messages = [message for _, message in decoded[schemas.STATE.name]]
    assert len(messages) == len(updates)
    for message, update in zip(messages, updates, strict=True):
        estimate = update.estimate
        assert list(RESULTS)[message.result] == estimate.result
        assert getattr(message, estimate.result.upper()) == message.result  # the constant of the definition
        assert schemas.PHASES[message.phase] == update.phase
        assert message.detection_chi2 == pytest.approx(estimate.detection_chi2, nan_ok=True)
        if estimate.ok:
            assert (message.s_contact, message.std_s) == (estimate.s_contact, estimate.std_s)
            force = [message.force.x, message.force.y, message.force.z]
            assert force == estimate.force_base.tolist()
            assert message.force_norm == pytest.approx(np.linalg.norm(force))
            assert message.friction_ratio == estimate.friction_ratio
            assert message.p_surface.z == estimate.p_surface_base[2]
        else:
            assert all(map(math.isnan, (message.s_contact, message.force.x, message.force_normal)))


@pytest.mark.parametrize("result", list(RESULTS))
def test_only_ok_has_numbers(model, updates, tmp_path, result):
    """Not even a result that carries those of a contact."""
    ok = next(each for each in updates if each.estimate.ok)
    update = replace(ok, estimate=replace(ok.estimate, result=result))
    found = write_estimate(tmp_path / "one.mcap", model, update)
    assert math.isnan(found[schemas.STATE.name].s_contact) == (result != "ok")
    assert (schemas.CONTACT.name in found) == (result == "ok")
    contact = [marker for marker in found[schemas.SCENE.name].markers if marker.ns == "contact"]
    assert [(marker.id, marker.action) for marker in contact] == [(i, 0 if result == "ok" else 2) for i in (0, 1)]


# time stamps


def test_headers_have_the_wall_clock_and_keep_the_pace_of_the_source(decoded, recorded, updates):
    _, before, after = recorded
    span = round((updates[-1].reading.time - updates[0].reading.time) * 1e9)
    for name in (schemas.RAW, schemas.STATE, schemas.WITHOUT_BIAS, schemas.BASE):
        stamps = [stamp(message) for _, message in decoded[name.name]]
        assert before - 10**9 <= stamps[0] <= after + 10**9
        assert stamps == [logged for logged, _ in decoded[name.name]]
        assert np.all(np.diff(stamps) > 0)
    assert stamps[-1] - stamps[0] == pytest.approx(span, abs=1)  # rounded to nanoseconds


def test_the_arrival_of_the_readings_sets_the_wall_clock(model, tmp_path):
    """Two seconds ago, although it is written only now."""

    received, arrival = time.monotonic() - 2.0, time.time_ns() - 2 * 10**9
    path = write(tmp_path / "late.mcap", model, [replace(block(70, 7), received=np.full(7, received))])
    assert stamp(messages_of(path)[schemas.RAW.name]) == pytest.approx(
        arrival, abs=5e8
    )  # both clocks are read one after the other, on a busy machine


def test_poses_are_replayed_by_the_clock_of_the_source_exactly(recorded, updates):
    for options in ({}, {"world": "world", "base": "base"}):
        found = read_bag_poses(recorded[0], **options)
        assert [pose.time for pose in found] == pytest.approx([u.reading.time for u in updates], abs=1e-9)


# frames and scene


def test_transforms_are_those_of_the_probe(decoded, model, updates):
    (_, static), *more = decoded[schemas.TF_STATIC.name]
    (edge,) = static.transforms
    assert (edge.header.frame_id, edge.child_frame_id, more) == ("base", "sensor", [])
    found = edge.transform.translation
    expected = -model.T_sensor_base[:3, :3].T @ model.T_sensor_base[:3, 3]
    assert [found.x, found.y, found.z] == pytest.approx(expected)
    (edge,) = decoded[schemas.TF.name][0][1].transforms
    assert (edge.header.frame_id, edge.child_frame_id) == ("world", "base")
    assert edge.transform.translation.z == 0.3 and len(decoded[schemas.TF.name]) == len(updates)


def test_the_scene_contains_the_bent_probe_and_its_contact(decoded, updates):
    ok = [each for each in updates if each.estimate.ok]
    scenes = [message.markers for _, message in decoded[schemas.SCENE.name]]
    markers = next({(m.ns, m.id): m for m in scene} for scene in reversed(scenes) if scene[-1].action == 0)
    points = np.array([[p.x, p.y, p.z] for p in markers["probe", 0].points])
    assert markers["probe", 0].type == 11 and len(points) % 3 == 0  # triangles
    tips = [bent_shape(each).p_base[-1] for each in ok]
    # the centre of the cap at the tip, to a micrometre, for one of the estimates
    assert min(np.linalg.norm(points - tip, axis=1).min() for tip in tips) < 1e-6
    ball, arrow = markers["contact", 0], markers["contact", 1]
    found = np.array([ball.pose.position.x, ball.pose.position.y, ball.pose.position.z])
    touched = min(ok, key=lambda each: np.linalg.norm(each.estimate.p_surface_base - found)).estimate
    assert found == pytest.approx(touched.p_surface_base)
    # the 95 % ellipsoid: the largest diameter is 2 · 2.7955 of the largest standard deviation
    assert ball.scale.z == pytest.approx(
        2 * 2.7955 * math.sqrt(np.linalg.eigvalsh(touched.cov_surface_base)[-1]), rel=1e-3
    )
    tail, head = (np.array([p.x, p.y, p.z]) for p in arrow.points)
    assert head == pytest.approx(found)
    assert (head - tail) / np.linalg.norm(head - tail) == pytest.approx(
        touched.force_base / np.linalg.norm(touched.force_base), abs=1e-9
    )
    assert ball.lifetime.sec == arrow.lifetime.sec == 1  # an old contact disappears by itself


# what rosbag2 and Foxglove need


def test_every_channel_offers_its_qos(recorded):
    with recorded[0].open("rb") as file:
        summary = make_reader(file).get_summary()
    assert {channel.topic for channel in summary.channels.values()} == {t.name for t in schemas.TOPICS}
    for channel in summary.channels.values():
        (qos,) = parse_qos(channel.metadata["offered_qos_profiles"])
        assert (qos.history, qos.depth) == (QosHistory.KEEP_LAST, 10)
        assert qos.reliability is QosReliability.RELIABLE
        latched = channel.topic == "/tf_static"
        assert qos.durability is (QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE)
        assert (qos.deadline.sec, qos.lifespan.nsec) == (9223372036, 854775807)


def test_the_layout_names_existing_topics_and_fields():
    layout = json.loads(LAYOUT.read_text())
    fields = {t.name: set(re.findall(r"^\S+ (\w+)", schemas.definition(t.type).decode(), re.M)) for t in schemas.TOPICS}
    paths = re.findall(r'"(/[\w/.]+)"', LAYOUT.read_text())
    assert len(paths) > 8
    for path in paths:
        topic, _, field = path.partition(".")
        assert topic in fields and (not field or field in fields[topic])
    placed = set(re.findall(r'"(\w+![\w]+)"', json.dumps(layout["layout"])))
    assert placed == set(layout["configById"])


# the live server


@pytest.fixture
def server(model):
    pytest.importorskip("foxglove")
    log_lines = []
    with socket.socket() as trial:
        trial.bind(("127.0.0.1", 0))
        port = trial.getsockname()[1]
    with closing(FoxgloveSink([model], ("127.0.0.1", port), log_lines.append)) as sink:
        sink.url, sink.log_lines = f"ws://127.0.0.1:{port}", log_lines
        yield sink


class Client:
    """A subscriber of all topics, by the published protocol."""

    def __init__(self, url: str) -> None:
        from websockets.sync.client import connect

        self._socket = connect(url, subprotocols=["foxglove.sdk.v1"], max_size=None)
        self.info = json.loads(self._socket.recv(timeout=30))
        self.channels = {}
        while len(self.channels) < len(schemas.TOPICS):
            message = self._socket.recv(timeout=30)
            if isinstance(message, str) and (content := json.loads(message))["op"] == "advertise":
                self.channels |= {channel["id"]: channel for channel in content["channels"]}
        chosen = [{"id": number, "channelId": number} for number in self.channels]
        self._socket.send(json.dumps({"op": "subscribe", "subscriptions": chosen}))

    def send(self, message) -> None:
        self._socket.send(message)

    def receive(self, *topics: str):
        """Messages until one of each topic has come: by topic its log time [ns] and its bytes, the first ones."""
        found = {}
        while not set(topics) <= set(found):
            message = self._socket.recv(timeout=30)
            if isinstance(message, bytes) and message[0] == 1:
                number, logged = struct.unpack_from("<IQ", message, 1)
                found.setdefault(self.channels[number]["topic"], (logged, message[13:]))
        return found

    def close(self) -> None:
        self._socket.close()


def decode(channel, data: bytes):
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(channel["schema"], channel["schemaName"]))
    return store.deserialize_cdr(data, channel["schemaName"])


def test_a_subscriber_receives_the_messages_of_a_recording(server, updates):
    """One schema for both; also the static transform, which was sent before it came."""
    ok = next(each for each in updates if each.estimate.ok)
    with closing(Client(server.url)) as client:
        assert client.info["capabilities"] == []
        by_topic = {channel["topic"]: channel for channel in client.channels.values()}
        for topic in schemas.TOPICS:
            channel = by_topic[topic.name]
            assert (channel["encoding"], channel["schemaEncoding"]) == ("cdr", "ros2msg")
            assert channel["schema"].encode() == schemas.definition(topic.type)
        assert schemas.TF_STATIC.name in client.receive(schemas.TF_STATIC.name)
        server.on_samples(block(0, 7))
        server.on_estimate(ok)
        server.on_event(0.0, "mark: here")
        wanted = (schemas.RAW, schemas.STATE, schemas.SCENE, schemas.CONTACT, schemas.EVENT)
        found = client.receive(*(topic.name for topic in wanted))
    logged, data = found[schemas.STATE.name]
    state = decode(by_topic[schemas.STATE.name], data)
    assert state.s_contact == ok.estimate.s_contact and stamp(state) == logged
    scene = decode(by_topic[schemas.SCENE.name], found[schemas.SCENE.name][1])
    assert {(marker.ns, marker.action) for marker in scene.markers} == {("probe", 0), ("sensor", 0), ("contact", 0)}
    assert b"mark: here" in found[schemas.EVENT.name][1]


def test_garbage_of_a_client_and_its_end_do_not_end_the_server(server, updates):
    client = Client(server.url)
    for message in (b"\xff" * 40, "garbage", "{}", '{"op": "subscribe", "subscriptions": 3}', b"", "x" * 100_000):
        client.send(message)
    client.close()
    with closing(Client(server.url)) as client:
        server.on_estimate(updates[0])
        assert schemas.STATE.name in client.receive(schemas.STATE.name)
    server.on_estimate(updates[0])
    assert [line for line in server.log_lines if "ended" in line] == []


def test_without_a_subscriber_nothing_is_encoded(model, updates, monkeypatch):
    pytest.importorskip("foxglove")
    server = FoxgloveServer([model], ("127.0.0.1", 0))
    monkeypatch.setattr(schemas, "stamped", lambda *_: pytest.fail("encoded"))
    server.on_samples(block(0, 7))
    server.on_estimate(updates[0])
    server.close()
    assert all(encoder.clock_offset is None for encoder in server._encoders.values())


@pytest.mark.parametrize("text", ["a/b", "127.0.0.1:99999", "127.0.0.1:0", "a b:1", "::1:3", "x@y:1"])
def test_what_is_no_address_is_refused_and_addresses_have_defaults(text):
    with pytest.raises(InputError, match="--foxglove") as error:
        parse_foxglove_address(text)
    assert str(error.value).isprintable()
    assert parse_foxglove_address("") == ("127.0.0.1", 8765)
    assert parse_foxglove_address(":9000") == ("127.0.0.1", 9000)
    assert parse_foxglove_address("0.0.0.0") == ("0.0.0.0", 8765)
    assert parse_foxglove_address("[::1]:80") == ("::1", 80)


def test_a_port_in_use_or_a_missing_package_is_one_line(model, server, monkeypatch):
    port = int(server.url.rpartition(":")[2])
    for address in (("127.0.0.1", port), ("192.0.2.1", 8765)):  # the second is nobody's
        with pytest.raises(InputError, match=f"--foxglove {address[0]}:{address[1]}") as error:
            FoxgloveServer([model], address)
        assert "\n" not in str(error.value)
    monkeypatch.setattr("probedesign.core.errors.find_spec", lambda name: None)
    with pytest.raises(MissingDependencyError, match=r"probedesign\[foxglove\]"):
        FoxgloveServer([model], ("127.0.0.1", 0))


def test_the_estimate_of_a_fault_is_encoded(model, tmp_path):
    """Without a shape and without any number."""
    reading = WrenchReading(0.0, np.full(6, np.nan), model.gravity_base, fault="saturated")
    found = write_estimate(tmp_path / "fault.mcap", model, EstimateUpdate(reading, Estimate("out_of_range")))
    assert found[schemas.STATE.name].result == list(RESULTS).index("out_of_range")
    shown = [marker.ns for marker in found[schemas.SCENE.name].markers if marker.action == 0]
    assert shown == ["sensor"]
