"""Test the ROS 2 node with a substitute for rclpy: it publishes what a recording contains."""

import ast
import base64
import json
import socket
import sys
import threading
import time
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.typesys import get_types_from_msg
from scipy.spatial.transform import Rotation

from probedesign.cli.main import run as run_command
from probedesign.design import load_design
from probedesign.live.outputs.message_streams import RosPublisher
from probedesign.live.outputs.sinks import ProbeSink, SinkGroup
from probedesign.live.poses.base_poses import BasePoses, TimedPose
from probedesign.live.processing.chain import ProcessingOptions
from probedesign.live.processing.commands import COMMANDS as RUN_COMMANDS
from probedesign.live.processing.commands import CommandQueue, DatagramInput
from probedesign.live.recordings import schemas
from probedesign.live.recordings.mcap_write import McapRecorder
from probedesign.live.run import estimate_stream
from probedesign.live.sources.sim import SimulatedSource
from probedesign.probe import build_probe

ROOT = Path(__file__).parents[2]
ROS = ROOT / "ros"


@pytest.fixture(scope="module")
def estimator():
    return build_probe(load_design(ROOT / "designs" / "large.toml")).estimator()


@pytest.fixture(scope="module")
def ros():
    """Put the package and the substitute on the path and remove their modules afterwards."""
    before, path = set(sys.modules), sys.path[:]
    sys.path[:0] = [str(ROOT / "tests" / "ros2_stub"), str(ROS / "probedesign_ros")]
    import probedesign_ros.node as node

    yield node
    sys.path[:] = path
    for name in set(sys.modules) - before:
        if name.split(".")[0] in {p.name for p in (ROOT / "tests" / "ros2_stub").iterdir()} | {"probedesign_ros"}:
            del sys.modules[name]


def made(ros, **overrides):
    """A node with parameters other than the usual ones of a test."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ros.Node, "overrides", {"port": 0, "control_port": 9002} | overrides)
        return ros.ProbeNode()


@pytest.fixture
def node(ros):
    node = made(ros)
    node._receiver._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 21)
    yield node
    node.destroy_node()


def sent(node, topic):
    return node.publishers_made[topic].sent if topic in node.publishers_made else []


def a_run(node, estimator, record=None, seconds=4):
    """A simulated run with a fixed pose of the base, published to the node and recorded."""
    lines = []
    sinks = SinkGroup()
    publisher = RosPublisher(f"ros2://127.0.0.1:{node._receiver.port}", [estimator.model], lines.append)
    sinks.add(publisher)
    poses = BasePoses("still", [TimedPose(0.04 * i, (0.4, 0.0, 0.3), (0.0, 0.6, 0.0, 0.8)) for i in range(120)])
    if record is not None:
        sinks.add(McapRecorder(record, estimator.model))
    poses.on_pose = sinks.on_pose
    source = SimulatedSource(estimator.model, f"speed=max&seconds={seconds}&rate_hz=10&period_s=5")
    options = ProcessingOptions(samples=1, zero="trusted")
    for _ in estimate_stream(estimator, source, options, lines.append, sinks, None, poses):
        node.receive()
    sinks.log("mark: cup")
    node.receive()
    sinks.close()
    return lines


START = 1_800_000_000  #: A constant wall clock [s].


def test_messages_equal_those_of_the_recording(node, estimator, tmp_path, monkeypatch):
    """Frames, numbers, covariances, and stamps by the clock of the first reading, to the bit."""
    monkeypatch.setattr(time, "time_ns", lambda: START * 10**9)
    path = tmp_path / "run.mcap"
    a_run(node, estimator, path)
    names = ["wrench", "contact", "state", "base"]
    recorded = {name: [] for name in names}
    with AnyReader([path]) as reader:
        for connection, _, raw in reader.messages():
            name = connection.topic.rpartition("/")[2]
            if name in recorded:
                recorded[name].append(reader.deserialize(raw, connection.msgtype))
    for name in names:
        ours = sent(node, f"~/{name}")
        assert len(ours) == len(recorded[name]) > 3
        for a, b in zip(ours, recorded[name], strict=True):
            a.header.frame_id = a.header.frame_id.removeprefix("large/")
            assert fields(a) == fields(b)
            a.header.frame_id = "world" if name == "base" else "large/base"
            stamps = [(m.header.stamp.sec, m.header.stamp.nanosec) for m in (a, b)]
            assert stamps[0] == stamps[1]
            assert abs(stamps[0][0] - START) <= 5  # the run takes four seconds by the source's clock
    assert {m.header.frame_id for m in sent(node, "~/contact")} == {"large/base"}  # base is the robot's
    assert any("mark: cup" in m.data for m in sent(node, "~/event"))


def fields(message):
    """Every number and text of a message but its time stamp and constants; NaN equals NaN."""
    if hasattr(message, "__dict__") and not isinstance(message, type):
        items = {k: v for k, v in vars(message).items() if k.islower() and k not in ("stamp", "__msgtype__")}
        return {k: fields(v) for k, v in items.items()}
    return repr(message.tolist() if hasattr(message, "tolist") else message)


def test_the_transforms_form_one_tree(node, estimator):
    a_run(node, estimator)
    edges = {(t.header.frame_id, t.child_frame_id) for m in sent(node, "/tf") for t in m.transforms}
    still = {(t.header.frame_id, t.child_frame_id) for m in sent(node, "/tf_static") for t in m.transforms}
    assert edges == {("world", "large/base"), ("large/base", "large/contact")}
    assert still == {("large/base", "large/sensor")}
    (static,) = {repr(m.transforms[0].transform) for m in sent(node, "/tf_static")}
    at = sent(node, "/tf_static")[0].transforms[0].transform
    expected = np.linalg.inv(estimator.model.T_sensor_base)
    assert [at.translation.x, at.translation.y, at.translation.z] == pytest.approx(expected[:3, 3], abs=1e-12)
    contact = sent(node, "~/contact")[-1]
    last = [t for m in sent(node, "/tf") for t in m.transforms if t.child_frame_id == "large/contact"][-1]
    assert last.transform.translation.x == contact.pose.pose.position.x and static


def test_a_prefix_of_the_frames(ros, estimator):
    node = made(ros, frame_prefix="robot1/", publish_tf=False)
    a_run(node, estimator, seconds=2)
    assert {m.header.frame_id for m in sent(node, "~/base")} == {"world"}
    frames = {m.header.frame_id for m in sent(node, "~/wrench")}
    edges = {(t.header.frame_id, t.child_frame_id) for m in sent(node, "/tf") for t in m.transforms}
    assert frames == {"robot1/large/base"} and edges == {("robot1/large/base", "robot1/large/contact")}
    node.destroy_node()


def test_the_topics_of_several_probes_begin_with_their_names(node, estimator):
    models = [replace(estimator.model, name=name) for name in ("left", "right-2")]
    run = SinkGroup(RosPublisher(f"ros2://127.0.0.1:{node._receiver.port}", models, print))
    for model in models:
        sinks = SinkGroup(ProbeSink(model.name, run))
        source = SimulatedSource(model, "speed=max&seconds=4&rate_hz=10&period_s=5")
        for _ in estimate_stream(estimator, source, ProcessingOptions(samples=1, zero="trusted"), print, sinks):
            node.receive()
    assert not sent(node, "~/wrench")
    for name in ("left", "right_2"):  # as a name of ROS may be
        assert {m.header.frame_id for m in sent(node, f"~/{name}/contact")} == {f"{name}/base"}
        assert len(sent(node, f"~/{name}/markers")) == len(sent(node, f"~/{name}/state")) == 40
    assert {t.child_frame_id for m in sent(node, "/tf") for t in m.transforms} == {"left/contact", "right_2/contact"}
    assert node._receiver.counts["malformed"] == 0


def test_markers_are_the_95_percent_ellipsoid_and_vanish_without_a_contact(node, estimator):
    """χ² of three degrees of freedom is below 7.8147 in 95 % of cases; half-axes from numpy, axes by scipy."""
    a_run(node, estimator)
    arrays = sent(node, "~/markers")
    states, contacts = sent(node, "~/state"), iter(sent(node, "~/contact"))
    assert len(arrays) == len(states)
    assert {s.result == 0 for s in states} == {True, False}
    for array, state in zip(arrays, states, strict=True):
        sphere = array.markers[0]
        if state.result != 0:
            assert {m.action for m in array.markers} == {2}
            continue
        contact = next(contacts)
        cov = np.array(contact.pose.covariance).reshape(6, 6)[:3, :3]
        q = sphere.pose.orientation
        R = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
        half = 0.5 * np.array([sphere.scale.x, sphere.scale.y, sphere.scale.z])
        variances = np.linalg.eigvalsh(cov)
        assert half == pytest.approx(np.maximum(np.sqrt(7.8147 * variances), 0.9e-3), rel=1e-4)
        assert R.T @ cov @ R == pytest.approx(np.diag(variances), abs=1e-9 * variances[-1])
        arrow = array.markers[1]
        tip, tail = arrow.points[1], arrow.points[0]
        direction = np.array([tip.x - tail.x, tip.y - tail.y, tip.z - tail.z])
        force = np.array([state.force.x, state.force.y, state.force.z])
        assert np.cross(direction, force) == pytest.approx(0.0, abs=1e-12) and direction @ force > 0.0


@pytest.mark.parametrize("turn", [np.eye(3), *Rotation.random(20, rng=np.random.default_rng(0)).as_matrix()])
def test_quaternions_as_scipy_has_them(ros, turn):
    from probedesign_ros.markers import quaternion_of

    assert Rotation.from_quat(quaternion_of(turn)).as_matrix() == pytest.approx(turn, abs=1e-12)


def test_hostile_datagrams_are_counted_and_survived(node, estimator):
    hostile = [
        b"", b"{", b"[]", b"\xff", b"[" * 5000, b'{"schema": 1, "kind": "message"}',
        *(json.dumps({"schema": 1, "kind": "message", "number": 1} | each).encode() for each in (
            {"topic": "/cmd_vel", "type": "x", "data": ""}, {"topic": "/tf", "type": "x", "data": "!"},
            {"topic": "/tf", "type": "x", "data": base64.b64encode(b"\x00\x01").decode()},
            {"topic": 5, "type": "x", "data": ""},
        )),
    ]  # fmt: skip
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for content in hostile:
            sender.sendto(content, ("127.0.0.1", node._receiver.port))
    node.receive()
    assert node._receiver.counts["malformed"] == len(hostile)
    assert not any(publisher.sent for publisher in node.publishers_made.values())
    a_run(node, estimator, seconds=1)
    assert sent(node, "~/state")
    node.report()
    node.report()
    assert sum("malformed" in line for line in node.get_logger().lines) == 1


def test_lost_datagrams_are_counted(node):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for number in (1, 2, 5, 1):
            text = base64.b64encode(schemas.texts(["{}"])[0].tobytes()).decode()
            content = {"schema": 1, "kind": "message", "topic": "/probedesign/event", "type": "std_msgs/msg/String"}
            datagram = json.dumps(content | {"number": number, "data": text}).encode()
            sender.sendto(datagram, ("127.0.0.1", node._receiver.port))
    node.receive()
    assert node._receiver.counts["lost"] == 2 and node._receiver.counts["received"] == 4


# services


def test_shapes_and_the_next_touch_of_explore_are_published(node, estimator):
    """Beside a run whose datagrams have numbers of their own; a plane of 40 by 20 mm, an edge along x."""
    T = np.eye(4)
    T[:3, 3] = 0.1, 0.2, 0.3
    plane = {"kind": "plane", "p_mm": [10.0, 0.0, 0.0], "axes": np.eye(3).tolist(), "radius_mm": None,
             "extent_mm": [[0.0, 40.0], [0.0, 20.0]]}  # fmt: skip
    edge = plane | {"kind": "edge", "axes": np.roll(np.eye(3), -1, axis=0).tolist(), "extent_mm": [[-30.0, 30.0]]}
    best = {"p_world_mm": [0.0, 0.0, 50.0], "normal_world": [0.0, 0.0, 1.0], "T_world_base": {"contact": T.tolist()}}
    lines = []
    for probe in ("", "left"):
        publisher = RosPublisher(f"ros2://127.0.0.1:{node._receiver.port}", [estimator.model], lines.append)
        publisher.on_event(0.0, "mark: before")
        publisher.send_map({"shapes": [plane, edge], "suggestion": best | {"probe": probe}})
        publisher.close()
    node.receive()
    assert node._receiver.counts["lost"] == node._receiver.counts["malformed"] == 0
    assert [sent(node, f"~{probe}/next_touch")[-1].pose.position.y for probe in ("", "/left")] == [0.2, 0.2]
    removed, flat, bar, arrow = sent(node, "~/shapes")[-1].markers
    assert removed.action == 3 and flat.header.frame_id == "world" and arrow.points[-1].z == pytest.approx(0.05)
    assert (flat.pose.position.x, flat.pose.position.y, flat.scale.x) == pytest.approx((0.03, 0.01, 0.04))
    q = bar.pose.orientation
    assert Rotation.from_quat([q.x, q.y, q.z, q.w]).apply([0.0, 0.0, bar.scale.z]) == pytest.approx([0.06, 0.0, 0.0])
    publisher = RosPublisher(f"ros2://127.0.0.1:{node._receiver.port}", [estimator.model], lines.append)
    publisher.send_map({"shapes": [{"kind": "plane"}]})
    publisher.close()
    node.receive()
    assert node._receiver.counts["malformed"] == 1


def test_every_command_is_a_service_and_waits_beside_the_topics(ros, node):
    """They are in a group of their own, and the executor has a thread for each."""
    assert set(ros.COMMANDS.values()) == set(RUN_COMMANDS)
    assert set(node.services_made) == {f"~/{name}" for name in (*ros.COMMANDS, "command")}
    (group,) = set(node.groups.values())
    assert group is not None
    assert "MultiThreadedExecutor(num_threads=2)" in Path(ros.__file__).read_text(encoding="utf-8")


def test_services_have_the_results_of_the_run(ros):
    """A refused service has the same message as in all inputs, because commands have one implementation."""
    commands, ended = CommandQueue(), threading.Event()
    commands.register("mark", lambda command: f"mark: {command.text}")
    inputs = DatagramInput("udp://:0", commands, lambda line: None)
    node = made(ros, control_port=inputs.address[1])

    def run():
        while not ended.wait(0.005):
            commands.execute(lambda line: None)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    from probedesign_msgs.srv import Command
    from std_srvs.srv import Trigger

    kind, call = node.services_made["~/command"]
    assert kind is Command
    response = call(Command.Request(command="mark", text="cup"), Command.Response())
    assert response.accepted and response.text == "mark: cup"
    response = call(Command.Request(command="format"), Command.Response())
    assert not response.accepted and "unknown command" in response.text
    kind, call = node.services_made["~/tare"]
    response = call(kind.Request(), kind.Response())
    assert kind is Trigger and not response.success and response.message == "tare is not available here"
    ended.set()
    thread.join()
    inputs.close()
    node.destroy_node()


def test_a_service_without_a_run_fails_in_time(ros):
    from probedesign_ros.link import Commander

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as silent:
        silent.bind(("127.0.0.1", 0))
        result = Commander("127.0.0.1", silent.getsockname()[1], 0.1).send("tare")
        assert not result.accepted and "no reply" in result.text
        closed = silent.getsockname()[1]
    assert not Commander("127.0.0.1", closed, 0.1).send("tare").accepted


# packages


def test_the_typed_message_is_that_of_the_recording():
    """The file's fields and constants, and those that a recording declares of its own messages."""
    text = (ROS / "probedesign_msgs" / "msg" / "Contact.msg").read_text(encoding="utf-8")
    name = schemas.CONTACT_STATE
    recorded = schemas.definition(name).decode().split("\n" + 80 * "=")[0]
    assert get_types_from_msg(text, name)[name] == get_types_from_msg(recorded, name)[name]


@pytest.mark.parametrize("package", ["probedesign_msgs", "probedesign_ros"])
def test_the_manifest_of_a_package(package):
    """REP 149: format 3, the elements that it requires, and a key of rosdep for each import: the name of a package."""
    root = ElementTree.parse(ROS / package / "package.xml").getroot()
    assert root.tag == "package" and root.get("format") == "3"
    tags = [child.tag for child in root]
    assert tags[:2] == ["name", "version"] and {"description", "maintainer", "license", "export"} <= set(tags)
    assert root.findtext("name") == package
    assert all(maintainer.get("email") for maintainer in root.iter("maintainer"))
    expected = {"probedesign_msgs": "ament_cmake", "probedesign_ros": "ament_python"}[package]
    assert root.findtext("export/build_type") == expected
    keys = {child.text for child in root if child.tag in ("depend", "exec_depend", "build_depend")}
    imported = set()
    for file in (ROS / package).rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            modules = [node.module] if isinstance(node, ast.ImportFrom) else []
            modules += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            imported |= {module.split(".")[0] for module in modules}
    imported -= {*sys.stdlib_module_names, package, "setuptools"}
    assert {"python3-numpy" if each == "numpy" else each for each in imported} <= keys  # rosdep's python.yaml


def test_the_messages_are_generated():
    text = (ROS / "probedesign_msgs" / "CMakeLists.txt").read_text()
    folder = ROS / "probedesign_msgs"
    assert all(f'"{f.relative_to(folder)}"' in text for kind in ("msg", "srv") for f in (folder / kind).iterdir())
    root = ElementTree.parse(folder / "package.xml").getroot()
    assert root.findtext("member_of_group") == "rosidl_interface_packages"
    assert root.findtext("exec_depend") == "rosidl_default_runtime"


def test_the_set_up_of_the_python_package(monkeypatch):
    """What ament_python requires: the marker, the manifest, scripts in lib/NAME, and files that exist."""
    folder, given = ROS / "probedesign_ros", {}
    monkeypatch.chdir(folder)
    import setuptools

    monkeypatch.setattr(setuptools, "setup", lambda **options: given.update(options))
    exec(compile((folder / "setup.py").read_text(), "setup.py", "exec"), {"__name__": "setup"})
    files = dict(given["data_files"])
    assert files["share/ament_index/resource_index/packages"] == ["resource/probedesign_ros"]
    assert files["share/probedesign_ros"] == ["package.xml"]
    assert all((folder / name).is_file() for names in files.values() for name in names)
    assert given["packages"] == ["probedesign_ros"]
    assert given["entry_points"]["console_scripts"] == ["probe = probedesign_ros.node:main"]
    assert "script_dir=$base/lib/probedesign_ros" in (folder / "setup.cfg").read_text()
    root = ElementTree.parse(folder / "package.xml").getroot()
    assert root.findtext("version") == given["version"]


def launched(**given):
    """The actions of the launch file and its declared arguments, with the stand-in for launch."""
    space = {}
    exec(compile((ROS / "probedesign_ros/launch/probe.launch.py").read_text(), "probe.launch.py", "exec"), space)
    *declared, opaque = space["generate_launch_description"]().entities
    context = {each.arguments[0]: each.options["default_value"] for each in declared}
    assert set(given) <= set(context) and all(each.options["description"] for each in declared)
    return opaque.options["function"](context | given), context


def test_the_launch_file_offers_every_parameter_and_every_option(ros):
    (node,), context = launched()
    assert {*ros.PARAMETERS, "use_sim_time", "bundle", "source", "pose", "tare", "options"} <= set(context)
    (values,) = node.options["parameters"]
    assert values.keys() == {*ros.PARAMETERS, "use_sim_time"}
    assert all(values[name].value_type is type(p.default) for name, p in ros.PARAMETERS.items())
    given = {"bundle": "a.json b.json", "source": "netft://h1 'sim:?a=1&b=2'", "pose": "fixed tf://world/b%2Fbase"}
    (_, run), _ = launched(**given, options="--record 'my run.mcap' --rate-hz 50", port="7001")
    words = run.options["cmd"]
    assert words[:4] == ["probedesign", "live", "a.json", "b.json"]
    assert words[4:8] == ["--source", "netft://h1", "--source", "sim:?a=1&b=2"] and "tf://world/b%2Fbase" in words
    assert "ros2://127.0.0.1:7001" in words and words[-4:] == ["--record", "my run.mcap", "--rate-hz", "50"]


def test_every_option_of_the_launch_is_one_of_live_and_it_ends_with_the_run(ros, capsys):
    """Only the frozen probe is missing, which is looked for after the options are read."""
    (_, run), _ = launched(bundle="a.json")
    assert type(run.options["on_exit"]).__name__ == "Shutdown"
    assert run_command(run.options["cmd"][1:]) == 2
    assert "a.json: no such frozen probe" in capsys.readouterr().err


# parameters and diagnostics


def test_parameters_have_types_ranges_and_descriptions(ros):
    node = made(ros, control_timeout_s=2)  # an integer is accepted for a float
    assert node._commander._timeout == 2.0
    for name, parameter in ros.PARAMETERS.items():
        described = node.descriptors[name]
        assert described.description == parameter.text and described.read_only
        ranges = described.integer_range + described.floating_point_range
        assert len(ranges) == (type(parameter.default) in (int, float))
        assert all(r.from_value == parameter.low and r.to_value == parameter.high for r in ranges)
    node.destroy_node()


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("control_timeout_s", 0, "is not in 0.01 ... 60"),
        ("control_timeout_s", "1", "is not a float"),
        ("port", 70000, "is not in 0 ... 65535"),
        ("port", 9001.0, "is not a int"),
        ("publish_tf", 1, "is not a bool"),
        ("control_timeout_s", float("nan"), "is not in"),
    ],
)
def test_a_wrong_parameter_is_named(ros, name, value, expected):
    with pytest.raises(ValueError, match=f"parameter {name}: .*{expected}"):
        made(ros, **{name: value})


def test_the_clock_of_a_simulation_stamps_the_messages(ros, estimator):
    node = made(ros, use_sim_time=True, world_frame="map")
    a_run(node, estimator, seconds=1)
    stamps = {m.header.stamp.sec for m in sent(node, "~/wrench")}
    stamps |= {t.header.stamp.sec for m in sent(node, "/tf") for t in m.transforms}
    assert stamps == {1}  # that of the stand-in stands at 1 s
    assert {m.header.frame_id for m in sent(node, "~/base")} == {"map"}
    node.destroy_node()


def test_diagnostics_state_estimates_losses_and_silence(node, estimator, monkeypatch):
    node.diagnose()
    a_run(node, estimator, seconds=1)
    node.diagnose()
    node._receiver.counts["lost"] = 3
    node.diagnose()
    later = time.monotonic() + 2.0
    monkeypatch.setattr(time, "monotonic", lambda: later)
    node.diagnose()
    states = [array.status[0] for array in sent(node, "/diagnostics")]
    assert [state.level for state in states] == [b"\x03", b"\x00", b"\x01", b"\x03"]
    assert {value.key: value.value for value in states[1].values}["estimates"] == "10"
    assert "3 datagrams lost" in states[2].message
