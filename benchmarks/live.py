"""Live over loopback: a simulated box in another process sends 7000 records a second to `netft://`.

Box, reader and subscriber share one machine, as nobody runs them, so the processor time of each is printed. A real box
has a processor of its own: where the system allows it, the simulated one has a real-time priority above that of `live`.
Then wrenches by UDP, one JSON object in each datagram, beside a loop that reads the same socket and does nothing else.
"""

import gc
import math
import os
import resource
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.timing import print_table
from benchmarks.view import free_port
from probedesign.design import load_design
from probedesign.estimation.estimator import Estimator
from probedesign.frozen_probe import load_estimator, write_frozen
from probedesign.live.outputs.guard import Guard, GuardChannel, GuardedSource, Limits
from probedesign.live.outputs.message_streams import FoxgloveSink
from probedesign.live.outputs.recording import RecordingSink
from probedesign.live.outputs.sinks import SinkGroup, UdpPublisher
from probedesign.live.priority import ESTIMATES
from probedesign.live.processing.chain import ProcessingOptions
from probedesign.live.processing.commands import CommandQueue
from probedesign.live.processing.tare import TareWindow
from probedesign.live.run import estimate_stream, warm_up
from probedesign.live.sources.netft import NetFTSource
from probedesign.live.sources.source import open_source
from probedesign.live.sources.udp import UdpSource
from probedesign.live.view.sinks import BrowserView
from probedesign.live.view.state import ViewState
from probedesign.probe import build_probe

MINUTES = 1.0 / 3.0
AVERAGE = 36
TARE = TareWindow(0.0, 3.0)
DESIGN = Path(__file__).parents[1] / "designs" / "large.toml"
PARTS = 10  #: Of the run, for what grows.
RARELY = 100  #: Estimates from one look at the memory to the next, since that takes as long as some.


def report(minutes: float = MINUTES, view: bool = False, foxglove: bool = False) -> None:
    """Print losses, latency and their growth.

    Args:
        minutes: how long the records stream [min].
        view: with the page of `live --view` open.
        foxglove: with the server of `live --foxglove`, and another process that subscribed to every topic.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        bundle = folder / "large.probe.json"
        write_frozen(build_probe(load_design(DESIGN)).model, bundle)
        estimator = load_estimator(bundle)  # as the command has it
        warm_up(estimator, print, fusing=True)
        with _box(bundle) as box:
            _rate(estimator, box, 60.0 * minutes, folder, view, foxglove)
        with _box(bundle) as box:  # another one, which is free at first
            _guard(estimator, box.spec, min(60.0 * minutes, 60.0))
        _datagrams(estimator)


class Peer(NamedTuple):
    """A box in another process: what `--source` takes to read it, and the number of the process."""

    spec: str
    pid: int


def _rate(estimator: Estimator, box: Peer, seconds: float, folder: Path, view: bool, foxglove: bool) -> None:
    source = open_source(box.spec, estimator.model, print)
    assert isinstance(source, NetFTSource)
    late, published, memory = [], [], []
    plan = ProcessingOptions(TARE, AVERAGE, seconds=seconds)
    recordings = RecordingSink(folder / "record.mcap", [estimator.model], print)
    recordings.start()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as controller, ExitStack() as others:
        controller.bind(("127.0.0.1", 0))  # it never reads: what it has no room for is dropped
        publisher = UdpPublisher(f"udp://127.0.0.1:{controller.getsockname()[1]}", print)
        sinks = others.enter_context(closing(SinkGroup(publisher, recordings)))
        peers = {"the simulated box": box.pid}
        if view:
            states = {"": ViewState(lambda: source.counts)}
            sinks.add(BrowserView(states, [(estimator, folder)], CommandQueue(), print))
        if foxglove:
            server = FoxgloveSink([estimator.model], ("127.0.0.1", free_port()), print)
            sinks.add(server)
            peers["the subscriber"] = others.enter_context(_subscriber(server.url))
        wall, cpu, collected = time.monotonic(), time.process_time(), gc.get_stats()[2]["collections"]
        before, stolen = {name: _processor_time(pid) for name, pid in peers.items()}, _stolen()
        for answer in estimate_stream(estimator, source, plan, print, sinks):
            published.append(1e3 * (time.monotonic() - answer.reading.received))
            late.append(1e3 * (answer.computed - answer.reading.received))
            if len(late) % RARELY == 1:
                memory.append(_resident())
        wall, cpu = time.monotonic() - wall, time.process_time() - cpu
        used = {name: _processor_time(pid) - before[name] for name, pid in peers.items()}
        stolen = _stolen() - stolen
    counts, parts = source.counts, [float(np.median(part)) for part in np.array_split(late, PARTS)]
    tenth = len(memory) // PARTS
    n_readings = counts["received"]
    used_readings = min(n_readings, int(7000.0 * seconds))
    due = used_readings // AVERAGE - math.ceil(7000.0 * TARE.end / AVERAGE)
    lost = f"{counts['lost']} ({counts['lost'] / max(n_readings, 1):.3%})"
    rows = [
        ["records", str(n_readings), ""],
        ["estimates a second", f"{len(late) / wall:.0f}", ""],
        ["made within 20 ms, of all that were due", f"{np.sum(np.array(late) <= 20.0) / due:.2%}", "99.9 %"],
        # the latencies below are of those that were made: none that waited for `control.MAX_AGE` is among them
        ["skipped since a newer reading had arrived", f"{max(due - len(late), 0)} of {due}", "none"],
        ["lost since the socket's buffer was full", str(counts["dropped"]), "none"],
        ["lost before it", lost, "none"],
        ["datagram to estimate, of those made, median [ms]", f"{np.median(late):.2f}", "≤ 0.8"],
        ["datagram to estimate, of those made, 99.9 % [ms]", f"{np.percentile(late, 99.9):.1f}", "≤ 10"],
        ["the same until it is published, median [ms]", f"{np.median(published):.2f}", ""],
        ["the same until it is published, 99.9 % [ms]", f"{np.percentile(published, 99.9):.1f}", ""],
        ["the latest [ms]", f"{max(late):.1f}", ""],
        ["median of the first, the last tenth [ms]", f"{parts[0]:.2f}, {parts[-1]:.2f}", "does not grow"],
        ["memory after a tenth, at the end [MB]", f"{memory[tenth]:.1f}, {memory[-1]:.1f}", "flat"],
        ["wall, processor [s]", f"{wall:.1f}, {cpu:.1f} ({cpu / wall:.0%} of one core)", ""],
        ["processor per mean of records [ms]", f"{1e3 * cpu / (n_readings / AVERAGE):.2f}", ""],
        *([f"processor of {name}", f"{time_ / wall:.0%} of one core", ""] for name, time_ in used.items()),
        ["processor time taken by the host of this machine", f"{stolen / wall:.1%} of one core", "none"],
        ["full collections of garbage", str(gc.get_stats()[2]["collections"] - collected), ""],
    ]
    title = f"live over loopback: {seconds:g} s of 7000 records/s, {AVERAGE} to an estimate, recorded, published by UDP"
    shown = ", seen" * view + ", subscribed in Foxglove's protocol" * foxglove
    print_table(title + shown, ["", "measured", "target"], rows)


GUARD_CLIENT = """
import json, socket, sys, time
link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
link.bind(("127.0.0.1", 0))
link.settimeout(3.0)
print(link.getsockname()[1], flush=True)
late, numbers = [], []
while True:
    try:
        event = json.loads(link.recv(4096))
    except TimeoutError:
        if numbers:
            break
        continue
    numbers.append(event["number"])
    if event["armed"]:
        late.append(1e3 * (time.monotonic() - event["received_monotonic_s"]))
late.sort()
print(len(late), late[len(late) // 2], late[int(0.999 * (len(late) - 1))], late[-1], numbers[-1] - len(numbers))
"""


def _guard(estimator: Estimator, spec: str, seconds: float) -> None:
    """Print the latency of the events of a guard, from the arrival of a sample to another process."""
    with subprocess.Popen([sys.executable, "-c", GUARD_CLIENT], stdout=subprocess.PIPE, text=True) as client:
        assert client.stdout is not None
        channel = GuardChannel(f"udp://127.0.0.1:{int(client.stdout.readline())}", print)
        guard = Guard(estimator, Limits(1.0, 0.1), channel.send, print)
        source = GuardedSource(open_source(spec, estimator.model, print), guard)
        plan = ProcessingOptions(TARE, AVERAGE, seconds=seconds)
        late = [1e3 * (a.computed - a.reading.received) for a in estimate_stream(estimator, source, plan, print, guard)]
        events, median, most, latest, lost = map(float, client.stdout.read().split())
    rows = [
        ["events, lost", f"{events:.0f}, {lost:.0f}", "none lost"],
        ["sample to event in another process, median [ms]", f"{median:.2f}", ""],
        ["the same, 99.9 % [ms]", f"{most:.2f}", "≤ 5"],
        ["the latest [ms]", f"{latest:.2f}", ""],
        ["datagram to estimate meanwhile, median, 99.9 % [ms]",
         f"{np.median(late):.2f}, {np.percentile(late, 99.9):.1f}", ""],
    ]  # fmt: skip
    print_table(f"guarded motion over loopback: {seconds:g} s", ["", "measured", "target"], rows)


DATAGRAM_RATES = (1000, 2000, 4000, 7000, 10_000)  #: Rates at which wrenches are sent by UDP [1/s].
DATAGRAM_SECONDS = 4.0
SENDER = """
import json, socket, sys, time
port, rate, seconds = int(sys.argv[1]), float(sys.argv[2]), float(sys.argv[3])
link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
link.connect(("127.0.0.1", port))
time.sleep(1.0)  # a source discards what arrives before it is read
names, start, sent = ("fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm"), time.monotonic(), 0
while (now := time.monotonic() - start) < seconds:
    while sent < rate * now:
        values = {name: 1e-3 * ((7 * sent + 13 * i) % 101) for i, name in enumerate(names)}
        try:
            link.send(json.dumps(values | {"sequence": sent, "time_s": sent / rate}).encode())
        except ConnectionRefusedError:
            pass
        sent += 1
    time.sleep(0.001)
print(sent)
"""


def _datagrams(estimator: Estimator) -> None:
    """Count the wrenches a second that `udp://` reads, beside a plain loop on a socket."""
    rows = []
    for rate in DATAGRAM_RATES:
        plain = _plain_loop(rate)
        sent, received, busy = _udp_source(estimator, rate)
        rows.append(
            [f"{rate}", f"{plain:.0f}", f"{sent / DATAGRAM_SECONDS:.0f}", f"{received / DATAGRAM_SECONDS:.0f}",
             f"{max(sent - received, 0) / max(sent, 1):.2%}", f"{busy / DATAGRAM_SECONDS:.0%}"]
        )  # fmt: skip
    print_table(
        "wrenches by UDP in JSON, a second",
        ["asked for", "plain socket loop reads", "sent to udp://", "udp:// reads", "not read", "of one core"],
        rows,
    )


def _sender(port: int, rate: float) -> subprocess.Popen[str]:
    arguments = [sys.executable, "-c", SENDER, str(port), str(rate), str(DATAGRAM_SECONDS)]
    return subprocess.Popen(arguments, stdout=subprocess.PIPE, text=True)


def _plain_loop(rate: float) -> float:
    """Return the datagrams a second that a loop reads, which does nothing with them."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        link.bind(("127.0.0.1", 0))
        link.settimeout(1.0)
        sender, count, ended = _sender(link.getsockname()[1], rate), 0, False
        while not ended:
            ended = sender.poll() is not None  # what was sent before is read in the next pass
            try:
                while True:
                    link.recv(4096)
                    count += 1
            except TimeoutError:
                pass
    return count / DATAGRAM_SECONDS


def _udp_source(estimator: Estimator, rate: float) -> tuple[int, int, float]:
    """Return the numbers of datagrams sent and read, and the processor time of reading them [s]."""
    source = open_source("udp://127.0.0.1:0", estimator.model, lambda line: None)
    assert isinstance(source, UdpSource)
    received, sender, cpu = 0, None, time.process_time()
    with closing(iter(source)) as blocks:
        sender = _sender(source.address[1], rate)
        for block in blocks:
            received += len(block)
            if len(block) == 0 and sender.poll() is not None:
                break
    cpu = time.process_time() - cpu
    assert sender.stdout is not None
    return int(sender.stdout.read()), received, cpu


SUBSCRIBER = """
import json, sys
from websockets.sync.client import connect
with connect(sys.argv[1], subprotocols=["foxglove.sdk.v1"], max_size=None) as ws:
    for message in ws:
        if isinstance(message, str) and json.loads(message)["op"] == "advertise":
            wanted = [{"id": c["id"], "channelId": c["id"]} for c in json.loads(message)["channels"]]
            ws.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
            print("subscribed", flush=True)
"""


@contextmanager
def _subscriber(url: str) -> Iterator[int]:
    """A process that receives every message of a Foxglove server; its number."""
    client = subprocess.Popen(
        [sys.executable, "-c", SUBSCRIBER, url], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    try:
        assert client.stdout is not None
        client.stdout.readline()
        yield client.pid
    finally:
        client.terminate()
        client.wait()


def _processor_time(pid: int) -> float:
    """Processor time of another process so far [s]; NaN where the system does not state it as Linux does."""
    try:
        # user and system time are the 14th and 15th field; the second, in brackets, may contain spaces
        ticks = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[11:13]
    except OSError:
        return float("nan")
    return sum(map(int, ticks)) / os.sysconf("SC_CLK_TCK")


def _stolen() -> float:
    """Processor time that the host of a virtual machine has not given to it [s]; NaN where that is not stated."""
    try:
        # the eighth number of the first line, that of all processors
        ticks = Path("/proc/stat").read_text().split(maxsplit=9)[8]
    except OSError:
        return float("nan")
    return int(ticks) / os.sysconf("SC_CLK_TCK")


def _resident() -> float:
    """Memory of this process now [MB]."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except OSError:  # no Linux: the most it ever had
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    return pages * resource.getpagesize() / 2**20


@contextmanager
def _box(bundle: Path) -> Iterator[Peer]:
    """A box in a process of its own, as `probedesign simulate` makes it."""
    command = [sys.executable, "-m", "probedesign.cli.main", "simulate", str(bundle)]
    box = subprocess.Popen([*command, "--port", "0", "--http-port", "0"], stdout=subprocess.PIPE, text=True)
    try:
        assert box.stdout is not None
        spec = next(line.split('"')[1] for line in box.stdout if "netft://" in line)
        with suppress(OSError):  # not allowed, or no Linux
            for thread in os.listdir(f"/proc/{box.pid}/task"):
                os.sched_setscheduler(int(thread), os.SCHED_FIFO, os.sched_param(ESTIMATES + 1))
        yield Peer(spec, box.pid)
    finally:
        box.terminate()
        box.wait()
