"""The state of the studio: every change is checked as a file is, and can be undone and restored."""

import pytest

from probedesign.core.errors import InputError
from probedesign.design.catalog import RESINS, STIFFNESS_SPREAD
from probedesign.design.edit import tables_of
from probedesign.design.io import check_design, load_design, parse_design, render_design
from probedesign.estimation.model import Tolerances
from probedesign.probe import build_probe
from probedesign.studio.session import MAX_PINNED, MERGE_SECONDS, Session, StudioTouch, with_knots


@pytest.fixture
def session():
    return Session(load_design("large"))


def test_a_drag_is_undone_at_once_and_separate_changes_one_by_one(session):
    start = session.design
    for i, length in enumerate((149.0, 140.0, 120.0)):
        assert session.change({"probe.length_mm": length}, now=10.0 + 0.5 * MERGE_SECONDS * i)
    assert session.change({"probe.base_d_mm": 10.0}, now=11.6)
    assert session.undo() and session.design.probe.length_mm == 120.0 and session.design.probe.base_d_mm == 12.0
    assert session.undo() and session.design == start and not session.undo()
    assert session.redo() and session.redo() and session.design.probe.base_d_mm == 10.0 and not session.redo()


def test_an_invalid_change_keeps_the_design_and_gives_the_reason_of_the_file(session):
    start = session.design
    assert not session.change({"probe.tip_d_mm": 14.0}, now=0.0)  # wider than the base
    assert session.design == start and "tip_d_mm" in session.refused and "\n" not in session.refused
    tables = tables_of(start)
    tables["probe"]["tip_d_mm"] = 14.0
    with pytest.raises(InputError) as reason:
        check_design(tables)
    assert str(reason.value) == session.refused
    assert session.change({"probe.tip_d_mm": 3.0}, now=5.0) and not session.refused


@pytest.mark.parametrize("shape", ["cylinder", "profile", "cone"])
@pytest.mark.parametrize("section", ["hollow", "elliptic", "round"])
def test_shapes_and_sections_follow_each_other(session, shape, section):
    assert session.change({"probe.base_d_mm": 14.0}, now=0.0)
    assert session.change({"probe.section": section}, now=2.0), session.refused
    assert session.change({"probe.shape": shape}, now=4.0), session.refused
    assert (session.design.probe.shape, session.design.probe.section) == (shape, section)
    for other in ("cone", "profile"):
        assert session.change({"probe.shape": other}, now=9.0), session.refused


def test_a_profile_keeps_its_knots_when_length_and_ends_change(session):
    assert session.change({"probe.shape": "profile"}, now=0.0)
    assert session.change(with_knots(session.design, {2: 9.5}), now=2.0)
    assert session.change({"probe.length_mm": 120.0}, now=4.0)
    assert session.change({"probe.base_d_mm": 13.0}, now=6.0)
    profile = session.design.probe.profile_mm
    assert [s for s, _ in profile] == [0.0, 30.0, 60.0, 90.0, 120.0]
    assert profile[0][1] == 13.0 and profile[2][1] == 9.5


@pytest.mark.parametrize("resin", sorted(RESINS))
def test_a_resin_brings_its_own_numbers(session, resin):
    assert session.change({"material.resin": resin}, now=0.0)
    assert session.design.youngs_modulus.value == RESINS[resin].youngs_modulus.value
    assert session.design.friction.value == RESINS[resin].friction.value


def test_a_modulus_chosen_by_hand_is_assumed(session):
    assert session.design.youngs_modulus.provenance == "identified"
    assert session.change({"material.youngs_modulus_mpa": 3.0}, now=0.0)
    assert session.design.youngs_modulus.provenance == "assumed"


@pytest.mark.parametrize(
    "values",
    [{"probe.lenght_mm": 3}, {"probe.length_mm": float("nan")}, {"probe.length_mm": -5}, {"probe.length_mm.x": 3},
     {"probe": [], "probe.length_mm": 3}, {"sensor": 3, "sensor.model": "gamma"},
     {"material.provenance": 3, "material.youngs_modulus_mpa": 3}],
)  # fmt: skip
def test_bad_values_give_one_line(session, values):
    assert not session.change(values, now=0.0) and session.refused and "\n" not in session.refused


def test_pins_are_kept_once_and_the_oldest_gives_way(session):
    for n in range(MAX_PINNED + 2):
        session.change({"probe.length_mm": 100.0 + n}, now=10.0 * n)
        assert session.pin() is not None and session.pin() is None
    assert [one.design.probe.length_mm for one in session.pinned] == [102.0, 103.0, 104.0, 105.0]
    assert len({one.label for one in session.pinned}) == MAX_PINNED


def test_an_axis_is_bent_and_straightened(session):
    """Keys that the new kind of axis lacks go, keys that it shares stay."""
    assert session.change({"probe.axis": "arc"}, now=0.0), session.refused
    assert session.change({"probe.axis_bend_deg": 80.0}, now=2.0)
    assert session.change({"probe.axis": "helix"}, now=4.0), session.refused
    probe = session.design.probe
    assert (probe.axis_bend_deg, probe.axis_turns, probe.axis_azimuth_deg) == (80.0, 0.5, 0.0)
    assert not session.change({"probe.axis_bend_deg": 2000.0}, now=6.0) and "axis_bend_deg" in session.refused
    assert session.change({"probe.axis": "straight"}, now=8.0)
    assert session.design.probe == load_design("large").probe


def test_a_changed_body_has_assumed_stiffness_and_the_same_body_keeps_its_own(session):
    """What was identified on the paper's prints says nothing of a print of another body."""
    moduli = {"material.youngs_modulus_mpa", "material.shear_modulus_mpa"}
    assert session.change({"contact.friction": 0.4}, now=0.0)
    assert not moduli & set(session.design.assumptions)
    assert session.change({"probe.length_mm": 140.0}, now=2.0)
    assert moduli <= set(parse_design(render_design(session.design)).assumptions)
    assert session.design.youngs_modulus.value == load_design("large").youngs_modulus.value
    known = Tolerances.of(build_probe(session.design).model)
    assert known.youngs_modulus == pytest.approx(STIFFNESS_SPREAD.value)
    assert session.undo() and not moduli & set(session.design.assumptions)


def test_a_link_restores_the_state_and_a_damaged_one_changes_nothing(session):
    assert session.change({"probe.length_mm": 130.0}, now=0.0)
    session.pin()
    assert session.change({"probe.section": "hollow"}, now=2.0)
    session.touch, session.forces_mN = StudioTouch(0.5, 30.0, 20.0), (5.0, 10.0)
    other = Session(load_design("small"))
    for damaged in ("", "x", session.link[:-9], session.link[9:]):
        with pytest.raises(InputError, match="link is damaged"):
            other.open_link(damaged)
    assert other.design == load_design("small") and not other.pinned
    other.open_link(session.link)
    assert (other.design, other.touch, other.forces_mN) == (session.design, session.touch, session.forces_mN)
    assert other.pinned == session.pinned
    assert other.undo() and other.design == load_design("small")


def test_the_pinned_design_and_the_current_one_are_exchanged(session):
    assert not session.toggle()
    session.pin()
    start = session.design
    assert session.change({"probe.length_mm": 130.0}, now=0.0) and session.former == start
    changed = session.design
    assert session.toggle() and session.design == start
    assert session.toggle() and session.design == changed
