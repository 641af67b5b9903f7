"""Compare the rod with closed forms, published tables and converged solutions, every entry of data/truth.json."""

import json
from pathlib import Path

import numpy as np
import pytest

from probedesign.rod.rod import Rod

ENTRIES = json.loads((Path(__file__).parents[1] / "data/truth.json").read_text())["entries"]
EXACT = [e for e in ENTRIES if "linear" not in e["expected"]]
LINEAR = [e for e in ENTRIES if "linear" in e["expected"]]


def rod_of(entry):
    return Rod(
        s=np.array([0.0, entry["length_m"]]),
        radius=np.array([entry["base_d_m"], entry["tip_d_m"]]) / 2.0,
        youngs_modulus=entry["youngs_modulus_Pa"],
        shear_modulus=entry["shear_modulus_Pa"],
        density=entry["density_kg_m3"],
        shear_coefficient=entry["shear_coefficient"],
        inextensible=entry["inextensible_unshearable"],
    )


def solve(entry):
    # The helix is one of several equilibria under its load: it is entered at its own tip tangent.
    helix = entry["id"].startswith("helix")
    guess = [*entry["expected"]["tip_tangent"], 1.0, 0.0, 0.0] if helix else None  # any x axis of a round rod
    return rod_of(entry).solve(
        entry["gravity_base_m_s2"],
        entry["force_base_N"],
        entry["s_contact_m"],
        tip_moment=entry["tip_moment_base_Nm"],
        mode="reference",
        guess=guess,
    )


def assert_as_expected(entry, found):
    """Compare within the entry's tolerance relative to the length, to 1 for a direction, to its size for a load."""
    for key, wanted in entry["expected"].items():
        if key.startswith("p_"):
            size = entry["length_m"]
        else:
            size = 1.0 if key == "tip_tangent" else np.linalg.norm(wanted)
        error = np.abs(found[key] - np.array(wanted)).max()
        assert error <= entry["suggested_tolerance"] * size, f"{key} is off by {error:g}"


@pytest.mark.parametrize("entry", EXACT, ids=[e["id"] for e in EXACT])
def test_reference_solution_meets_the_table(entry):
    eq = solve(entry)
    assert eq.result == "ok"
    assert_as_expected(
        entry,
        {
            "p_tip_base_m": eq.p_base[-1],
            "p_contact_base_m": eq.p_contact_base,
            "tip_tangent": eq.R_base[-1, :, 2],
            "base_force_N": eq.wrench_base[:3],
            "moment_base_Nm": eq.wrench_base[3:],
        },
    )


@pytest.mark.parametrize("entry", LINEAR, ids=[e["id"] for e in LINEAR])
def test_a_slight_bend_is_that_of_linear_beam_theory(entry):
    eq, wanted = solve(entry), entry["expected"]["linear"]
    found = {
        "tip_x_m": eq.p_base[-1, 0],
        "contact_x_m": eq.p_contact_base[0],
        "slope_rad": np.arctan2(eq.R_base[-1, 0, 2], eq.R_base[-1, 2, 2]),
    }
    known = {key: value for key, value in wanted.items() if value is not None}
    assert "tip_x_m" in known
    for key, value in known.items():
        # The entries' own tolerance: terms of order (deflection/L)² are left out of the theory.
        assert found[key] == pytest.approx(value, rel=1e-8), key
