"""Rod, noise, drift and catalogue against measurements that others made and published.

The files are not part of the project: `--data` names the folder, docs/real-data.md the sources and licences.
"""

import csv
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from benchmarks.figures import draw_allan, draw_bamboo
from benchmarks.timing import print_table
from benchmarks.touches import ROOT
from probedesign.core.frames import Array
from probedesign.core.units import GRAM, MM, MPA
from probedesign.design import check_design, load_design
from probedesign.design.catalog import RESINS
from probedesign.design.edit import tables_of
from probedesign.design.sensor_catalog import SENSORS
from probedesign.estimation.bias import WALK_STEPS
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.model import Tolerances
from probedesign.live.blocks import Block
from probedesign.live.processing.chain import Chain, ProcessingOptions
from probedesign.live.processing.estimates import EstimateUpdate
from probedesign.live.processing.payload import Rest, calibrate, tool_model
from probedesign.live.processing.tare import TareWindow
from probedesign.probe import build_probe
from probedesign.rod.rod import Rod

Row = list[str]
HEAD = ["measured by others", "measured", "model", "difference"]
G = 9.81  #: [m/s²].


def report(data: str | None = None) -> None:
    """Print a table of each data set; one line where the data are absent.

    Args:
        data: folder with the data sets, one folder each; None: nothing is compared.
    """
    root = None if data is None else Path(data)
    present = [] if root is None else [name for name in DATA_SETS if (root / name).is_dir()]
    if root is None or not present:
        print(f"no measurements of others in {root or '--data, which is not given'}: nothing is compared")
        return
    for name in present:
        title, compare = DATA_SETS[name]
        print_table(title, HEAD, compare(root / name))


def columns(path: Path) -> dict[str, list[str]]:
    """Return the columns of a CSV file with a header, as text."""
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    return {name: [row[name] for row in rows] for name in rows[0]}


def numbers(path: Path) -> Array:
    """Return the numbers of a file of comma separated values without a header, (n, columns)."""
    return np.loadtxt(path, delimiter=",", ndmin=2)


def _row(name: str, measured: float, model: float, unit: str, spec: str = ".3g") -> Row:
    """Return a row with the relative difference."""
    return [name, f"{measured:{spec}} {unit}", f"{model:{spec}} {unit}", f"{model / measured - 1.0:+.1%}"]


# A tapered rod -------------------------------------------------------------------------------------------------------

CLAMPED_MM = 1879.7  #: From the clamp to the tip: "ActionLength" of 6.167 ft in the author's file.
#: A, I, I and J of a hexagon over those of the circle inside it: 2 √3/π, 20 √3/(9 π) twice, and J by Roark.
HEXAGON = (1.1027, 1.2252, 1.2252, 1.175)
SMALL_G = 21.0  #: Largest tip mass of the fit that predicts the others [g].


def bamboo(folder: Path) -> list[Row]:
    """Compare a clamped tapered rod under its weight and tip masses; E and density are fitted."""
    profile = {name: np.array(values, dtype=float) for name, values in columns(folder / "profile.csv").items()}
    read = {name: np.array(values, dtype=float) for name, values in columns(folder / "deflections.csv").items()}
    masses, stations = np.unique(read["tip_mass_g"]), np.unique(read["from_tip_mm"])
    mean, spread = (
        np.array([[of(read["deflection_mm"][(read["tip_mass_g"] == m) & (read["from_tip_mm"] == x)]) for x in stations]
                  for m in masses]) for of in (np.mean, np.std)
    )  # fmt: skip
    at_mm = CLAMPED_MM - profile["from_tip_mm"]
    inside = at_mm > 0.0
    s_mm = np.append(at_mm[inside], 0.0)[::-1]
    flats_mm = np.interp(s_mm, at_mm[::-1], profile["flat_to_flat_mm"][::-1])

    def deflections(x: Array, of: Array) -> Array:
        E, density = np.exp(x)
        rod = Rod(s_mm * MM, flats_mm * MM / 2.0, E, E / 20.0, density, factors=HEXAGON)
        solved = [rod.solve((-G, 0.0, 0.0), (-m * GRAM * G, 0.0, 0.0)) for m in of]
        return np.array([eq.p_at((CLAMPED_MM - stations) * MM)[:, 0] / MM for eq in solved])

    def fit(of: Array) -> Array:
        def off(x: Array) -> Array:
            return np.ravel(deflections(x, of) - mean[np.isin(masses, of)])

        return np.asarray(least_squares(off, np.log([50e9, 800.0])).x)

    whole, small = fit(masses), fit(masses[masses < SMALL_G])
    fitted, predicted = deflections(whole, masses), deflections(small, masses)
    draw_bamboo(CLAMPED_MM - stations, masses, mean, spread, predicted, (masses < SMALL_G).tolist())
    tip, differs = int(np.argmin(stations)), fitted - mean
    rows = [
        ["E and density, fitted to all", "-", f"{np.exp(whole[0]) / 1e9:.1f} GPa, {np.exp(whole[1]):.0f} kg/m³", "-"],
        [f"RMS of {differs.size} deflections, {-mean.min():.0f} mm at most", "-", "-",
         f"{np.sqrt((differs**2).mean()):.1f} mm, {np.abs(differs).max():.1f} at worst"],
        ["repeats of one deflection, standard deviation", f"{spread.max():.1f} mm at most", "-", "-"],
    ]  # fmt: skip
    return rows + [
        _row(f"tip under {m:g} g, predicted from {masses[masses < SMALL_G].max():g} g and less",
             -mean[k, tip], -predicted[k, tip], "mm", ".1f")
        for k, m in enumerate(masses) if m > SMALL_G
    ]  # fmt: skip


# A silicone cantilever -----------------------------------------------------------------------------------------------

SIDE, LENGTH = 30.0 * MM, 100.0 * MM  #: Of the square section and of the beam [m].
DRAGON_SKIN = 0.264 * MPA, 1070.0  #: E [Pa] and density [kg/m³] that its authors state.
#: A, I, I and J of a square over those of the circle inside it: 4/π, 16/(3 π) twice, 0.1406 · 32/π.
SQUARE = (1.2732, 1.6977, 1.6977, 1.4322)
FORCES_N = {"gravity": 0.0, "load52": 0.510, "load101": 1.001}  #: Hung from the end, by file.
LUMPED = 33.0 / 140.0  #: Share of a cantilever's mass that swings with its tip (Rayleigh).


def sag_and_frequency(columns_of: dict[str, list[str]]) -> tuple[float, float]:
    """Return the displacement of the tip along gravity, −x, [mm] and the frequency [Hz] of a beam that is let go.

    The marker that moves most is the one next to the end.
    """
    time = np.array(columns_of["time_s"], dtype=float)
    tips, bases = (
        np.array([columns_of[f"{part}{k}_x_mm"] for k in (1, 2, 3)], dtype=float) for part in ("tip", "base")
    )
    x, rate = tips[int(np.argmax(np.ptp(tips, axis=1)))] - bases.mean(axis=0), 1.0 / float(np.median(np.diff(time)))
    rest, start = x[-round(rate) :].mean(), x[:10].mean()
    let_go = int(np.argmax(np.abs(x - start) > 0.2 * abs(rest - start)))
    swing = x[let_go : let_go + round(1.5 * rate)] - rest
    swing = (swing - swing.mean()) * np.hanning(len(swing))
    spectrum = np.abs(np.fft.rfft(swing, 1 << 15))
    return float(start - rest), float(np.argmax(spectrum) * rate / (1 << 15))


def silicone(folder: Path) -> list[Row]:
    """Compare sag and frequency of a cast cantilever with the stiffness that its authors state."""
    E, density = DRAGON_SKIN
    rod = Rod(np.array([0.0, LENGTH]), np.full(2, SIDE / 2.0), E, E / 3.0, density, 5.0 / 6.0, factors=SQUARE)
    mass, rows = density * SIDE**2 * LENGTH, []
    for name, force in FORCES_N.items():
        found = [sag_and_frequency(columns(path)) for path in sorted(folder.glob(f"{name}_*.csv"))]
        if not found:
            continue
        sag_mm, frequency = np.mean(found, axis=0)
        tips = [float(rod.solve((-G, 0.0, 0.0), (-f, 0.0, 0.0)).p_at(LENGTH)[0]) for f in (force, force + 0.01)]
        swings = LUMPED * mass + force / G
        model = np.sqrt(0.01 / (tips[0] - tips[1]) / swings) / (2.0 * np.pi)
        rows += [_row(f"{force:.3g} N at the end: sag of the tip", sag_mm, -tips[0] / MM, "mm"),
                 _row(f"{force:.3g} N at the end: frequency", frequency, float(model), "Hz")]  # fmt: skip
    return rows


# Three force/torque sensors ------------------------------------------------------------------------------------------

CHANNELS = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")
RATE_HZ = 200.0  #: Nominal: the newest sample of each poll.
#: File, first column and calibration of each sensor.
NANO17 = {"S1": ("free_S1_S2.csv", 0, "si-25-0.25"), "S2": ("free_S1_S2.csv", 6, "si-50-0.5"),
          "S3": ("free_S3.csv", 0, "si-25-0.25")}  # fmt: skip


def white_and_walk(steps: Array, rate: float, window_s: float = 1.0) -> tuple[Array, Array]:
    """Return white noise [steps] and random walk [steps/√s] of each channel.

    The noise is that of neighbouring samples. Means of windows of τ seconds differ by 2 σ²/n + 2/3 w² τ in the mean
    square (the Allan variance is half of it), of which w is the walk.

    Args:
        steps: samples in steps of the resolution, (n, channels).
        rate: of the samples [Hz].
        window_s: τ.
    """
    noise = np.diff(steps, axis=0).std(axis=0) / np.sqrt(2.0)
    n = round(window_s * rate)
    means = np.array([steps[i : i + n].mean(axis=0) for i in range(0, len(steps) - n + 1, n)])
    excess = (np.diff(means, axis=0) ** 2).mean(axis=0) - 2.0 * noise**2 / n
    return noise, np.sqrt(np.maximum(1.5 * excess / window_s, 0.0))


def allan(steps: Array, rate: float) -> tuple[Array, Array]:
    """Return window lengths τ [s] and the Allan deviation of the channel of the largest drift [steps] over them."""
    lengths = np.unique(np.round(np.geomspace(1, len(steps) // 4, 16)).astype(int))
    found = []
    for n in lengths:
        means = np.array([steps[i : i + n].mean(axis=0) for i in range(0, len(steps) - n + 1, n)])
        found.append(np.sqrt(0.5 * (np.diff(means, axis=0) ** 2).mean(axis=0)))
    deviations = np.array(found)
    return lengths / rate, deviations[:, int(np.argmax(deviations[-1]))]


def nano17(folder: Path) -> list[Row]:
    """Compare noise and drift of three unloaded sensors with what is assumed."""
    rows, curves = [], {}
    for name, (file, first, calibration) in NANO17.items():
        resolution = np.array(SENSORS["nano17"].calibration(calibration).resolution)
        steps = numbers(folder / file)[:, first : first + 6] * [1.0, 1.0, 1.0, MM, MM, MM] / resolution
        noise, walk = white_and_walk(steps, RATE_HZ)
        ends = steps[-100:].mean(axis=0) - steps[:100].mean(axis=0)
        worst = int(np.argmax(walk))
        curves[f"{name}, {calibration}"] = allan(steps, RATE_HZ)
        rows += [
            [f"{name} {calibration}: noise of one sample", f"{noise.min():.2f} to {noise.max():.2f} steps", "1 step",
             "-"],
            [f"{name} {calibration}: random walk, median channel", f"{np.median(walk):.2f} steps/√s",
             f"{WALK_STEPS:g} steps/√s", f"{np.median(walk) / WALK_STEPS:.0f} times"],
            [f"{name} {calibration}: random walk, worst ({CHANNELS[worst]})",
             f"{walk[worst]:.1f} steps/√s", f"{WALK_STEPS:g} steps/√s", f"{walk[worst] / WALK_STEPS:.0f} times"],
            [f"{name} {calibration}: drift within 4.5 s, worst channel", f"{np.abs(ends).max():.1f} steps",
             f"{WALK_STEPS * np.sqrt(4.5):.2f} steps", "-"],
            [f"{name} {calibration}: readings of live after a tare of 1 s", "free", live_results(steps, calibration),
             "-"],
        ]  # fmt: skip
    draw_allan(curves, WALK_STEPS)
    return rows


def live_results(steps: Array, calibration: str) -> str:
    """Return how often each result occurs in `live` with the large probe on a sensor.

    Args:
        steps: samples of the sensor without load, in steps of the resolution, (n, 6).
        calibration: of the sensor.
    """
    tables = tables_of(load_design(ROOT / "designs/large.toml"))
    model = build_probe(check_design(tables | {"sensor": tables["sensor"] | {"calibration": calibration}})).model
    step = np.array(SENSORS["nano17"].calibration(calibration).resolution)
    free = model.to_sensor(model.rod.solve(model.gravity_base).wrench_base, model.gravity_base)
    chain = Chain(Estimator(model), ProcessingOptions(TareWindow(0.0, 1.0), None), None, lambda line: None)
    t, updates = np.arange(len(steps)) / RATE_HZ, list[EstimateUpdate]()
    for i in range(0, len(t), 20):
        part = slice(i, i + 20)
        read = free + steps[part] * step
        updates += chain.process(Block(t[part], read, model.gravity_base, np.full(len(read), np.nan)))
    results = Counter(update.estimate.result for update in [*updates, *chain.finish()])
    return ", ".join(f"{code} {n / results.total():.0%}" for code, n in results.most_common())


# A payload on an arm -------------------------------------------------------------------------------------------------


def payload(R: Array, wrenches: Array) -> tuple[Array, Array, Array, Array]:
    """Fit a rigid payload and a bias of the sensor to wrenches in base axes by least squares.

    F = R b + w and M = R m + (R c) × w: bias b, m and centre c in sensor axes, weight w in base axes.

    Args:
        R: rotation of the sensor in the base, (n, 3, 3).
        wrenches: [N, N·m], (n, 6).

    Returns:
        Weight [N] (3,), centre [m] (3,), and residuals of force (n, 3) and moment (n, 3).
    """
    n = len(R)
    A = np.concatenate([R, np.tile(np.eye(3), (n, 1, 1))], axis=2).reshape(3 * n, 6)
    force = np.linalg.lstsq(A, wrenches[:, :3].ravel(), rcond=None)[0]
    w = force[3:]
    across = -np.cross(np.eye(3), w).T  # (R c) × w = across @ R c
    B = np.concatenate([R, -across @ R], axis=2).reshape(3 * n, 6)
    moment = np.linalg.lstsq(B, wrenches[:, 3:].ravel(), rcond=None)[0]
    off = (A @ force - wrenches[:, :3].ravel(), B @ moment - wrenches[:, 3:].ravel())
    return w, moment[3:], off[0].reshape(n, 3), off[1].reshape(n, 3)


DOWN = np.array([0.0, 0.0, -G])
DRAWS, CHI2_95_6 = 10, 12.592  #: Of half of the poses; 95 % quantile of χ² with six degrees of freedom.


def held_out(rests: list[Rest]) -> tuple[Array, Array]:
    """Return χ² (n,) and errors (n, 6) of the readings in half of the poses, predicted from the other half."""
    chi2, errors = [], []
    for seed in range(DRAWS):
        drawn = np.random.default_rng(seed).permutation(len(rests))
        used = sorted(drawn[: len(rests) // 2])
        found = calibrate(tool_model(), [rests[i] for i in used], DOWN, tool=True)
        for i in drawn[len(rests) // 2 :]:
            mean, cov = found.predict(rests[i].time, rests[i].R)
            errors.append(rests[i].wrench - mean)
            chi2.append(float(errors[-1] @ np.linalg.solve(cov, errors[-1])))
    return np.array(chi2), np.array(errors)


def axia80(folder: Path) -> list[Row]:
    """Fit bias, weight and centre of a gripper to 100 rest poses."""
    poses, wrenches = (numbers(folder / f"recorded_messages_{part}_100.txt") for part in ("pose", "wrench"))
    R = Rotation.from_quat(poses[:, 3:7]).as_matrix()
    w, c, force, moment = payload(R, wrenches)
    rms = [float(np.sqrt((off**2).mean())) for off in (force, moment)]
    read = np.concatenate([np.einsum("nji,nj->ni", R, wrenches[:, k : k + 3]) for k in (0, 3)], axis=1)
    rests = [Rest(float(i), row, np.zeros(6), each) for i, (row, each) in enumerate(zip(read, R, strict=True))]
    whole = calibrate(tool_model(), rests, DOWN, tool=True).residuals
    left = [float(np.sqrt((whole[:, k : k + 3] ** 2).mean())) for k in (0, 3)]
    chi2, errors = held_out(rests)
    weight = float(np.linalg.norm(w))
    return [
        ["weight of the gripper, fitted", "-", f"{weight:.2f} N", "-"],
        ["its centre from the sensor, fitted", "-", f"{np.linalg.norm(c) / MM:.0f} mm", "-"],
        [f"force in {len(R)} poses, RMS of a component", f"{np.sqrt((wrenches[:, :3] ** 2).mean()):.1f} N",
         "weight and bias", f"{rms[0]:.2f} N left, {rms[0] / weight:.1%} of the weight"],
        ["moment, the same", f"{1e3 * np.sqrt((wrenches[:, 3:] ** 2).mean()):.0f} mN·m", "weight and bias",
         f"{1e3 * rms[1]:.1f} mN·m left"],
        ["residual of calibrate --tool, which follows the drift", "-", f"{whole.shape[0]} poses",
         f"{left[0]:.3f} N, {1e3 * left[1]:.1f} mN·m left"],
        [f"force of the other half predicted, {DRAWS} draws", "-", f"{np.sqrt((errors[:, :3] ** 2).mean()):.3f} N RMS",
         f"{np.mean(chi2 < CHI2_95_6):.0%} in 95 %, mean χ² {chi2.mean():.1f} of 6"],
    ]  # fmt: skip


# Prints of a silicone resin ------------------------------------------------------------------------------------------


#: Test, column and what it holds.
PRINTED = (
    ("Compression", "thickness_or_gage_mm", "thickness of a disc"),
    ("Compression", "diameter_or_thickness_mm", "diameter of a disc"),
    ("Tensile", "diameter_or_thickness_mm", "thickness of a strip"),
    ("Tensile", "width_mm", "width of a strip"),
)


def silicone_40a(folder: Path) -> list[Row]:
    """Compare stiffness and dimensions of prints with the catalogue and the tolerances."""
    resin, rows = RESINS["silicone-40a"], []
    fits = columns(folder / "young_modulus_bootstrap.csv")
    untreated = np.array(fits["sterilization"]) == "none"
    for washed in sorted(set(fits["resin"])):
        E = np.array(fits["E_MPa"], dtype=float)[untreated & (np.array(fits["resin"]) == washed)]
        stated = resin.youngs_modulus.value / MPA
        rows += [
            _row(f"E, {washed}, {len(E)} bootstrapped fits", float(E.mean()), stated, "MPa"),
            [f"spread of E, {washed}", f"{E.std() / E.mean():.0%}", f"{resin.stiffness_spread.value:.0%}", "-"],
        ]
    parts, known = columns(folder / "specimens.csv"), Tolerances()
    model = float(np.hypot(known.diameter_mm, known.diameter_scatter_mm))
    for test, name, what in PRINTED:
        groups: dict[str, list[float]] = {}
        for of, washed, value in zip(parts["test"], parts["resin"], parts[name], strict=True):
            if of == test and value:
                groups.setdefault(washed, []).append(float(value))
        spreads = [float(np.std(values, ddof=1)) for values in groups.values()]
        rows.append([f"standard deviation of the {what}, {len(spreads)} groups",
                     f"{min(spreads):.3f} to {max(spreads):.3f} mm", f"{model:.3f} mm", "-"])  # fmt: skip
    return rows


#: Title and comparison of each data set, by folder.
DATA_SETS: dict[str, tuple[str, Callable[[Path], Sequence[Row]]]] = {
    "bamboo_rod": ("Tapered bamboo rod of 1.88 m, clamped, tip masses up to 40.6 g", bamboo),
    "silicone_beam": ("Cast silicone cantilever 30 x 30 x 100 mm, let go", silicone),
    "nano17_three_sensors": ("Three ATI Nano17 without load, 1000 samples each", nano17),
    "axia80_gravity": ("ATI Axia80 with a gripper on an arm, at rest", axia80),
    "silicone40a_prints": ("Printed Silicone 40A", silicone_40a),
}
