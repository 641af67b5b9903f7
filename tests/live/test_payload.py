"""Calibration from free motion: the truth is a set of point masses, which the code does not use."""

import json
import math
from dataclasses import replace
from itertools import groupby

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from probedesign.cli.main import run
from probedesign.core.errors import InputError
from probedesign.frozen_probe import load_model, write_frozen
from probedesign.live.blocks import Block
from probedesign.live.poses.base_poses import BasePoses, pose_from_matrix
from probedesign.live.processing import payload as calibration
from probedesign.live.processing.chain import Chain, ProcessingOptions
from probedesign.live.processing.payload import (
    AVERAGING,
    MASS,
    MEASURED,
    MOVING,
    STIFFNESS,
    SWAYING,
    TURN,
    Rest,
    RestCollector,
    calibrate,
    guide,
)
from probedesign.live.processing.tare import TareWindow

DOWN = np.array([0.0, 0.0, -9.81])
#: Gravity along ± x, ± y, ± z, as docs/robot.md recommends.
SIX = Rotation.from_euler("xy", [[0, 0], [180, 0], [90, 0], [-90, 0], [0, 90], [0, -90]], degrees=True).as_matrix()
REST = 5.0  #: Time from rest to rest [s].


def point_masses(masses, places, R_world_sensor):
    """Wrench of point masses on the sensor, summed in world axes."""
    force, moment = np.zeros(3), np.zeros(3)
    for m, p in zip(masses, places, strict=True):
        arm = R_world_sensor @ p
        force += m * DOWN
        moment += np.cross(arm, m * DOWN)
    return np.concatenate([R_world_sensor.T @ force, R_world_sensor.T @ moment])


def rotations(n, rng):
    return np.concatenate([SIX, Rotation.random(n - 6, rng=rng).as_matrix()])


def tool_rests(rng, n=12, mass=0.4, R_flange_sensor=None, std=(2e-2, 5e-4), walk=(2e-3, 5e-5)):
    """Rests of a tool of three point masses, the truth of mass and centre, and the bias at the mean time."""
    R_fs = Rotation.random(rng=rng).as_matrix() if R_flange_sensor is None else R_flange_sensor
    masses, places = mass * np.array([0.5, 0.3, 0.2]), rng.uniform(-0.05, 0.1, (3, 3))
    std, walk = np.repeat(std, 3), np.repeat(walk, 3)
    bias = rng.normal(size=6) * 50.0 * std + np.cumsum(math.sqrt(REST) * walk * rng.normal(size=(n, 6)), axis=0)
    rests = [
        Rest(REST * i, point_masses(masses, places, R @ R_fs) + bias[i] + std * rng.normal(size=6), np.zeros(6), R)
        for i, R in enumerate(rotations(n, rng))
    ]
    return rests, mass, masses @ places / mass, R_fs


def test_a_tool_is_found_with_its_mount_and_stated_error():
    """90 numbers of 30 draws: a share of 95 % lies above 89 % with 2.5 standard deviations, and two percent are lost
    because the noise itself is estimated from twelve rests. The squares, of 7 degrees of freedom, have a mean of
    1 ± 0.1; a covariance that is too large shows in it."""
    inside, squares = [], []
    for seed in range(30):
        rests, mass, com, R_fs = tool_rests(np.random.default_rng(seed))
        found = calibrate(calibration.tool_model(), rests, DOWN, tool=True)
        turn = Rotation.from_matrix(found.R.T @ R_fs).as_rotvec()
        chi2 = ((found.mass - mass) ** 2 / found.std[MASS] ** 2,
                (com - found.p_com) @ np.linalg.solve(found.cov_com, com - found.p_com),
                turn @ np.linalg.solve(found.cov[TURN, TURN], turn))  # fmt: skip
        inside += [chi2[0] < 3.84, chi2[1] < 7.81, chi2[2] < 7.81]
        squares.append(sum(chi2) / 7.0)
    assert np.mean(inside) > 0.87 and np.mean(squares) > 0.7


def test_predictions_of_other_poses_have_the_stated_error():
    chi2 = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        rests, *_ = tool_rests(rng, 40)
        held = rng.permutation(np.arange(1, 39))[:12]
        found = calibrate(calibration.tool_model(), [r for i, r in enumerate(rests) if i not in held], DOWN, tool=True)
        for i in held:
            mean, cov = found.predict(rests[i].time, rests[i].R)
            chi2.append((rests[i].wrench - mean) @ np.linalg.solve(cov, rests[i].wrench - mean))
    # Of 120 predictions 95 % ± 2 % lie within 12.59, fewer by the noise that is estimated from 28 rests.
    assert 0.87 < np.mean(np.array(chi2) < 12.59) <= 1.0


def probe_rests(model, rng, n=12, added=3e-3, turn=(0.01, -0.02, 0.015), factor=1.0, tilt=1.0):
    """Rests of a probe with an added point mass, a base that is turned against the poses, and another E."""
    stiff = {name: factor * getattr(model.rod, name) for name in ("youngs_modulus", "shear_modulus")}
    rod, R_pb = replace(model.rod, **stiff), Rotation.from_rotvec(turn).as_matrix()
    step = model.noise.std * math.sqrt(model.averaging_samples)
    drift = np.cumsum(0.05 * math.sqrt(REST) * step * rng.normal(size=(n, 6)), axis=0)
    bias, std = 20.0 * step * rng.normal(size=6), model.noise.std / 6.0
    nominal, place = model.payload, np.array([5e-3, -3e-3, 40e-3])
    found = []
    for i, R in enumerate(rotations(n, rng)):
        g = R_pb.T @ R.T @ DOWN
        R_ws = R @ R_pb @ model.T_sensor_base[:3, :3].T
        read = model.to_sensor(rod.solve(g, mode="reference").wrench_base, np.zeros(3))
        read += point_masses([nominal.mass, added], [nominal.p_com, place], R_ws)
        found.append(Rest(REST * i, read + bias + drift[i] + std * rng.normal(size=6), std, R))
    mass = nominal.mass + added
    return found, mass, nominal.mass * nominal.p_com + added * place, R_pb


def test_a_probe_is_found_with_mount_and_stiffness(model):
    wide = replace(model, tolerances=None, stiffness_spread=0.1)
    squares, E = [], []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        factor = math.exp(0.1 * rng.normal())
        rests, mass, moment, R_pb = probe_rests(wide, rng, factor=factor)
        found = calibrate(wide, rests, DOWN)
        assert found.verdict == "ok", found.notes
        turn = Rotation.from_matrix(R_pb).as_rotvec()
        off = found.x[12:] - np.concatenate([[mass], moment, turn, [math.log(factor)]])
        squares.append((off / found.std[12:]) ** 2)
        E.append(found.std[STIFFNESS])
    # 48 numbers of six independent draws: 95 % ± 3 % within two standard deviations, and squares of 1 ± 0.2.
    assert np.mean(np.array(squares) < 3.84) > 0.87 and np.mean(squares) > 0.5
    assert max(E) < 0.06  # ../world.md's bound for twelve poses is 3.6 %; here the bias walks, too
    frozen = found.calibrated()
    assert frozen.fingerprint == model.fingerprint
    assert frozen.material["youngs_modulus"].provenance == "identified"
    assert frozen.rod.youngs_modulus == pytest.approx(factor * model.rod.youngs_modulus, rel=0.15)


def test_the_derivative_is_that_of_differences(model):
    rng = np.random.default_rng(1)
    x = np.concatenate([rng.normal(size=12) * 1e-3, [0.02], rng.normal(size=3) * 1e-4, [0.0] * 3, [0.1]])
    R, g, step = Rotation.random(rng=rng).as_matrix(), np.array([3.0, -5.0, 7.0]), 1e-4
    _, J = calibration._linearised(model, x, R, g, 3.0, False)
    for i in range(calibration.SIZE):
        values = []
        for sign in (1.0, -1.0):
            moved, turned = x.copy(), R
            moved[i] += sign * step
            if i in range(16, 19):
                turned = R @ Rotation.from_rotvec(moved[TURN]).as_matrix()
            values.append(calibration._linearised(model, moved, turned, g, 3.0, False)[0])
        # The rod is solved to 1e-6 of its moment, divided by the step.
        np.testing.assert_allclose(J[:, i], (values[0] - values[1]) / (2.0 * step), atol=3e-5, rtol=1e-3)


def test_a_touched_rest_is_dropped_and_stated(model):
    rests, mass, *_ = probe_rests(model, np.random.default_rng(3), 14)
    rests[7] = replace(rests[7], wrench=rests[7].wrench + np.array([0.02, 0.0, 0.0, 0.0, 2e-3, 0.0]))
    found = calibrate(model, rests, DOWN)
    assert found.dropped == (rests[7].time,)
    assert "touched or moving" in found.notes[0]
    assert abs(found.mass - mass) < 4.0 * found.std[MASS]


def test_a_channel_that_noise_does_not_explain_is_named(model):
    rng = np.random.default_rng(4)
    rests, *_ = probe_rests(model, rng)
    rests = [replace(r, wrench=r.wrench + 0.03 * rng.normal() * np.eye(6)[2]) for r in rests]
    found = calibrate(model, rests, DOWN)
    assert found.verdict == "inconsistent" and found.inconsistent == ("Fz",)
    assert found.noise[:, 2].max() > 5e-3  # [N]; it widens the covariance


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_missing_turn_and_too_few_orientations_are_named(axis, model):
    around = [Rotation.from_rotvec(angle * np.eye(3)[axis]).as_matrix() for angle in np.linspace(0.0, 5.0, 8)]
    start = SIX[0] if axis < 2 else SIX[2]
    rests = [Rest(REST * i, np.zeros(6), model.noise.std, start @ R) for i, R in enumerate(around)]
    with pytest.raises(
        InputError, match=f"hardly changes along the base's {'xyz'[axis]} axis .* {'xyz'[axis]} points up"
    ):
        calibrate(model, rests, DOWN)
    rests = [Rest(REST * i, np.zeros(6), model.noise.std, R) for i, R in enumerate(SIX[[0, 2, 4, 0, 2, 4, 1]])]
    with pytest.raises(InputError, match=r"4 orientations are fewer than 6: rest 1\.3 s in 2 more"):
        calibrate(model, rests, DOWN)


def test_a_negative_mass_is_refused():
    rests, *_ = tool_rests(np.random.default_rng(5))
    with pytest.raises(InputError, match=r"negative mass, -\d+ ± \S+ g: check the sign of --gravity-world"):
        calibrate(calibration.tool_model(), rests, -DOWN, tool=True)


# Readings


def turning(model, orientations, rng, added=0.0, rate=200.0, rest=4.0, turn=3.0):
    """Readings and poses of a base that rests and turns in between; while it turns the readings are wrong."""
    n = len(orientations)
    t = np.arange(round(n * (rest + turn) * rate)) / rate
    stated, read = [], np.zeros((len(t), 6))
    for k, R in enumerate(orientations):
        free = model.to_sensor(model.rod.solve(R.T @ DOWN).wrench_base, R.T @ DOWN)
        free = free + point_masses([added], [np.array([0.0, 0.0, 0.04])], R @ model.T_sensor_base[:3, :3].T)
        start = k * (rest + turn)
        read[(t >= start) & (t < start + rest)] = free
        between = (t >= start + rest) & (t < start + rest + turn)
        read[between] = free + np.array([0.1, 0.1, 0.1, 1e-3, 1e-3, 1e-3])
        after = orientations[(k + 1) % n]
        step = Rotation.from_matrix(R.T @ after).as_rotvec()
        for at in np.arange(start, start + rest + turn - 1e-9, 0.02):
            x = max(at - start - rest, 0.0) / turn
            T = np.eye(4)
            T[:3, :3] = R @ Rotation.from_rotvec(step * x**3 * (10.0 - 15.0 * x + 6.0 * x * x)).as_matrix()
            stated.append(pose_from_matrix(float(at), T))
    noise = model.noise.std * math.sqrt(model.averaging_samples)
    return t, read + noise * rng.normal(size=read.shape), BasePoses("stated", stated)


def blocks(model, t, read):
    for i in range(0, len(t), 50):
        part = slice(i, i + 50)
        yield Block(t[part], read[part], model.gravity_base, np.full(len(t[part]), math.nan))


def collected(model, t, read, poses):
    lines, states = [], []
    collector = RestCollector(model, poses, lines.append)
    for block in blocks(model, t, read):
        collector.add(block)
        states.append(collector.guide)
    return collector.finish(), lines, states


def test_only_readings_at_rest_are_used(model):
    t, read, poses = turning(model, SIX, np.random.default_rng(6))
    rests, lines, states = collected(model, t, read, poses)
    assert len(rests) == len(SIX)
    for rest, R in zip(rests, SIX, strict=True):
        free = model.to_sensor(model.rod.solve(R.T @ DOWN).wrench_base, R.T @ DOWN)
        # Five standard deviations of the mean; a reading while it turns is off by 0.1 N.
        assert (np.abs(rest.wrench - free) < 5.0 * rest.std).all()
        np.testing.assert_allclose(rest.R, R, atol=1e-9)
    assert lines[1].endswith("turn it so that z points down; needed: x, y, z up and down, 5 more orientations")
    assert lines[-1].startswith("orientation 6: measured; enough")
    seen = [state for state, _ in groupby(each.state for each in states)]
    assert seen == ["no reading"] + [SWAYING, AVERAGING, MEASURED, MOVING] * len(SIX)
    np.testing.assert_allclose(states[-1].measured, SIX[:, 2], atol=1e-9)


def test_the_guide_leads_to_enough_orientations_in_six():
    """The next one is given until there are six directions, and gravity has turned along every axis."""
    turned = []
    while (following := guide(turned, DOWN).following) is not None:
        turned.append(Rotation.align_vectors([[0.0, 0.0, 1.0]], [following])[0].as_matrix())
    assert len(turned) == 6 and guide(turned, DOWN).enough
    # Turned about z alone, z is missing whatever the number.
    around = [SIX[2] @ Rotation.from_rotvec([0.0, 0.0, a]).as_matrix() for a in np.linspace(0.0, 5.0, 8)]
    assert abs(guide(around, DOWN).following[2]) == 1.0 and not guide(around, DOWN).enough


def test_a_rest_that_is_touched_halfway_is_refused(model):
    t, read, poses = turning(model, SIX[:2], np.random.default_rng(7))
    read[(t > 3.0) & (t < 4.0), 0] += 0.2
    rests, lines, states = collected(model, t, read, poses)
    assert len(rests) == 1
    np.testing.assert_allclose(states[-1].refused, SIX[:1, 2], atol=1e-9)
    assert len(states[-1].measured) == 1
    assert any("Fx scatters" in line and "touched or moving?" in line for line in lines)


@pytest.mark.parametrize(("added", "reported"), [(3e-3, True), (0.0, False)])
def test_live_reports_a_wrong_payload_in_a_run_that_turns(added, reported, estimator, model):
    t, read, poses = turning(model, SIX, np.random.default_rng(8), added)
    lines = []
    chain = Chain(estimator, ProcessingOptions(TareWindow(0.0, 2.0), 36, rate=1.0), poses, lines.append)
    for block in blocks(model, t, read):
        list(chain.process(block))
    told = [line for line in lines if "run probedesign calibrate" in line]
    assert len(told) == reported
    if reported:
        assert "is 3 g heavier than the frozen probe states, by 4 orientations" in told[0]


# The command


@pytest.fixture(scope="module")
def frozen(tmp_path_factory, model):
    path = tmp_path_factory.mktemp("calibrate") / "large.probe.json"
    write_frozen(model, path)
    return path


SIM = "sim:?orientations=8&payload_g=3&speed=max&rate_hz=25"


def test_the_command_writes_a_copy_of_the_frozen_probe(frozen, capsys, model):
    assert run(["calibrate", str(frozen), "--source", SIM, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["verdict"] == "ok" and document["orientations"] == 8
    found = load_model(frozen.parent / "large.calibrated.probe.json")
    # Four standard deviations.
    assert abs(found.payload.mass - model.payload.mass - 3e-3) < 4.0 * document["mass_std_kg"]
    assert document["mass_std_kg"] < 1e-4
    assert found.payload.mass == document["mass_kg"]
    assert run(["calibrate", str(frozen), "--source", SIM]) == 2
    assert "exists already" in capsys.readouterr().err
    assert run(["calibrate", str(frozen), "--source", SIM, "--force"]) == 0
    (line,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("  payload")]
    value, std = line.removeprefix("  payload").removesuffix(" g").split(" ± ")
    assert abs(float(value) - 1e3 * document["mass_kg"]) <= 0.05 * float(std)  # two digits of it


def test_a_tool_is_calibrated_from_a_recording(tmp_path, capsys, model):
    rng = np.random.default_rng(9)
    t, read, poses = turning(model, rotations(8, rng), rng, 0.05, rate=100.0)
    rows = "".join(f"{a!r},{','.join(map(repr, row))}\n" for a, row in zip(t.tolist(), read.tolist(), strict=True))
    head = "time_s,Fx_N,Fy_N,Fz_N,Mx_Nm,My_Nm,Mz_Nm"
    (tmp_path / "run.csv").write_text(f"# frame: sensor\n{head}\n{rows}")
    stated = "".join(f"{p.time!r},{','.join(map(repr, (*p.p, *p.q)))}\n" for p in poses.track.spanning(-1.0, 1e9))
    (tmp_path / "poses.csv").write_text(f"time_s,x_mm,y_mm,z_mm,qx,qy,qz,qw\n{stated}")
    arguments = ["calibrate", "--tool", "--source", f"replay:{tmp_path}/run.csv?speed=max", "--pose",
                 f"{tmp_path}/poses.csv", "--out", str(tmp_path / "tool.calibration.json")]  # fmt: skip
    assert run(arguments) == 0, capsys.readouterr().err
    document = json.loads((tmp_path / "tool.calibration.json").read_text())
    # The whole probe hangs on the sensor; its sag moves the centre and is scatter to a rigid tool.
    assert document["mass_kg"] == pytest.approx(model.payload.mass + model.mass + 0.05, rel=0.01)
    assert run(arguments) == 2


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--source", SIM], "give the frozen probe, or --tool"),
        (["FROZEN", "--tool", "--source", SIM], "not both"),
        (["--tool", "--source", SIM], "simulates a frozen probe"),
        (["FROZEN", "--source", "sim:"], "--pose is missing"),
        (["FROZEN", "--source", SIM, "--pose", "fixed"], "--pose fixed does not turn"),
        (["FROZEN", "--source", SIM, "--count", "0"], "--count 0 must be positive"),
        (["FROZEN", "--source", SIM, "--count", "2"], "along the base's x axis"),
        (["FROZEN", "--source", SIM.replace("payload_g=3", "payload_g=-50")], "negative mass"),
    ],
)
def test_what_cannot_be_used_is_refused_in_one_line(arguments, message, frozen, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    words = [str(frozen) if word == "FROZEN" else word for word in arguments]
    out = tmp_path / "out.probe.json"
    assert run(["calibrate", *words, "--out", str(out)]) == 2
    err = [line for line in capsys.readouterr().err.splitlines() if not line.startswith("note:")]
    assert len(err) == 1 and message in err[0]
    assert not out.exists()
