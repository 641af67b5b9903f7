"""Pictures of all pages, the studio and the live view: wide and narrow, light and dark, and what a browser reports.

To be looked at one by one before a change of the pages is called done.
"""

import shutil
import subprocess
import sys
import tempfile
import threading
from collections import deque
from collections.abc import Iterator
from contextlib import chdir, contextmanager
from pathlib import Path
from typing import Any

from benchmarks.studio import ARGUMENTS
from benchmarks.timing import print_table
from probedesign.cli.main import run
from probedesign.design import load_design
from probedesign.studio.page import StudioPage
from probedesign.studio.session import Session

OUT = Path("exports/pictures")
SIZES = {"wide": {"width": 1280, "height": 800}, "narrow": {"width": 390, "height": 844}}
#: Commands whose pages are photographed; the demo writes the others.
COMMANDS = (
    ("demo", "--out", "demo"),
    ("compare", "large", "medium", "small", "--out", "comparison.html"),
    ("sweep", "large", "--vary", "probe.base_d_mm=8,10,12", "--at", "0.8", "--touches", "1"),
    ("campaign", "small", "data"),
    ("identify", "small", "data", "--for", "E,G", "--accept"),
)


def report(out: Path = OUT) -> None:
    """Write the pictures into a folder, and print what each page sent to the console and to a network."""
    from playwright.sync_api import sync_playwright

    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    if chromium is None:
        print("no Chromium is installed; apt-get install chromium")
        return
    out.mkdir(parents=True, exist_ok=True)
    rows = []
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=chromium, args=ARGUMENTS)
        with chdir(folder):
            for command in COMMANDS:
                run([*command])
            pages = {str(page.relative_to(folder)): page.as_uri() for page in sorted(Path(folder).rglob("*.html"))}
        for name, address in pages.items():
            rows += _pictures(browser, name.removesuffix(".html").replace("/", "-"), address, out, 1500)
        with _studio() as address:
            rows += _pictures(browser, "studio", address, out, 8000)
        for name, source in (("live", "sim:?seconds=600"), ("calibrate", "sim:?orientations=12&payload_g=3")):
            with chdir(folder), _live(name, source) as address:
                rows += _pictures(browser, name, address, out, 6000)
        browser.close()
    print_table(f"Pictures in {out}", ["page", "picture", "errors", "requests to a network", "cut off [px]",
                                          "texts of low contrast"], rows)  # fmt: skip


def _pictures(browser: Any, name: str, address: str, out: Path, wait_ms: int) -> Iterator[list[str]]:
    """Take the four pictures of a page, and yield a row for each: errors, requests, width beyond the window, and texts
    whose contrast is below 4.5."""
    from axe_playwright_python.sync_playwright import Axe

    for size, scheme in ((size, scheme) for size in SIZES for scheme in ("light", "dark")):
        tab = browser.new_page(viewport=SIZES[size], color_scheme=scheme)
        errors, requests = list[str](), list[str]()
        tab.on("console", lambda message, to=errors: to.append(message.text) if message.type == "error" else None)
        tab.on("pageerror", lambda error, to=errors: to.append(str(error)))
        tab.on("request", lambda request, to=requests: None if _is_local(request.url) else to.append(request.url))
        tab.goto(address)
        tab.wait_for_timeout(wait_ms)
        beyond = tab.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")
        picture = f"{name}-{size}-{scheme}.png"
        tab.screenshot(path=out / picture)
        low = Axe().run(tab, options={"runOnly": ["color-contrast"]}).response["violations"]
        tab.close()
        yield [name, picture, "; ".join(errors) or "none", "; ".join(requests) or "none", str(beyond),
               str(sum(len(rule["nodes"]) for rule in low))]  # fmt: skip


def _is_local(url: str) -> bool:
    return url.startswith(("file:", "data:", "blob:", "http://127.0.0.1", "ws://127.0.0.1", "http://localhost"))


@contextmanager
def _studio() -> Iterator[str]:
    page = StudioPage(Session(load_design("large")), 8095)
    try:
        yield page.url
    finally:
        page.stop()


@contextmanager
def _live(command: str, source: str) -> Iterator[str]:
    """Run `live` or `calibrate` with its page, with the demo's probe and a simulated source."""
    probe = next(Path.cwd().rglob("*.probe.json"))
    program = "import sys; from probedesign.cli.main import main; sys.exit(main())"
    words = [sys.executable, "-c", program, command, str(probe), "--source", source, "--view"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as running:
        assert running.stdout is not None
        try:
            for line in running.stdout:
                if "http://" in line:
                    # It would wait for a reader of its lines.
                    threading.Thread(target=deque, args=(running.stdout, 0), daemon=True).start()
                    yield "http://" + line.split("http://")[1].split()[0].rstrip(",")
                    break
        finally:
            running.terminate()
