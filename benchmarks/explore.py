"""What `explore` reaches on the simulated card house: through the command, and through `fuse` from Python.

The large probe, E known to 1 %, the base 0.05 mm off in common and 0.01 mm from pose to pose, no touch above 5 mN. Once
the poses tell the base's turn and `explore` is told so; once it is off as the tolerances have it, tilt 0.2°, clocking
0.5°.
Through the command the sensor's bias walks as the contact test assumes, 0.05 steps of its resolution in a root second,
which is 0.2 from touch to touch; through `fuse` it walks 0.2 steps from each pose to the next.
"""

import csv
import io
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass, replace
from itertools import count, islice
from pathlib import Path

import numpy as np
from scipy.stats import beta

from benchmarks.figures import draw_card_house
from benchmarks.timing import print_table
from benchmarks.touches import paper_models
from probedesign.cli.main import run
from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.core.units import MILLINEWTON, MM
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.model import ProbeModel
from probedesign.estimation.tolerances import Tolerances
from probedesign.frozen_probe import write_frozen
from probedesign.mapping.contact_map import CHI2_95
from probedesign.mapping.touch_point import BasePoseUncertainty
from probedesign.rod.friction import ASSUMED_FRICTION
from probedesign.simulation.scenes import card_house, touch_targets
from probedesign.simulation.simulated_run import RunErrors, SimulatedRun, simulate_run, write_run

COMMANDS, HOUSES = 3, 20
"""Runs of the command, each a house of its own; houses fused from Python. Touches of a house share E and its base, so
they hold or miss together: many houses tell more than many draws of one."""
READINGS = 50
"""To a pose, in Python: a quarter of a second of a Net F/T box's samples, averaged by 36."""
FRICTION = ASSUMED_FRICTION
"""Median friction coefficient of the cards."""
TARGET = 2.0
SYMMETRIC = np.array([[3, 4, 5], [4, 6, 7], [5, 7, 8]])
"""Where a row of place and covariance has the covariance's entries."""
STILL = ("--tilt-deg", "0", "--clocking-deg", "0")
"""Options of `explore` for a base whose stated poses have no error of rotation."""


@dataclass(frozen=True)
class Found:
    """What was found of points that were touched.

    Attributes:
        off: from the true points [mm], NaN where a touch was not located, (n,).
        chi2: squared Mahalanobis distance of each from its true point, (n,).
        rows: place and covariance xx, xy, xz, yy, yz, zz of those located [mm, mm²], (k, 9).
    """

    off: Array
    chi2: Array
    rows: Array


def report() -> None:
    """Print what is reached, and draw the first house."""
    model = replace(paper_models()["large"], stiffness_spread=0.01)
    turned = RunErrors.from_priors(model, BasePoseUncertainty(), FRICTION)
    houses = list(islice(_houses(model), HOUSES))
    runs = [_through_command(model, house, seed, STILL) for seed, house in enumerate(houses[:COMMANDS])]
    turns = [_through_command(model, simulate_run(model, touch_targets(), np.random.default_rng(seed), turned), seed)
             for seed in range(COMMANDS)]  # fmt: skip
    fused = [_through_fuse(model, house, np.random.default_rng(100 + i)) for i, house in enumerate(houses)]
    ways = {"command, points": runs, "command, base turned": turns, "fuse, single touches": fused}
    head = [
        "way",
        "located",
        f"within {TARGET:g} mm",
        "95 % interval of that",
        "95 % within",
        "median",
        "worst",
    ]
    title = f"Card house, {len(touch_targets())} touches of 25 points a run, errors in mm"
    print_table(title, head, [[way, *_errors(found)] for way, found in ways.items()])
    print_table("Do the ellipsoids come true?",
                ["way", "in the 95 % ellipsoid", "95 % interval of that", "mean χ², 3 is right", "stated RMS [mm]",
                 "RMS error [mm]"],
                [[way, *_honesty(found)] for way, found in ways.items()])  # fmt: skip
    touches = [touch for house in houses for touch in house.touches]
    print_table("What the object and the sensor feel",
                ["greatest force", "greatest moment about the base", "least room to the card behind"],
                [[f"{max(t.force for t in touches) / MILLINEWTON:.2f} mN",
                  f"{1e3 * max(t.moment for t in touches):.2f} N·mm",
                  f"{min(t.clearance for t in touches) / MM:.2f} mm"]])  # fmt: skip
    cards, meant = (
        [card.corners / MM for card in card_house()],
        [target.p_world / MM for target in touch_targets()],
    )
    draw_card_house(cards, runs[0].rows, np.array(meant))


def _houses(model: ProbeModel) -> Iterator[SimulatedRun]:
    """Houses touched, without those whose base is so far off that it misses an edge."""
    for seed in count():
        with suppress(InputError):
            yield simulate_run(
                model, touch_targets(), np.random.default_rng(seed), RunErrors(friction=FRICTION)
            )


def _through_command(model: ProbeModel, house: SimulatedRun, seed: int, known: Sequence[str] = ()) -> Found:
    """All points; `known` are the options that say how well the base is known."""
    with tempfile.TemporaryDirectory() as folder:
        at = Path(folder)
        write_frozen(model, at / "large.probe.json")
        write_run(house, model, at, np.random.default_rng(1000 + seed))
        _run(["explore", f"{at}/large.probe.json", f"{at}/house.mcap", "--pose", f"{at}/poses.csv",
              "--tare-s", "0.5:3.5", "--average", "36", "--out", f"{at}/found", *known])  # fmt: skip
        with (at / "found/points.csv").open(encoding="utf-8") as file:
            found = [row for row in csv.DictReader(file) if row["result"] == "ok"]
    names = [f"{axis}_world_mm" for axis in "xyz"]
    names += [f"cov_world_{name}_mm2" for name in ("xx", "xy", "xz", "yy", "yz", "zz")]
    rows = np.array([[float(row[name]) for name in names] for row in found]).reshape(-1, 9)
    times = [float(row["time_s"]) for row in found]
    truth, starts = np.array([t.p_world for t in house.touches]) / MM, [t.start for t in house.touches]
    nearest = [int(np.argmin(np.abs(np.array(starts) - time))) for time in times]
    missing = max(sum(not t.target.repeated for t in house.touches) - len(found), 0)
    return _compared(rows, truth[nearest], missing)


def _compared(rows: Array, truth: Array, missing: int) -> Found:
    """What was found, beside the true points [mm], (k, 3)."""
    off = rows[:, :3] - truth
    chi2 = np.einsum("ka,ka->k", off, np.linalg.solve(rows[:, SYMMETRIC], off[:, :, None])[:, :, 0])
    room = np.full(missing, np.nan)
    return Found(np.append(np.linalg.norm(off, axis=1), room), np.append(chi2, room), rows)


def _run(arguments: list[str]) -> None:
    output = io.StringIO()
    with redirect_stdout(output), redirect_stderr(output):
        status = run(arguments)
    if status:
        raise InputError(f"probedesign {' '.join(arguments)}: {output.getvalue()}")


def _through_fuse(model: ProbeModel, house: SimulatedRun, rng: np.random.Generator) -> Found:
    """All touches, each by itself, with a free reading before and after it."""
    estimator, rows, truth = Estimator(model), list[Array](), list[Array]()
    priors = replace(Tolerances.of(model), drift_steps=10.0)
    step = model.noise_base() * model.averaging_samples
    for touch in house.touches:
        wrenches = np.vstack([house.wrench_free, touch.wrenches_base, house.wrench_free])
        k = len(wrenches)
        read = wrenches + rng.multivariate_normal(np.zeros(6), model.noise_base() / READINGS, k)
        read += rng.multivariate_normal(np.zeros(6), priors.walk_steps**2 * step, k).cumsum(axis=0)
        Ts = np.concatenate([touch.Ts_world_base[:1], touch.Ts_world_base, touch.Ts_world_base[-1:]])
        touched = [False, *[True] * len(touch.wrenches_base), False]
        answer = estimator.fuse(read, Ts, (0.0, 0.0, -9.81), touched=touched, priors=priors)
        if answer.ok:
            cov = answer.cov_surface_world[np.triu_indices(3)] / MM**2
            rows.append(np.append(answer.p_surface_world / MM, cov))
            truth.append(touch.p_world / MM)
    return _compared(np.array(rows), np.array(truth), len(house.touches) - len(rows))


def _errors(found: Sequence[Found]) -> list[str]:
    """Located, share within the target with its interval, quantiles."""
    off = np.concatenate([one.off for one in found])
    located = off[np.isfinite(off)]
    return [f"{len(located)} of {len(off)}", *_share(int((located <= TARGET).sum()), len(off)),
            f"{np.quantile(located, 0.95):.2f}", f"{np.median(located):.2f}", f"{located.max():.2f}"]  # fmt: skip


def _honesty(found: Sequence[Found]) -> list[str]:
    """Share within the stated ellipsoid with its interval, mean squared distance, RMS stated and true."""
    chi2, off = (np.concatenate([getattr(one, name) for one in found]) for name in ("chi2", "off"))
    rows, located = np.concatenate([one.rows for one in found]), np.isfinite(chi2)
    stated = float(np.sqrt(rows[:, [3, 6, 8]].sum(axis=1).mean()))
    return [*_share(int((chi2[located] <= CHI2_95).sum()), int(located.sum())), f"{chi2[located].mean():.2f}",
            f"{stated:.2f}", f"{float(np.sqrt((off[located] ** 2).mean())):.2f}"]  # fmt: skip


def _share(within: int, n: int) -> tuple[str, str]:
    """Of n, with Clopper and Pearson's interval at 95 %."""
    low = beta.ppf(0.025, within, n - within + 1) if within else 0.0
    high = beta.ppf(0.975, within + 1, n - within) if within < n else 1.0
    return f"{within / n:.1%}", f"{low:.1%} – {high:.1%}"
