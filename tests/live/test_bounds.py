"""Nothing from outside holds a run up: slow pages, devices, silent sources, forged names, an early Ctrl-C."""

import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
import tracemalloc
from itertools import count
from pathlib import Path

import numpy as np
import pytest

from probedesign.cli.main import run
from probedesign.core.errors import InputError
from probedesign.core.files import parse_bounded_toml
from probedesign.frozen_probe import _checksum, load_model
from probedesign.live.blocks import dropout_block, limit_duration
from probedesign.live.poses.pose_sources import read_pose_file
from probedesign.live.recordings import AppendFile
from probedesign.live.recordings.csv import read_recording
from probedesign.live.sources.netft_configuration import MAX_PAGE_BYTES, fetch_page
from probedesign.live.sources.source import open_source

# the page of a box


HEAD = b"HTTP/1.0 200 OK\r\n\r\n"
ENDLESS = {
    "a header byte by byte": (b"HTTP/1.0 200 OK\r\n", b"x"),
    "a body byte by byte": (HEAD, b"x"),
    "many short headers": (b"HTTP/1.0 200 OK\r\n", b"a: b\r\n"),
    "chunks": (b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n", b"1\r\nx\r\n"),
    "nothing": (b"", b""),
}


class Server:
    """Accepts one connection and sends a beginning, then a piece every 20 ms until the client gives up."""

    def __init__(self, start, piece, pause=0.02):
        self._socket = socket.create_server(("127.0.0.1", 0))
        self.port = self._socket.getsockname()[1]
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._serve, args=(start, piece, pause), daemon=True)
        self._thread.start()

    def _serve(self, start, piece, pause):
        connection, _ = self._socket.accept()
        with connection:
            try:
                connection.sendall(start)
                while not self._ended.wait(pause):
                    connection.sendall(piece)
            except OSError:
                pass

    def close(self):
        self._ended.set()
        self._thread.join()
        self._socket.close()


@pytest.mark.parametrize("start, piece", ENDLESS.values(), ids=ENDLESS.keys())
def test_an_endless_page_ends_with_one_line(start, piece):
    """Within 0.3 s by the timeout that is given here; thirty times that is a hang."""
    server, began = Server(start, piece), time.monotonic()
    with pytest.raises(InputError) as error:
        fetch_page("127.0.0.1", server.port, timeout=0.3)
    assert time.monotonic() - began < 9.0
    assert str(error.value).isprintable()
    server.close()


def test_a_page_is_bounded_in_size():
    server = Server(HEAD, b"x" * 65536, pause=0.0)
    with pytest.raises(InputError, match="too long"):
        fetch_page("127.0.0.1", server.port, timeout=20.0)
    server.close()
    assert MAX_PAGE_BYTES <= 65536


def test_a_status_line_cannot_control_the_terminal():
    server = Server(b"HTTP/1.0 \x1b[2J evil\r\n\r\n", b"")
    with pytest.raises(InputError) as error:
        fetch_page("127.0.0.1", server.port, timeout=1.0)
    assert str(error.value).isprintable()
    server.close()


# files


@pytest.fixture
def special(tmp_path):
    """A pipe, a socket and a device: reading one of them does not end."""
    os.mkfifo(tmp_path / "pipe.csv")
    listening = socket.socket(socket.AF_UNIX)
    listening.bind(str(tmp_path / "socket.csv"))
    (tmp_path / "link.mcap").symlink_to("/dev/zero")
    folder = tmp_path / "bag"
    folder.mkdir()
    (folder / "metadata.yaml").write_text("rosbag2_bagfile_information: {}")
    os.mkfifo(folder / "bag_0.db3")
    yield [tmp_path / "pipe.csv", tmp_path / "socket.csv", tmp_path / "link.mcap", folder, Path("/dev/zero")]
    listening.close()


def test_devices_pipes_and_sockets_are_no_recordings_no_poses_and_no_probes(special, estimator):
    attempts = [(lambda path: open_source(f"replay:{path}", estimator.model), special)]
    attempts += [(attempt, special[:3]) for attempt in (read_pose_file, load_model)]
    for attempt, path in ((attempt, path) for attempt, paths in attempts for path in paths):
        with pytest.raises(InputError, match="is a device, pipe or socket"):
            attempt(path)


@pytest.mark.parametrize("attempt", [read_recording, read_pose_file])
def test_an_endless_line_is_one_line(tmp_path, attempt):
    """300 MB without an end: 20 MB are more than the megabytes that are read, and less than the line."""
    path = tmp_path / "long.csv"
    with path.open("wb") as file:
        file.write(b"time_s\n1")
        file.truncate(300_000_000)
    tracemalloc.start()
    with pytest.raises(InputError, match="has a line of more than 1 MB") as error:
        attempt(path)
    assert str(error.value).isprintable() and tracemalloc.get_traced_memory()[1] < 20e6
    tracemalloc.stop()


@pytest.mark.parametrize("text", ["a" + 50_000 * ".a" + " = 1", "x = {" + 50_000 * '"" . ' + "a = 1}", "#" * 1_100_000])
def test_settings_and_designs_are_bounded(tmp_path, monkeypatch, capsys, text):
    """tomllib takes ten gigabytes for 50,000 dots; numbers, texts and paths have as many dots as they like."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.toml").write_text(text)
    tracemalloc.start()
    assert run(["check", "a.toml"]) == 2
    (tmp_path / "probedesign.toml").write_text(text)
    assert run(["doctor"]) == 2
    assert tracemalloc.get_traced_memory()[1] < 100e6
    tracemalloc.stop()
    assert capsys.readouterr().err.count("\n") == 2
    many = "x = [" + "1.5, " * 1000 + "]\ny = '" + "a/../" * 100 + "'\na.b.c = 1"
    assert parse_bounded_toml(many)["a"] == {"b": {"c": 1}}


def test_a_recording_is_never_written_through_a_link(tmp_path):
    victim = tmp_path / "victim.csv"
    victim.write_text("kept")
    for target in (victim, tmp_path / "none.csv"):
        link = tmp_path / "link.csv"
        link.unlink(missing_ok=True)
        link.symlink_to(target)
        for force in (False, True):
            with pytest.raises(InputError, match="is a link to another file; name that file"):
                AppendFile(link, force)
    assert victim.read_text() == "kept" and not (tmp_path / "none.csv").exists()


def test_a_missing_recording_is_reported_before_anything_is_compiled(bundle, capsys, monkeypatch):
    def compiled(*arguments, **options):
        raise AssertionError("a kernel is compiled")

    monkeypatch.setattr("probedesign.live.run.warm_up", compiled)
    for command in (
        ["estimate", str(bundle), "none.csv"],
        ["explore", str(bundle), "none.mcap", "--pose", "none.csv", "--tare-s", "0:1"],
        ["live", str(bundle), "--source", "replay:none.mcap"],
    ):
        assert run(command) == 2
        err = capsys.readouterr().err
        assert "no such recording" in err and err.count("\n") == 1


def test_an_address_with_a_space_is_one_line(bundle, capsys):
    for source in ("netft://a b", "netft://a\x7fb"):
        assert run(["live", str(bundle), "--source", source]) == 2
        err = capsys.readouterr().err
        assert "write netft://HOST" in err and err.count("\n") == 1


# forged names


def forged(bundle, tmp_path, **changes):
    """A frozen probe with other texts, and the checksum that belongs to them."""
    data = json.loads(bundle.read_text())
    for key, value in changes.items():
        *tables, last = key.split("__")
        table = data
        for name in tables:
            table = table[name]
        table[last] = value
    del data["checksum"]
    path = tmp_path / "forged.probe.json"
    path.write_text(json.dumps({**data, "checksum": _checksum(data)}))
    return path


@pytest.mark.parametrize(
    "name", ["../../etc/x", "/tmp/x", "a/b", "..", "", "a\x1b[31m", "a\nb", "x" * 65, "a.toml", 5, None]
)
def test_a_forged_name_cannot_leave_its_folder(bundle, tmp_path, name):
    with pytest.raises(InputError) as error:
        load_model(forged(bundle, tmp_path, name=name))
    assert "not a plain name" in str(error.value) and str(error.value).isprintable()


FORGED = [
    *((key, text, None) for key in ("contact__source", "sensor__model", "material__density_kg_m3__source")
      for text in ("\x1b]0;owned\x07", "x" * 501, 5, ["a"])),
    *(("assumptions", texts, "assumptions") for texts in ("none", [1], ["\x1b[2J"])),
]  # fmt: skip


@pytest.mark.parametrize(("key", "text", "named"), FORGED)
def test_forged_texts_are_refused(bundle, tmp_path, key, text, named):
    with pytest.raises(InputError, match=named) as error:
        load_model(forged(bundle, tmp_path, **{key: text}))
    assert str(error.value).isprintable()


def test_a_message_with_a_piece_of_a_file_does_not_control_the_terminal(bundle, tmp_path, capsys):
    for changes in ({"schema": "\x1b[2J"}, {"tolerances__\x1b[2J": 1.0}, {"name": "\x1b[2J"}):
        assert run(["estimate", str(forged(bundle, tmp_path, **changes)), str(bundle)]) == 2
        err = capsys.readouterr().err
        assert err.count("\n") == 1 and err.strip().isprintable()


# time


def test_seconds_end_by_the_wall_clock_when_the_source_is_silent():
    """Silent blocks, one a tenth of a second by this clock; the first opens it, the twentieth is too late."""
    now = count()
    silent = (dropout_block(np.zeros(3), "stale", 0) for _ in count())
    assert len(list(limit_duration(silent, 2.0, clock=lambda: 0.1 * next(now)))) == 19


def test_a_silent_source_ends_in_time(bundle, capsys):
    began = time.monotonic()
    assert run(["live", str(bundle), "--source", "udp://127.0.0.1:0", "--seconds", "0.5"]) == 0
    assert time.monotonic() - began < 60.0  # a hang; kernels may be compiled first
    assert "0 estimates" in capsys.readouterr().err


# Ctrl-C


@pytest.mark.parametrize("module", ["cyclopts", "numba"])
def test_ctrl_c_at_the_start_is_one_line(bundle, tmp_path, module):
    """The signal arrives while the module is imported: here it raises it, at exactly that place."""
    hook = f"""
import os, signal, sys
class Interrupt:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            signal.signal(signal.SIGINT, signal.default_int_handler)
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Interrupt())
from probedesign.cli.main import main
sys.argv = ["probedesign", "live", {str(bundle)!r}, "--source", "sim:"]
main()
"""
    done = subprocess.run([sys.executable, "-c", hook], capture_output=True, text=True, timeout=120)
    assert done.returncode in (130, -signal.SIGINT)
    assert done.stderr == "probedesign: error: interrupted\n" and done.stdout == ""


def test_the_example_receiver_ends_with_one_line():
    script = Path(__file__).parents[2] / "docs" / "examples" / "receive_udp.py"
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    receiver = subprocess.Popen(
        [sys.executable, str(script), str(port)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )  # fmt: skip
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for content in (b"junk", b"[1]", b'{"number": "x"}'):
            sender.sendto(content, ("127.0.0.1", port))
        assert "stale" in receiver.stdout.readline()
    receiver.send_signal(signal.SIGINT)
    _, err = receiver.communicate(timeout=30)
    assert err == "interrupted\n"
