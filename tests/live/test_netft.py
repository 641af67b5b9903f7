"""`netft://` and the simulated box over real sockets: units, frames, records, and errors."""

import json
import re
import socket
import sys
import time
from collections import Counter
from contextlib import closing
from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from probedesign.cli.main import run
from probedesign.core.errors import InputError
from probedesign.live.sources import netft_rdt as rdt
from probedesign.live.sources.netft import RdtSession, buffer_note
from probedesign.live.sources.netft_configuration import parse_configuration
from probedesign.live.sources.netft_rdt import RECORD, Request, SequenceMonitor
from probedesign.live.sources.source import open_source
from probedesign.simulation import scenes
from probedesign.simulation.netft_box import (
    CYCLE_DWELL_TIME,
    MOVE_TIME,
    NATIVE,
    OFFSET,
    PRESS_TIME,
    REST_TIME,
    BaseMotion,
    SimulatedNetFT,
    SimulatedTransducer,
    configuration_page,
)
from probedesign.simulation.scenes import press_scene
from tests.live.peers import LOAD, box, close, mean_of, taken, until

# units and frames


TURNED = {"tool": (0.5, 0.0, 1.0, 0.5, 0.4, 0.0), "length_unit": "in", "angle_unit": "radians",
          "force_unit": "lbf", "torque_unit": "lbf-in", "counts_per_torque": 64000.0}  # fmt: skip


@pytest.mark.parametrize("settings", [{}, TURNED])
def test_the_box_is_read_in_si_and_in_the_sensor_frame(estimator, settings):
    with box(estimator, replace(NATIVE, **settings)) as peer:
        readings, source = taken(peer, estimator, 200)
    off = np.abs(mean_of(readings) - LOAD - OFFSET)
    rounding = np.abs(source.configuration.to_sensor).sum(axis=1)  # one count of every channel
    assert (off <= close(estimator, 200) + rounding).all()
    assert any("compensated" in note for note in source.notes) == bool(settings)


@pytest.mark.parametrize(
    ("settings", "force", "moment"),
    [
        ({"torque_unit": "N-m"}, 1.0, 1.0),
        ({"torque_unit": "Nmm"}, 1.0, 1e-3),
        ({"force_unit": "lbf", "torque_unit": "lbf-in"}, 4.4482216152605, 0.1129848290276167),
    ],
)
def test_counts_are_multiples_of_the_units_on_the_page(settings, force, moment):
    configuration = parse_configuration(configuration_page(replace(NATIVE, **settings, counts_per_torque=64000.0)))
    expected = np.repeat([force / 1e6, moment / 64000.0], 3)
    assert np.diag(configuration.to_sensor) == pytest.approx(expected, rel=1e-12)


def test_the_transform_turns_about_x_then_the_new_y_then_the_new_z():
    """By hand: of a quarter turn about x and then about the new z, the tool's x lies along the sensor's z... its
    own z has been turned to the sensor's -y first, and x about that."""
    T = replace(NATIVE, tool=(1.0, 2.0, 3.0, 90.0, 0.0, 90.0)).T_sensor_tool
    assert np.allclose(T[:3, 2], [0, -1, 0], atol=1e-15)
    assert np.allclose(T[:3, 0], [0, 0, 1], atol=1e-15)
    assert np.allclose(T[:3, 3], [1e-3, 2e-3, 3e-3], atol=1e-18)


@pytest.mark.parametrize(
    ("ranges", "noted"), [((12, 12, 17, 120, 120, 120), 0), ((25, 25, 35, 250, 250, 250), 1), ((), 0)]
)
def test_a_sensor_of_another_calibration_is_noted(estimator, ranges, noted):
    with box(estimator, replace(NATIVE, ranges=tuple(map(float, ranges)))) as peer:
        source = open_source(peer.source, estimator.model)
    assert sum("the range of the box" in note for note in source.notes) == noted


def test_pynetft_reads_the_same_from_our_box(estimator):
    """An independent client, with its own reading of the page. Its socket holds 277 records: beyond these a busy
    machine may lose some, which lack in both numbers. It must not connect anew where the box is not run for 0.1 s."""
    pynetft = pytest.importorskip("pynetft")
    with box(estimator) as peer:
        config = pynetft.Config("127.0.0.1", peer.address[1], peer.http_port, receive_timeout=5.0)
        with pynetft.Client(config, queue_size=8192) as client:
            samples = list(islice(client.samples(timeout=5.0), 700))
    assert {(s.force_unit.value, s.torque_unit.value) for s in samples} == {("N", "N-mm")}
    wrench = np.mean([s.wrench for s in samples], axis=0) * ([1.0] * 3 + [1e-3] * 3)
    assert (np.abs(wrench - LOAD - OFFSET) <= close(estimator, 700) + 1e-6).all()
    assert [s.rdt_sequence for s in samples[:277]] == list(range(1, 278))
    assert {s.ft_sequence - s.rdt_sequence for s in samples} == {samples[0].ft_sequence - 1}


# the wire, by hand


def ask(peer: SimulatedNetFT, command: int, records: int) -> list[bytes]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        udp.settimeout(5.0)
        udp.sendto(Request(command, records).packed(), peer.address)
        return [udp.recv(65536) for _ in range(records)]


def test_a_number_of_records_is_sent_and_no_more(estimator):
    with box(estimator) as peer:
        records = [RECORD.unpack(d) for d in ask(peer, rdt.REALTIME, 5)]
        until(lambda: peer.client is None)  # cleared shortly after the last record is sent
    assert [record[0] for record in records] == [1, 2, 3, 4, 5]
    assert set(np.diff([record[1] for record in records])) == {1}


def test_bias_makes_zero_and_shows_on_the_page(estimator):
    with box(estimator) as peer:
        ask(peer, rdt.BUFFERED, 70)
        ask(peer, rdt.BIAS, 0)
        until(lambda: any(peer.configuration.bias))
        readings, source = taken(peer, estimator, 200)
    assert (np.abs(mean_of(readings)) < 3.0 * close(estimator, 7)).all()  # the bias is the mean of one packet's samples
    assert any("software bias" in note for note in source.notes)


def test_what_is_no_request_is_not_answered(estimator):
    with box(estimator) as peer, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        for datagram in (b"", b"\x12", b"\x43\x21\0\2\0\0\0\0", b"\x12\x34\0\2\0\0\0\0x"):
            udp.sendto(datagram, peer.address)
        assert len(ask(peer, rdt.REALTIME, 1)) == 1  # requests are read in order
        udp.setblocking(False)
        with pytest.raises(BlockingIOError):
            udp.recv(100)


# what is refused


@pytest.mark.parametrize(
    ("page", "expected"),
    [
        (b"not xml", "not valid or safe XML"),
        (b'<!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>', "not valid or safe XML"),
        (b"<netft><scfgfu>N</scfgfu></netft>", "has no scfgtu, cfgcpf, cfgcpt"),
        ({"scfgtu": "N-furlong"}, "scfgtu = 'N-furlong' is not a known unit"),
        ({"scfgfu": ""}, "is not a known unit"),
        ({"cfgcpf": "0"}, "cfgcpf = 0 must be positive"),
        ({"cfgcpt": "-1"}, "must be positive"),
        ({"cfgcpf": "nan"}, "is not a number"),
        ({"cfgtfx": "1;2;3"}, "cfgtfx has 3 numbers"),
        ({"cfgtfx": "1;2;3;4;5;six"}, "is not a number"),
    ],
)
def test_an_invalid_page_is_refused(page, expected):
    """Other bytes, or the page of a box with another value of a tag."""
    if isinstance(page, dict):
        ((tag, value),) = page.items()
        page = re.sub(rf"<{tag}>.*</{tag}>".encode(), f"<{tag}>{value}</{tag}>".encode(), configuration_page(NATIVE))
    with pytest.raises(InputError) as error:
        parse_configuration(page)
    assert expected in str(error.value)


def test_a_port_in_use_is_reported(estimator):
    with box(estimator) as peer:
        with pytest.raises(InputError, match="Address already in use; use another --port"):
            box(estimator, port=peer.address[1])
        with pytest.raises(InputError, match="Address already in use; use another --http-port"):
            box(estimator, http_port=peer.http_port)


# the commands


@pytest.fixture(scope="module")
def motions(estimator):
    """By friction: a base that presses an edge."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(scenes.SCENES, "edges", scenes.SCENES["edges"][:1])
        return {mu: BaseMotion(estimator.model, press_scene(estimator.model, "edges", mu)) for mu in (0.0, 0.5)}


def test_simulate_and_live_meet(bundle, estimator, motions, capsys, monkeypatch):
    """The whole way: a scene of the rod, over the wire, tared and located, also where tests keep the machine busy."""
    monkeypatch.setattr("probedesign.live.processing.chain.MAX_AGE", 10.0)
    motion = motions[0.0]

    def hurried(when):  # ten times as fast: the rest is over after half a second
        return motion.wrench_sensor(10.0 * when)

    with SimulatedNetFT(SimulatedTransducer(estimator.model, hurried, seed=1, drift=0.0)) as peer:
        arguments = ["live", str(bundle), "--source", peer.source, "--tare-s", "0:0.3", "--average", "36"]
        status = run([*arguments, "--count", "75", "--rate-hz", "100", "--json"])  # 0.75 s after the tare
    out, err = capsys.readouterr()
    rows = [json.loads(line) for line in out.splitlines()]
    located = [row for row in rows if row["result"] == "ok"]
    assert status == 0 and "records" in err and "tare from" in err
    assert len(located) > 5
    s = np.median([row["s_contact_mm"] for row in located])
    assert s == pytest.approx(1e3 * motion.objects[0].s_contact, abs=3.0 * located[0]["std_s_mm"])


def test_objects_are_pressed_and_left_again_with_friction_on_another_way(estimator, motions):
    """The tangential force turns round while the base turns round; without friction both ways are one."""
    model, before = estimator.model, np.array([0.03, 0.06])  # pressed still: the edge is left after 0.13 s
    free = model.to_sensor(model.rod.solve(model.gravity_base).wrench_base, model.gravity_base)
    begun = REST_TIME + MOVE_TIME + PRESS_TIME
    for friction, motion in motions.items():
        first, length = motion.objects[0], motion.cycle_time
        rest, pressed, left, again = motion.wrench_sensor(np.array([1.0, begun + 0.5, length - 0.01, length + 1.0]))
        assert all(np.allclose(each, free, atol=1e-6) for each in (rest, left, again))
        assert np.linalg.norm((pressed - free)[:3]) == pytest.approx(first.force, rel=1e-3) and first.force > 1e-3
        on, off = (motion.wrench_sensor(begun - before), motion.wrench_sensor(begun + CYCLE_DWELL_TIME + before))
        apart = np.abs(on - off).max(axis=1)
        assert (apart > 1e-3).all() if friction else (apart < 1e-9).all()


def test_friction_differs_from_object_to_object_and_repeats_with_its_seed(estimator, monkeypatch):
    monkeypatch.setattr(scenes, "_pressed", lambda model, free, thing, solver: solver.friction)
    drawn = [press_scene(estimator.model, "points", 0.5, 0.2, seed) for seed in (1, 1, 2)]
    assert drawn[0] == drawn[1] != drawn[2] and len(set(drawn[0])) == 3


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (["--friction", "-0.1"], "--friction -0.1 must lie in 0 ... 3"),
        (["--scene", "castle"], "--scene castle is unknown; available are edges"),
        (["--seconds", "0"], "--seconds 0.0 must be positive"),
        (["--host", "203.0.113.1", "--scene", "free"], "203.0.113.1:49152: "),
    ],
)
def test_simulate_refuses(bundle, capsys, options, expected):
    assert run(["simulate", str(bundle), *options]) == 2
    out, err = capsys.readouterr()
    assert expected in err and err.count("\n") == 1 and out == ""


# the session


def accepted(records, cut=0):
    """Which of (rdt, ft) are new, and the counts; in two parts."""
    counts = Counter()
    monitor = SequenceMonitor(counts)
    new = []
    for part in (records[:cut], records[cut:]):
        table = np.array(part, dtype=np.int64).reshape(-1, 2)
        chosen = monitor.accept(table[:, 0], table[:, 1]) if part else []
        new += [True] * len(table) if chosen is None else list(chosen)
    return new, counts


@pytest.mark.parametrize("cut", range(8))
@pytest.mark.parametrize(
    ("records", "new", "counted"),
    [
        # three is lost, four comes late and then again, and six comes twice
        ([(i, 100 + i) for i in (1, 2, 5, 6, 6, 4, 4, 7)], [1, 1, 1, 1, 0, 0, 0, 1], (2, 3)),
        ([(n % 2**32, n % 2**32) for n in range(2**32 - 2, 2**32 + 2)], [1] * 4, (0, 0)),  # the numbers overflow
        ([(500, 9000), (501, 9001), (1, 9100), (2, 9101)], [1] * 4, (0, 0)),  # counted from one again
        ([(1, 7), (2, 8), (3, 8), (4, 8), (5, 9)], [1, 1, 0, 0, 1], (0, 0)),  # the box runs on without its sensor
    ],
)
def test_lost_late_and_repeated_records_are_told_apart(records, new, counted, cut):
    accepted_records, counts = accepted(records, cut)
    assert accepted_records == new
    assert (counts["lost"], counts["late"]) == counted


@pytest.mark.skipif(sys.platform != "linux", reason="the system states the arrival on Linux")
def test_the_arrival_does_not_depend_on_how_late_records_are_read():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
        peer.bind(("127.0.0.1", 0))
        session = RdtSession("netft://box", *peer.getsockname())
        records = session.records()
        with closing(records):
            assert next(records) is None  # the request is sent, and nothing has come
            _, client = peer.recvfrom(64)
            before = time.monotonic()
            for i in range(3):
                peer.sendto(RECORD.pack(1 + i, 7 + i, 0, *[0] * 6), client)
            after = time.monotonic()
            time.sleep(0.02)
            received = next(batch for batch in records if batch is not None).received
    # the wall clock, by which the system states it, is steered by less than a millisecond in this time
    assert (received >= before - 1e-3).all() and (received <= after + 1e-3).all() and after < time.monotonic() - 0.02
    assert (np.diff(received) >= 0.0).all()


def test_a_small_buffer_of_the_system_is_noted():
    assert "30 ms of records" in " ".join(buffer_note(162_000)) and not buffer_note(8 << 20)


def test_as_many_readings_as_are_expected_come_together(estimator):
    """A mean takes 36; a block is not smaller, unless gathering takes too long."""
    with box(estimator) as peer:
        source = open_source(peer.source, estimator.model)
        source.expect(36)
        with closing(iter(source)) as stream:
            blocks = [next(stream) for _ in range(15)]
    sizes = [len(block) for block in blocks if len(block)]
    assert np.median(sizes) >= 36
