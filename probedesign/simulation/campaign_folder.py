"""Data folder of a simulated campaign: its tables as a laboratory would fill them, and the ground truth."""

import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from probedesign.campaigns.manifest import manifest_lines, number_list
from probedesign.campaigns.reading import CONTROL_POINTS_SCHEMA, PIXELS_SCHEMA, TESTS_SCHEMA, WRENCHES_SCHEMA
from probedesign.core import csv_tables
from probedesign.core.errors import InputError
from probedesign.core.files import check_replaceable, replaced_folder
from probedesign.core.frames import Array
from probedesign.core.units import MM
from probedesign.estimation.error_sources import bow_of
from probedesign.estimation.model import WALK_SECONDS, ProbeModel
from probedesign.simulation.ground_truth import STD_BASE, CampaignPlan, GroundTruth, SimulatedTest
from probedesign.simulation.stereo_rig import CLICK_PX, CONTROL_PX, SIZE_PX, StereoRig

TRUTH = "truth.json"
#: Standard deviation of a contact's position, on each axis [m]: a millimetre in space by two cameras (assumed, as in
#: docs/prediction.md), a twentieth by a stage.
STD_CONTACT = {"cameras": 0.6 * MM, "stage": 0.05 * MM}
STD_WEIGHT_ARCLENGTH = 0.5 * MM  #: Of the position of a thread [m] (assumed).
STD_SAG = 0.5 * MM  #: Of the tip's sag in a photograph with a scale [m] (assumed).
STD_WEIGHING = 1e-5  #: Of a laboratory balance [kg] (assumed).

TEST_SECONDS = 60.0  #: Time from one test to the next (assumed).


@dataclass(frozen=True, eq=False)
class SimulatedCampaign:
    """A simulated campaign that was written."""

    folder: Path  #: of it.
    files: tuple[str, ...]  #: names of its files.
    tests: int  #: number of tests.


def make_campaign(model: ProbeModel, folder: Path, plan: CampaignPlan, force: bool = False) -> SimulatedCampaign:
    """Simulate a campaign and write its data folder, atomically.

    Args:
        model: of the probe as designed.
        folder: to write.
        plan: of the campaign.
        force: replace an existing simulated campaign.

    Raises:
        InputError: the folder exists, or the probe or the plan cannot be simulated.
    """
    check_replaceable(folder, TRUTH, "synthetic campaign", force)
    rng = np.random.default_rng(plan.seed)
    truth = GroundTruth.draw(model, plan, rng)
    tests = truth.tests()
    rig = StereoRig(truth)
    tables = {
        "campaign.toml": _manifest(truth, rig),
        "tests.csv": _tests(truth, tests, rng),
        "wrenches.csv": _wrenches(truth, tests, rng),
        **_markers(rig, tests, rng),
        TRUTH: _truth(truth, tests),
    }
    with replaced_folder(folder) as draft:
        for name, text in tables.items():
            (draft / name).write_bytes(text.encode())
    names = sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())
    return SimulatedCampaign(folder, tuple(names), len(tests))


# tables


def _manifest(truth: GroundTruth, rig: StereoRig) -> str:
    plan, model = truth.plan, truth.model
    about = "A synthetic campaign, simulated by `probedesign campaign`. The ground truth is in truth.json."
    lines = manifest_lines(about, model, truth.T_world_base, STD_BASE[plan.kind], truth.stated_gravity)
    if plan.kind == "cameras":
        lines += ["", "[markers]                   # marker 1 is the nearest to the base",
                  f"s_mm = {number_list(rig.marker_s / MM)}"]  # fmt: skip
        if plan.marker_noise is None:
            lines += [f"side_deg = {math.degrees(rig.side):g}              # dots on the surface, this side",
                      "", "[cameras]", 'names = ["left", "right"]']  # fmt: skip
        else:
            lines += [f"std_mm = {plan.marker_noise / MM:g}"]
    mass_g = 1e3 * (truth.rod.mass + np.random.default_rng([plan.seed, 1]).normal() * STD_WEIGHING)
    lines += ["", "[weighing]", f"mass_g = {mass_g:.2f}", f"std_g = {1e3 * STD_WEIGHING:g}",
              'of = "flexible"', "", "[source]", f'made_by = "probedesign campaign, seed {plan.seed}"', ""]  # fmt: skip
    return "\n".join(lines)


def _tests(truth: GroundTruth, tests: list[SimulatedTest], rng: np.random.Generator) -> str:
    rows, touches, std = [], 0, STD_CONTACT[truth.plan.kind]
    for test in tests:
        row, surface = {"test": test.name, "direction": test.direction}, test.p_surface_base
        if test.weight is not None:
            row |= _point("force_{}_world_N", test.weight, ".6g")
        if test.weight is not None and test.weight.any():
            row |= _known("s_contact_mm", "std_s_mm", test.s_contact, STD_WEIGHT_ARCLENGTH, rng)
        elif surface is not None:
            touches += 1
            if truth.plan.kind == "stage":
                row |= _known("s_contact_mm", "std_s_mm", test.s_contact, std, rng)
            touched = test.bench.to_world(surface) + rng.normal(size=3) * std
            row |= _point("contact_{}_world_mm", touched / MM, ".4f") | {"std_contact_mm": f"{std / MM:g}"}
            row["use"] = "validate" if truth.plan.hold_out and touches % 2 == 0 else ""
        if test.name == "hang-1":
            row |= _known("tip_sag_mm", "std_sag_mm", _sag(truth, test), STD_SAG, rng)
        rows.append(row)
    return csv_tables.write(TESTS_SCHEMA.like.split(","), rows).decode()


def _point(column: str, values: Array, spec: str) -> dict[str, str]:
    return {column.format(axis): f"{value + 0.0:{spec}}" for axis, value in zip("xyz", values, strict=True)}


def _known(column: str, std_column: str, value: float, std: float, rng: np.random.Generator) -> dict[str, str]:
    return {column: f"{(value + rng.normal() * std) / MM:.4f}", std_column: f"{std / MM:g}"}


def _sag(truth: GroundTruth, test: SimulatedTest) -> float:
    """Return the displacement of the tip along gravity from the probe as designed, without weight [m]."""
    origin, down = truth.model.rod.sag_origin, test.bench.gravity_base
    tip = test.equilibrium.p_at(truth.rod.length) - origin
    return (1.0 + truth.flaws.length_scale) * float(tip @ down / np.linalg.norm(down))


def _wrenches(truth: GroundTruth, tests: list[SimulatedTest], rng: np.random.Generator) -> str:
    """Return the text of `wrenches.csv`: readings with noise, errors of the gain, and a bias that walks."""
    model, flaws = truth.model, truth.flaws
    std = model.noise.std
    step = math.sqrt(model.averaging_samples) * std
    bias = flaws.drift_steps * step * rng.normal(size=6)
    walk = flaws.walk_steps * math.sqrt(TEST_SECONDS / WALK_SECONDS) * step
    rows = ["# frame: sensor", WRENCHES_SCHEMA.like]
    for k, test in enumerate(tests):
        for i in range(truth.plan.readings):
            reading = (1.0 + flaws.gain) * test.wrench_sensor + bias + std * rng.normal(size=6)
            rows.append(",".join([test.name, f"{TEST_SECONDS * k + i:g}", *(f"{value:.8g}" for value in reading)]))
        bias = bias + walk * rng.normal(size=6)
    return "\n".join(rows) + "\n"


def _markers(rig: StereoRig, tests: list[SimulatedTest], rng: np.random.Generator) -> dict[str, str]:
    """Return the text of the tables of the reference, by name."""
    plan = rig.truth.plan
    if plan.kind == "stage":
        return {}
    if plan.marker_noise is not None:
        rows = ["test,marker,x_world_mm,y_world_mm,z_world_mm"]
        for test in tests:
            s = np.minimum(rig.marker_s, rig.truth.rod.length)
            on_axis = test.bench.to_world(test.equilibrium.p_at(s))
            seen = on_axis + rng.normal(size=on_axis.shape) * plan.marker_noise
            rows += [f"{test.name},{i},{_row(p / MM, 4)}" for i, p in enumerate(seen, 1)]
        return {"markers.csv": "\n".join(rows) + "\n"}
    pixels, control = [PIXELS_SCHEMA.like], [CONTROL_POINTS_SCHEMA.like]
    for camera in rig.cameras:
        seen = camera.project(rig.control_points) + rng.normal(size=(20, 2)) * CONTROL_PX
        control += [f"{i},{_row(p / MM, 2)},{camera.name},{_row(uv, 2)}"
                    for i, (p, uv) in enumerate(zip(rig.control_points, seen, strict=True), 1)]  # fmt: skip
    for test in tests:
        for camera in rig.cameras:
            seen = camera.project(rig.markers(test))
            seen = seen + rng.normal(size=seen.shape) * CLICK_PX
            if (seen < 0).any() or (seen > SIZE_PX).any():
                raise InputError(f"test {test.name}: the probe leaves the cameras' field of view; use "
                                 "--marker-noise-mm 1 instead")  # fmt: skip
            pixels += [f"{test.name},{camera.name},{i},{_row(uv, 2)},{CLICK_PX:g}" for i, uv in enumerate(seen, 1)]
    return {"control_points.csv": "\n".join(control) + "\n", "pixels.csv": "\n".join(pixels) + "\n"}


def _truth(truth: GroundTruth, tests: list[SimulatedTest]) -> str:
    rod = truth.rod
    document = {
        "what": "what a synthetic campaign was made from; no command reads it",
        "seed": truth.plan.seed,
        "youngs_modulus_mpa": rod.youngs_modulus / 1e6,
        "shear_modulus_mpa": rod.shear_modulus / 1e6,
        "density_kg_m3": rod.density,
        "length_mm": rod.length / MM,
        "diameters_mm": (2.0 * rod.radius / MM).tolist(),
        "bow_mm": (bow_of(truth.model, rod, truth.curvature) / MM).tolist(),
        "curvature": truth.curvature,
        "mass_g": 1e3 * rod.mass,
        "root_rigid_radii": rod.rigid_length / float(rod.radius[0]),
        "gain": truth.flaws.gain.tolist(),
        "creep": truth.flaws.creep,
        "length_scale": truth.flaws.length_scale,
        "T_world_base": truth.T_world_true.tolist(),
        "gravity_world_m_s2": truth.gravity_world.tolist(),
        "tests": {test.name: _true_test(test) for test in tests},
    }
    return json.dumps(document, indent=1) + "\n"


def _true_test(test: SimulatedTest) -> dict[str, object]:
    eq, bench, surface = test.equilibrium, test.bench, test.p_surface_base
    force = bench.T_world_true[:3, :3] @ eq.load[0:3]
    return {
        "force_world_N": force.tolist(),
        "s_contact_mm": test.s_contact / MM if force.any() else None,
        "friction": None if surface is None else test.friction,
        "contact_world_mm": None if surface is None else (bench.to_world(surface) / MM).tolist(),
        "wrench_sensor": test.wrench_sensor.tolist(),
    }


def _row(values: Array, digits: int) -> str:
    return ",".join(f"{value:.{digits}f}" for value in values)
