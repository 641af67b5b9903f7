"""Point errors of the simulated card house with the command `explore` and with `Estimator.fuse`.

The simulation uses the large probe with E known to 1 %, a constant base position error of 0.05 mm and one of 0.01 mm
at each pose, and no touch above 5 mN. The command runs with exact base orientations, which its options state, and with
the default orientation errors (tilt 0.2°, clocking 0.5°). For the command the bias of the sensor is a random walk of
0.05 steps of the resolution per √s, as the contact test assumes, which is about 0.2 steps from touch to touch; for
`fuse` it has steps of 0.2 from pose to pose.
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

from benchmarks.error_statistics import CHI2_95, proportion_cells
from benchmarks.figures import draw_card_house
from benchmarks.timing import print_table
from benchmarks.touches import paper_models
from probedesign.cli.main import run
from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.core.units import MILLINEWTON, MM
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.model import ProbeModel, Tolerances
from probedesign.frozen_probe import write_frozen
from probedesign.rod.friction import ASSUMED_FRICTION
from probedesign.simulation.scenes import card_house, shared_targets, touch_targets
from probedesign.simulation.simulated_run import RunErrors, SimulatedRun, simulate_run, write_run

#: Simulated runs for the command and for `fuse`. All touches of a run have the same E and base errors, so their errors
#: are correlated, and many runs estimate the coverage better than many touches of one run.
COMMAND_RUNS, FUSE_RUNS = 3, 20
READINGS = 50  #: Readings at each pose for `fuse`: a quarter of a second of a Net F/T box, averaged by 36.
FRICTION = ASSUMED_FRICTION  #: Median friction coefficient of the cards.
#: Smallest and largest compliance of cards that yield [m/N]; the estimator has a prior of the largest. Assumed.
CARDS = (0.02, 0.2)
TARGET_MM = 2.0  #: Target of the error of a located point.
#: Columns of the covariance in a row of position and covariance.
SYMMETRIC = np.array([[3, 4, 5], [4, 6, 7], [5, 7, 8]])
#: Options of `explore` for a base whose stated poses have no error of rotation.
EXACT_ROTATION = ("--tilt-deg", "0", "--clocking-deg", "0")


@dataclass(frozen=True)
class PointErrors:
    """Errors of the touched points of one run."""

    error: Array  #: distance from the true points [mm], NaN where a touch was not located, (n,).
    nees: Array  #: normalised estimation error squared, NaN where a touch was not located, (n,).
    rows: Array  #: position and covariance xx, xy, xz, yy, yz, zz of the located points [mm, mm²], (k, 9).


def report(only: str = "") -> None:
    """Print the tables and draw the points of the first run; `only` "probes" prints that of two probes alone."""
    report_probes()
    if only == "probes":
        return
    model = replace(paper_models()["large"], stiffness_spread=0.01)
    with_rotation = RunErrors.from_priors(Tolerances.of(model), FRICTION)
    simulated = list(islice(_simulated_runs(model), FUSE_RUNS))
    exact = [_by_command(model, [one], seed, EXACT_ROTATION) for seed, one in enumerate(simulated[:COMMAND_RUNS])]
    rotated = [
        _by_command(model, [simulate_run(model, touch_targets(), np.random.default_rng(seed), with_rotation)], seed)
        for seed in range(COMMAND_RUNS)
    ]
    soft = replace(model, tolerances=replace(Tolerances.of(model), object_compliance=CARDS[1]))
    yielding = [_by_command(soft, [one], seed, EXACT_ROTATION)
                for seed, one in enumerate(islice(_simulated_runs(soft, CARDS), COMMAND_RUNS))]  # fmt: skip
    fused = [_by_fuse(model, one, np.random.default_rng(100 + i)) for i, one in enumerate(simulated)]
    methods = {
        "explore, exact orientation": exact,
        "explore, orientation errors": rotated,
        "explore, cards of 5 to 50 N/m": yielding,
        "fuse, single touches": fused,
    }
    head = ["method", "located", f"within {TARGET_MM:g} mm", "95 % interval", "95th percentile", "median", "maximum"]
    title = f"Card house, {len(touch_targets())} touches of 25 points in each run, errors in mm"
    print_table(title, head, [[name, *_error_cells(found)] for name, found in methods.items()])
    print_table("Coverage of the 95 % ellipsoids",
                ["method", "coverage", "95 % interval", "mean NEES (expected 3)", "stated RMS [mm]",
                 "RMS error [mm]"],
                [[name, *_coverage_cells(found)] for name, found in methods.items()])  # fmt: skip
    touches = [touch for one in simulated for touch in one.touches]
    print_table("Loads and clearance of the simulated touches",
                ["largest force", "largest moment about the base", "smallest clearance to the card behind"],
                [[f"{max(t.force for t in touches) / MILLINEWTON:.2f} mN",
                  f"{1e3 * max(t.moment for t in touches):.2f} N·mm",
                  f"{min(t.clearance for t in touches) / MM:.2f} mm"]])  # fmt: skip
    cards, targets = ([card.corners / MM for card in card_house()], [target.p_world / MM for target in touch_targets()])
    draw_card_house(cards, exact[0].rows, np.array(targets))


def report_probes(runs: int = COMMAND_RUNS) -> None:
    """Print the time and the errors of one probe and of two that touch the same house at the same time."""
    model, rows = replace(paper_models()["large"], stiffness_spread=0.01), list[list[str]]()
    errors, alone = RunErrors.from_priors(Tolerances.of(model), FRICTION), 0.0
    for n in (1, 2):
        found, seconds = list[PointErrors](), list[float]()
        for seed in range(runs):
            parts = enumerate(shared_targets(touch_targets(), n))
            at_once = [simulate_run(model, part, np.random.default_rng([seed, i]), errors) for i, part in parts]
            seconds.append(max(one.trajectory.end for one in at_once))
            found.append(_by_command(model, at_once, seed))
        alone = alone or float(np.mean(seconds))
        share = f"{100 * np.mean(seconds) / alone:.0f} %"
        rows.append([str(n), f"{np.mean(seconds):.0f} s", share, *_error_cells(found), *_coverage_cells(found)[:1]])
    head = ["probes", "time of the run", "of one", "located", f"within {TARGET_MM:g} mm", "95 % interval"]
    print_table(f"Two probes against one, card house, orientation errors, {runs} runs of each, errors in mm",
                [*head, "95th percentile", "median", "maximum", "inside the 95 % ellipsoid"], rows)  # fmt: skip


def _simulated_runs(model: ProbeModel, compliance: tuple[float, float] | None = None) -> Iterator[SimulatedRun]:
    """Yield simulated runs without end, except those whose base position error makes a touch miss its edge.

    The compliance of the cards [m/N] is log-uniform in a range, or zero.
    """
    for seed in count():
        rng = np.random.default_rng([seed, 1])
        drawn = np.exp(rng.uniform(*np.log(compliance), 100)) if compliance else np.zeros(100)
        with suppress(InputError):
            yield simulate_run(
                model, touch_targets(iter(drawn).__next__), np.random.default_rng(seed), RunErrors(friction=FRICTION)
            )


def _by_command(
    model: ProbeModel, simulated: Sequence[SimulatedRun], seed: int, options: Sequence[str] = ()
) -> PointErrors:
    """Locate the points of a run, or of several probes at once, with the command `explore` and some of its options."""
    with tempfile.TemporaryDirectory() as folder:
        at, recordings, poses = Path(folder), list[str](), list[str]()
        names = ["large"] if len(simulated) == 1 else [f"probe{i}" for i in range(len(simulated))]
        for i, (name, each) in enumerate(zip(names, simulated, strict=True)):
            write_frozen(replace(model, name=name), at / f"{name}.probe.json")
            write_run(each, replace(model, name=name), at / name, np.random.default_rng(1000 * (i + 1) + seed))
            recordings, poses = [*recordings, f"{at}/{name}/house.mcap"], [*poses, "--pose", f"{at}/{name}/poses.csv"]
        _run(["explore", *(f"{at}/{name}.probe.json" for name in names), *recordings, *poses,
              "--tare-s", "0.5:3.5", "--average", "36", "--out", f"{at}/found", *options])  # fmt: skip
        with (at / "found/points.csv").open(encoding="utf-8") as file:
            found = [row for row in csv.DictReader(file) if row["result"] == "ok"]
    columns = [f"{axis}_world_mm" for axis in "xyz"]
    columns += [f"cov_world_{name}_mm2" for name in ("xx", "xy", "xz", "yy", "yz", "zz")]
    rows = np.array([[float(row[name]) for name in columns] for row in found]).reshape(-1, 9)
    truth = []
    for row in found:
        touches = simulated[names.index(row["touch_numbers"].split()[0]) if len(names) > 1 else 0].touches
        truth.append(min(touches, key=lambda touch: abs(touch.start - float(row["time_s"]))).p_world / MM)
    missing = max(sum(not t.target.repeated for each in simulated for t in each.touches) - len(found), 0)
    return _point_errors(rows, np.array(truth), missing)


def _point_errors(rows: Array, truth: Array, missing: int) -> PointErrors:
    """Compare located points, (k, 9), with the true ones [mm], (k, 3); `missing` touches were not located."""
    error = rows[:, :3] - truth
    nees = np.einsum("ka,ka->k", error, np.linalg.solve(rows[:, SYMMETRIC], error[:, :, None])[:, :, 0])
    none = np.full(missing, np.nan)
    return PointErrors(np.append(np.linalg.norm(error, axis=1), none), np.append(nees, none), rows)


def _run(arguments: list[str]) -> None:
    output = io.StringIO()
    with redirect_stdout(output), redirect_stderr(output):
        status = run(arguments)
    if status:
        raise InputError(f"probedesign {' '.join(arguments)}: {output.getvalue()}")


def _by_fuse(model: ProbeModel, simulated: SimulatedRun, rng: np.random.Generator) -> PointErrors:
    """Locate each touch of a run from its readings and a free reading before and after them."""
    priors = replace(Tolerances.of(model), drift_steps=10.0)
    estimator, rows, truth = Estimator(model, priors), list[Array](), list[Array]()
    step = model.noise_base() * model.averaging_samples
    for touch in simulated.touches:
        wrenches = np.vstack([simulated.wrench_free, touch.wrenches_base, simulated.wrench_free])
        k = len(wrenches)
        read = wrenches + rng.multivariate_normal(np.zeros(6), model.noise_base() / READINGS, k)
        read += rng.multivariate_normal(np.zeros(6), priors.walk_steps**2 * step, k).cumsum(axis=0)
        Ts = np.concatenate([touch.Ts_world_base[:1], touch.Ts_world_base, touch.Ts_world_base[-1:]])
        touched = [False, *[True] * len(touch.wrenches_base), False]
        fused = estimator.fuse(read, Ts, (0.0, 0.0, -9.81), touched=touched)
        if fused.ok:
            cov = fused.cov_surface_world[np.triu_indices(3)] / MM**2
            rows.append(np.append(fused.p_surface_world / MM, cov))
            truth.append(touch.p_world / MM)
    return _point_errors(np.array(rows), np.array(truth), len(simulated.touches) - len(rows))


def _error_cells(found: Sequence[PointErrors]) -> list[str]:
    """Return cells with the located touches, the share within the target with its interval, and quantiles."""
    error = np.concatenate([one.error for one in found])
    located = error[np.isfinite(error)]
    return [f"{len(located)} of {len(error)}", *proportion_cells(int((located <= TARGET_MM).sum()), len(error)),
            f"{np.quantile(located, 0.95):.2f}", f"{np.median(located):.2f}", f"{located.max():.2f}"]  # fmt: skip


def _coverage_cells(found: Sequence[PointErrors]) -> list[str]:
    """Return cells with the coverage of the 95 % ellipsoid and its interval, mean NEES, stated and actual RMS error."""
    nees, error = (np.concatenate([getattr(one, name) for one in found]) for name in ("nees", "error"))
    rows, located = np.concatenate([one.rows for one in found]), np.isfinite(nees)
    stated = float(np.sqrt(rows[:, [3, 6, 8]].sum(axis=1).mean()))
    return [*proportion_cells(int((nees[located] <= CHI2_95).sum()), int(located.sum())),
            f"{nees[located].mean():.2f}", f"{stated:.2f}",
            f"{float(np.sqrt((error[located] ** 2).mean())):.2f}"]  # fmt: skip
