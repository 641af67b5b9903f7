"""The rod against three-dimensional finite elements of touches with friction on the surface of printed cones.

The head of the data file states the method; docs/decisions/0006 has the script that computed it.
"""

import json
from pathlib import Path

import numpy as np
import pytest

from probedesign.rod.rod import Rod

DATA = json.loads((Path(__file__).parents[1] / "data/fem_surface_cases.json").read_text())
CASES = DATA["cases"]
RIGID_RADII = 0.12


def rod_of(case, rigid_radii=RIGID_RADII):
    radius = np.array([case["base_d_m"], case["tip_d_m"]]) / 2.0
    return Rod(
        s=np.array([0.0, case["length_m"]]),
        radius=radius,
        youngs_modulus=case["youngs_modulus_Pa"],
        shear_modulus=case["shear_modulus_Pa"],
        density=case["density_kg_m3"],
        rigid_length=rigid_radii * radius[0],
        finite_strain=True,
    )


def touched(case, rigid_radii=RIGID_RADII, couple=True):
    """Return the equilibrium under the force at the touched point of the rod's deformed surface, and that point."""
    rod, s, force = rod_of(case, rigid_radii), case["s_contact_m"], np.array(case["force_base_N"])
    r, phi = rod.radius_at(s), case["phi_rad"]
    arm = r * np.array([np.cos(phi), np.sin(phi), 0.0])
    for _ in range(12):
        eq = rod.solve(case["gravity_base_m_s2"], force, s, couple=couple * np.cross(arm, force))
        assert eq.result == "ok"
        R = eq.R_at(s)
        arm, before = r * (np.cos(phi) * R[:, 0] + np.sin(phi) * R[:, 1]), arm
        if np.abs(arm - before).max() < 1e-9:
            break
    return eq, eq.p_at(s) + arm


def differences(case, rigid_radii=RIGID_RADII, couple=True):
    """Return the errors of touched point and centreline point [m] and the relative error of the base moment."""
    eq, surface = touched(case, rigid_radii, couple)
    moment = np.array(case["wrench_base"][3:])
    return (
        np.linalg.norm(surface - case["p_surface_section_base_m"]),
        np.linalg.norm(eq.p_at(case["s_contact_m"]) - case["p_centreline_base_m"]),
        np.linalg.norm(eq.wrench_base[3:] - moment) / np.linalg.norm(moment),
    )


@pytest.mark.parametrize("case", CASES, ids=[c["id"] for c in CASES])
def test_the_touched_point_and_the_base_moment_agree(case):
    surface, centreline, moment = differences(case)
    # Distances: the data's own mesh error is a few micrometres (`convergence`), and 0.12 base radii for the root is
    # rounded from 0.117-0.125, 0.03-0.2 % of the deflection (docs/decisions/0006). Measured: 0.014 mm at most, 0.002 mm
    # in the median; a located touch is asked to be within 0.1 mm.
    assert surface < 2e-5 and centreline < 2e-5
    # Moment: the patch's resultant acts up to 0.04 mm inside the surface, so with friction 0.5 its line of action
    # passes 0.02 mm beside the point of an arm of at least 15 mm. Measured: 0.1 % at most, 0.008 % in the median.
    assert moment < 1.5e-3


def test_the_couple_of_friction_and_the_root_are_needed():
    with_both = np.array([differences(case) for case in CASES])
    no_couple = np.array([differences(case, couple=False) for case in CASES])
    bare = np.array([differences(case, rigid_radii=0.0) for case in CASES])
    # A force moved to the centreline leaves out a moment of up to r F: percents of the base moment.
    assert np.median(no_couple[:, 2]) > 10.0 * np.median(with_both[:, 2])
    # The root contributes about 1 % of the deflection (docs/decisions/0006).
    assert np.median(bare[:, 0]) > 10.0 * np.median(with_both[:, 0])
