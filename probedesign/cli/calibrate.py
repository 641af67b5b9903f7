"""`probedesign calibrate`: bias, payload, mount and stiffness from a robot that turns the free probe."""

import math
from collections.abc import Iterable
from contextlib import ExitStack, closing, suppress
from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from probedesign.cli.console import interrupt_on_termination, json_bytes, print_json, print_note, print_table
from probedesign.cli.options import FrozenProbeIfAny, JsonOutput
from probedesign.core.errors import InputError
from probedesign.core.files import check_overwrite, write_atomically
from probedesign.core.units import GRAM, MM, MPA

if TYPE_CHECKING:
    from probedesign.live.processing.payload import FreeMotionFit

KIND = "probedesign tool calibration"


def calibrate(
    bundle: FrozenProbeIfAny = None,
    /,
    *,
    source: str,
    pose: str = "",
    tool: bool = False,
    out: Path | None = None,
    force: bool = False,
    pose_latency_ms: float = 0.0,
    gravity_world: str | None = None,
    count: int | None = None,
    seconds: float | None = None,
    manifest: Path | None = None,
    as_json: JsonOutput = False,
) -> None:
    """Measure bias, payload, mount and stiffness with a robot that turns the free probe.

    Let the robot rest for four seconds in six or more orientations while nothing touches the probe; the terminal shows
    which turn is missing. Ends with the source, at --count or --seconds, or with Ctrl-C, and then writes a copy of the
    frozen probe with the payload, the stiffness and the pose on the robot that were measured: docs/robot.md.

    Args:
        source: as of live, or replay:FILE?speed=max for a recording.
        pose: poses of the base as of live; with --tool of the robot's flange. Default: those of a simulated source.
        tool: calibrate a sensor with any tool, without a probe.
        out: output file. Default: NAME.calibrated.probe.json beside BUNDLE, or tool.calibration.json.
        force: replace an existing output file.
        pose_latency_ms: delay of a pose relative to a reading of the same time [ms].
        gravity_world: X,Y,Z of gravity in world axes [m/s²]. Default: 0,0,-9.81.
        count: end after this number of rests.
        seconds: end this many seconds after the first reading.
        manifest: manifest.json of the printed parts; its geometry must be the bundle's.
    """
    from probedesign import pipeline
    from probedesign.frozen_probe import write_frozen
    from probedesign.live.blocks import limit_duration
    from probedesign.live.poses.open import open_poses
    from probedesign.live.processing.payload import RestCollector, calibrate, tool_model
    from probedesign.live.sources.source import open_source

    if tool == (bundle is not None):
        raise InputError("give the frozen probe, or --tool for a sensor with another tool, and not both")
    for name, value in (("count", count), ("seconds", seconds)):
        if value is not None and not value > 0:
            raise InputError(f"--{name} {value} must be positive")
    model = tool_model() if bundle is None else pipeline.load_estimator(bundle, manifest).model
    if out is None:
        beside = Path() if bundle is None else bundle if bundle.is_dir() else bundle.parent
        out = beside / ("tool.calibration.json" if tool else f"{model.name}.calibrated.probe.json")
    check_overwrite(out, force)
    with ExitStack() as inputs, interrupt_on_termination():
        opened = open_source(source, model, print_note)
        simulated = getattr(opened, "poses", None)
        if not pose and simulated is None:
            raise InputError("--pose is missing: the orientations of the robot, as ur://HOST or FILE.csv")
        poses = open_poses(pose, pose_latency_ms, gravity_world, print_note) if pose else simulated
        if poses is None:
            raise InputError("--pose fixed does not turn: give the poses of the robot, as ur://HOST or FILE.csv")
        inputs.callback(poses.close)
        collector = RestCollector(model, poses, print_note, tool=tool)
        with suppress(KeyboardInterrupt), closing(iter(opened)) as stream:
            blocks = stream if seconds is None else limit_duration(stream, seconds)
            for block in takewhile(lambda _: count is None or len(collector.rests) < count, blocks):
                collector.add(block)
    fit = calibrate(model, collector.finish(), poses.gravity_world, tool=tool)
    result = fit.as_dict()
    if tool:
        write_atomically(out, json_bytes({"kind": KIND, "schema": 1, **result}), replace=force)
    else:
        write_frozen(fit.calibrated(), out)
    if as_json:
        print_json({"file": out, **result})
        return
    _print(fit)
    print(f"wrote {out}")


def _print(fit: "FreeMotionFit") -> None:
    from scipy.spatial.transform import Rotation

    from probedesign.live.processing.payload import BIAS, MASS, RATE, STIFFNESS, TURN

    std, model = fit.std, fit.model
    numbers: dict[str, tuple[Iterable[float], Iterable[float], list[float], str]] = {
        "bias": (fit.x[BIAS], std[BIAS], [1e-3] * 6, "mN, N·mm"),
        "its drift": (fit.x[RATE], std[RATE], [1e-3 / 60.0] * 6, "mN, N·mm a minute"),
        "payload": ([fit.mass], [std[MASS]], [GRAM], "g"),
        "its centre": (fit.p_com, np.sqrt(np.diag(fit.cov_com)), [MM] * 3, "mm in sensor axes"),
        "mount": (Rotation.from_matrix(fit.R).as_rotvec(), std[TURN], [math.radians(1.0)] * 3, "° about x, y, z"),
    }  # fmt: skip
    if not fit.tool:
        E = math.exp(fit.x[STIFFNESS]) * model.rod.youngs_modulus
        numbers["E"] = ([E], [std[STIFFNESS] * E], [MPA], "MPa")
    force, moment = (1e3 * np.sqrt((fit.residuals[:, part] ** 2).mean()) for part in (slice(0, 3), slice(3, 6)))
    print(f"{len(fit.rests)} rests: {fit.verdict}")
    texts = {
        name: ", ".join(f"{v / u:.4g} ± {s / u:.2g}" for v, s, u in zip(values, stds, units, strict=True)) + f" {unit}"
        for name, (values, stds, units, unit) in numbers.items()
    }
    print_table({**texts, "residual": f"{force:.3g} mN, {moment:.3g} N·mm"})
    T = fit.calibrated().T_robotflange_base if not fit.tool else None
    if T is not None:
        x, y, z = T[:3, 3] / MM
        rx, ry, rz = Rotation.from_matrix(T[:3, :3]).as_rotvec()
        print(f"  tool centre point of the robot: {x:.2f}, {y:.2f}, {z:.2f} mm, rotation vector {rx:.4f}, {ry:.4f}, "
              f"{rz:.4f} rad")  # fmt: skip
    for note in fit.notes:
        print(f"  note: {note}")
