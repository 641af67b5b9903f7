"""What every page must fulfil in a real browser, measured in Chromium: legibility, width, print, no network.

`axe-core` judges the HTML. It cannot judge text in pictures, so the contrast of that is measured in a screenshot.
"""

import io
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
SOFTWARE = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]  #: A scene without a GPU.
PATIENCE = 120_000  #: A page drawn by a busy processor is slow, and no test is about that [ms].
STALL = "GPU stall due to ReadPixels"
MIN_CONTRAST = 4.5  #: Of text of normal size. Source: WCAG 2.2, success criterion 1.4.3, level AA.
SCALE = 2  #: Pixels of a screenshot per pixel of the page, so that the strokes of a letter have their full colour.
NARROW, WIDE, HEIGHT = 360, 1000, 800


@contextmanager
def browser(*flags: str) -> Iterator[Any]:
    if CHROMIUM is None:
        pytest.skip("no Chromium")
    playwright = pytest.importorskip("playwright.sync_api")
    with playwright.sync_playwright() as driver:
        running = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox", *flags])
        yield running
        running.close()


@contextmanager
def opened(running: Any, file: Path, width: int, scheme: str) -> Iterator[Any]:
    """Open a page with everything unfolded and without motion; it must load without faults and requests."""
    context = running.new_context(
        viewport={"width": width, "height": HEIGHT},
        color_scheme=scheme,
        reduced_motion="reduce",
        device_scale_factor=SCALE,
    )
    page = context.new_page()
    faults, requests = [], []
    # A screenshot of a scene that the processor draws reads pixels back, which the driver reports as slow.
    page.on("console", lambda message: STALL in message.text or faults.append(message.text))
    page.on("pageerror", lambda error: faults.append(str(error)))
    page.on("request", lambda request: requests.append(request.url))
    page.goto(file.as_uri())
    page.evaluate("document.querySelectorAll('details').forEach(d => d.open = true)")
    yield page
    fetched = [url for url in requests if not url.startswith("data:")]
    assert not faults and all(url.startswith(file.parent.as_uri()) for url in fetched)
    context.close()


def check_page(running: Any, file: Path) -> tuple[int, list[str]]:
    """Check a page: all rules but colours on a phone, the colours of text and pictures in light and dark on a screen.

    Colours do not depend on the width, and their rule takes longer than all others.

    Returns:
        The number of its sheets in print, and what is cut off at their right edge.
    """
    axe = pytest.importorskip("axe_playwright_python.sync_playwright").Axe()
    contrast = {"runOnly": ["color-contrast"]}
    others = {"rules": {"color-contrast": {"enabled": False}}}
    with opened(running, file, NARROW, "light") as page:
        for scheme, width, rules in (("light", NARROW, others), ("light", WIDE, contrast), ("dark", WIDE, contrast)):
            page.set_viewport_size({"width": width, "height": HEIGHT})
            page.emulate_media(color_scheme=scheme)
            assert page.evaluate("document.documentElement.scrollWidth") <= width, (file.name, width)
            found = axe.run(page, options=rules).response["violations"]
            assert not found, (file.name, scheme, [(v["id"], v["nodes"][0]["html"]) for v in found])
            if width == WIDE:
                faint = [pair for pair in picture_contrasts(page) if pair[1] < MIN_CONTRAST]
                assert not faint, (file.name, scheme, faint[:10])
        page.emulate_media(color_scheme="light")
        pdf = page.pdf(prefer_css_page_size=True)
        page.emulate_media(media="print")
        page.set_viewport_size({"width": round((210 - 28) / 25.4 * 96), "height": 900})  # within the margins of A4
        cut = page.evaluate(
            """() => [...document.querySelectorAll('table, svg, img, p, ul')].filter(one =>
                one.getBoundingClientRect().right > document.documentElement.clientWidth + 1).map(one =>
                one.tagName + ': ' + one.textContent.slice(0, 60))"""
        )
    return len(re.findall(rb"/Type\s*/Page\b(?!s)", pdf)), cut


def picture_contrasts(page: Any) -> list[tuple[str, float]]:
    """Return each text of the page's SVG with its contrast as rendered.

    The background is the most frequent colour of the text's box, the ink the colour most distant from it.
    """
    image = pytest.importorskip("PIL.Image")
    boxes = page.evaluate(
        """() => [...document.querySelectorAll('svg text')].map(text => {
            const box = text.getBoundingClientRect();
            return [text.textContent, box.left + scrollX, box.top + scrollY, box.right + scrollX, box.bottom + scrollY];
        }).filter(([text, a, b, c, d]) => text.trim() && c > a && d > b)"""
    )
    shot = np.asarray(image.open(io.BytesIO(page.screenshot(full_page=True))).convert("RGB"))
    found = []
    for text, left, top, right, bottom in boxes:
        part = shot[int(SCALE * top) : int(SCALE * bottom) + 1, int(SCALE * left) : int(SCALE * right) + 1]
        numbers = part.astype(np.int32) @ np.array([1 << 16, 1 << 8, 1], dtype=np.int32)  # one for each colour
        colours, counts = np.unique(numbers, return_counts=True)
        light = luminance(np.stack([colours >> 16, colours >> 8 & 255, colours & 255], axis=1))
        paper = light[np.argmax(counts)]
        ratios = (np.maximum(light, paper) + 0.05) / (np.minimum(light, paper) + 0.05)
        found.append((text, float(ratios[counts >= 4].max(initial=1.0))))
    return found


def luminance(colours: Any) -> Any:
    """Return the relative luminance of colours (n, 3) of 0 to 255. Source: WCAG 2.2, relative luminance."""
    share = np.asarray(colours) / 255.0
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    return linear @ np.array([0.2126, 0.7152, 0.0722])
