"""Tests that a laboratory could make: free hangs, weights and touches, each solved for the probe as designed.

A candidate carries the readings that the designed probe would give, without noise, so that a campaign of candidates
goes through the same residuals and derivatives as a measured one.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np

from probedesign.campaigns.campaign import MARKERS, Campaign, Markers, Test, Use
from probedesign.core.errors import InputError
from probedesign.core.frames import Array, pose, rotation_under_gravity
from probedesign.core.statistics import rms
from probedesign.core.units import MM
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.model import ProbeModel
from probedesign.prediction.touches import DIRECTIONS
from probedesign.rod.contact import outline, solve_frictionless, surface_point
from probedesign.rod.equilibrium import Equilibrium
from probedesign.simulation.ground_truth import BASE_POSITION, marker_arclengths

SetUp = Literal["weighing", "calipers", "hang", "turned", "weight", "touch"]
#: Duration of each kind of test [min], with the wait until creep has settled: assumed until a laboratory times its own.
MINUTES: dict[SetUp, float] = dict(weighing=5.0, calipers=10.0, hang=4.0, turned=8.0, weight=5.0, touch=4.0)
#: Readings of the sensor in each test. Their noise is then below the drift of the bias, which more do not reduce.
READINGS = 20
#: Standard deviation of the arclength of a mark on the probe [m] (assumed: a pencil line set with a caliper).
STD_MARK = 0.5 * MM
WEIGHT_PLACES = (0.4, 0.6, 0.8, 0.95)
TOUCH_PLACES = (0.35, 0.5, 0.65, 0.8, 0.92)  #: Fractions of the length with a mark.
#: Displacement of the touched section over its arclength. Farther, the probe slides along the edge (assumed).
DISPLACEMENTS = (0.06, 0.14, 0.25)
ROUNDED = 0.5 * MM  #: Step of proposed marks and displacements.
#: Bisection for the force of a displacement, and the relative error that ends it.
MAX_PRESS_STEPS, DISPLACEMENT_ERROR = 40, 0.02
#: Stated error of the located contact over the length up to which a touch is proposed. Simulated touches with a larger
#: one are located in nine of ten campaigns or fewer (docs/measurements.md).
MAX_STATED_ERROR = 0.06
#: Displacement of the loaded section over its arclength up to which a weight is proposed: beyond it a thread slips on a
#: steep probe (assumed).
MAX_DEFLECTION = 0.6
#: Orientations of the base: direction of gravity in base axes.
TURNS = {"tip down": (0.0, 0.0, 1.0), "tip up": (0.0, 0.0, -1.0), "x down": (1.0, 0.0, 0.0), "x up": (-1.0, 0.0, 0.0),
         "y down": (0.0, 1.0, 0.0), "y up": (0.0, -1.0, 0.0)}  # fmt: skip


@dataclass(frozen=True)
class Instruments:
    """What the bench has besides the force/torque sensor."""

    #: standard deviation of a place that a stage measures, on each axis [m]; None without a stage.
    stage: float | None = 0.05 * MM
    #: standard deviation of a marker, on each axis [m]; None without cameras or another reference.
    cameras: float | None = None
    weights: tuple[float, ...] = (0.5e-3, 1e-3, 2e-3, 5e-3)  #: masses that can be hung [kg].
    turnable: bool = True  #: whether the base can be held in other orientations, with known poses.
    balance: float | None = 1e-5  #: standard deviation of a weighing [kg]; None without a balance.
    calipers: float | None = 0.05 * MM  #: standard deviation of a measured diameter [m]; None without calipers.
    #: standard deviations of the base pose in the frame of the reference [m, rad].
    std_base: tuple[float, float] = (0.2 * MM, math.radians(0.2))

    @property
    def std_place(self) -> float | None:
        """Standard deviation of a touched place, by the stage, else by the cameras [m]."""
        return self.cameras if self.stage is None else self.stage


@dataclass(frozen=True, eq=False)
class CandidateTest:
    """A test that could be made."""

    set_up: SetUp  #: kind of the test.
    #: as `campaigns.Test`, with the readings of the designed probe; None for a weighing and calipers.
    test: Test | None
    shape: Equilibrium | None  #: of the designed probe; None as well.
    words: str  #: what to do, one line.
    mass: float = 0.0  #: of the weight [kg]; 0 without.
    mark: float = math.nan  #: arclength of the mark on the surface where the load acts [m]; NaN without a load.
    displacement: float = 0.0  #: of the touched point by the stage [m]; 0 for other tests.
    held_out: bool = False  #: whether it is for `validate`, and `identify` leaves it out.

    @property
    def name(self) -> str:
        """Name of the test, or of what is measured."""
        return self.set_up if self.test is None else self.test.name

    @property
    def minutes(self) -> float:
        """Its usual duration [min]."""
        return MINUTES[self.set_up]

    def named(self, name: str, held_out: bool = False, time: float = math.nan) -> "CandidateTest":
        """Return it with a name of its own, and the time since the start when it is made [s]."""
        assert self.test is not None
        use: Use = "validate" if held_out else ""
        return replace(self, test=replace(self.test, name=name, use=use, time=time), held_out=held_out)


@dataclass(frozen=True, eq=False)
class Bench:
    """The designed probe on a bench: makes candidates."""

    model: ProbeModel  #: of the probe as designed.
    instruments: Instruments  #: of the bench.
    gravity_world: Array = field(init=False)

    def __post_init__(self) -> None:
        size = float(np.linalg.norm(self.model.gravity_base))
        if size == 0.0:
            raise InputError("mount.gravity_base_m_s2 is zero; a campaign needs gravity")
        object.__setattr__(self, "gravity_world", np.array([0.0, 0.0, -size]))

    def T_world_base(self, gravity_base: Array) -> Array:
        """Return the pose of the base with gravity in this direction of its axes, (4, 4)."""
        return pose(rotation_under_gravity(gravity_base), BASE_POSITION)

    def campaign(self, candidates: list[CandidateTest]) -> Campaign:
        """Return the candidates' tests as a campaign; its weighing is apart."""
        model, std = self.model, self.instruments.std_base
        marker_s = np.array(marker_arclengths(model.rod.length)) if self.instruments.cameras else np.zeros(0)
        tests = tuple(candidate.test for candidate in candidates if candidate.test is not None)
        return Campaign(model.name, model.fingerprint, self.T_world_base(model.gravity_base), *std,
                        self.gravity_world, marker_s, None, tests, None, Path("plan"))  # fmt: skip

    def candidates(self) -> list[CandidateTest]:
        """Return all tests that could be made, the free hang as mounted first.

        Raises:
            InputError: the designed probe does not hang stably in its mount.
        """
        eq = self.model.rod.solve(self.model.gravity_base)
        if not eq.ok:
            raise InputError(f"{self.model.name} has no stable equilibrium in its mount ({eq.result})")
        words = "Let the probe hang free as mounted."
        candidates = [self._candidate("hang", "hang", eq, np.zeros(3), words=words)]
        if self.instruments.turnable:
            candidates += self._turned()
        candidates += self._weights()
        if self.instruments.std_place is not None:
            candidates += self._touches()
        if self.instruments.balance is not None:
            candidates.append(CandidateTest("weighing", None, None, "Weigh the printed probe with its flange."))
        if self.instruments.calipers is not None:
            words = "Measure the diameter at each mark, twice, at a right angle, without pressing it in."
            candidates.append(CandidateTest("calipers", None, None, words))
        return candidates

    def _turned(self) -> Iterator[CandidateTest]:
        size = float(np.linalg.norm(self.model.gravity_base))
        for name, direction in TURNS.items():
            gravity = size * np.array(direction)
            eq = self.model.rod.solve(gravity)
            if eq.ok and gravity @ self.model.gravity_base < 0.9 * size**2:
                words = f"Turn the base: {name}. Let the probe hang free, and note the pose of the base."
                slug = "turned-" + name.replace(" ", "-")
                yield self._candidate("turned", slug, eq, np.zeros(3), gravity_base=gravity, words=words)

    def _weights(self) -> Iterator[CandidateTest]:
        rod, down = self.model.rod, self.gravity_world / np.linalg.norm(self.gravity_world)
        R = self.T_world_base(self.model.gravity_base)[:3, :3]
        free = rod.solve(self.model.gravity_base)
        for fraction in WEIGHT_PLACES:
            s = _rounded(fraction * rod.length)
            for mass in self.instruments.weights:
                force = mass * float(np.linalg.norm(self.gravity_world)) * down
                eq = rod.solve(self.model.gravity_base, R.T @ force, s)
                if not eq.ok or np.linalg.norm(eq.p_at(s) - free.p_at(s)) > MAX_DEFLECTION * s:
                    continue
                words = f"Hang {1e3 * mass:g} g by a thread at the mark s = {s / MM:g} mm."
                yield self._candidate("weight", f"weight-{s / MM:g}-{1e3 * mass:g}", eq, force, s=s,
                                      words=words, mass=mass, mark=s)  # fmt: skip

    def _touches(self) -> Iterator[CandidateTest]:
        rod, gravity, estimator = self.model.rod, self.model.gravity_base, Estimator(self.model)
        for fraction in TOUCH_PLACES:
            s = _rounded(fraction * rod.length)
            for direction in DIRECTIONS:
                for share in DISPLACEMENTS:
                    moved = _rounded(share * s)
                    eq = self._pressed(s, DIRECTIONS[direction], moved)
                    if eq is None:
                        continue
                    estimate = estimator.estimate(np.tile(eq.wrench_base, (READINGS, 1)), gravity)
                    if not estimate.ok or rms(estimate.cov_surface_base) >= MAX_STATED_ERROR * rod.length:
                        continue
                    words = f"Push the mark s = {s / MM:g} mm by {moved / MM:g} mm toward {direction} of the base."
                    name = f"touch-{s / MM:g}-{direction}-{moved / MM:g}"
                    yield self._candidate("touch", name, eq, None, s=eq.s_contact, direction=direction,
                                          words=words, mark=s, displacement=moved)  # fmt: skip

    def _pressed(self, mark: float, angle: float, displacement: float) -> Equilibrium | None:
        """Return the probe pressed at a mark without friction until the section has moved so far; None if it does not
        get there within the range of the sensor.

        The line of the force comes nearest to the axis at s = mark - r g tan α, nearer to the base than the mark.
        """
        rod, gravity = self.model.rod, self.model.gravity_base
        radius, reach = float(rod.radius_at(mark)), outline(rod.flatness, np.cos(angle), np.sin(angle))[0]
        s = float(np.clip(mark - radius * reach**2 * rod.taper_at(mark), 0.01 * rod.length, rod.flank_end))
        start = rod.solve(gravity).p_at(s)
        low, high = 0.0, math.nan
        force = 0.75 * math.pi * rod.youngs_modulus * radius**4 * displacement / s**3  # of a cantilever
        for _ in range(MAX_PRESS_STEPS):
            contact = solve_frictionless(rod, gravity, s, angle, force)
            eq = contact.equilibrium
            moved = float(np.linalg.norm(eq.p_at(s) - start)) if contact.result == "ok" else math.inf
            if abs(moved - displacement) < DISPLACEMENT_ERROR * displacement:
                return eq if self.model.in_range(self.model.to_sensor(eq.wrench_base, gravity)) else None
            low, high = (force, high) if moved < displacement else (low, force)
            force = 2.0 * force if math.isnan(high) else 0.5 * (low + high)
        return None

    def _candidate(
        self,
        set_up: SetUp,
        name: str,
        eq: Equilibrium,
        force_world: Array | None,
        *,
        words: str,
        gravity_base: Array | None = None,
        s: float = math.nan,
        direction: str = "",
        mass: float = 0.0,
        mark: float = math.nan,
        displacement: float = 0.0,
    ) -> CandidateTest:
        gravity = self.model.gravity_base if gravity_base is None else gravity_base
        T = self.T_world_base(gravity)
        rod, touched, std_place, markers = self.model.rod, None, math.nan, None
        if force_world is None:
            assert self.instruments.std_place is not None
            touched, std_place = T[:3, :3] @ surface_point(rod, eq) + T[:3, 3], self.instruments.std_place
        if (std := self.instruments.cameras) is not None:
            marked = np.array(marker_arclengths(rod.length))
            p, n = eq.p_at(np.minimum(marked, rod.length)) @ T[:3, :3].T + T[:3, 3], len(marked)
            markers = Markers(np.arange(n), p, np.tile(std**2 * np.eye(3), (n, 1, 1)), MARKERS)
        std_s = math.nan if math.isnan(s) else STD_MARK
        test = Test(
            name, T, self.gravity_world, force_world, s, std_s, touched, std_place, direction, math.nan, math.nan,
            np.tile(eq.wrench_base, (READINGS, 1)), "base", markers,
        )  # fmt: skip
        return CandidateTest(set_up, test, eq, words, mass, mark, displacement)


def _rounded(length: float) -> float:
    return max(round(length / ROUNDED), 1) * ROUNDED
