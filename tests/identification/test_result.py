"""Caveats and total standard deviations of identified numbers, wherever they are shown or written."""

import numpy as np
import pytest

from probedesign import load_design
from probedesign.cli.identify import _print
from probedesign.estimation.model import ProbeModel
from probedesign.identification.design_update import design_changes
from probedesign.identification.result import (
    Identification,
    Identified,
    SystematicEffect,
    with_caveats,
    with_systematics,
)
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
    model: ProbeModel, *numbers: Identified, shifts: tuple[SystematicEffect, ...] = ()
) -> Identification:
    """Return the numbers as the result of a campaign."""
    found = with_caveats(with_systematics(numbers, shifts, NORMAL), model.rod)
    return Identification(
        "ok", model.name, model.fingerprint, "data", 15, 100, 20, found, np.eye(len(found)),
        tuple(one.name for one in found), (), NORMAL, (), shifts, (), (), 1.0,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("value", "share", "present", "absent"),
    [
        (0.78, 0.099, ("weakly identifiable", "consistent with E/3 and the design's E/3.05"), ()),
        (0.78, 0.03, ("consistent with E/3 and",), ("weakly",)),
        (0.60, 0.03, (), ("weakly", "consistent with")),
        (0.753, 0.006, ("consistent with the design's E/3.05",), ("weakly", "E/3 ")),
    ],
)
def test_caveats_of_G_are_shown_and_written(value, share, present, absent, model: ProbeModel, capsys) -> None:
    found = identification_of(model, number("E", 2.32, 0.002, 2.32), number("G", value, share, 0.761))
    G, design = found.found[1], load_design(LARGE)
    note = next(c.note for c in design_changes(found, design, "2026-01-02") if c.key == "shear_modulus_mpa")
    _print(found)
    console = capsys.readouterr().out
    places = (console, identification_page(found).decode().replace("&#x27;", "'"), note)
    assert all(words in place for words in present for place in places)
    assert not any(words in place for words in absent for place in (console, note))
    assert f"{G.low:.4g} ... {G.high:.4g} in 95 %" in note


def test_written_standard_deviations_include_systematic_effects(model: ProbeModel) -> None:
    """Root of the sum of squares: 0.3 % by the fit, 0.4 % and 1.2 % by causes, are 1.3 %."""
    shifts = (
        SystematicEffect("a", "E", -0.4),
        SystematicEffect("b", "E", 1.2),
        SystematicEffect("a", "G", 5.0),
    )
    found = identification_of(model, number("E", 2.4, 0.003, 2.32), shifts=shifts)
    assert found.found[0].relative_std_total == pytest.approx(0.013, rel=1e-12)  # rounding
    changes = {(one.table, one.key): one for one in design_changes(found, load_design(LARGE), "2026-01-02")}
    assert (
        changes["tolerances", "youngs_modulus"].text
        == changes["material", "stiffness_spread"].text
        == "0.013"
    )
    assert "0.003 by the fit" in changes["tolerances", "youngs_modulus"].note
    assert "2.34 ... 2.462 in 95 %" in changes["material", "youngs_modulus_mpa"].note
    assert changes["tolerances", "youngs_modulus_by_diameter"].text == "-4.00"
