"""The page: its process, its errors, its buttons, and its appearance in a real browser."""

import base64
import io
import json
import shutil
import signal
import socket
import subprocess
import sys
import time
from itertools import islice
from urllib.request import urlopen

import numpy as np
import pytest

from probedesign.cli.main import run
from probedesign.core.errors import InputError, MissingDependencyError
from probedesign.live.processing.control import COMMANDS, CommandQueue, ProcessingOptions
from probedesign.live.run import estimate_stream
from probedesign.live.sources.sim import SimulatedSource
from probedesign.live.view.sinks import BrowserView

pytest.importorskip("viser")

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
SOFTWARE = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"]
"""A browser without a GPU, and as root in a container."""
PATIENCE = 120_000
"""A page drawn by a busy processor is slow, and no test is about that [ms]."""


def free_port() -> int:
    with socket.socket() as trial:
        trial.bind(("127.0.0.1", 0))
        return trial.getsockname()[1]


def assert_eventually(happened, seconds=60.0):
    deadline = time.monotonic() + seconds
    while not happened():
        assert time.monotonic() < deadline
        time.sleep(0.02)


@pytest.fixture(scope="module")
def view(estimator, tmp_path_factory):
    """A page that shows a simulated touch, its messages, and its commands."""
    log_lines, requests = [], CommandQueue()
    view = BrowserView(
        estimator, tmp_path_factory.mktemp("view"), requests, log_lines.append, port=free_port()
    )
    view.log_lines, view.requests = log_lines, requests
    stream = SimulatedSource(estimator.model, "speed=max&rate_hz=10&seconds=8")
    list(estimate_stream(estimator, stream, ProcessingOptions(), log_lines.append, view))
    yield view
    view.close()


def test_the_page_is_served_to_this_machine(view):
    assert view.url.startswith("http://127.0.0.1:")
    assert "there is no manifest.json" in view.log_lines[0]
    assert view.log_lines[1] == f"view: {view.url}, open to this machine only"
    with urlopen(view.url) as page:
        assert b"<title>" in page.read()


def test_only_the_page_itself_may_talk_to_its_server(view):
    """A page of the internet, open in a browser on this machine, could else press the buttons."""
    import viser
    from websockets.exceptions import InvalidStatus
    from websockets.sync.client import connect
    from websockets.typing import Origin, Subprotocol

    ours, protocol = view.url.replace("http", "ws"), Subprotocol(f"viser-v{viser.__version__}")
    with connect(ours, origin=Origin(view.url), subprotocols=[protocol]) as own:
        assert len(own.recv(timeout=30)) > 0
    with pytest.raises(InvalidStatus, match="403"):
        connect(ours, origin=Origin("http://example.org"), subprotocols=[protocol])


def test_the_next_free_port_is_used_and_network_access_is_reported(estimator, tmp_path, view):
    port = int(view.url.rpartition(":")[2])
    log_lines = []
    second = BrowserView(estimator, tmp_path, CommandQueue(), log_lines.append, host="0.0.0.0", port=port)
    second.close()
    assert second.url != view.url
    assert (
        log_lines[-1] == f"view: {second.url}, open to the network: anyone there can tare and stop recordings"
    )
    with pytest.raises(OSError):
        urlopen(second.url)


@pytest.mark.parametrize(
    ("host", "port", "expected"),
    [
        ("no-such-host.invalid", 8080, "--view-host no-such-host.invalid"),
        ("192.0.2.1", 8080, "--view-host 192.0.2.1"),  # kept for documentation: nobody's
        ("127.0.0.1", 0, "--view-port 0 must be in 1 ... 65535"),
    ],
)
def test_what_is_no_address_of_this_machine(estimator, tmp_path, host, port, expected):
    with pytest.raises(InputError) as error:
        BrowserView(estimator, tmp_path, CommandQueue(), print, host=host, port=port)
    assert expected in str(error.value) and str(error.value).isprintable()


def test_without_viser_the_remedy_is_reported(estimator, tmp_path, monkeypatch):
    monkeypatch.setattr("probedesign.core.errors.find_spec", lambda name: None)
    with pytest.raises(MissingDependencyError, match=r"probedesign\[view\]"):
        BrowserView(estimator, tmp_path, CommandQueue(), print)


def test_commands_reach_the_run_and_nothing_else_does(view):
    lines = [
        {"command": "tare"},
        {"command": "mark", "text": "x" * 999},
        {"command": "rm"},
        {"command": ["stop"]},
        3,
        {"command": "stop recording"},
    ]
    view._read(io.BytesIO(b"garbage\n" + b"".join(json.dumps(line).encode() + b"\n" for line in lines)))
    asked = []
    for name in COMMANDS:
        view.requests.register(name, asked.append)
    view.requests.execute(print)
    assert [request.name for request in asked] == ["tare", "mark", "stop recording"]
    assert len(asked[1].text) == 200


def live_process(bundle, port: int) -> "subprocess.Popen[str]":
    command = [
        sys.executable,
        "-m",
        "probedesign.cli.main",
        "live",
        str(bundle),
        "--source",
        "sim:?seconds=1000000",
    ]

    def handle_sigint() -> None:
        signal.signal(signal.SIGINT, signal.SIG_DFL)

    return subprocess.Popen(
        [*command, "--view", "--view-port", str(port)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=handle_sigint,
    )  # fmt: skip


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_the_page_ends_with_the_run_however_that_ends(bundle, how):
    with live_process(bundle, port := free_port()) as process:
        list(islice(process.stdout, 3))
        with urlopen(f"http://127.0.0.1:{port}") as page:
            assert page.status == 200
        process.send_signal(how)
        _, err = process.communicate(timeout=60)
    assert "Traceback" not in err

    def gone():
        with socket.socket() as trial:
            return trial.connect_ex(("127.0.0.1", port)) != 0

    assert_eventually(gone)


def test_lines_of_json_stay_clean_beside_a_page(bundle, capfd):
    options = ["--source", "sim:?speed=max&rate_hz=3", "--json", "--view", "--view-port", str(free_port())]
    assert run(["live", str(bundle), *options]) == 0
    out, err = capfd.readouterr()
    assert len([json.loads(line) for line in out.splitlines()]) == 60
    assert "viser" not in err and "view: http://127.0.0.1:" in err


@pytest.fixture
def tab(view):
    """The page in a headless browser, as small as it may be: it is drawn by the processor."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if CHROMIUM is None:
        pytest.skip("no Chromium or Chrome on the path to look at the page with")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=SOFTWARE)
        tab = browser.new_page(viewport={"width": 1000, "height": 480})
        tab.foreign = []
        tab.on("request", lambda request: tab.foreign.append(request.url))
        tab.goto(view.url, timeout=PATIENCE)
        tab.get_by_text("Touches so far").wait_for(timeout=PATIENCE)
        yield tab
        tab.close()  # a browser that still draws takes half a minute to close
        browser.close()


def test_a_browser_shows_status_and_sends_commands(view, tab):
    words = {log_lines.name: log_lines.text for log_lines in view.snapshot().status}
    for name in ("contact", "force", "point"):
        tab.get_by_text(words[name], exact=True).first.wait_for(timeout=PATIENCE)
    tab.get_by_text("stale: no reading for", exact=False).first.wait_for(timeout=PATIENCE)
    tab.locator("input.mantine-TextInput-input").last.fill("third card", timeout=PATIENCE)
    asked = []
    for i, button in enumerate(("Tare", "Mark", "Start", "Stop")):
        tab.locator("button", has_text=button).dispatch_event("click")
        # The lambda is called within this pass only.
        assert_eventually(lambda: asked.extend(view.requests.pop_all()) or len(asked) > i)  # noqa: B023
    assert [request.name for request in asked] == ["tare", "mark", "start recording", "stop recording"]
    assert asked[1].text == "third card"
    assert tab.locator("text=Share").count() == 0
    outside = [url for url in tab.foreign if not url.startswith((view.url, "data:", "blob:"))]
    assert outside == []  # no request to the internet


@pytest.mark.slow
def test_a_browser_draws_the_probe(view, tab):
    """Slow, since a processor draws it: the colours of the probe and of the plain grey cylinders are there."""
    from PIL import Image

    session = tab.context.new_cdp_session(tab)

    def drawn():
        shot = session.send("Page.captureScreenshot", {"format": "png"})["data"]
        picture = np.asarray(Image.open(io.BytesIO(base64.b64decode(shot))).convert("RGB")).astype(int)
        dark = (picture.max(axis=2) < 200) & (np.ptp(picture, axis=2) < 40)
        return dark[:, 370:590].sum() > 500

    assert_eventually(drawn, 300.0)


def test_the_run_goes_on_without_its_page(estimator, view):
    """The last, since it spoils the page that the others share."""
    view._process.kill()
    assert_eventually(lambda: "the run continues" in view.log_lines[-1])
    stream = SimulatedSource(estimator.model, "speed=max&rate_hz=10&seconds=1")
    assert (
        len(list(estimate_stream(estimator, stream, ProcessingOptions(), view.log_lines.append, view))) == 10
    )
