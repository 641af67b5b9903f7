"""Intervals and total standard deviations of identified numbers, wherever they are shown or written."""

from dataclasses import replace

import numpy as np

from probedesign import load_design
from probedesign.cli.identify import _print
from probedesign.estimation.model import ProbeModel
from probedesign.identification.design_update import design_changes
from probedesign.identification.result import ErrorContribution, Identification, Identified
from probedesign.reports.identification_page import identification_page
from tests.identification.conftest import LARGE

NORMAL = 1.96


def number(name: str, value: float, share: float, design: float) -> Identified:
    """Return a number as a fit has it, in MPa."""
    std, ends = share * value, [value * float(np.exp(sign * NORMAL * share)) for sign in (-1.0, 1.0)]
    return Identified(
        name, "modulus", "MPa", "identified", value, design, std, *ends, value, std, *ends, by_diameter=-4.0
    )


def identification_of(
    model: ProbeModel, *numbers: Identified, shifts: tuple[ErrorContribution, ...] = ()
) -> Identification:
    """Return the numbers as the result of a campaign."""
    return Identification(
        "ok", model.name, model.fingerprint, "data", 15, 100, 20, numbers, np.eye(len(numbers)),
        tuple(number.name for number in numbers), (), NORMAL, (), shifts, (), (), 1.0,
    )  # fmt: skip


def test_the_interval_of_G_is_shown_and_written(model: ProbeModel, capsys) -> None:
    found = identification_of(model, number("E", 2.32, 0.002, 2.32), number("G", 0.78, 0.03, 0.761))
    G, design = found.found[1], load_design(LARGE)
    note = next(c.note for c in design_changes(found, design, "2026-01-02") if c.key == "shear_modulus_mpa")
    _print(found)
    for text in (capsys.readouterr().out, identification_page(found).decode(), note):
        assert f"{G.low:.4g} ... {G.high:.4g}" in text


def test_what_follows_from_a_prior_is_written_as_such(model: ProbeModel) -> None:
    """G beside a new E is neither stale nor called identified."""
    E = number("E", 2.4, 0.003, 2.32)
    G = replace(number("G", 0.805, 0.007, 0.761), result="inferred", why="E/G by a prior")
    found = identification_of(model, E, G, shifts=(ErrorContribution("gain", "E", 0.2),))
    changes = {(one.table, one.key): one for one in design_changes(found, load_design(LARGE), "2026-01-02")}
    assert changes["tolerances", "youngs_modulus"].text == "0.003"
    assert changes["material", "stiffness_spread"].text == "0.003"
    assert changes["tolerances", "youngs_modulus_by_diameter"].text == "-4.00"
    assert changes["material", "shear_modulus_mpa"].text == "0.805"
    assert changes["material", "shear_modulus_mpa"].note.startswith("E/G by a prior")
    assert changes["material.provenance", "shear_modulus_mpa"].text == '"assumed"'
    assert changes["material.provenance", "youngs_modulus_mpa"].text == '"identified"'


def test_a_change_is_that_of_value_and_interval_from_the_design() -> None:
    """Moduli in percent, the root in base radii; a number without an interval, or a pose, has none."""
    E = Identified("E", "", "MPa", "identified", 2.2, 2.0, std=0.05, low=2.1, high=2.3)
    root = Identified("root", "", "", "inferred", -0.18, 0.12, std=0.1, low=-0.38, high=0.02)
    assert E.change == "+10.0 % (+5.0 ... +15.0 %)" and root.change == "-0.3 (-0.5 ... -0.1)"
    assert replace(E, result="not_observable", low=None, high=None).change == ""
    assert Identified("tilt_x", "", "deg", "identified", 0.1, 0.0, std=0.1, low=-0.1, high=0.3).change == ""
