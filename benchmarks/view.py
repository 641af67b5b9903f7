"""Take the picture of the page of `live --view` for the documentation in a browser.

`python -m benchmarks view` needs playwright and Chromium. `python -m benchmarks live --view` measures the effect of the
page on the estimates.
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
from probedesign.live.blocks import Block
from probedesign.live.processing.chain import ProcessingOptions
from probedesign.live.run import estimate_stream, warm_up
from probedesign.live.sources.sim import SimulatedSource
from probedesign.live.view.sinks import scene_setup
from probedesign.live.view.state import PageSetup, ViewState
from probedesign.probe import build_probe

ROOT = Path(__file__).parents[1]
PICTURE = ROOT / "docs/pictures/live-view.png"
SIZE = {"width": 1440, "height": 860}
#: Options of Chromium without a GPU and as root, as in a container.
BROWSER_OPTIONS = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"]
#: Script that stops the clock of the page, which otherwise marks values as old after three seconds.
STOP_CLOCK = "(() => { const now = Date.now(); Date.now = () => now; })()"
#: Waiting time for the fade-in of the scene, whose first frames are slow without a GPU [s].
FADE_IN_SECONDS = float(os.environ.get("PROBEDESIGN_VIEW_SECONDS", "20"))


def report() -> None:
    """Take the picture."""
    with tempfile.TemporaryDirectory() as elsewhere:
        bundle = Path(elsewhere) / "large.probe.json"
        write_frozen(build_probe(load_design(ROOT / "designs" / "large.toml")).model, bundle)
        estimator = load_estimator(bundle)  # the command also loads a frozen probe
        warm_up(estimator, print)
        draw_page(estimator, Path("exports/large"))


def draw_page(estimator: Estimator, folder: Path, until: float = 26.5, picture: Path = PICTURE) -> None:
    """Take a picture of the page after a simulated touch and during the next one.

    Args:
        estimator: estimator of the probe.
        folder: folder of its exported parts; without them the page shows cylinders.
        until: end of the simulation [s].
        picture: file to write.
    """
    from probedesign.live.view.page import STYLE, ViewerPage
    from probedesign.web.guard import protect

    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        print("playwright is not installed, so no picture of the page is taken")
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
        if 0.0 <= now - 12.0 < 0.05:
            state.on_event(now, "mark: second press")
    setup = PageSetup("127.0.0.1", free_port(), (scene_setup(estimator, folder, print),))
    protect(setup.title, setup.token, f"<style>{STYLE}</style>")
    page = ViewerPage(setup, lambda wish, text: None)
    page.show([state.snapshot()])
    try:
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=browser_path, args=BROWSER_OPTIONS)
            tab = browser.new_page(viewport=SIZE)
            tab.add_init_script(STOP_CLOCK)
            tab.goto(page.url)
            tab.get_by_text("Events").wait_for(timeout=120_000)
            time.sleep(FADE_IN_SECONDS)
            write_picture(screenshot(tab), picture)
            tab.close()  # a browser that still draws takes half a minute to close
            browser.close()
    finally:
        page.stop()
    print(f"picture written to {picture}")


def screenshot(tab: Any) -> bytes:
    """Return a screenshot as PNG.

    Playwright's own method waits until the page is idle, which this page never is. Notifications of the browser are
    removed.
    """
    tab.evaluate("document.querySelectorAll('.mantine-Notification-root').forEach(e => e.remove())")
    session = tab.context.new_cdp_session(tab)
    return base64.b64decode(session.send("Page.captureScreenshot", {"format": "png"})["data"])


def write_picture(shot: bytes, picture: Path) -> None:
    """Write a screenshot with 256 colours, which halves its size."""
    from PIL import Image

    Image.open(io.BytesIO(shot)).convert("RGB").quantize(256, dither=Image.Dither.NONE).save(picture, optimize=True)


def free_port() -> int:
    """Return a free port."""
    with socket.socket() as trial:
        trial.bind(("127.0.0.1", 0))
        return int(trial.getsockname()[1])
