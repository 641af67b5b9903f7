"""Commands by key, datagram or page: one table, one execution, the same refusals."""

import json
import os
import pty
import socket
import termios
import time
from typing import get_args

import msgpack
import pytest

from probedesign.core.errors import InputError
from probedesign.live.outputs.recording import RecordingSink
from probedesign.live.processing.chain import ProcessingOptions
from probedesign.live.processing.commands import (
    COMMANDS,
    MAX_NOTE,
    CommandName,
    CommandQueue,
    CommandResult,
    DatagramInput,
    KeyInput,
)
from probedesign.live.run import estimate_stream
from probedesign.live.sources.sim import SimulatedSource
from tests.live.peers import until


def test_the_table_has_every_command_and_every_key_once():
    assert set(COMMANDS) == set(get_args(CommandName))
    keys = list(COMMANDS.values())
    assert len(set(keys)) == len(keys) and all(len(key) == 1 for key in keys)


@pytest.fixture
def run(estimator, tmp_path):
    """Queue, messages, and an iterator of estimates of a run at the first of them, which records on request."""
    commands, lines = CommandQueue(), []
    recordings = RecordingSink(tmp_path / "touch.csv", [estimator.model], lines.append)
    commands.register("start recording", lambda command: recordings.start())
    commands.register("stop recording", lambda command: recordings.stop())
    source = SimulatedSource(estimator.model, "speed=max&seconds=20&rate_hz=50")
    updates = estimate_stream(estimator, source, ProcessingOptions(rate=1.0), lines.append, recordings, commands)
    next(updates)
    yield commands, lines, updates
    updates.close()
    recordings.close()


def results_of(run, *names):
    commands, _, updates = run
    results: list[CommandResult] = []
    for name in names:
        commands.put(name, "here", results.append)
    next(updates, None)
    return results


def test_what_is_accepted_and_what_is_refused(run, tmp_path):
    """Each refusal has its reason, and is logged; nothing ends the run but `stop`."""
    first = results_of(run, "stop recording", "tare", "tare", "mark", "start recording", "start recording")
    assert [result.accepted for result in first] == [False, True, False, True, True, False]
    assert first[3].text == "mark: here"
    assert first[4].text == f"recording to {tmp_path / 'touch.csv'}"
    assert all(result.text in run[1] for result in first if not result.accepted)
    second = results_of(run, "stop recording", "stop recording", "stop", "mark")
    assert [result.accepted for result in second] == [True, False, True]  # nothing is executed after the end
    assert second[0].text.startswith("recorded ") and second[0].text.endswith(str(tmp_path / "touch.csv"))
    assert list(run[2]) == [] and (tmp_path / "touch.csv").exists()


def test_a_mark_cannot_control_a_terminal(run):
    commands, lines, updates = run
    commands.put("mark", "\x1b[2Jcup\n" + "x" * 1000)
    next(updates)
    assert lines[-1].startswith("mark: \\x1b[2Jcup x") and lines[-1].isprintable() and len(lines[-1]) <= 6 + MAX_NOTE


# datagrams


@pytest.fixture
def remote():
    """A queue whose commands come by datagram, messages, and a socket connected to it."""
    commands, lines = CommandQueue(), []
    inputs = DatagramInput("udp://:0", commands, lines.append)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.connect(inputs.address)
        sender.settimeout(10.0)
        yield commands, lines, sender, inputs
    inputs.close()


def test_a_command_by_datagram_is_executed_and_answered(remote):
    commands, lines, sender, inputs = remote
    done = []
    commands.register("mark", lambda command: done.append(command.text) or "marked")
    for encode in (lambda values: json.dumps(values).encode(), msgpack.packb):
        sender.send(encode({"command": "mark", "text": "cup", "id": 7}))
        until(lambda: inputs.counts["taken"] > len(done))
        assert not commands.execute(lines.append)
        assert json.loads(sender.recv(4096)) == {
            "schema": 1, "kind": "reply", "command": "mark", "id": 7, "accepted": True, "text": "marked",
        }  # fmt: skip
    assert done == ["cup", "cup"] and "marked" in lines


def test_refusals_and_unknown_commands_are_answered(remote):
    commands, lines, sender, inputs = remote

    def refuse(command):
        raise InputError("the probe is touching")

    commands.register("tare", refuse)
    sender.send(json.dumps({"command": "tare"}).encode())
    until(lambda: inputs.counts["taken"] == 1)
    commands.execute(lines.append)
    answer = json.loads(sender.recv(4096))
    assert answer["accepted"] is False and answer["text"] == "tare refused: the probe is touching"
    for name in ("format", 5, None, ["tare"]):
        sender.send(json.dumps({"command": name}).encode())
        assert json.loads(sender.recv(4096))["accepted"] is False


def test_hostile_commands_are_counted_and_not_answered(remote):
    _, lines, sender, inputs = remote
    hostile = [
        b"", b"tare", b"[1]", b"\xff" * 100, b" " * 5000, json.dumps({"command": "mark", "text": 5}).encode(),
        json.dumps({"command": "mark", "id": "x" * 100}).encode(), json.dumps({"command": "mark", "id": [1]}).encode(),
    ]  # fmt: skip
    for content in hostile:
        sender.send(content)
        time.sleep(0.002)
    until(lambda: inputs.counts["invalid"] == len(hostile))
    sender.settimeout(0.05)
    with pytest.raises(TimeoutError):
        sender.recv(4096)
    assert sum("rejected and counted" in line for line in lines) == 1


@pytest.mark.parametrize("address", ["udp:5", "9000", "udp://:99999", "udp://192.0.2.1:9000"])
def test_what_is_no_address(address):
    with pytest.raises(InputError) as error:
        DatagramInput(address, CommandQueue(), print)
    assert "--control" in str(error.value)


# keys


def test_keys_of_the_terminal(monkeypatch):
    """On a pseudo-terminal: keys are read without Enter, others ignored, and the terminal is as before at the end."""
    monkeypatch.setattr(os, "tcgetpgrp", lambda fd: os.getpgrp())  # it is not the terminal of this process
    primary, terminal = pty.openpty()
    before, commands, lines, done = termios.tcgetattr(terminal), CommandQueue(), [], []
    for name in COMMANDS:
        commands.register(name, lambda command: done.append(command.name))
    keys = KeyInput(commands, lines.append, terminal)
    assert not termios.tcgetattr(terminal)[3] & termios.ICANON
    os.write(primary, b"tz\x1b\xff m")
    until(lambda: commands.execute(lines.append) or len(done) == 2)
    os.write(primary, b"q")
    until(lambda: commands.execute(lines.append))
    keys.close()
    assert done == ["tare", "mark"]
    assert termios.tcgetattr(terminal) == before
    assert all(f"{key} {name}" in lines[0] for name, key in COMMANDS.items())
    os.close(primary)
    os.close(terminal)


def test_without_a_terminal_no_keys_are_read():
    reading, writing = os.pipe()
    lines = []
    KeyInput(CommandQueue(), lines.append, reading).close()
    assert lines == []
    os.close(reading)
    os.close(writing)
