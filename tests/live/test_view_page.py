"""The page: its process, its errors, its buttons, and its appearance in a real browser."""

import base64
import contextlib
import io
import json
import re
import signal
import socket
import subprocess
import sys
import time
from http.client import HTTPConnection
from itertools import islice
from urllib.parse import urlsplit
from urllib.request import urlopen

import numpy as np
import pytest

from probedesign.cli.main import run
from probedesign.core.errors import InputError, MissingDependencyError
from probedesign.live.blocks import group_readings, iter_readings
from probedesign.live.processing.chain import ProcessingOptions
from probedesign.live.processing.commands import COMMANDS, CommandQueue
from probedesign.live.processing.payload import RestCollector
from probedesign.live.run import estimate_stream
from probedesign.live.sources.sim import SimulatedSource
from probedesign.live.view.sinks import BrowserView
from probedesign.live.view.state import GuideState, ViewState
from tests.reports.page_checks import PATIENCE, SOFTWARE, browser

pytest.importorskip("viser")


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
    log_lines, requests, recording = [], CommandQueue(), ["", ""]
    states = {"": ViewState(recording=lambda: tuple(recording))}
    probes = [(estimator, tmp_path_factory.mktemp("view"))]
    view = BrowserView(states, probes, requests, log_lines.append, port=free_port())
    view.log_lines, view.requests, view.recording = log_lines, requests, recording
    stream = SimulatedSource(estimator.model, "speed=max&rate_hz=10&seconds=8")
    list(estimate_stream(estimator, stream, ProcessingOptions(), log_lines.append, view))
    yield view
    view.close()


def ask(url: str, **headers: str):
    """The response to a request, also if it is a refusal; redirections are not followed."""
    address = urlsplit(url)
    connection = HTTPConnection(address.hostname, address.port, timeout=30)
    connection.request("GET", url.removeprefix(f"http://{address.netloc}") or "/", headers=headers)
    response = connection.getresponse()
    body = response.read()
    connection.close()
    return response, body


def handshake(url: str, **headers: str) -> None:
    """Open a WebSocket as a browser does, and receive something."""
    import viser
    from websockets.sync.client import connect
    from websockets.typing import Origin, Subprotocol

    origin = headers.pop("Origin", None)
    protocol = Subprotocol(f"viser-v{viser.__version__}")
    with connect(
        url.replace("http", "ws"), origin=origin and Origin(origin), subprotocols=[protocol], additional_headers=headers
    ) as own:
        assert len(own.recv(timeout=30)) > 0


def test_only_the_page_itself_on_this_machine_may_talk_to_its_server(view):
    """A page of the internet, open in a browser on this machine, could else press the buttons, under its own name or
    under one that was bound to this machine."""
    from websockets.exceptions import InvalidStatus

    assert view.url.startswith("http://127.0.0.1:") and "there is no manifest.json" in view.log_lines[0]
    assert view.log_lines[1] == f"view: {view.url}, open to this machine only"
    handshake(view.url, Origin=view.url)
    other_port = f"http://127.0.0.1:{int(view.url.rpartition(':')[2]) + 1}"
    for origin in ("http://example.org", "null", other_port, view.url + ".example.org", None):
        with pytest.raises(InvalidStatus, match="403"):
            handshake(view.url, **({"Origin": origin} if origin else {}))
    response, body = ask(view.url, Host="example.org")
    assert response.status == 403 and b"this machine only" in body
    assert ask(view.url, Host="localhost:1")[0].status == 200


def test_the_page_has_title_and_icon_of_the_project_and_refuses_frames(view):
    response, body = ask(view.url, **{"Accept-Encoding": "gzip"})
    assert b"<title>probedesign large " in body and b"Viser</title>" not in body
    assert body.count(b'rel="icon"') == 1 and b"%23ec9242" in body
    assert response.getheader("X-Frame-Options") == "DENY"
    missing, _ = ask(view.url + "/no-such-file")
    assert missing.status == 404
    assert all("frame-ancestors 'none'" in each.getheader("Content-Security-Policy") for each in (response, missing))


@pytest.fixture(scope="module")
def public(estimator, tmp_path_factory, view):
    """A page that is open to the network, and its token, as the terminal shows it."""
    log_lines, shown = [], io.StringIO()
    port = int(view.url.rpartition(":")[2])
    with contextlib.redirect_stderr(shown):
        probes = [(estimator, tmp_path_factory.mktemp("public"))]
        public = BrowserView({"": ViewState()}, probes, CommandQueue(), log_lines.append, host="0.0.0.0", port=port)
    public.local = public.url.replace("0.0.0.0", "127.0.0.1")
    public.token = re.search(r"view: open http://\S+:\d+/\?token=(\S+)", shown.getvalue())[1]
    public.log_lines = log_lines
    yield public
    public.close()
    with pytest.raises(OSError):
        urlopen(public.local)


def test_beyond_this_machine_the_token_is_required(public, view):
    """Once in the address, from then on as a cookie that scripts and other sites cannot use. The log, which recordings
    and the network receive, does not state it. The page is at the next free port."""
    from websockets.exceptions import InvalidStatus

    assert public.url != view.url and len(public.token) >= 32
    assert public.log_lines[-1] == f"view: {public.url}, open to the network, with its token"
    assert not any(public.token in line for line in public.log_lines)
    url, name = public.local, f"probedesign_view_{public.local.rpartition(':')[2]}"
    for path in ("", "/?token=", "/?token=wrong", f"/?token={public.token}x", "/?token=%00%FF"):
        response, body = ask(url + path)
        assert response.status == 403 and b"token" in body and public.token.encode() not in body
    response, _ = ask(f"{url}/?token={public.token}")
    assert (response.status, response.getheader("Location")) == (303, "/")
    cookie = response.getheader("Set-Cookie")
    assert {"HttpOnly", "SameSite=Strict"} <= set(cookie.split("; "))
    known = {"Cookie": cookie.partition(";")[0]}
    assert b"<title>" in ask(url, **known)[1]
    handshake(url, Origin=url, **known)
    for headers in (
        {"Origin": url},
        {"Origin": "http://example.org", **known},
        {"Origin": url, "Cookie": f"{name}=wrong"},
        {"Origin": url, "Cookie": ";=;;,"},
    ):
        with pytest.raises(InvalidStatus, match="403"):
            handshake(url, **headers)


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
        BrowserView({}, [(estimator, tmp_path)], CommandQueue(), print, host=host, port=port)
    assert expected in str(error.value) and str(error.value).isprintable()


def test_without_viser_the_remedy_is_reported(estimator, tmp_path, monkeypatch):
    monkeypatch.setattr("probedesign.core.errors.find_spec", lambda name: None)
    with pytest.raises(MissingDependencyError, match=r"probedesign\[view\]"):
        BrowserView({}, [(estimator, tmp_path)], CommandQueue(), print)


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


def test_the_page_ends_with_the_run_even_if_that_is_killed(bundle):
    command = [sys.executable, "-m", "probedesign.cli.main", "live", str(bundle), "--source", "sim:?seconds=1000000",
               "--view", "--view-port", str(port := free_port())]  # fmt: skip
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        list(islice(process.stdout, 3))
        with urlopen(f"http://127.0.0.1:{port}") as page:
            assert page.status == 200
        process.kill()
        _, err = process.communicate(timeout=60)
    assert "Traceback" not in err

    def gone():
        with socket.socket() as trial:
            return trial.connect_ex(("127.0.0.1", port)) != 0

    assert_eventually(gone)


def test_lines_of_json_stay_clean_beside_a_page(bundle, capfd):
    options = ["--source", "sim:?speed=max&rate_hz=3", "--json", "--view", "--view-port", str(free_port())]
    assert run(["live", str(bundle.parent), *options]) == 0  # parts are in the folder that is named
    out, err = capfd.readouterr()
    assert f"view: parts of {bundle.parent}: there is no manifest.json" in err
    assert len([json.loads(line) for line in out.splitlines()]) == 60
    assert "viser" not in err and "view: http://127.0.0.1:" in err


@pytest.fixture(scope="module")
def running():
    """A headless browser; playwright runs once in a thread."""
    with browser(*SOFTWARE) as running:
        yield running


@pytest.fixture(scope="module")
def tab(view, running):
    """The page, opened once: it is drawn by the processor."""
    tab = running.new_page(viewport={"width": 1000, "height": 240})
    tab.foreign = []
    tab.on("request", lambda request: tab.foreign.append(request.url))
    tab.goto(view.url, timeout=PATIENCE)
    tab.get_by_text("Events").wait_for(timeout=PATIENCE)
    yield tab
    tab.close()  # a browser that still draws takes half a minute to close


def test_a_browser_shows_status_and_sends_commands(view, tab):
    words = {log_lines.name: log_lines.text for log_lines in view.snapshots()[0].status}
    for name in ("contact", "force", "point"):
        tab.get_by_text(words[name], exact=True).first.wait_for(timeout=PATIENCE)
    tab.get_by_text("stale: no reading for", exact=False).first.wait_for(timeout=PATIENCE)
    tab.locator("input.mantine-TextInput-input").last.fill("third card", timeout=PATIENCE)
    asked = []
    for name in COMMANDS:
        view.requests.register(name, asked.append)
    for i, button in enumerate(("Tare", "Mark", "Start", "Stop")):
        if button == "Stop":  # it is disabled until something is recorded
            assert tab.locator("button", has_text=button).is_disabled()
            view.recording[0] = "to a.mcap, 7 readings"
            tab.get_by_text("to a.mcap, 7 readings").first.wait_for(timeout=PATIENCE)
            assert_eventually(lambda: tab.locator("button", has_text="Stop").is_enabled())
        tab.locator("button", has_text=button).dispatch_event("click")
        # The lambda is called within this pass only.
        assert_eventually(lambda: view.requests.execute(view.log_lines.append) or len(asked) > i)  # noqa: B023
    assert [request.name for request in asked] == ["tare", "mark", "start recording", "stop recording"]
    assert asked[1].text == "third card"
    for label in ("Pause", "Continue: paused at", "Pause"):
        tab.get_by_text(label).first.wait_for(timeout=PATIENCE)
        tab.locator("button", has_text=label).dispatch_event("click")
    assert tab.locator("text=Share").count() == 0
    outside = [url for url in tab.foreign if not url.startswith((view.url, "data:", "blob:"))]
    assert outside == []  # no request to the internet


def test_a_browser_that_is_cut_off_shows_no_value_as_current(view, tab):
    """The page's process is stopped, as a network that fails does it; then it continues."""
    banner = tab.locator("#pd-lost")
    assert_eventually(lambda: not banner.is_visible())
    view._process.send_signal(signal.SIGSTOP)
    try:
        banner.wait_for(state="visible", timeout=PATIENCE)
        assert "all values are" in banner.inner_text()
        assert "grayscale" in tab.evaluate("() => getComputedStyle(document.querySelector('.pd')).filter")
    finally:
        view._process.send_signal(signal.SIGCONT)
    banner.wait_for(state="hidden", timeout=PATIENCE)


def test_a_calibration_is_guided_by_the_page(estimator, running, tmp_path):
    """What is next, the state of the rest, and the result; it can be finished from the page once it is enough."""
    model, requests = estimator.model, CommandQueue()
    source = SimulatedSource(model, "orientations=7&speed=max&rate_hz=25")
    collector = RestCollector(model, source.poses, lambda line: state.on_event(0.0, line))
    state = GuideState(collector, model, source.poses.gravity_world, clock=lambda: 0.0)  # readings do not age
    view = BrowserView({"": state}, [(estimator, tmp_path)], requests, print, port=free_port(), guided=True)
    stream = group_readings(iter_readings(source))

    def feed(until):
        for block in stream:
            state.on_samples(block)
            collector.add(block)
            if block.time[-1] > until:
                return

    with contextlib.closing(view):
        tab = running.new_page(viewport={"width": 1000, "height": 240})
        feed(1.2)
        tab.goto(view.url, timeout=PATIENCE)
        tab.get_by_text(re.compile(r"hold still: \d+%")).first.wait_for(timeout=PATIENCE)
        feed(3.5)
        tab.get_by_text("measured: turn the base on").first.wait_for(timeout=PATIENCE)
        for text in ("next: turn it so that z points down", "1 orientations, of at least 6", "Events"):
            tab.get_by_text(text).first.wait_for(timeout=PATIENCE)
        button = tab.locator("button", has_text="Finish")
        assert button.is_disabled() and not tab.locator("button", has_text="Tare").is_visible()
        feed(100.0)
        assert_eventually(button.is_enabled)
        # Seven points lie in the halves, of which the four on the rim are in both.
        assert tab.locator('svg[aria-label="orientations measured"] circle[r="6"]').count() >= 7
        button.dispatch_event("click")
        assert_eventually(lambda: requests.execute(print))
        state.show_result("7 rests: ok", True, {"payload": "12.40 ± 0.01 g"})
        for text in ("7 rests: ok", "12.40 ± 0.01 g"):
            tab.get_by_text(text).first.wait_for(timeout=PATIENCE)
        assert_eventually(button.is_disabled)
        tab.close()


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
    assert len(list(estimate_stream(estimator, stream, ProcessingOptions(), view.log_lines.append, view))) == 10
