"""Ground truth of the source `sim:` and of simulated campaigns: contact at a given section of the rod, sensor noise.

Contacts with objects at a given place in space are in `scenes`. All simulators take their noise from here: white noise
is that of the frozen probe, which states it for the mean of `averaging_samples` samples; the bias of each channel walks
at a rate stated per √s.
"""

import math
from typing import NamedTuple

import numpy as np

from probedesign.core.frames import Array
from probedesign.estimation.force_moment import surface_point
from probedesign.estimation.model import ProbeModel
from probedesign.rod.contact import line_of_action, solve_frictionless, solve_surface_force
from probedesign.rod.equilibrium import Equilibrium
from probedesign.rod.rod import Mode, Rod


class RodContact(NamedTuple):
    """A contact with the rod; all but `result` and `equilibrium` is meaningful only with result "ok"."""

    result: str  #: "ok" or the code of the equilibrium that was not found.
    equilibrium: Equilibrium  #: of the rod under the contact.
    s_contact: float  #: arclength where the line of action of the force passes the centreline [m].
    p_contact_base: Array  #: point of the centreline there [m], (3,).
    force_base: Array  #: force of the object on the probe [N], (3,).
    p_surface_base: Array  #: touched point of the surface [m], (3,).


def solve_contact(
    rod: Rod,
    gravity_base: Array,
    s: float,
    push_angle: float,
    normal_force: float,
    friction_ratios: tuple[float, float] | None = None,
    mode: Mode = "fast",
) -> RodContact:
    """Return the contact of an object that pushes on the section at s.

    Args:
        rod: the rod.
        gravity_base: gravity in base axes [m/s²], (3,).
        s: arclength of the contact [m]; with friction, of the touched section.
        push_angle: direction of the push about the tangent, from the x axis of the section [rad].
        normal_force: force normal to the surface [N].
        friction_ratios: axial and circumferential force over normal force; None for a contact without friction.
        mode: "fast" or "reference".
    """
    missing = np.full(3, np.nan)
    if friction_ratios is None:
        frictionless = solve_frictionless(rod, gravity_base, s, push_angle, normal_force, mode=mode)
        eq = frictionless.equilibrium
        if frictionless.result != "ok":
            return RodContact(frictionless.result, eq, s, missing, missing, missing)
        surface = surface_point(rod, eq)
        return RodContact("ok", eq, eq.s_contact, eq.p_contact_base, frictionless.force_base, surface)
    # The touched point lies opposite to the direction of the push.
    angle = push_angle + math.pi
    contact = solve_surface_force(rod, gravity_base, s, angle, normal_force, friction_ratios, mode)
    eq = contact.equilibrium
    if contact.result != "ok":
        return RodContact(contact.result, eq, s, missing, missing, missing)
    s_axis = line_of_action(rod, eq, contact.p_surface_base)
    return RodContact("ok", eq, s_axis, eq.p_at(s_axis), contact.force_base, contact.p_surface_base)


# noise of the sensor


def reading_std(model: ProbeModel) -> Array:
    """Return the standard deviations of one reading, the mean of `averaging_samples` samples [N, N·m], (6,)."""
    return model.noise.std


def sample_std(model: ProbeModel) -> Array:
    """Return the standard deviations of one sample [N, N·m], (6,); a step of the resolution is taken as large."""
    return reading_std(model) * math.sqrt(model.averaging_samples)


def bias_step(rng: np.random.Generator, rate: float, seconds: float) -> Array:
    """Return how far the bias walks in a time [s], (6,).

    `rate` is the standard deviation of each channel per √s, in any unit, which is also that of the result.
    """
    return rng.normal(0.0, rate * math.sqrt(seconds), 6)
