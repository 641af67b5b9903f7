"""The tables of a synthetic campaign, as a laboratory would fill them, and the truth beside them."""

import json
import math

import numpy as np
from scipy.spatial.transform import Rotation

from probedesign.errors import InputError
from probedesign.estimation.tolerances import Tolerances
from probedesign.frames import Array
from probedesign.simulation.ground_truth import STD_BASE, State, World
from probedesign.simulation.stereo_rig import CLICK_PX, CONTROL_PX, SIZE_PX, Sight
from probedesign.units import MM

STD_CONTACT = {"cameras": 0.6 * MM, "stage": 0.05 * MM}
"""Of the place of a contact, on each axis [m]: of two cameras a millimetre in space (assumed, as `predict --table1`
has it); of a stage the issue's."""
STD_WEIGHT_PLACE = 0.5 * MM
"""Of where a thread lies [m] (assumed)."""
STD_SAG = 0.5 * MM
"""Of a tip's sag in a photograph with a scale [m] (assumed)."""
STD_WEIGHING = 1e-5
"""Of laboratory scales [kg] (assumed)."""

TESTS = (
    "test,force_x_world_N,force_y_world_N,force_z_world_N,s_contact_mm,std_s_mm,contact_x_world_mm,"
    "contact_y_world_mm,contact_z_world_mm,std_contact_mm,direction,tip_sag_mm,std_sag_mm"
)


def manifest_of(world: World, sight: Sight) -> str:
    """Text of `campaign.toml`."""
    plan, model = world.plan, world.model
    turn = np.degrees(Rotation.from_matrix(world.T_world_base[:3, :3]).as_rotvec())
    std_place, std_turn = STD_BASE[plan.kind]
    lines = [
        "# A synthetic campaign: made by probedesign campaign, measured by nobody. What was true stands in truth.json.",
        "schema = 1",
        f"probe = {json.dumps(model.name)}",
        f"fingerprint = {json.dumps(model.fingerprint)}",
        "",
        "[base]                      # pose of the base in the world of the control points",
        f"p_world_mm = {_list(world.T_world_base[:3, 3] / MM)}",
        f"rotation_world_deg = {_list(turn)}",
        f"std_mm = {std_place / MM:g}",
        f"std_deg = {math.degrees(std_turn):g}",
        "",
        "[gravity]",
        f"world_m_s2 = {_list(world.gravity_said)}",
    ]
    if plan.kind == "cameras":
        lines += ["", "[markers]                   # marker 1 is the nearest to the base",
                  f"s_mm = {_list(sight.marker_s / MM)}"]  # fmt: skip
        if plan.marker_noise is None:
            lines += [f"side_deg = {math.degrees(sight.side):g}              # dots on the surface, this side",
                      "", "[cameras]", 'names = ["left", "right"]']  # fmt: skip
        else:
            lines += [f"std_mm = {plan.marker_noise / MM:g}"]
    lines += ["", "[weighing]", f"mass_g = {_weighed(world):.2f}", f"std_g = {1e3 * STD_WEIGHING:g}", 'of = "flexible"',
              "", "[source]", f'made_by = "probedesign campaign, seed {plan.seed}"', ""]  # fmt: skip
    return "\n".join(lines)


def _weighed(world: World) -> float:
    """What scales say of the soft part [g]."""
    noise = np.random.default_rng([world.plan.seed, 1]).normal() * STD_WEIGHING
    return float(1e3 * (world.rod.mass + noise))


def tests_of(world: World, states: list[State], rng: np.random.Generator) -> str:
    """Text of `tests.csv`."""
    rows = [TESTS]
    for state in states:
        force = ["", "", ""] if state.weight is None else [f"{value + 0.0:.6g}" for value in state.weight]
        s, contact, spread = ["", ""], ["", "", ""], ""
        std = STD_CONTACT[world.plan.kind]
        true_s = state.s_contact
        if state.weight is not None and state.weight.any():
            s = _known(true_s + rng.normal() * STD_WEIGHT_PLACE, STD_WEIGHT_PLACE)
        elif state.p_surface_base is not None:
            if world.plan.kind == "stage":
                s = _known(true_s + rng.normal() * std, std)
            place = world.to_world(state.p_surface_base) + rng.normal(size=3) * std
            contact, spread = [f"{value / MM:.4f}" for value in place], f"{std / MM:g}"
        sag = (
            _known(_sag(world, state) + rng.normal() * STD_SAG, STD_SAG)
            if state.name == "hang-1"
            else ["", ""]
        )
        rows.append(",".join([state.name, *force, *s, *contact, spread, state.direction, *sag]))
    return "\n".join(rows) + "\n"


def _known(value: float, std: float) -> list[str]:
    return [f"{value / MM:.4f}", f"{std / MM:g}"]


def _sag(world: World, state: State) -> float:
    """How far the tip hangs below where the straight probe has it, along gravity [m]."""
    length = world.rod.length
    tip = state.equilibrium.p_at(length) - np.array([0.0, 0.0, length])
    return float(tip @ world.gravity_base / np.linalg.norm(world.gravity_base))


def wrenches_of(world: World, states: list[State], rng: np.random.Generator) -> str:
    """Readings with their noise and, from test to test, the drift of the bias."""
    model, tolerances = world.model, Tolerances.of(world.model)
    std = np.repeat([model.noise.force, model.noise.moment], 3)
    drift = 0.0 if world.plan.exact else tolerances.drift_steps * math.sqrt(model.averaging_samples)
    rows = ["# frame: sensor", "test,time_s,Fx_N,Fy_N,Fz_N,Mx_Nm,My_Nm,Mz_Nm"]
    for k, state in enumerate(states):
        bias = drift * std * rng.normal(size=6)
        for i in range(world.plan.readings):
            read = state.wrench_sensor + bias + std * rng.normal(size=6)
            rows.append(",".join([state.name, f"{60 * k + i:g}", *(f"{value:.8g}" for value in read)]))
    return "\n".join(rows) + "\n"


def markers_of(sight: Sight, states: list[State], rng: np.random.Generator) -> dict[str, str]:
    """The tables of the reference, by name."""
    plan = sight.world.plan
    if plan.kind == "stage":
        return {}
    if plan.marker_noise is not None:
        rows = ["test,marker,x_world_mm,y_world_mm,z_world_mm"]
        for state in states:
            on_axis = sight.world.to_world(
                state.equilibrium.p_at(np.minimum(sight.marker_s, sight.world.rod.length))
            )
            seen = on_axis + rng.normal(size=on_axis.shape) * plan.marker_noise
            rows += [f"{state.name},{i},{_row(p / MM, 4)}" for i, p in enumerate(seen, 1)]
        return {"markers.csv": "\n".join(rows) + "\n"}
    pixels = ["test,camera,marker,u_px,v_px,std_px"]
    control = ["point,x_world_mm,y_world_mm,z_world_mm,camera,u_px,v_px"]
    for camera in sight.cameras:
        seen = camera.project(sight.control_points) + rng.normal(size=(20, 2)) * CONTROL_PX
        control += [f"{i},{_row(p / MM, 2)},{camera.name},{_row(uv, 2)}"
                    for i, (p, uv) in enumerate(zip(sight.control_points, seen, strict=True), 1)]  # fmt: skip
    for state in states:
        for camera in sight.cameras:
            seen = camera.project(sight.markers(state))
            seen = seen + rng.normal(size=seen.shape) * CLICK_PX
            _check_in_picture(seen, state.name)
            pixels += [
                f"{state.name},{camera.name},{i},{_row(uv, 2)},{CLICK_PX:g}" for i, uv in enumerate(seen, 1)
            ]
    calibrated = {"control_points.csv": "\n".join(control) + "\n"}
    if plan.images:  # the markers are to be found in them
        return calibrated
    return {**calibrated, "pixels.csv": "\n".join(pixels) + "\n"}


def _check_in_picture(pixels: Array, test: str) -> None:
    if (pixels < 0).any() or (pixels > SIZE_PX).any():
        raise InputError(
            f"test {test}: the probe bends out of the cameras' pictures; try --marker-noise-mm 1 instead"
        )


def truth_of(world: World, states: list[State]) -> str:
    """Text of `truth.json`."""
    rod = world.rod
    document = {
        "what": "what a synthetic campaign was made from; no command reads it",
        "seed": world.plan.seed,
        "youngs_modulus_mpa": rod.youngs_modulus / 1e6,
        "shear_modulus_mpa": rod.shear_modulus / 1e6,
        "density_kg_m3": rod.density,
        "length_mm": rod.length / MM,
        "diameters_mm": (2.0 * rod.radius / MM).tolist(),
        "mass_g": 1e3 * rod.mass,
        "T_world_base": world.T_world_true.tolist(),
        "gravity_world_m_s2": world.gravity_world.tolist(),
        "tests": {state.name: _true(world, state) for state in states},
    }
    return json.dumps(document, indent=1) + "\n"


def _true(world: World, state: State) -> dict[str, object]:
    eq, R = state.equilibrium, world.T_world_true[:3, :3]
    force = R @ eq.load[0:3]
    touched = bool(force.any())
    surface = state.p_surface_base
    return {
        "force_world_N": force.tolist(),
        "s_contact_mm": state.s_contact / MM if touched else None,
        "friction": state.friction if surface is not None else None,
        "contact_world_mm": None if surface is None else (world.to_world(surface) / MM).tolist(),
        "axis_world_mm": (world.to_world(eq.p_at(state.s_contact)) / MM).tolist() if touched else None,
        "wrench_sensor": state.wrench_sensor.tolist(),
    }


def _list(values: Array) -> str:
    return "[" + ", ".join(repr(round(float(value), 6) + 0.0) for value in values) + "]"


def _row(values: Array, digits: int) -> str:
    return ",".join(f"{value:.{digits}f}" for value in values)
