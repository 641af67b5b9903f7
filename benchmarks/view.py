"""The page of `live --view`: its picture for the documentation, from a real browser.

`python -m benchmarks view`; it needs playwright and Chromium. What the page costs the estimates
`benchmarks live --view` tells.
"""

import base64
import io
import os
import shutil
import socket
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from probedesign.design import load_design
from probedesign.estimation.estimator import Estimator
from probedesign.frozen_probe import load_estimator, write_frozen
from probedesign.live.processing.blocks import Block
from probedesign.live.processing.control import ProcessingOptions
from probedesign.live.run import estimate_stream, warm_up
from probedesign.live.sources.sim import SimulatedSource
from probedesign.live.view.sinks import scene_setup
from probedesign.live.view.state import ViewState
from probedesign.probe import build_probe

ROOT = Path(__file__).parents[1]
PICTURE = ROOT / "docs/pictures/live-view.png"
SIZE = {"width": 1440, "height": 860}
SOFTWARE = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"]
"""Chromium without a GPU and as root, as in a container."""
CLOCK_STANDS = "(() => { const now = Date.now(); Date.now = () => now; })()"
"""The page marks values as old that are not renewed for three seconds; this one draws one snapshot for longer."""
FADED_IN = float(os.environ.get("PROBEDESIGN_VIEW_SECONDS", "20"))
"""The scene fades in over its first frames, which a processor takes its time for [s]."""


def report() -> None:
    """Draw the picture."""
    with tempfile.TemporaryDirectory() as elsewhere:
        bundle = Path(elsewhere) / "large.probe.json"
        write_frozen(build_probe(load_design(ROOT / "designs" / "large.toml")).model, bundle)
        estimator = load_estimator(bundle)  # as the command has it
        warm_up(estimator, print)
        draw_page(estimator, ROOT / "exports" / "large")


def draw_page(estimator: Estimator, folder: Path, until: float = 26.5, picture: Path = PICTURE) -> None:
    """The page as it is after a simulated touch and during the next.

    Args:
        estimator: of the probe.
        folder: of its exported parts; without them plain cylinders are drawn.
        until: when [s].
        picture: where it goes.
    """
    from probedesign.live.view.access import protect
    from probedesign.live.view.page import ViewerPage

    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        print("no picture of the page: playwright is not installed")
        return
    browser_path = shutil.which("chromium") or shutil.which("google-chrome")
    now = 0.0
    state = ViewState(clock=lambda: now)
    source = SimulatedSource(estimator.model, f"speed=max&rate_hz=20&seconds={until}")
    state.on_event(now, source.title)
    for answer in estimate_stream(estimator, source, ProcessingOptions(), print):
        now, one = answer.reading.time, np.array([answer.reading.time])
        state.on_samples(Block(one, answer.reading.wrench_sensor[None], answer.reading.gravity_base, one))
        state.on_estimate(answer)
    setup = scene_setup(estimator, folder, "127.0.0.1", free_port(), print)
    protect(setup.title, setup.token)
    page = ViewerPage(setup, lambda wish, text: None)
    page.show(state.snapshot())
    try:
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=browser_path, args=SOFTWARE)
            tab = browser.new_page(viewport=SIZE)
            tab.add_init_script(CLOCK_STANDS)
            tab.goto(page.url)
            tab.get_by_text("Touches so far").wait_for(timeout=120_000)
            time.sleep(FADED_IN)
            _write(screenshot(tab), picture)
            tab.close()  # a browser that still draws takes half a minute to close
            browser.close()
    finally:
        page.stop()
    print(f"page drawn in {picture}")


def screenshot(tab: Any) -> bytes:
    """Of a page that never rests, which playwright's own waits for; without the browser's word on software."""
    tab.evaluate("document.querySelectorAll('.mantine-Notification-root').forEach(e => e.remove())")
    session = tab.context.new_cdp_session(tab)
    return base64.b64decode(session.send("Page.captureScreenshot", {"format": "png"})["data"])


def _write(shot: bytes, picture: Path) -> None:
    """With 256 colours, which takes less than half the room."""
    from PIL import Image

    Image.open(io.BytesIO(shot)).convert("RGB").quantize(256, dither=Image.Dither.NONE).save(
        picture, optimize=True
    )


def free_port() -> int:
    """A port that nobody listens on."""
    with socket.socket() as trial:
        trial.bind(("127.0.0.1", 0))
        return int(trial.getsockname()[1])
