"""Time of the studio from the motion of a slider to new curves and a new shape in a browser; picture of its page."""

import shutil
import statistics
import tempfile
import time
from contextlib import chdir
from pathlib import Path

import numpy as np

from benchmarks.timing import print_table
from benchmarks.view import write_picture
from probedesign.cli.main import run
from probedesign.design import load_design
from probedesign.design.catalog import PROBES
from probedesign.studio.page import StudioPage
from probedesign.studio.session import Session

PICTURE = Path(__file__).parents[1] / "docs/pictures/studio.png"
SIZE = {"width": 1280, "height": 800}
MOVES = 60  #: Moves of a slider for each probe.
#: Options of a browser without a GPU, which draws WebGL on the processor.
ARGUMENTS = ["--enable-unsafe-swiftshader", "--no-sandbox"]
#: Script that records the time of the second frame after each change of a chart, when chart and shape are drawn.
WATCH = """() => { window.seen = []; let last = ''; new MutationObserver(() => {
  const text = [...document.querySelectorAll('svg')].map(svg => svg.outerHTML.length + svg.textContent).join();
  if (text === last) return;
  last = text;
  const entry = [0, [...document.querySelectorAll('.st table')].map(table => table.textContent).join()];
  requestAnimationFrame(() => requestAnimationFrame(() => { entry[0] = Date.now(); window.seen.push(entry) }));
}).observe(document.body, {childList: true, subtree: true, characterData: true, attributes: true}) }"""


def report() -> None:
    """Print the times of the computation and until the browser shows the result, and take the picture."""
    from playwright.sync_api import sync_playwright

    rows = []
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    for name in PROBES:
        page = StudioPage(Session(load_design(name)), 8095)
        try:
            alone = [_computed(page, factor) for factor in _factors()]
            row = [name, *_quantiles(alone)]
            if chromium:
                with sync_playwright() as driver:
                    browser = driver.chromium.launch(executable_path=chromium, args=ARGUMENTS)
                    tab = browser.new_page(viewport=SIZE)
                    tab.goto(page.url)
                    tab.wait_for_selector("svg title", state="attached", timeout=120_000)
                    tab.wait_for_timeout(3000)
                    tab.evaluate(WATCH)
                    row += _quantiles([_seen(page, tab, factor) for factor in _factors()])
                    browser.close()
            rows.append(row)
        finally:
            page.stop()
    head = ["probe", "computation, median", "95th percentile", "shown in the browser, median", "95th percentile"]
    print_table(f"Time from the motion of a slider to new curves and shape, {MOVES} moves each", head, rows)
    if chromium:
        draw_page(chromium)


def draw_page(chromium: str, picture: Path = PICTURE) -> None:
    """Take the picture of the page with the design of the README, as `new --length 150 --base-d 12` writes it."""
    from playwright.sync_api import sync_playwright

    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        assert run(["new", "--length", "150", "--base-d", "12"]) == 0
        design = load_design(Path("designs/cone-150x12x2.toml"))
    page = StudioPage(Session(design), 8095)
    try:
        with sync_playwright() as driver:
            browser = driver.chromium.launch(executable_path=chromium, args=ARGUMENTS)
            tab = browser.new_page(viewport=SIZE)
            tab.goto(page.url)
            tab.wait_for_selector("small >> text=fused", timeout=120_000)
            tab.locator(".mantine-Notification-closeButton").click()  # of the note that there is no GPU
            tab.wait_for_timeout(5000)
            write_picture(tab.screenshot(), picture)
            browser.close()
    finally:
        page.stop()


def _factors() -> "np.ndarray[tuple[int], np.dtype[np.float64]]":
    return np.random.default_rng(7).uniform(0.8, 1.2, MOVES)


def _computed(page: StudioPage, factor: float) -> float:
    """Return the time of one change without a browser [s]."""
    start = time.perf_counter()
    page.move("probe.length_mm", round(100.0 * factor, 1))
    page.settle()
    return time.perf_counter() - start


def _seen(page: StudioPage, tab: "object", factor: float) -> float:
    """Return the time until the browser shows the new design [s]: its sag in the table identifies it."""
    tab.evaluate("() => { window.seen = [] }")  # type: ignore[attr-defined]
    start = time.time()
    page.move("probe.length_mm", round(100.0 * factor, 1))
    page.settle()
    shown = next(row.text for row in page.figures.summary() if row.name == "tip sag")
    first = "window.seen.find(([_, text]) => text.includes(shown))"
    tab.wait_for_function(f"shown => {first} !== undefined", arg=shown, polling=5, timeout=60_000)  # type: ignore[attr-defined]
    seen = tab.evaluate(f"shown => {first}[0]", shown)  # type: ignore[attr-defined]
    return float(seen) / 1e3 - start


def _quantiles(seconds: list[float]) -> list[str]:
    return [f"{1e3 * statistics.median(seconds):.0f} ms", f"{1e3 * float(np.quantile(seconds, 0.95)):.0f} ms"]
