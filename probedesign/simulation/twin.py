"""A probe for the simulators of others: a chain of links with elastic hinges as MJCF and USD, a rigid body as SDF and
URDF. The world's axes and origin are those of the base frame.

The chain approximates the `Rod`. The axis is cut into elements that are shorter where the rod is thinner. Each has two
universal hinges at the Gauss points of its bending compliance f/(E I), with the compliance of shear added
to its second moment, so that an element bends, deflects and shears under any load beyond it as the rod does to first
order:

    Σ cᵢ = ∫ f/(E I) ds,    Σ cᵢ (sᵢ - s̄)² = ∫ (s - s̄)² f/(E I) ds + ∫ ds/(k G A),    Σ cᵢ (sᵢ - s̄)ᵏ exact for k = 1, 3,

with f the factor of the bonded root. The second hinge turns about its axes in the opposite order, so that the order
does not count to first order; a straight element needs one torsion only, between both. Stretch and the stiffening by
finite strain are neglected. Accuracy and time of a step: docs/twin.md.
"""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple
from xml.etree.ElementTree import Comment, Element, SubElement, indent, tostring

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from probedesign.core.errors import InputError, require
from probedesign.core.frames import Array, inverse, pose, rotation_z
from probedesign.estimation.model import ProbeModel
from probedesign.geometry.mass import MassProperties, combined
from probedesign.rod.equilibrium import Equilibrium
from probedesign.rod.rod import Rod, natural_frequency

#: Name of the format, ending of its file.
FORMATS = {"mjcf": ".xml", "sdf": ".sdf", "urdf": ".urdf", "usd": ".usda"}
LINKS, CURVED_LINKS = 10, 14  #: Of the chain of a straight and of a curved probe by default.
MIN_LINKS, MAX_LINKS = 4, 40
TIME_STEP = 2e-4  #: Of the MJCF [s].
#: Ratio of the damping of the first mode to the critical one (assumed). Materials of this kind have 0.05 to 0.1.
DAMPING_RATIO = 0.05
#: Exponent of 1/radius to which the number of elements per length is proportional. 0.5 gives the smallest errors.
_CROWDING = 0.5
_CLEAR = 0.05  #: Shortest distance from a hinge to the end of its element, as a fraction of the element.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
_ENVELOPE = 24  #: Fewest cylinders of the rigid body.
LEAST_INERTIA = 2e-15  #: Of a link [kg·m²], where that of a thin tip is less: MuJoCo refuses 1e-15.
HOLD_RADIUS = 0.02  #: Of the points at which the mount is held [m].
_INERTIA = (("ixx", 0, 0), ("iyy", 1, 1), ("izz", 2, 2), ("ixy", 0, 1), ("ixz", 0, 2), ("iyz", 1, 2))


class Link(NamedTuple):
    """A rigid piece of the chain, from its hinge to the next one."""

    s: float  #: arclength of its hinge [m]; 0 for the first piece, which is fixed to the base.
    T_base_link: Array  #: section at its hinge, unloaded, (4, 4).
    #: of its hinges about the section's axes [N·m/rad], in their order from the base; none for the first piece.
    stiffness: dict[str, float]
    material: MassProperties  #: of the rod from its hinge to the next one, in its own frame.
    p_end: Array  #: the next hinge, or the tip, in its own frame [m], (3,).
    radius: float  #: of a capsule along it [m].


def chain_of(rod: Rod, links: int | None = None) -> list[Link]:
    """Return the first piece, which is fixed to the base, and the links of the chain.

    Args:
        rod: the flexible part.
        links: number of links; even. `LINKS` or `CURVED_LINKS` if None.

    Raises:
        InputError: the number is odd or out of range.
    """
    if links is None:
        links = LINKS if rod.rest_curvature is None else CURVED_LINKS
    if links % 2 or not MIN_LINKS <= links <= MAX_LINKS:
        raise InputError(f"--links {links} must be an even number in {MIN_LINKS} ... {MAX_LINKS}")
    rest, tip = rod.solve(mode="reference"), rod.length
    s, stiffness = _hinges(rod, links)
    starts, ends = [0.0, *s], [*s, tip]
    chain = []
    for a, b, k in zip(starts, ends, [{}, *stiffness], strict=True):
        T = pose(rest.R_at(a), rest.p_at(a))
        radius = float(rod.radius_at((a + b) / 2.0))
        end = b if b < tip else max(tip - radius, a)  # the round end of a capsule stays within the tip
        p_end = T[:3, :3].T @ (rest.p_at(end) - T[:3, 3])
        material = _material(rod, rest, a, b).moved(inverse(T))
        chain.append(Link(a, T, k, material, p_end, radius * math.sqrt(rod.flatness)))
    return chain


def _hinges(rod: Rod, links: int) -> tuple[list[float], list[dict[str, float]]]:
    """Return arclength and stiffness of the hinges, see the module.

    The end of a rounded tip is rigid: nothing touches there, and it would attract the last hinge.
    """
    grid = np.linspace(0.0, rod.flank_end, 2001)
    crowding = np.append(0.0, np.cumsum(rod.radius_at((grid[1:] + grid[:-1]) / 2.0) ** -_CROWDING))
    cuts = np.interp(np.linspace(0.0, crowding[-1], links // 2 + 1), crowding, grid)
    depth, reach = rod.root
    area, xx, yy, torsion = rod.factors
    hinges: list[float] = []
    stiffness: list[dict[str, float]] = []
    for a, b in pairwise(cuts):
        s, w = _quadrature(rod, a, b)
        r = rod.radius_at(s)
        missing = depth * np.clip(1.0 - s / reach, 0.0, None) ** 3 if reach > 0.0 else 0.0
        c = 4.0 * w * (1.0 - missing) / (np.pi * rod.youngs_modulus * r**4)
        bending, twisting = float(c.sum()), float((2.0 * w / (np.pi * rod.shear_modulus * r**4)).sum())
        sheared = float((w / (rod.shear_coefficient * rod.shear_modulus * area * np.pi * r**2)).sum())
        sheared *= 0.0 if rod.inextensible else math.sqrt(xx * yy)  # of both planes of bending
        middle = float(c @ s) / bending
        second = (float(c @ (s - middle) ** 2) + sheared) / bending
        skew = float(c @ (s - middle) ** 3) / bending / second
        apart = skew / 2.0 + np.array([-1.0, 1.0]) * math.sqrt(skew**2 / 4.0 + second)
        clear = _CLEAR * (b - a)  # a short and thick element shears more than two hinges within it can
        apart = np.clip(apart, a + clear - middle, b - clear - middle)
        near, far = apart[::-1] / (apart[1] - apart[0]) * (1.0, -1.0)  # of the compliance
        x, y = xx / bending, yy / bending
        hinges += [middle + apart[0], middle + apart[1]]
        z = torsion / twisting
        if rod.rest_curvature is None:
            stiffness += [{"x": x / near, "y": y / near, "z": z}, {"y": y / far, "x": x / far}]
        else:
            stiffness += [{"x": x / near, "y": y / near, "z": z / near}, {"z": z / far, "y": y / far, "x": x / far}]
    return hinges, stiffness


def _quadrature(rod: Rod, a: float, b: float) -> tuple[Array, Array]:
    """Return Gauss points and weights on [a, b], between the knots and the end of the root."""
    breaks = np.array([a, b, *rod.s, rod.root[1]])
    ends = np.unique(breaks[(breaks >= a) & (breaks <= b)])
    half = np.diff(ends)[:, None] / 2.0
    return (ends[:-1, None] + half * (1.0 + _NODES)).ravel(), (half * _WEIGHTS).ravel()


def _material(rod: Rod, rest: Equilibrium, a: float, b: float) -> MassProperties:
    """Return the mass properties of the unloaded rod between two arclengths, in the base frame."""
    s, w = _quadrature(rod, a, b)
    r, (area, xx, yy, _) = rod.radius_at(s), rod.factors
    volumes, p, R = w * area * np.pi * r**2, rest.p_at(s), rest.R_at(s)
    volume = float(volumes.sum())
    p_com = volumes @ p / volume
    second = np.einsum("i,ij,ik->jk", volumes, p - p_com, p - p_com)
    for factor, axis in ((yy, R[:, :, 0]), (xx, R[:, :, 1])):
        second += np.einsum("i,ij,ik->jk", factor * w * np.pi / 4.0 * r**4, axis, axis)
    inertia = rod.density * (np.trace(second) * np.eye(3) - second)
    return MassProperties(volume, rod.density * volume, p_com, inertia)


def twin_files(
    model: ProbeModel, formats: Sequence[str] = ("mjcf", "sdf", "urdf"), links: int | None = None
) -> dict[str, bytes]:
    """Return the files of a probe for simulators by name.

    Args:
        model: of the probe.
        formats: out of `FORMATS`.
        links: number of links of the chain in MJCF and USD, as for `chain_of`.

    Raises:
        InputError: the probe buckles under its own weight, or the number of links is out of range.
        MissingDependencyError: USD needs usd-core.
    """
    if not model.rod.solve(model.gravity_base).ok:
        g = ", ".join(f"{x:g}" for x in model.gravity_base)
        raise InputError(
            f"{model.name}: buckles under its own weight with mount.gravity_base_m_s2 = [{g}]; "
            "mount it in another direction, or make it shorter or thicker"
        )
    chain, rest, tip = chain_of(model.rod, links), model.rod.solve(mode="reference"), model.rod.length
    frames = {"probe_base": np.eye(4), "probe_tip": pose(rest.R_at(tip), rest.p_at(tip))}
    frames["sensor"] = inverse(model.T_sensor_base)
    if model.T_robotflange_base is not None:
        frames["robotflange"] = inverse(model.T_robotflange_base)
    writers = {"mjcf": _mjcf, "sdf": _sdf, "urdf": _urdf, "usd": _usd}
    return {f"{model.name}{FORMATS[name]}": writers[name](model, chain, frames) for name in formats}


def _text(values: ArrayLike) -> str:
    return " ".join(f"{x + 0.0:.9g}" for x in np.asarray(values, dtype=float).ravel())


def _add(parent: Element, tag: str, text: ArrayLike = "", **attributes: ArrayLike) -> Element:
    """Add an element with its text and attributes; numbers are written with nine digits."""
    written = {key: value if isinstance(value, str) else _text(value) for key, value in attributes.items()}
    element = SubElement(parent, tag, written)
    element.text = text if isinstance(text, str) else _text(text)
    return element


def _quaternion(R: Array) -> Array:
    return np.roll(Rotation.from_matrix(R).as_quat(canonical=True), 1)


def _principal(inertia: Array) -> tuple[Array, Array]:
    moments, axes = np.linalg.eigh(inertia)
    axes[:, 0] *= np.sign(np.linalg.det(axes))
    return moments, axes


def _note(model: ProbeModel) -> str:
    return (
        f"Probe {model.name}, geometry {model.fingerprint}, in SI units. Axes and origin of the world: those of the "
        f"probe's base frame, z towards the tip. Assumed: {', '.join(('damping', *model.assumptions))}."
    )


def _file(root: Element, note: str) -> bytes:
    root.insert(0, Comment(f" {note.replace('--', '- -')} "))
    indent(root)
    return f'<?xml version="1.0" encoding="utf-8"?>\n{tostring(root, encoding="unicode")}\n'.encode()


def _damping_time(rod: Rod) -> float:
    """Return τ of a damping in proportion to the stiffness, E (1 + τ d/dt) [s], (assumed).

    τ of half a time step keeps every mode stable, since MuJoCo's damping is implicit and its stiffness is not.
    """
    return max(DAMPING_RATIO / (math.pi * natural_frequency(rod)), TIME_STEP)


def _mjcf(model: ProbeModel, chain: list[Link], frames: dict[str, Array]) -> bytes:
    def placed(T: Array) -> dict[str, ArrayLike]:
        return {"pos": T[:3, 3], "quat": _quaternion(T[:3, :3])}

    def weighs(body: Element, of: MassProperties) -> None:
        moments, axes = _principal(of.inertia)
        moments = np.maximum(moments, LEAST_INERTIA)
        _add(body, "inertial", pos=of.p_com, quat=_quaternion(axes), mass=of.mass, diaginertia=moments)

    tau, T = _damping_time(model.rod), frames["sensor"]
    root = Element("mujoco", model=model.name)
    _add(root, "compiler", angle="radian", autolimits="true")
    option = _add(root, "option", timestep=TIME_STEP, integrator="Euler", gravity=model.gravity_base)
    _add(option, "flag", island="disable", warmstart="disable")  # they cost time, and the hold gains nothing by them
    custom = _add(root, "custom")
    _add(custom, "numeric", name="hinge_s_m", data=[link.s for link in chain[1:]])
    _add(custom, "numeric", name="damping_time_s_assumed", data=tau)
    # touches others, not itself
    _add(_add(root, "default"), "geom", contype="1", conaffinity="0", rgba="0.85 0.8 0.7 1")
    world = _add(root, "worldbody")
    holder = _add(world, "body", name="holder", mocap="true", **placed(T))
    if "robotflange" in frames:
        _add(holder, "site", name="robotflange", **placed(inverse(T) @ frames["robotflange"]))
    body = _add(world, "body", name="mount")
    _add(body, "freejoint", name="mount")
    # MuJoCo's sensors state what a body's parent does to it: wrench_base, where the body is a leaf that is held.
    leaf = _add(body, "body", name="sensor", **placed(T))
    _add(leaf, "site", name="sensor")
    _add(body, "site", name="probe_base")
    mount = ("mount", leaf, -float(T[2, 3]), model.flange.diameter)
    for name, parent, height, d in (("holder", holder, -model.sensor_height, model.sensor_d), mount):
        _add(parent, "geom", name=name, type="cylinder", mass="0", size=d / 2.0, fromto=[0, 0, 0, 0, 0, height])
    weighs(body, combined([model.payload.moved(T), chain[0].material]))
    T = np.eye(4)
    for i, link in enumerate(chain):
        if i:
            body = _add(body, "body", name=f"link_{i}", **placed(inverse(T) @ link.T_base_link))
            weighs(body, link.material)
        T = link.T_base_link
        for axis, stiffness in link.stiffness.items():
            _add(body, "joint", name=f"link_{i}_{axis}", type="hinge", axis=[float(axis == other) for other in "xyz"],
                 stiffness=stiffness, damping=tau * stiffness)  # fmt: skip
        if np.linalg.norm(link.p_end) > link.radius / 10.0:  # the last may lie within the round end of the one before
            _add(body, "geom", name=f"link_{i}", type="capsule", size=link.radius, fromto=[0, 0, 0, *link.p_end])
    _add(body, "site", name="probe_tip", **placed(inverse(T) @ frames["probe_tip"]))
    held = _add(root, "equality")
    for turn in (0.0, 1.0, 2.0):  # not a weld, whose torque MuJoCo 3.4 counts twice in its sensors
        anchor = rotation_z(2.0 * math.pi / 3.0 * turn)[:, 0] * HOLD_RADIUS
        _add(held, "connect", body1="sensor", body2="holder", anchor=anchor, solref=[2.0 * TIME_STEP, 1.0],
             solimp="0.9999 0.9999 0.001")  # fmt: skip
    sensors = _add(root, "sensor")
    _add(sensors, "force", name="force", site="sensor", noise=model.noise.force)
    _add(sensors, "torque", name="torque", site="sensor", noise=model.noise.moment)
    return _file(root, f"{_note(model)} Sensors force and torque: what the probe and its mount do to the sensor, about "
                 "the sensor's origin. Noise: standard deviation of a reading, the mean of "
                 f"{model.averaging_samples} samples.")  # fmt: skip


# SDF and URDF: the unloaded probe as a rigid body


def _rpy(T: Array) -> Array:
    """Return roll, pitch and yaw of R = Rz(yaw) Ry(pitch) Rx(roll) [rad], (3,); no roll where the pitch is ±90°."""
    R = T[:3, :3]
    level = math.hypot(R[0, 0], R[1, 0])
    pitch = math.atan2(-R[2, 0], level)
    if level < 1e-9:
        return np.array([0.0, pitch, math.atan2(-R[0, 1], R[1, 1])])
    return np.array([math.atan2(R[2, 1], R[2, 2]), pitch, math.atan2(R[1, 0], R[0, 0])])


def _xyz_rpy(T: Array) -> str:
    return _text([*T[:3, 3], *_rpy(T)])


class _Rigid(NamedTuple):
    """A rigid link at the frame of its name."""

    parent: str
    material: MassProperties | None  #: in its own frame; None for the body of the sensor, and for a mere frame.
    #: T_base_cylinder, radius and length of the cylinders that enclose it, about z at their middle.
    cylinders: list[tuple[Array, float, float]]


def _rigid_links(model: ProbeModel, chain: list[Link], frames: dict[str, Array]) -> dict[str, _Rigid]:
    rod, rest, pieces = model.rod, model.rod.solve(mode="reference"), []
    for a, b in pairwise(np.unique(np.append(np.linspace(0.0, rod.length, _ENVELOPE + 1), rod.s))):
        chord = rest.p_at(b) - rest.p_at(a)
        z, x = chord / np.linalg.norm(chord), rest.R_at((a + b) / 2.0)[:, 0]
        x = np.cross(np.cross(z, x), z)
        x /= np.linalg.norm(x)
        T = pose(np.column_stack([x, np.cross(z, x), z]), rest.p_at(a) + chord / 2.0)
        pieces.append((T, float(rod.radius_at([a, b]).max()), float(np.linalg.norm(chord))))
    flexible, height = combined(link.material.moved(link.T_base_link) for link in chain), model.T_sensor_base[2, 3]
    mount = (pose(p=[0.0, 0.0, -height / 2.0]), model.flange.diameter / 2.0, height)
    sensor = (pose(p=[0.0, 0.0, -height - model.sensor_height / 2.0]), model.sensor_d / 2.0, model.sensor_height)
    links = {"sensor_body": _Rigid("", None, [sensor]), "sensor": _Rigid("sensor_body", model.payload, [mount]),
             "probe_base": _Rigid("sensor", flexible, pieces), "probe_tip": _Rigid("probe_base", None, [])}  # fmt: skip
    return links | ({"robotflange": _Rigid("sensor_body", None, [])} if "robotflange" in frames else {})


def _ft_sensor(parent: Element, model: ProbeModel) -> None:
    """Add Gazebo's sensor of force and torque: what the child does to its parent, in the child's frame."""
    sensor = _add(parent, "sensor", name="force_torque", type="force_torque")
    _add(sensor, "always_on", "true")
    _add(sensor, "update_rate", 1000.0)
    settings = _add(sensor, "force_torque")
    _add(settings, "frame", "child")
    _add(settings, "measure_direction", "child_to_parent")
    for kind, std in (("force", model.noise.force), ("torque", model.noise.moment)):
        channels = _add(settings, kind)
        for axis in "xyz":
            noise = _add(_add(channels, axis), "noise", type="gaussian")
            _add(noise, "mean", 0.0)
            _add(noise, "stddev", std)


def _sdf(model: ProbeModel, chain: list[Link], frames: dict[str, Array]) -> bytes:
    root = Element("sdf", version="1.9")
    world = _add(root, "world", name=model.name)
    _add(world, "gravity", model.gravity_base)
    # Gazebo publishes the sensor with its plugin only; with one plugin, the usual three are to be named as well.
    for file, name in (("physics", "Physics"), ("user-commands", "UserCommands"),
                       ("scene-broadcaster", "SceneBroadcaster"), ("forcetorque", "ForceTorque")):  # fmt: skip
        _add(world, "plugin", filename=f"gz-sim-{file}-system", name=f"gz::sim::systems::{name}")
    sdf = _add(world, "model", name="probe", canonical_link="sensor_body")
    for name, rigid in _rigid_links(model, chain, frames).items():
        T = frames.get(name, np.eye(4))
        if not rigid.cylinders:
            _add(_add(sdf, "frame", name=name, attached_to=rigid.parent), "pose", _xyz_rpy(T), relative_to="__model__")
            continue
        link = _add(sdf, "link", name=name)
        _add(link, "pose", _xyz_rpy(T))
        if rigid.material is not None:
            inertial = _add(link, "inertial")
            _add(inertial, "pose", [*rigid.material.p_com, 0.0, 0.0, 0.0])
            _add(inertial, "mass", rigid.material.mass)
            inertia = _add(inertial, "inertia")
            for key, i, j in _INERTIA:
                _add(inertia, key, rigid.material.inertia[i, j])
        for i, (T_base_cylinder, radius, length) in enumerate(rigid.cylinders):
            for kind in ("collision", "visual"):
                shape = _add(link, kind, name=f"{kind}_{i}")
                _add(shape, "pose", _xyz_rpy(inverse(T) @ T_base_cylinder))
                cylinder = _add(_add(shape, "geometry"), "cylinder")
                _add(cylinder, "radius", radius)
                _add(cylinder, "length", length)
        joint = _add(sdf, "joint", name=f"{name}_joint", type="fixed")
        _add(joint, "parent", rigid.parent or "world")
        _add(joint, "child", name)
        if name == "sensor":
            _ft_sensor(joint, model)
    return _file(root, f"{_note(model)} Rigid: the unloaded shape.")


def _urdf(model: ProbeModel, chain: list[Link], frames: dict[str, Array]) -> bytes:
    root = Element("robot", name=model.name)
    for name, rigid in _rigid_links(model, chain, frames).items():
        T, link = frames.get(name, np.eye(4)), _add(root, "link", name=name)
        if rigid.material is not None:
            inertial = _add(link, "inertial")
            _add(inertial, "origin", xyz=rigid.material.p_com, rpy="0 0 0")
            _add(inertial, "mass", value=rigid.material.mass)
            _add(inertial, "inertia", **{key: rigid.material.inertia[i, j] for key, i, j in _INERTIA})
        for T_base_cylinder, radius, length in rigid.cylinders:
            T_cylinder = inverse(T) @ T_base_cylinder
            for kind in ("collision", "visual"):
                shape = _add(link, kind)
                _add(shape, "origin", xyz=T_cylinder[:3, 3], rpy=_rpy(T_cylinder))
                _add(_add(shape, "geometry"), "cylinder", radius=radius, length=length)
        if rigid.parent:
            T_parent = inverse(frames.get(rigid.parent, np.eye(4))) @ T
            joint = _add(root, "joint", name=f"{name}_joint", type="fixed")
            _add(joint, "origin", xyz=T_parent[:3, 3], rpy=_rpy(T_parent))
            _add(joint, "parent", link=rigid.parent)
            _add(joint, "child", link=name)
    gazebo = _add(root, "gazebo", reference="sensor_joint")
    _add(gazebo, "preserveFixedJoint", "true")
    _ft_sensor(gazebo, model)
    g = _text(model.gravity_base)
    return _file(root, f"{_note(model)} Rigid: the unloaded shape. Gravity [m/s²], which URDF cannot state: {g}.")


def _usd(model: ProbeModel, chain: list[Link], frames: dict[str, Array]) -> bytes:
    require("pxr", "--format usd", "usd", "usd-core")
    from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics

    stage = Usd.Stage.CreateInMemory()
    stage.GetRootLayer().comment = f"{_note(model)} Damping time of the drives [s]: {_text(_damping_time(model.rod))}."
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, "Z")
    root = UsdGeom.Xform.Define(stage, "/probe")
    stage.SetDefaultPrim(root.GetPrim())
    UsdPhysics.ArticulationRootAPI.Apply(root.GetPrim())
    scene, g = UsdPhysics.Scene.Define(stage, "/scene"), float(np.linalg.norm(model.gravity_base))
    scene.CreateGravityMagnitudeAttr(g)
    scene.CreateGravityDirectionAttr(Gf.Vec3f(*(model.gravity_base / (g or 1.0))))

    def quaternion(R: Array) -> Any:
        return Gf.Quatf(*map(float, _quaternion(R)))

    def placed(path: str, T: Array) -> Any:
        prim = UsdGeom.Xform.Define(stage, path)
        prim.AddTranslateOp().Set(Gf.Vec3d(*T[:3, 3]))
        prim.AddOrientOp().Set(quaternion(T[:3, :3]))
        return prim.GetPrim()

    def jointed(joint: Any, parent: str, child: str, T_parent_child: Array) -> Any:
        if parent:
            joint.CreateBody0Rel().SetTargets([parent])
        joint.CreateBody1Rel().SetTargets([child])
        joint.CreateLocalPos0Attr(Gf.Vec3f(*T_parent_child[:3, 3]))
        joint.CreateLocalRot0Attr(quaternion(T_parent_child[:3, :3]))
        return joint.GetPrim()

    for i, link in enumerate(chain):
        path, T = f"/probe/link_{i}", link.T_base_link
        prim = placed(path, T)
        UsdPhysics.RigidBodyAPI.Apply(prim)
        material = link.material if i else combined([link.material, model.payload.moved(frames["sensor"])])
        moments, axes = _principal(material.inertia)
        mass = UsdPhysics.MassAPI.Apply(prim)
        mass.CreateMassAttr(material.mass)
        mass.CreateCenterOfMassAttr(Gf.Vec3f(*material.p_com))
        mass.CreateDiagonalInertiaAttr(Gf.Vec3f(*moments))
        mass.CreatePrincipalAxesAttr(quaternion(axes))
        capsule, long = UsdGeom.Capsule.Define(stage, f"{path}/capsule"), float(np.linalg.norm(link.p_end))
        capsule.CreateHeightAttr(long)
        capsule.CreateRadiusAttr(link.radius)
        capsule.AddTranslateOp().Set(Gf.Vec3d(*(link.p_end / 2.0)))
        turn = Gf.Rotation(Gf.Vec3d(0.0, 0.0, 1.0), Gf.Vec3d(*link.p_end)).GetQuat()
        capsule.AddOrientOp().Set(Gf.Quatf(turn))
        UsdPhysics.CollisionAPI.Apply(capsule.GetPrim())
        if i == 0:
            jointed(UsdPhysics.FixedJoint.Define(stage, "/probe/fixed"), "", path, T)
            continue
        parent, T_parent = f"/probe/link_{i - 1}", chain[i - 1].T_base_link
        joint = jointed(UsdPhysics.Joint.Define(stage, f"{path}_joint"), parent, path, inverse(T_parent) @ T)
        for axis in ("transX", "transY", "transZ", "rotX", "rotY", "rotZ"):
            stiffness = link.stiffness.get(axis[-1].lower()) if axis.startswith("rot") else None
            if stiffness is None:  # a limit whose low end is above the high one locks the axis
                limit = UsdPhysics.LimitAPI.Apply(joint, axis)
                limit.CreateLowAttr(1.0)
                limit.CreateHighAttr(-1.0)
                continue
            drive, per_degree = UsdPhysics.DriveAPI.Apply(joint, axis), stiffness * math.pi / 180.0
            drive.CreateTypeAttr("force")
            drive.CreateStiffnessAttr(per_degree)
            drive.CreateDampingAttr(_damping_time(model.rod) * per_degree)
    last = f"/probe/link_{len(chain) - 1}"
    for name, T in frames.items():
        parent, T_parent = (last, chain[-1].T_base_link) if name == "probe_tip" else ("/probe/link_0", np.eye(4))
        frame = placed(f"{parent}/{name}", inverse(T_parent) @ T)
        if name == "sensor":
            for kind, noise in (("force", model.noise.force), ("torque", model.noise.moment)):
                frame.CreateAttribute(f"probedesign:noise_{kind}", Sdf.ValueTypeNames.Double).Set(noise)
    return str(stage.GetRootLayer().ExportToString()).encode()
