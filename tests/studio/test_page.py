"""The studio in a real browser."""

import math
import os
import signal
import subprocess
import sys
import time
import urllib.request
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import viser.transforms

from probedesign.cli.main import run
from probedesign.design.io import load_design
from probedesign.geometry.tube import centreline
from probedesign.studio.page import CHARTS_WIDTH, CONTROLS_WIDTH, StudioPage
from probedesign.studio.session import Session, knots_of
from probedesign.web.scene import UNIT, level_rotation
from tests.reports.page_checks import PATIENCE, SOFTWARE, browser

TABLET = {"device_scale_factor": 2, "has_touch": True, "is_mobile": True}  #: Two drawn pixels for each of the page.


@pytest.fixture(scope="module")
def running():
    with browser(*SOFTWARE) as started:
        yield started


@contextmanager
def opened(running, page, width=1280, height=720, **options):
    """Open the studio in a tab; yields it and what its console reports as errors."""
    context = running.new_context(viewport={"width": width, "height": height}, **options)
    tab, faults = context.new_page(), []
    tab.set_default_timeout(PATIENCE)
    tab.on("console", lambda message: faults.append(message.text) if message.type == "error" else None)
    tab.on("pageerror", lambda error: faults.append(str(error)))
    try:
        tab.goto(page.url)
        yield tab, faults
    finally:
        context.close()


@pytest.fixture
def page(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    served = StudioPage(Session(load_design("small")), 8185)
    yield served
    served.stop()


def assert_scene_is_wide(tab, width):
    tab.wait_for_selector("text=/one reading of 10 mN locates/")
    # Edges and handles of the panels take some pixels.
    tab.wait_for_function(
        "wide => Math.abs([...document.querySelectorAll('canvas')].at(-1).clientWidth - wide) < 20", arg=width
    )


def test_tabs_show_one_state_the_scene_what_the_panels_leave_and_buttons_write_files(page, running):
    """A screen and a tablet, whose charts are below the controls, where they would leave the scene too little."""
    beside_both = 1280 - CONTROLS_WIDTH - CHARTS_WIDTH
    with opened(running, page) as (wide, wide_faults):
        assert_scene_is_wide(wide, beside_both)
        with opened(running, page, 820, 1180, **TABLET) as (narrow, faults):
            assert_scene_is_wide(narrow, 820 - CONTROLS_WIDTH)
            tabs = wide, narrow
            assert wide.get_by_role("textbox").nth(0).is_visible()
            page.move("probe.length_mm", 60.0)
            page.settle()
            for tab in tabs:
                tab.wait_for_function("() => [...document.querySelectorAll('input')].some(i => i.value === '60')")
            # An impossible design: the reason, and the last valid design is kept.
            page.move("probe.tip_d_mm", 11.0)
            for tab in tabs:
                tab.wait_for_selector("text=/Not applied: .*tip_d_mm/")
            assert page.session.design.probe.length_mm == 60.0 and page.session.design.probe.tip_d_mm == 1.5
            wide.get_by_role("button", name="undo").click()
            narrow.wait_for_function("() => [...document.querySelectorAll('input')].some(i => i.value === '50')")
            assert page.session.design == load_design("small")
            assert not [fault for fault in wide_faults + faults if "favicon" not in fault]
    with opened(running, page) as (tab, _):  # however the tab before was arranged
        assert_scene_is_wide(tab, beside_both)
        tab.get_by_role("tab", name="Save").click()
        tab.get_by_role("button", name="Save the design").click()
        tab.wait_for_selector("text=/wrote designs.small.toml/")
        tab.get_by_role("button", name="Save the design").click()
        tab.wait_for_selector("text=/exists already/")
        tab.get_by_role("button", name="Deploy the estimator").click()
        tab.wait_for_selector("text=/wrote exports.small.small.probe.json/")
    assert run(["check", "designs/small.toml"]) == 0  # as a command would have written it
    assert Path("exports/small/small.probe.json").exists()


def test_a_knot_of_a_profile_is_dragged_with_the_pointer(page, running):
    """The pointer goes out from the knot across the probe to three times the radius: the diameter becomes as large."""
    page.move("probe.shape", "profile")
    page.settle()
    index, _, d = knots_of(page.session.design)[1]
    others = {i: other for i, _, other in knots_of(page.session.design) if i != index}
    with opened(running, page) as (tab, _):
        tab.wait_for_selector("text=/one reading of 10 mN locates/")
        tab.wait_for_timeout(3000)  # the scene is drawn after the panels
        start, end = (knot_on_screen(page, tab, 1, stretch) for stretch in (1.0, 3.0))
        tab.mouse.move(*start)
        tab.mouse.down()
        for share in (0.2, 0.4, 0.6, 0.8, 1.0):
            tab.mouse.move(*(start + share * (end - start)))
            tab.wait_for_timeout(200)
        tab.mouse.up()
        tab.wait_for_timeout(500)
        page.settle()
    diameters = {i: d for i, _, d in knots_of(page.session.design)}
    # A pixel is 0.13 mm of radius. The pointer moves in a plane through the front of the mark, 1.6 mm nearer to the
    # camera than its centre, whose distance is 12 cm, and faces it: the camera stands 20 degrees above the section.
    assert diameters[index] == pytest.approx(3.0 * d, rel=0.1)
    assert {i: d for i, d in diameters.items() if i != index} == others


def knot_on_screen(page, tab, i, stretch):
    """Return the pixel of a knot's mark, moved away from the centreline by a factor of its radius."""
    scene, (client,) = page._scene, page._server.get_clients().values()
    probe, _, bent = scene._shown
    _, s, _ = knots_of(probe.design)[i]
    middle = UNIT * centreline(bent, np.array([s]))[0][0]
    p = level_rotation(probe.model.gravity_base) @ (middle + stretch * (scene._knots[i].position - middle))
    camera = client.camera
    right, down, ahead = viser.transforms.SO3(camera.wxyz).as_matrix().T
    off = p - camera.position
    box = tab.locator("canvas").last.bounding_box()
    focal = box["height"] / 2.0 / math.tan(camera.fov / 2.0)
    return np.array([box["x"] + box["width"] / 2.0, box["y"] + box["height"] / 2.0]) + focal / (off @ ahead) * np.array(
        [off @ right, off @ down]
    )


def test_keys_undo_and_exchange_and_a_link_restores(page, running):
    with opened(running, page) as (tab, faults):
        tab.wait_for_selector("text=/one reading of 10 mN locates/")
        page._request(lambda: page._pin(page.session.pin))
        page.move("probe.length_mm", 60.0)
        page.settle()
        link = f"{page.url}/?state={page.session.link}"
        for key, length in (("Control+z", 50.0), ("Control+Shift+z", 60.0), ("Space", 50.0), ("Space", 60.0)):
            tab.keyboard.press(key)
            wait_until(lambda length=length: page.session.design.probe.length_mm == length)
        page.move("probe.length_mm", 40.0)
        page.settle()
        tab.goto(link)
        wait_until(lambda: page.session.design.probe.length_mm == 60.0)
        tab.wait_for_selector("text=/one reading of 10 mN locates/")
        assert "state" not in tab.url  # a reload keeps what was changed since
        assert not [fault for fault in faults if "favicon" not in fault]


def test_a_link_in_another_page_changes_nothing(page):
    """A browser states whether the user opened the address or another page led to it."""
    address = f"{page.url}/?state={Session(load_design('large')).link}"
    for site, name in (("cross-site", "small"), ("same-site", "small"), ("none", "large")):
        urllib.request.urlopen(urllib.request.Request(address, headers={"Sec-Fetch-Site": site})).read()
        page.settle()
        assert page.session.design.name == name


def test_the_former_shape_stays_while_a_slider_moves(page, monkeypatch):
    """The ghost is the probe before the drag, bent by the same touch, and goes when the hand rests."""
    wait_until(lambda: page.figures.complete)
    tip = page._scene._shown[2].p_base[-1]
    monkeypatch.setattr("probedesign.studio.page.REST_SECONDS", 3.0)  # on a machine that does much else, too
    for length in (55.0, 60.0):
        page.move("probe.length_mm", length)
        page.settle()
        ghost, camera = page._scene._ghosts["former"].vertices / UNIT, page._server.initial_camera.position
        # Its end is a disc about the tip, 0.97 of the radius of 0.75 mm.
        assert np.linalg.norm(ghost - tip, axis=1).min() < 1e-6
        assert page._scene._shown[0].length == length / 1e3
    wait_until(lambda: page.figures.complete and "former" not in page._scene._ghosts)
    assert np.array_equal(camera, page._server.initial_camera.position)


def fail(*_):
    raise OSError(28, "No space\nleft on device")


def wait_until(condition):
    limit = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < limit
        time.sleep(0.05)


def test_a_button_that_fails_is_one_line_and_the_page_goes_on(page, capsys):
    page._press(fail, None)
    page.settle()
    assert "OSError: [Errno 28] No space left on device (a defect of probedesign;" in page._status.content
    assert "test_page.py" in capsys.readouterr().err  # the traceback
    page.move("probe.length_mm", 60.0)
    page.settle()
    assert page.session.design.probe.length_mm == 60.0 and "defect" not in page._status.content


def test_a_prediction_at_rest_that_fails_is_one_line_and_the_page_goes_on(page, capsys, monkeypatch):
    wait_until(lambda: page.figures.complete)
    with monkeypatch.context() as patch:
        patch.setattr("probedesign.studio.page.complete", fail)
        page.move("probe.length_mm", 60.0)
        wait_until(lambda: "That failed: OSError" in page._status.content)
        assert capsys.readouterr().err.count("Traceback") == 1  # it is not repeated
    page.move("probe.length_mm", 61.0)
    wait_until(lambda: page.figures.complete)
    assert "failed" not in page._status.content


def test_another_web_page_cannot_connect(page):
    """The handshake of a WebSocket from another origin is refused."""
    import viser
    from websockets.exceptions import InvalidStatus
    from websockets.sync.client import connect
    from websockets.typing import Origin, Subprotocol

    address, protocol = page.url.replace("http", "ws"), Subprotocol(f"viser-v{viser.__version__}")
    with connect(address, origin=Origin(page.url), subprotocols=[protocol]) as own:
        assert len(own.recv(timeout=30)) > 0
    with pytest.raises(InvalidStatus, match="403"):
        connect(address, origin=Origin("http://example.org"), subprotocols=[protocol])


@pytest.mark.parametrize("arguments", [["--port", "0"], ["none.toml"]])
def test_bad_arguments_give_one_line(arguments, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run(["studio", *arguments]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()[-1:]) == 1


def test_ctrl_c_leaves_nothing_running(tmp_path):
    """The studio hears SIGINT even if these tests run in a shell's background, where it is inherited as ignored."""
    process = subprocess.Popen(
        [sys.executable, "-m", "probedesign.cli.main", "studio", "small", "--no-open"],
        cwd=tmp_path, stdout=subprocess.PIPE, text=True,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])},
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip
    assert process.stdout is not None
    assert process.stdout.readline().startswith("studio: http")  # nothing else is printed before
    process.send_signal(signal.SIGINT)
    assert process.wait(timeout=60) == 0
    assert process.stdout.read() == ""
