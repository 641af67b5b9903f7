"""The rod against three-dimensional finite elements of the printed cones, base face bonded rigid."""

import json
from pathlib import Path

import numpy as np
import pytest

from probedesign.rod.rod import Rod

CASES = json.loads((Path(__file__).parents[1] / "data/fem_cases.json").read_text())["cases"]
RIGID_RADII = 0.12


def differences(case, rigid_radii):
    """Worst centreline error over the tip's deflection, and the base moment's error over itself."""
    radius = np.array([case["base_d_m"], case["tip_d_m"]]) / 2.0
    rod = Rod(
        s=np.array([0.0, case["length_m"]]),
        radius=radius,
        youngs_modulus=case["youngs_modulus_Pa"],
        shear_modulus=case["shear_modulus_Pa"],
        density=case["density_kg_m3"],
        rigid_length=rigid_radii * radius[0],
    )
    eq = rod.solve(case["gravity_base_m_s2"], case["force_base_N"], case["s_contact_m"])
    assert eq.result == "ok"
    p, moment = np.array(case["p_base_m"]), np.array(case["base_moment_Nm"])
    off = np.linalg.norm(eq.p_at(np.array(case["s_m"])) - p, axis=1).max()
    off_moment = np.linalg.norm(eq.wrench_base[3:] - moment)
    return off / case["tip_deflection_m"], off_moment / np.linalg.norm(moment)


@pytest.mark.parametrize("case", CASES, ids=[c["id"] for c in CASES])
def test_the_rigid_root_agrees_and_the_bare_rod_bends_too_much(case):
    rooted, _ = differences(case, RIGID_RADII)
    bare, _ = differences(case, 0.0)
    # 1.5 %: the worst that was left when the correction was fitted, at large bending of the small probe,
    # where the finite elements' section flattens and the rod's does not.
    assert rooted <= 0.015
    assert rooted < bare


def test_the_usual_case_agrees_to_a_hundredth_of_a_millimetre():
    rooted = np.array([differences(case, RIGID_RADII) for case in CASES])
    bare = np.array([differences(case, 0.0) for case in CASES])
    # The medians that were measured when the correction was fitted: 0.07 % and 0.01 %, against 1.1 % without.
    assert np.median(rooted[:, 0]) <= 7e-4
    assert np.median(rooted[:, 1]) <= 1e-4
    assert np.median(bare[:, 0]) >= 1e-2


def test_the_base_carries_the_load_and_the_weight():
    for case in CASES:
        g, F = np.array(case["gravity_base_m_s2"]), np.array(case["force_base_N"])
        radius = np.array([case["base_d_m"], case["tip_d_m"]]) / 2.0
        rod = Rod(np.array([0.0, case["length_m"]]), radius, 1e6, 1e6, case["density_kg_m3"])
        mass = rod.density * rod.body.volume_beyond[0]
        # 1e-9 N: the finite elements' own residual.
        np.testing.assert_allclose(F + mass * g, case["base_force_N"], atol=1e-9)
