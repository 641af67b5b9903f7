"""Expected and actual intervals of planned campaigns, and pictures of the set-ups for the documentation.

Measurements of a plan are simulated and identified. The table compares the stated standard deviations with the expected
ones and with the errors.
"""

import csv
import io
import math
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.timing import print_table
from probedesign import build_probe, data_of, identify
from probedesign.campaigns import read_campaign
from probedesign.core.frames import Array, inverse, wrench_map
from probedesign.core.units import MM
from probedesign.design import Design, load_design
from probedesign.estimation.model import Tolerances
from probedesign.planning.candidates import READINGS, STD_MARK, CandidateTest, Instruments
from probedesign.planning.plan import Plan, make_plan, tables
from probedesign.prediction.touches import DIRECTIONS
from probedesign.reports.plan_page import set_up_chart
from probedesign.rod.contact import solve_contact
from probedesign.simulation.ground_truth import CampaignPlan, GroundTruth

ROOT = Path(__file__).parents[1]
PICTURES = ROOT / "docs/pictures"
CAMPAIGNS = 12
MINUTES = 120.0
NAMES = ("E", "root")
#: Instruments of the benches, without calipers and balance, which do not affect the tests.
BENCHES = {
    "stage 0.05 mm": Instruments(calipers=None, balance=None),
    "cameras 1 mm": Instruments(stage=None, cameras=1.0 * MM, calipers=None, balance=None),
}


def report() -> None:
    """Print the table and draw the set-ups."""
    rows = []
    for name in ("large", "small"):
        design = load_design(ROOT / f"designs/{name}.toml")
        probe = build_probe(design)
        for bench, instruments in BENCHES.items():
            plan = make_plan(probe.model, probe.flange_volume, MINUTES, NAMES, instruments, 4)
            rows += _compare(f"{name}, {bench}", design, plan)
    print_table(f"Plans of {MINUTES:g} minutes, {CAMPAIGNS} simulated campaigns of each",
                ["plan", "ok", "parameter", "expected std", "mean stated std", "stated / expected", "RMS error",
                 "in 95 %"], rows)  # fmt: skip
    draw_set_ups()


def _compare(label: str, design: Design, plan: Plan) -> list[list[str]]:
    """Return the rows of one plan; E is compared as that of the material, because the dimensions are drawn."""
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in NAMES}
    ok, probe = 0, build_probe(design)
    for seed in range(CAMPAIGNS):
        with tempfile.TemporaryDirectory() as folder:
            truth = fill(Path(folder), plan, seed)
            identified = identify(data_of(read_campaign(Path(folder)), probe.model, probe.flange_volume), NAMES)
        ok += identified.result == "ok"
        true = {"E": truth.rod.youngs_modulus / 1e6, "root": truth.rod.rigid_length / float(truth.rod.radius[0])}
        for name in NAMES:
            one = identified.of(name)
            if one is not None and one.value_of_print is not None and one.std_of_print is not None:
                scale = true[name] if name == "E" else 1.0
                found[name].append(((one.value_of_print - true[name]) / scale, one.std_of_print / scale))
    rows = []
    for one in plan.expected:
        errors, stated = np.array(found[one.name]).reshape(-1, 2).T
        assert one.std_of_print is not None
        inside = int(np.sum(np.abs(errors) <= 1.96 * stated))
        rows.append([label, f"{ok} of {CAMPAIGNS}", one.name, f"{one.std_of_print:.3g}", f"{stated.mean():.3g}",
                     f"{stated.mean() / one.std_of_print:.2f}", f"{math.sqrt(np.mean(errors**2)):.3g}",
                     f"{inside} of {len(errors)}"])  # fmt: skip
    return rows


def fill(folder: Path, plan: Plan, seed: int, exact: bool = False) -> GroundTruth:
    """Write the data folder of a plan with simulated measurements of a random print, and return the truth.

    Args:
        folder: folder to write to.
        plan: the plan.
        seed: seed of all draws.
        exact: whether the print equals the design and the mount its stated pose.
    """
    rng = np.random.default_rng(seed)
    model = plan.bench.model
    truth = GroundTruth.draw(model, CampaignPlan("cameras", seed, exact=exact), rng)
    contents = tables(plan)
    rows = list(csv.DictReader(io.StringIO(contents["tests.csv"])))
    wrenches, markers = [contents["wrenches.csv"].rstrip()], ["test,marker,x_world_mm,y_world_mm,z_world_mm"]
    drift = 0.0 if exact else Tolerances.of(model).drift_steps * math.sqrt(model.averaging_samples)
    std = model.noise.std
    tests = [one for one in plan.candidates if one.test is not None]
    for row, one in zip(rows, tests, strict=True):
        assert one.test is not None
        reading, T, points, place = _measured(truth, one, rng)
        bias = drift * std * rng.normal(size=6)
        for i in range(READINGS):
            values = reading + bias + std * rng.normal(size=6)
            wrenches.append(",".join([row["test"], f"{one.test.time + i:g}", *(f"{value:.8g}" for value in values)]))
        if place is not None:
            measured = (T[:3, :3] @ place + T[:3, 3] + one.test.std_contact * rng.normal(size=3)) / MM
            row |= {f"contact_{axis}_world_mm": f"{value:.4f}" for axis, value in zip("xyz", measured, strict=True)}
        if plan.bench.instruments.cameras is not None:
            measured = points @ T[:3, :3].T + T[:3, 3]
            measured = (measured + plan.bench.instruments.cameras * rng.normal(size=measured.shape)) / MM
            markers += [f"{row['test']},{i},{p[0]:.4f},{p[1]:.4f},{p[2]:.4f}" for i, p in enumerate(measured, 1)]
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    contents |= {"tests.csv": text.getvalue(), "wrenches.csv": "\n".join(wrenches) + "\n"}
    if plan.bench.instruments.cameras is not None:
        contents["markers.csv"] = "\n".join(markers) + "\n"
    for name, content in contents.items():
        (folder / name).write_text(content)
    return truth


def _measured(
    truth: GroundTruth, one: CandidateTest, rng: np.random.Generator
) -> tuple[Array, Array, Array, Array | None]:
    """Return the reading without noise, the true pose of the base, and the markers on the axis and the touched point in
    the true base frame."""
    test, rod, model = one.test, truth.rod, truth.model
    assert test is not None and one.shape is not None
    error = inverse(truth.T_world_base)
    T_mount = test.T_world_base @ error @ truth.T_world_mount
    T = test.T_world_base @ error @ truth.T_world_true
    gravity = T[:3, :3].T @ truth.gravity_world
    place = None
    if test.force_world is None:
        s = test.s_contact + STD_MARK * rng.normal()
        force = float(np.linalg.norm(one.shape.load[0:3]))
        while (found := solve_contact(rod, gravity, s, DIRECTIONS[test.direction], force)).result != "ok":
            force /= 1.1  # the true probe is softer than the designed one
        eq, place = found.equilibrium, found.p_surface_base
    elif test.free:
        eq = rod.solve(gravity)
    else:
        s = test.s_contact + test.std_s * rng.normal()
        eq = rod.solve(gravity, T[:3, :3].T @ test.force_world, s)
    assert eq.ok
    wrench = wrench_map(inverse(T_mount) @ T) @ eq.wrench_base
    reading = model.to_sensor(wrench, T_mount[:3, :3].T @ truth.gravity_world)
    count = 0 if test.markers is None else len(test.markers)
    marker_s = np.minimum(10.0 * MM * (1.0 + np.arange(count)), rod.length)
    return reading, T, eq.p_at(marker_s) if count else np.zeros((0, 3)), place


def draw_set_ups() -> None:
    """Write docs/pictures/setup-*.svg: two free tests, a weight and two touches of the large probe."""
    from probedesign.planning.candidates import Bench

    bench = Bench(build_probe(load_design(ROOT / "designs/large.toml")).model, Instruments())
    every = {one.name: one for one in bench.candidates()}
    drawn = {"hang": "hang", "turned": "turned-tip-down", "weight": "weight-120-2", "touch-x": "touch-97.5-+x-13.5",
             "touch-y": "touch-97.5--y-24.5"}  # fmt: skip
    for name, candidate in drawn.items():
        svg = set_up_chart(bench.model, every[candidate]).svg()
        (PICTURES / f"setup-{name}.svg").write_bytes(
            svg.replace(b"<svg ", b'<svg style="background: #fff" ', 1) + b"\n"
        )
