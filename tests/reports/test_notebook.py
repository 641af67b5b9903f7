"""What results show in a notebook: tables with units, pictures, data frames; and the tutorial notebooks run."""

import ast
import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

import probedesign
from probedesign.identification.result import Identification, Identified, Residual

ROOT = Path(__file__).parents[2]
NOTEBOOKS = sorted((ROOT / "docs/notebooks").glob("*.ipynb"))
GRAVITY = (9.81, 0.0, 0.0)


@pytest.fixture(scope="module")
def design():
    return probedesign.load_design(ROOT / "designs/large.toml")


@pytest.fixture(scope="module")
def probe(design):
    return probedesign.build_probe(design)


@pytest.fixture(scope="module")
def prediction(probe):
    return probe.predict(fractions=(0.4, 0.8), forces_N=(0.01, 0.02), directions=("+x", "+y"))


@pytest.fixture(scope="module")
def estimate(probe):
    touch = probedesign.solve_frictionless(probe.rod, GRAVITY, 0.12, 0.3, 0.02)
    return probe.estimator().estimate(touch.equilibrium.wrench_base)


@pytest.fixture(scope="module")
def free(probe):
    return probe.estimator().estimate(probe.solve().wrench_base)


@pytest.fixture(scope="module")
def fused(probe):
    wrenches, poses = [], []
    for force in (0.002, 0.005):
        touch = probedesign.solve_frictionless(probe.rod, GRAVITY, 0.105, 1.57, force)
        wrenches.append(touch.equilibrium.wrench_base)
        pose = np.eye(4)
        pose[:3, 3] = -touch.equilibrium.p_contact_base
        poses.append(pose)
    return probe.estimator().fuse(wrenches, poses, GRAVITY)


@pytest.fixture
def identification():
    modulus = Identified("E", "Young's modulus", "MPa", "identified", 2.5, 2.32, 0.02, 2.46, 2.54)
    tilt = Identified("tilt_x", "tilt", "deg", "not_observable", 0.0, 0.0, why="the <tests> hang")
    residuals = tuple(Residual(test, "markers", 1, 10.0, (0.1, 0.0, 0.1), 1.1, 1.0) for test in ("hang", "weight"))
    return Identification(
        "inconsistent", "large", "abc", "data", 2, 6, 3, (modulus, tilt), np.eye(1), ("E",), (), 1.96, (), (), (),
        residuals, 0.1, "<script>alert(1)</script>",
    )  # fmt: skip


PICTURED = ("design", "probe", "prediction", "estimate", "identification")


@pytest.mark.parametrize("name", [*PICTURED, "fused"])
def test_a_result_shows_a_table_and_a_picture(name, request):
    """The HTML is well-formed, so that it cannot spoil the notebook; the picture has a text alternative."""
    thing = request.getfixturevalue(name)
    bundle = thing._repr_mimebundle_()
    html = ElementTree.fromstring(bundle["text/html"])
    cells = ["".join(cell.itertext()) for cell in html.iter() if cell.tag in ("td", "th")]
    pictures = [one for one in html.iter() if one.tag.endswith("svg")]
    assert len(pictures) == (name in PICTURED)
    assert all(picture.get("role") == "img" and picture.get("aria-label") for picture in pictures)
    assert bundle["text/html"] == thing._repr_html_() and len(cells) > 4
    assert all(cell in bundle["text/plain"] for cell in cells)


def test_plot_draws_into_the_axes_that_are_given_or_makes_them(request, free):
    pyplot = pytest.importorskip("matplotlib.pyplot")
    pyplot.switch_backend("agg")
    for name in PICTURED:
        axes = pyplot.figure().subplots()
        assert request.getfixturevalue(name).plot(axes) is axes
        assert axes.get_title() and (axes.lines or axes.patches) and axes.get_xlabel() + axes.get_ylabel()
        axes.figure.savefig("/dev/null", format="svg")  # every element can be drawn
    empty = free.plot()
    assert not empty.lines and "no_contact" in empty.get_title()
    pyplot.close("all")


def test_hostile_text_is_escaped(identification):
    html = identification._repr_html_()
    assert "<script" not in html and "the &lt;tests&gt; hang" in html
    assert "2.5 MPa" in html and "2.46 ... 2.54" in html


def test_a_reading_without_contact_shows_no_position(free):
    assert free.result == "no_contact"
    assert "svg" not in free._repr_html_() and "nan" not in free._repr_html_() and "mm" not in free._repr_html_()
    assert len(free.to_dataframe()) == 0


def test_the_picture_of_an_estimate_contains_the_touched_point(estimate):
    x, _, z = 1e3 * estimate.p_surface_base
    assert f"mm]: {z:.4g}\n" in estimate._repr_html_() and f"[mm]: {x:.3g}</title>" in estimate._repr_html_()


def test_a_data_frame_has_the_values_of_the_result(prediction, estimate, fused, identification):
    pytest.importorskip("pandas")
    frame = prediction.to_dataframe()
    single = frame[frame.touches == 1]
    assert single.predicted_error_mm.tolist() == [c.predicted_error_mm for c in prediction.conditions]
    assert len(frame) == len(prediction.conditions) + len(prediction.fused)
    units = ("_mm", "_mm2", "_N", "_mN", "_Nmm")
    for table in (frame, estimate.to_dataframe(), fused.to_dataframe()):
        assert table.columns.is_unique and sum(column.endswith(units) for column in table.columns) >= 3
    best = estimate.to_dataframe().iloc[0]
    assert best.s_contact_mm == pytest.approx(1e3 * estimate.s_contact, rel=1e-12)  # rounding
    assert best.rms_mm == pytest.approx(1e3 * math.sqrt(np.trace(estimate.cov_surface_base)), rel=1e-12)
    assert fused.to_dataframe().force_normal_N.tolist() == fused.force_normal.tolist()
    assert identification.to_dataframe().set_index("name").loc["E", "high"] == 2.54


def test_the_probe_and_its_model_show_the_same(probe):
    assert probe._repr_html_() == probe.model._repr_html_()


def test_a_buckled_probe_is_named(probe):
    soft = replace(probe.model, gravity_base=np.array([0.0, 0.0, -900.0]))
    assert "buckles" in soft._repr_html_()


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_tutorial_notebook_runs(path, monkeypatch):
    """In this process, without a kernel: the last expression of each cell shows itself as it would in one."""
    pyplot = pytest.importorskip("matplotlib.pyplot")
    pytest.importorskip("pandas")
    pyplot.switch_backend("agg")
    monkeypatch.chdir(path.parent)
    names, shown = dict[str, Any](), list[str]()
    for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
        body = ast.parse("".join(cell["source"])).body if cell["cell_type"] == "code" else []
        last = body.pop() if body and isinstance(body[-1], ast.Expr) else None
        exec(compile(ast.Module(body, []), str(path), "exec"), names)
        if last is not None:
            result = eval(compile(ast.Expression(last.value), str(path), "eval"), names)
            shown.append(result._repr_html_() if hasattr(result, "_repr_html_") else repr(result))
    assert pyplot.get_fignums() and any("<svg" in text for text in shown) and any("<table" in text for text in shown)
    pyplot.close("all")


def test_committed_notebooks_have_no_outputs():
    assert len(NOTEBOOKS) == 2
    for path in NOTEBOOKS:
        assert not any(cell.get("outputs") for cell in json.loads(path.read_text(encoding="utf-8"))["cells"])
