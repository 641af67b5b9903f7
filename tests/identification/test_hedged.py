"""A number that is barely told says so wherever it is shown or written."""

import numpy as np
import pytest

from probedesign import load_design
from probedesign.cli.identify import _print
from probedesign.estimation.model import ProbeModel
from probedesign.identification.design_changes import changes_of
from probedesign.identification.hedged import hedged
from probedesign.identification.identification import Identification, Identified, Shift
from probedesign.identification.report import counted_in_all
from probedesign.reports.identification_page import identification_page
from tests.identification.conftest import LARGE

NORMAL = 1.96


def number(name: str, value: float, share: float, design: float) -> Identified:
    """As a fit tells it, in MPa."""
    std, ends = share * value, [value * float(np.exp(sign * NORMAL * share)) for sign in (-1.0, 1.0)]
    return Identified(
        name, "modulus", "MPa", "identified", value, design, std, *ends, value, std, *ends, by_diameter=-4.0
    )


def told(model: ProbeModel, *numbers: Identified, shifts: tuple[Shift, ...] = ()) -> Identification:
    """They in a campaign's findings."""
    found = hedged(counted_in_all(numbers, shifts, NORMAL), model.rod)
    return Identification(
        "ok", model.name, model.fingerprint, "data", 15, 100, 20, found, np.eye(len(found)),
        tuple(one.name for one in found), (), NORMAL, (), shifts, (), (), 1.0,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("value", "share", "said", "unsaid"),
    [
        (0.78, 0.099, ("barely told", "not told apart from E/3 and the design's E/3.05"), ()),
        (0.78, 0.03, ("not told apart from E/3 and",), ("barely",)),
        (0.60, 0.03, (), ("barely", "apart")),
        (0.753, 0.006, ("not told apart from the design's E/3.05",), ("barely", "E/3 ")),
    ],
)
def test_G_that_E_tells_as_well_is_said_to(value, share, said, unsaid, model: ProbeModel, capsys) -> None:
    found = told(model, number("E", 2.32, 0.002, 2.32), number("G", value, share, 0.761))
    G, design = found.found[1], load_design(LARGE)
    note = next(c.note for c in changes_of(found, design, "2026-01-02") if c.key == "shear_modulus_mpa")
    _print(found)
    console = capsys.readouterr().out
    places = (console, identification_page(found).decode().replace("&#x27;", "'"), note)
    assert all(words in place for words in said for place in places)
    assert not any(words in place for words in unsaid for place in (console, note))
    assert f"{G.low:.4g} ... {G.high:.4g} in 95 %" in note


def test_what_is_written_has_in_it_what_the_fit_does_not_count(model: ProbeModel) -> None:
    """Root of the sum of squares: 0.3 % by the fit, 0.4 % and 1.2 % by causes, are 1.3 %."""
    shifts = (Shift("a", "E", -0.4), Shift("b", "E", 1.2), Shift("a", "G", 5.0))
    found = told(model, number("E", 2.4, 0.003, 2.32), shifts=shifts)
    assert found.found[0].share_in_all == pytest.approx(0.013, rel=1e-12)  # rounding
    changes = {(one.table, one.key): one for one in changes_of(found, load_design(LARGE), "2026-01-02")}
    assert (
        changes["tolerances", "youngs_modulus"].text
        == changes["material", "stiffness_spread"].text
        == "0.013"
    )
    assert "0.003 by the fit" in changes["tolerances", "youngs_modulus"].note
    assert "2.34 ... 2.462 in 95 %" in changes["material", "youngs_modulus_mpa"].note
    assert changes["tolerances", "youngs_modulus_by_diameter"].text == "-4.00"
