"""What `explore` reaches on the simulated card house: through the command, and through `fuse` from Python.

The large probe, E known to 1 %, the base 0.05 mm off in common and 0.01 mm from pose to pose, no touch above 5 mN.
Through the command the sensor's bias walks as the contact test assumes, 0.05 steps of its resolution in a root second,
which is 0.2 from touch to touch; through `fuse` it walks 0.2 steps from each pose to the next.
"""

import io
import tempfile
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.stats import beta

from benchmarks.figures import draw_card_house
from benchmarks.timing import print_table
from benchmarks.touches import paper_models
from probedesign.cli.main import run
from probedesign.deployment import write_frozen
from probedesign.errors import InputError
from probedesign.estimator.estimator import Estimator
from probedesign.estimator.model import ProbeModel
from probedesign.estimator.unknowns import Unknowns
from probedesign.exploring.card_house import card_house, spots
from probedesign.exploring.rehearsal import Rehearsal, rehearse
from probedesign.exploring.rehearsal_files import write_rehearsal
from probedesign.frames import Array
from probedesign.units import MILLINEWTON, MM

COMMANDS, HOUSES, DRAWS = 3, 4, 5
"""Runs of the command, each a house of its own; houses fused from Python; how often each with new noise and bias."""
READINGS = 50
"""To a pose, in Python: a quarter of a second of a Net F/T box's samples, averaged by 36."""
TARGET = 2.0


def report() -> None:
    """Print what is reached, and draw the first house."""
    model = replace(paper_models()["large"], stiffness_spread=0.01)
    rows, houses = [], [rehearse(model, spots(), np.random.default_rng(seed)) for seed in range(HOUSES)]
    runs = [_through_command(model, house, seed) for seed, house in enumerate(houses[:COMMANDS])]
    rows.append(["command, points", *_told(np.concatenate([off for off, _ in runs]))])
    fused = [
        _through_fuse(model, house, np.random.default_rng(100 + k)) for house in houses for k in range(DRAWS)
    ]
    rows.append(["fuse, single touches", *_told(np.concatenate(fused))])
    head = [
        "way",
        "located",
        f"within {TARGET:g} mm",
        "95 % interval of that",
        "95 % within",
        "median",
        "worst",
    ]
    print_table(f"Card house, {len(spots())} touches of 25 points a run, errors in mm", head, rows)
    touches = [touch for house in houses for touch in house.touches]
    print_table("What the object and the sensor feel",
                ["greatest force", "greatest moment about the base", "least room to the card behind"],
                [[f"{max(t.force for t in touches) / MILLINEWTON:.2f} mN",
                  f"{1e3 * max(t.moment for t in touches):.2f} N·mm",
                  f"{min(t.clearance for t in touches) / MM:.2f} mm"]])  # fmt: skip
    _, points = runs[0]
    draw_card_house(
        [card.corners / MM for card in card_house()], points, np.array([s.p_world for s in spots()]) / MM
    )


def _through_command(model: ProbeModel, house: Rehearsal, seed: int) -> tuple[Array, Array]:
    """Errors [mm] of all points, NaN where a touch was not located, and the points' rows of numbers."""
    with tempfile.TemporaryDirectory() as folder:
        at = Path(folder)
        write_frozen(model, at / "large.probe.json")
        write_rehearsal(house, model, at, np.random.default_rng(1000 + seed))
        _run(["explore", f"{at}/large.probe.json", f"{at}/house.mcap", "--pose", f"{at}/poses.csv",
              "--tare-s", "0.5:3.5", "--average", "36", "--out", f"{at}/found"])  # fmt: skip
        table = np.genfromtxt(
            at / "found/points.csv", delimiter=",", names=True, dtype=None, encoding="utf-8"
        )
    found = table[table["result"] == "ok"]
    points = np.stack([found[f"{axis}_world_mm"] for axis in "xyz"], axis=1).astype(float)
    cov = np.stack([found[f"cov_world_{name}_mm2"] for name in ("xx", "xy", "xz", "yy", "yz", "zz")], axis=1)
    truth = {t.start: t.p_world / MM for t in house.touches}
    starts = np.array(list(truth))
    off = [float(np.linalg.norm(p - truth[starts[np.argmin(np.abs(starts - time))]]))
           for p, time in zip(points, found["time_s"], strict=True)]  # fmt: skip
    missing = max(sum(not t.spot.again for t in house.touches) - len(found), 0)
    return np.array(off + [np.nan] * missing), np.concatenate([points, cov.astype(float)], axis=1)


def _run(arguments: list[str]) -> None:
    told = io.StringIO()
    with redirect_stdout(told), redirect_stderr(told):
        status = run(arguments)
    if status:
        raise InputError(f"probedesign {' '.join(arguments)}: {told.getvalue()}")


def _through_fuse(model: ProbeModel, house: Rehearsal, rng: np.random.Generator) -> Array:
    """Errors [mm] of all touches, each by itself, with a free reading before and after it."""
    estimator, off = Estimator(model), list[float]()
    unknowns = replace(Unknowns.of(model), bias_steps=10.0)
    step = model.noise_base() * model.averaging_samples
    for touch in house.touches:
        wrenches = np.vstack([house.free, touch.wrenches, house.free])
        k = len(wrenches)
        read = wrenches + rng.multivariate_normal(np.zeros(6), model.noise_base() / READINGS, k)
        read += rng.multivariate_normal(np.zeros(6), unknowns.bias_walk_steps**2 * step, k).cumsum(axis=0)
        Ts = np.concatenate([touch.Ts_told[:1], touch.Ts_told, touch.Ts_told[-1:]])
        touched = [False, *[True] * len(touch.wrenches), False]
        answer = estimator.fuse(read, Ts, (0.0, 0.0, -9.81), touched=touched, unknowns=unknowns)
        off.append(
            float(np.linalg.norm(answer.p_surface_world - touch.p_world)) / MM if answer.ok else np.nan
        )
    return np.array(off)


def _told(off: Array) -> list[str]:
    """Located, share within the target with Clopper and Pearson's interval, quantiles."""
    n, located = len(off), off[np.isfinite(off)]
    within = int((located <= TARGET).sum())
    low = beta.ppf(0.025, within, n - within + 1) if within else 0.0
    high = beta.ppf(0.975, within + 1, n - within) if within < n else 1.0
    return [f"{len(located)} of {n}", f"{within / n:.1%}", f"{low:.1%} – {high:.1%}",
            f"{np.quantile(located, 0.95):.2f}", f"{np.median(located):.2f}", f"{located.max():.2f}"]  # fmt: skip
