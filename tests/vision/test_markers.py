"""Dots in synthetic photographs: detected in order at their true positions, or refused."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scene import SIZE, camera, probe
from scipy.ndimage import gaussian_filter

from probedesign.core.errors import InputError
from probedesign.vision.markers import find_markers, fit_dot, overlay, patch_of, read_grey, write_png
from tests.vision.rendering import PaintedDots, RenderStyle, render

cv2 = pytest.importorskip("cv2")

SIGHT = camera("left", focal=2300.0, size=SIZE)
TUBE, DOTS = probe()
BASE = SIGHT.project(np.zeros(3))
LIGHT_DOTS = RenderStyle(probe=0.2, dot=0.85, seed=3)


def photograph(folder, look=None, dots=DOTS, tube=TUBE):
    path = folder / "photograph.png"
    write_png(path, render(SIGHT, tube, dots, SIZE, look))
    return path


@pytest.fixture(scope="module")
def usual(tmp_path_factory):
    return photograph(tmp_path_factory.mktemp("usual"))


def where(dots=DOTS, tube=TUBE):
    return SIGHT.project(tube.dot_positions(dots))


def test_the_renderer_draws_what_the_camera_projects():
    """The centre of the grey levels of one dark dot, without noise or shade, is its projection."""
    plain = RenderStyle(ambient=1.0, gloss=0.0, mottle=0.0, noise=0.0, full_well=1e15, clutter=0)
    one = PaintedDots(DOTS.s[4:5], DOTS.outward_world[4:5], np.array([0.001]))
    bare = render(SIGHT, TUBE, PaintedDots(DOTS.s[:0], DOTS.outward_world[:0], DOTS.diameter[:0]), SIZE, plain)
    ink = bare.astype(float) - render(SIGHT, TUBE, one, SIZE, plain)
    v, u = np.mgrid[: SIZE[1], : SIZE[0]]
    seen = np.array([np.sum(u * ink), np.sum(v * ink)]) / np.sum(ink)
    # Nine rays a pixel find the edge of a dot of 3 px to a tenth of a pixel at most places.
    assert seen == pytest.approx(SIGHT.project(TUBE.dot_positions(one))[0], abs=0.1)


@pytest.mark.parametrize(
    "look",
    [None, LIGHT_DOTS, RenderStyle(background=0.8, seed=1), RenderStyle(clutter=30, seed=2)],
    ids=["dark on light", "light on dark", "white wall", "cluttered"],
)
def test_dots_are_found_in_order_within_their_standard_deviation(look, usual, tmp_path):
    path = usual if look is None else photograph(tmp_path, look)
    found = find_markers(path, DOTS.s, BASE)
    error = found.pixels - where()
    assert found.dark == (look is not LIGHT_DOTS)
    assert np.sqrt(np.mean(error**2)) < 0.25  # 0.09 to 0.16 px are usual
    assert np.sqrt(np.mean((error / found.std_px[:, None]) ** 2)) < 1.8  # 28 numbers, some of one cause
    assert (found.std_px < 0.6).all()


def test_the_base_side_determines_the_order(usual):
    from_left, from_right = (find_markers(usual, DOTS.s, side, True) for side in ("left", "right"))
    assert from_left.pixels == pytest.approx(from_right.pixels[::-1])
    assert np.abs(from_left.pixels - where()).max() < 1.0  # not one dot off: they are 20 px apart


def bent_dot(sink, tilt=0.6):
    """A dot of 9 px on a probe along u that is seen obliquely, as the rays through nine places of each pixel have it:
    its places sink by the square of how far round they lie."""
    v, u = (grid / 3.0 for grid in np.mgrid[-60:63, -60:63])
    x, y = (u - 1.0 / 3.0) / math.cos(tilt), v - 1.0 / 3.0
    x = x + sink * 9.0 * math.tan(tilt) * (y / 9.0) ** 2
    inked = np.hypot(x, y) <= 9.0
    share = inked.reshape(41, 3, 41, 3).mean(axis=(1, 3))
    return np.round(200.0 - 150.0 * gaussian_filter(share, 0.8)).astype(np.uint8)


@pytest.mark.parametrize("sink", [-0.22, 0.0, 0.22])
def test_a_dot_bent_round_its_probe_is_found_where_it_is_painted(sink):
    """The middle of its outline is off by 9 px · 0.22 · sin 0.6 / 4 = 0.28 px, which would be an ellipse's error."""
    dot = fit_dot(bent_dot(sink), np.array([20.2, 19.9]), 18.0, np.array([1.0, 0.0]))
    # Nine positions within a pixel determine an outline of 50 pixels to 0.03 px.
    assert dot.pixel == pytest.approx([20.0, 20.0], abs=0.06)


def test_correlated_pixels_count_as_one_patch():
    """A patch of noise is a pixel; of noise that is smooth over σ = 2 px it is 4πσ² = 50 pixels, within a third."""
    v, u = np.mgrid[:60, :60]
    offsets = np.column_stack([u.ravel(), v.ravel()]).astype(float)
    noise = np.random.default_rng(1).normal(size=(60, 60))
    assert patch_of(noise.ravel(), offsets) < 3.0
    assert patch_of(gaussian_filter(noise, 2.0).ravel(), offsets) == pytest.approx(50.0, rel=0.35)


@pytest.mark.parametrize(
    ("count", "words"),
    [(15, "14 dots in a row, but 15 are expected"), (13, "more dots in a row than the 13"), (2, "at least three dots")],
)
def test_another_number_of_dots_is_refused(usual, count, words):
    with pytest.raises(InputError, match=words):
        find_markers(usual, 0.01 * np.arange(1, count + 1), BASE)


def test_a_hidden_dot_is_missed_and_an_empty_wall_has_none(usual, tmp_path):
    hidden = read_grey(usual)
    u, v = np.round(where()[5]).astype(int)
    hidden[v - 15 : v + 15, u - 15 : u + 15] = hidden[v - 13, u - 13]
    wall = np.random.default_rng(0).normal(100, 3, SIZE[::-1]).astype(np.uint8)
    for picture, words in ((hidden, "dots in a row, but 14 are expected"), (wall, "no row of dots, but 14")):
        write_png(tmp_path / "picture.png", picture)
        with pytest.raises(InputError, match=words):
            find_markers(tmp_path / "picture.png", DOTS.s, BASE)


@pytest.mark.parametrize("content", [b"", b"no picture", b"\x89PNG\r\n\x1a\n" + bytes(100)])
def test_invalid_images_are_refused(content, tmp_path):
    path = tmp_path / "bad.png"
    path.write_bytes(content)
    with pytest.raises(InputError, match="not an image that can be read"):
        read_grey(path)
    with pytest.raises(InputError, match="no such photograph"):
        read_grey(tmp_path / "missing.png")
    with pytest.raises(InputError, match="cannot be read"):
        read_grey(tmp_path)


def test_the_overlay_shows_the_row(usual):
    grey = read_grey(usual)
    found = find_markers(usual, DOTS.s, BASE)
    drawn = overlay(grey, found)
    assert drawn.shape[1] >= 1000 and drawn.dtype == np.uint8
    green = np.sum((drawn[..., 1] > 180) & (drawn[..., 0] < 120) & (drawn[..., 2] < 120))
    assert green > 14 * 10  # an outline of ten pixels a dot at least
    assert overlay(grey, replace(found, dots=found.dots[:5])).shape == drawn.shape
