"""`probedesign calibrate`: bias, payload, mount and stiffness from a robot that turns the free probe."""

import math
import sys
from collections.abc import Iterable
from contextlib import ExitStack, closing, suppress
from itertools import takewhile
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Annotated

import numpy as np
from cyclopts import Parameter

from probedesign.cli.console import interrupt_on_termination, json_bytes, print_json, print_note, print_table
from probedesign.cli.options import FrozenProbeIfAny, JsonOutput
from probedesign.core.errors import InputError
from probedesign.core.files import check_overwrite, write_atomically
from probedesign.core.units import GRAM, MM, MPA

if TYPE_CHECKING:
    from probedesign.live.processing.payload import FreeMotionFit
    from probedesign.live.view.state import GuideState

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
    view: bool = False,
    view_host: str = "127.0.0.1",
    view_port: int = 8080,
    open_: Annotated[bool, Parameter(name="--open", negative="--no-open")] = True,
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
        view: guide on a page in the browser, which shows the result as well.
        view_host: address on which the page is served. 0.0.0.0 makes it accessible from the network.
        view_port: port of the page, or the next free one.
        open_: open the page in a browser, if the output is a terminal.
    """
    from probedesign.estimation.estimator import Estimator
    from probedesign.frozen_probe import load_estimator, write_frozen
    from probedesign.live.blocks import limit_duration
    from probedesign.live.poses.open import open_poses
    from probedesign.live.processing.commands import CommandQueue
    from probedesign.live.processing.payload import RestCollector, calibrate, tool_model
    from probedesign.live.sources.source import open_source
    from probedesign.live.view.sinks import BrowserView
    from probedesign.live.view.state import GuideState

    for wrong, message in (
        (tool == (bundle is not None), "give the frozen probe, or --tool for a sensor with another tool, and not both"),
        (tool and source.startswith("sim:"), "--source sim: simulates a frozen probe: give BUNDLE instead of --tool"),
        (count is not None and count <= 0, f"--count {count} must be positive"),
        (seconds is not None and not seconds > 0.0, f"--seconds {seconds} must be positive"),
    ):
        if wrong:
            raise InputError(message)
    estimator = Estimator(tool_model()) if bundle is None else load_estimator(bundle, manifest)
    model, beside = estimator.model, _folder(bundle)
    out = out or beside / ("tool.calibration.json" if tool else f"{model.name}.calibrated.probe.json")
    check_overwrite(out, force)
    with ExitStack() as page:
        with ExitStack() as inputs, interrupt_on_termination():
            opened = open_source(source, model, print_note)
            poses = getattr(opened, "poses", None)
            if pose:
                poses = open_poses(pose, pose_latency_ms, gravity_world, print_note)
            if poses is None:
                why = "fixed does not turn: give the poses" if pose else "is missing: the orientations"
                raise InputError(f"--pose {why} of the robot, as ur://HOST or FILE.csv")
            inputs.callback(poses.close)

            def log(line: str) -> None:
                print_note(line)
                state.on_event(math.nan, line)

            collector, commands = RestCollector(model, poses, log, tool=tool), CommandQueue()
            state = GuideState(collector, model, poses.gravity_world)
            if view:
                page.callback(BrowserView(
                    {"": state}, [(estimator, beside)], commands, print_note, view_host, view_port,
                    open_browser=open_ and sys.stdout.isatty(), guided=True,
                ).close)  # fmt: skip
            with suppress(KeyboardInterrupt), closing(iter(opened)) as stream:
                blocks = stream if seconds is None else limit_duration(stream, seconds)
                for block in takewhile(lambda _: count is None or len(collector.rests) < count, blocks):
                    state.on_samples(block)
                    collector.add(block)
                    if commands.execute(log):
                        break
        fit = calibrate(model, collector.finish(), poses.gravity_world, tool=tool)
        if tool:
            write_atomically(out, json_bytes({"kind": KIND, "schema": 1, **fit.as_dict()}), replace=force)
        else:
            write_frozen(fit.calibrated(), out)
        _report(fit, out, as_json, state)
        if view and sys.stdout.isatty():
            print_note("the page stays open until Ctrl-C")
            with suppress(KeyboardInterrupt):
                Event().wait()


def _report(fit: "FreeMotionFit", out: Path, as_json: bool, page: "GuideState") -> None:
    """Print the result, and show it on the page."""
    rows, verdict = _rows(fit), f"{len(fit.rests)} rests: {fit.verdict}"
    page.show_result(verdict, fit.verdict == "ok", {"file": str(out), **rows})
    if as_json:
        return print_json({"file": out, **fit.as_dict()})
    print(verdict)
    print_table(rows)
    print(f"wrote {out}")


def _folder(bundle: Path | None) -> Path:
    return Path() if bundle is None else bundle if bundle.is_dir() else bundle.parent


def _rows(fit: "FreeMotionFit") -> dict[str, str]:
    """Return the results with their standard deviations, by name."""
    from scipy.spatial.transform import Rotation

    from probedesign.live.processing.payload import BIAS, MASS, RATE, STIFFNESS, TURN

    def measured(value: float, std: float, unit: float) -> str:
        """Return a value to two digits of its standard deviation."""
        digits = max(1 - math.floor(math.log10(std / unit)), 0) if 0.0 < std < math.inf else 4
        return f"{value / unit:z.{digits}f} ± {std / unit:.{digits}f}"

    std, model = fit.std, fit.model
    numbers: dict[str, tuple[Iterable[float], Iterable[float], list[float], str]] = {
        "payload": ([fit.mass], [std[MASS]], [GRAM], "g"),
        "its centre": (fit.p_com, np.sqrt(np.diag(fit.cov_com)), [MM] * 3, "mm in sensor axes"),
        "mount": (Rotation.from_matrix(fit.R).as_rotvec(), std[TURN], [math.radians(1.0)] * 3, "° about x, y, z"),
        "bias": (fit.x[BIAS], std[BIAS], [1e-3] * 6, "mN, N·mm"),
        "its drift": (fit.x[RATE], std[RATE], [1e-3 / 60.0] * 6, "mN, N·mm a minute"),
    }  # fmt: skip
    if not fit.tool:
        E = math.exp(fit.x[STIFFNESS]) * model.rod.youngs_modulus
        numbers = {"E": ([E], [std[STIFFNESS] * E], [MPA], "MPa"), **numbers}
    force, moment = (1e3 * np.sqrt((fit.residuals[:, part] ** 2).mean()) for part in (slice(0, 3), slice(3, 6)))
    rows = {name: f"{', '.join(map(measured, *values))} {unit}" for name, (*values, unit) in numbers.items()}
    rows["residual"] = f"{force:.3g} mN, {moment:.3g} N·mm"
    T = fit.calibrated().T_robotflange_base if not fit.tool else None
    if T is not None:
        x, y, z = T[:3, 3] / MM
        rx, ry, rz = Rotation.from_matrix(T[:3, :3]).as_rotvec()
        rows["robot's TCP"] = f"{x:.2f}, {y:.2f}, {z:.2f} mm, rotation vector {rx:z.4f}, {ry:z.4f}, {rz:z.4f} rad"
    return rows | {f"note {i + 1}": note for i, note in enumerate(fit.notes)}
