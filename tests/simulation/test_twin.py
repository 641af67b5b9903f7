"""The files for simulators, read and run by MuJoCo, against the rod."""

import math
import xml.etree.ElementTree as ET
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from probedesign.cli.main import run
from probedesign.core.errors import InputError
from probedesign.core.frames import inverse, pose
from probedesign.design import parse_design
from probedesign.design.io import load_design
from probedesign.geometry import Axis
from probedesign.geometry.mass import combined
from probedesign.probe import build_probe
from probedesign.rod.rod import natural_frequency
from probedesign.simulation.twin import chain_of, twin_files
from tests.rod.rods import FLAT, TUBE
from tests.simulation.mujoco_statics import FREE, Twin

#: The paper's horizontal mount, hanging and upright [m/s²].
GRAVITY = ((9.81, 0.0, 0.0), (0.0, 0.0, 9.81), (0.0, 0.0, -9.81))


@pytest.fixture(scope="module")
def model():
    return build_probe(load_design("large")).model


def bent(rod, axis):
    s = np.unique(np.concatenate([rod.s, axis.s]))
    return replace(rod, s=s, radius=rod.radius_at(s), rest_curvature=axis.rest_curvature(s))


def variant(rod, name):
    """Return a rod like that of the large probe with another section or axis."""
    if name in ("hollow", "flat"):
        return replace(rod, factors={"hollow": TUBE, "flat": FLAT}[name], finite_strain=False)
    if name == "arc":
        return bent(rod, Axis.helix(rod.length, math.pi / 2.0))
    return bent(rod, Axis.helix(rod.length, 2.5, 1.0, 0.3)) if name == "helix" else rod


def mjcf(model, **options):
    return twin_files(model, ["mjcf"], **options)[f"{model.name}.xml"]


@pytest.mark.parametrize("name", ["straight", "hollow", "flat", "arc", "helix"])
def test_the_chain_bends_as_the_rod(model, name):
    """Base moment and touched point under 10 to 50 mN at 0.5 to 0.9 of the length, in three directions of gravity."""
    rod = variant(model.rod, name)
    cases = ((0.5, (0.01, 0.0, 0.0)), (0.7, (0.0, -0.03, 0.02)), (0.9, (-0.03, 0.0, 0.0)), (0.9, (0.0, 0.05, 0.0)))
    for gravity in GRAVITY:
        twin = Twin(mjcf(replace(model, rod=rod, gravity_base=np.array(gravity))), rod)
        for fraction, force in cases:
            exact = rod.solve(gravity, force, fraction * rod.length)
            p = twin.load(gravity, force, fraction * rod.length)
            # The targets of the issue. What remains is mostly the stretch, which the chain lacks: F L/(E A).
            assert np.linalg.norm(p - exact.p_contact_base) < 0.3e-3
            wanted = exact.wrench_base[3:]
            assert np.linalg.norm(twin.moment(p, force) - wanted) < 3e-3 * np.linalg.norm(wanted)


def test_more_links_come_closer_to_a_rod_that_does_not_stretch(model):
    rod = replace(model.rod, inextensible=True, finite_strain=False)
    exact = rod.solve(GRAVITY[0], (0.0, 0.03, 0.0), 0.8 * rod.length, mode="reference").p_contact_base
    errors = []
    for links in (8, 16, 32):
        twin = Twin(mjcf(replace(model, rod=rod), links=links), rod)
        errors.append(np.linalg.norm(twin.load(GRAVITY[0], (0.0, 0.03, 0.0), 0.8 * rod.length) - exact))
    # Second order would be a factor of 4; the place of the load within its element makes it uneven.
    assert errors[1] < errors[0] / 2.5 and errors[2] < errors[1] / 2.5 and errors[2] < 2e-5


REST = (0.0, 0.0, 0.0)


@pytest.mark.parametrize(("name", "gravity"), [*(("straight", g) for g in (REST, *GRAVITY[1:])), ("flat", REST),
                                               ("arc", REST), ("helix", REST)])  # fmt: skip
def test_its_first_frequency_is_that_of_the_beam(model, name, gravity):
    rod = variant(model.rod, name)
    twin = Twin(mjcf(replace(model, rod=rod, gravity_base=np.array(gravity))), rod)
    # the issue asks for 2 %
    assert twin.frequency(gravity) == pytest.approx(natural_frequency(rod, gravity), rel=0.01)


def test_it_comes_to_rest_by_itself_with_the_reading_of_the_sensor(model):
    """From a kick of 5 rad/s at all hinges, at its own time step: the wrench of the rod and the weight of the mount,
    with the sign of wrench_base."""
    twin, force, s = Twin(mjcf(model), model.rod), np.array([0.0, 0.01, 0.0]), 0.8 * model.rod.length
    assert twin.model.opt.timestep >= 2e-4
    data = mujoco.MjData(twin.model)
    data.qvel[FREE:] = 5.0
    body, local = twin.point(s)
    for _ in range(400):  # a dead load at the point of the centreline, 8 s in all
        R = data.xmat[body].reshape(3, 3) if data.time else np.eye(3)
        arm = data.xpos[body] + R @ local - data.xipos[body] if data.time else np.zeros(3)
        data.xfrc_applied[body] = [*force, *np.cross(arm, force)]
        mujoco.mj_step(twin.model, data, 100)
    exact = model.rod.solve(model.gravity_base, force, s)
    wanted = model.to_sensor(exact.wrench_base, model.gravity_base)
    assert not any(warning.number for warning in data.warning)
    assert np.abs(data.qvel).max() < 1e-3
    assert np.linalg.norm(data.body("mount").xpos) < 1e-7  # the hold of the mount is stiff
    assert data.sensor("force").data == pytest.approx(wanted[:3], abs=1e-5)
    # 0.3 % of the moment, 4 mN·m
    assert data.sensor("torque").data == pytest.approx(wanted[3:], abs=1.2e-5)


@pytest.mark.parametrize("probe", ["length_mm = 10.0\nbase_d_mm = 3.0\ntip_d_mm = 0.7",
                                   "length_mm = 30.0\nbase_d_mm = 16.0\ntip_d_mm = 8.0",
                                   'length_mm = 150.0\nbase_d_mm = 12.0\ntip_d_mm = 2.0\ntip = "rounded"'])  # fmt: skip
def test_probes_of_all_sizes_come_to_rest(probe):
    model = build_probe(parse_design(f'schema = 1\nname = "large"\n[probe]\n{probe}\n')).model
    twin = mujoco.MjModel.from_xml_string(mjcf(model).decode())
    data = mujoco.MjData(twin)
    data.qvel[FREE:] = 3.0
    mujoco.mj_step(twin, data, 20_000)
    free = model.to_sensor(model.rod.solve(model.gravity_base).wrench_base, model.gravity_base)
    assert not any(warning.number for warning in data.warning)
    assert np.append(data.sensor("force").data, data.sensor("torque").data) == pytest.approx(free, abs=2e-5)


def test_the_holder_moves_the_probe(model):
    """The mocap body carries the probe; in free fall the sensor reads nothing."""
    twin = Twin(mjcf(replace(model, gravity_base=np.zeros(3))), model.rod)
    data = mujoco.MjData(twin.model)
    start = twin.model.body("holder").pos.copy()
    for _ in range(2000):
        data.mocap_pos[0] = start + 0.5 * np.array([0.0, 0.0, 0.2]) * data.time**2
        mujoco.mj_step(twin.model, data)
    mass = model.payload.mass + model.mass
    assert data.body("mount").xpos[2] == pytest.approx(0.1 * data.time**2, abs=2e-4)
    # the inertia of what is accelerated, along z: force = -m a
    assert data.sensor("force").data[2] == pytest.approx(-mass * 0.2, rel=0.05)


@pytest.mark.parametrize("name", ["straight", "flat", "helix"])
def test_all_formats_have_the_mass_and_frames_of_the_probe(model, name):
    rod = variant(model.rod, name)
    section = replace(model.cross_section, flatness=0.7) if name == "flat" else model.cross_section
    model = replace(model, rod=rod, cross_section=section)
    rest, files = rod.solve(mode="reference"), twin_files(model)
    tip = pose(rest.R_at(rod.length), rest.p_at(rod.length))
    frames = {"probe_base": np.eye(4), "probe_tip": tip, "sensor": inverse(model.T_sensor_base),
              "robotflange": inverse(model.T_robotflange_base)}  # fmt: skip
    whole = combined([link.material.moved(link.T_base_link) for link in chain_of(rod)])
    assert whole.mass == pytest.approx(rod.mass, rel=1e-9)
    if name == "straight":
        body = build_probe(load_design("large")).body
        assert whole.p_com == pytest.approx(body.p_com, abs=1e-12)
        assert whole.inertia == pytest.approx(body.inertia, rel=1e-9, abs=1e-15)
    everything = combined([whole, model.payload.moved(frames["sensor"])])

    chain = mujoco.MjModel.from_xml_string(files["large.xml"].decode())
    data = mujoco.MjData(chain)
    mujoco.mj_forward(chain, data)
    assert data.subtree_com[0] == pytest.approx(everything.p_com, abs=1e-8)  # nine digits in the file
    assert chain.body_mass.sum() == pytest.approx(everything.mass, rel=1e-8)
    for key, T in frames.items():
        site = data.site(key)
        assert site.xpos == pytest.approx(T[:3, 3], abs=1e-8) and site.xmat.reshape(3, 3) == pytest.approx(
            T[:3, :3], abs=1e-7
        )

    sdf = ET.fromstring(files["large.sdf"])
    assert np.fromstring(sdf.find("world/gravity").text, sep=" ") == pytest.approx(model.gravity_base)
    masses = [float(one.text) for one in sdf.iterfind(".//inertial/mass")]
    assert sum(masses) == pytest.approx(everything.mass, rel=1e-8)
    for frame in sdf.iterfind("world/model/frame"):
        assert placed(frame.find("pose").text) == pytest.approx(frames[frame.get("name")], abs=1e-7)
    assert placed(sdf.find("world/model/link[@name='sensor']/pose").text) == pytest.approx(frames["sensor"], abs=1e-8)
    sensor = sdf.find("world/model/joint[@name='sensor_joint']/sensor")
    assert sensor.find("force_torque/measure_direction").text == "child_to_parent"  # the sign of wrench_base

    # MuJoCo reads URDF as well
    rigid = mujoco.MjModel.from_xml_string(files["large.urdf"].decode().replace(
        "</robot>", '<mujoco><compiler fusestatic="false" inertiafromgeom="false"/></mujoco></robot>'))  # fmt: skip
    data = mujoco.MjData(rigid)
    mujoco.mj_forward(rigid, data)
    assert data.subtree_com[0] == pytest.approx(everything.p_com, abs=1e-8)
    assert rigid.body_mass.sum() == pytest.approx(everything.mass, rel=1e-8)
    for key, T in frames.items():
        assert data.body(key).xpos == pytest.approx(T[:3, 3], abs=1e-8)


def placed(text):
    values = np.fromstring(text, sep=" ")
    return pose(Rotation.from_euler("xyz", values[3:]).as_matrix(), values[:3])


def test_usd_has_the_mass_and_the_stiffness_of_the_chain(model):
    pxr = pytest.importorskip("pxr", reason="usd-core is optional")
    from pxr import Sdf, Usd

    layer = Sdf.Layer.CreateAnonymous(".usda")
    assert pxr and layer.ImportFromString(twin_files(model, ["usd"])["large.usda"].decode())
    stage = Usd.Stage.Open(layer)
    masses = [prim.GetAttribute("physics:mass").Get() for prim in stage.Traverse() if prim.HasAttribute("physics:mass")]
    assert sum(masses) == pytest.approx(model.mass + model.payload.mass, rel=1e-6)  # single precision
    stiffness = stage.GetPrimAtPath("/probe/link_1_joint").GetAttribute("drive:rotX:physics:stiffness").Get()
    assert math.degrees(stiffness) == pytest.approx(chain_of(model.rod)[1].stiffness["x"], rel=1e-6)


def test_bad_input_is_one_line_and_writes_nothing(tmp_path, capsys, model):
    soft = replace(model, rod=replace(model.rod, youngs_modulus=2e4), gravity_base=np.array([0.0, 0.0, -9.81]))
    with pytest.raises(InputError, match=r"large: buckles under its own weight with mount.gravity_base_m_s2 = \["):
        twin_files(soft)
    out = tmp_path / "twin"
    for option, message in ((["--links", "11"], "--links 11 must be an even number"),
                            (["--format", "mjcf,gltf"], "'gltf' is not a format")):  # fmt: skip
        assert run(["twin", "designs/large.toml", "--out", str(out), *option]) == 2
        assert message in capsys.readouterr().err and not out.exists()
    assert run(["twin", "designs/large.toml", "--out", str(out), "--json"]) == 0
    assert {file.name for file in out.iterdir()} == {"large.xml", "large.sdf", "large.urdf"}
