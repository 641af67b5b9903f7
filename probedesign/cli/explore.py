"""`probedesign explore`: touches from a moving base into points of the world."""

import sys
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from probedesign.cli.ending import ending_well
from probedesign.cli.output import counted, print_json, working
from probedesign.errors import InputError

if TYPE_CHECKING:
    from probedesign.exploring.cloud import Cloud
    from probedesign.live.source import Source

FILES = ("points.csv", "points.ply", "points.html", "points.svg")


def explore(
    bundle: Path,
    recording: Path | None = None,
    /,
    *,
    pose: str = "fixed",
    tare_s: str | None = None,
    source: str | None = None,
    out: Path | None = None,
    force: bool = False,
    average: int = 1,
    apart_mm: float = 5.0,
    pose_latency_ms: float = 0.0,
    gravity_world: str | None = None,
    seconds: float | None = None,
    mend: bool = False,
    topic: str = "",
    moment_unit: Literal["Nm", "Nmm"] = "Nm",
    other_probe: bool = False,
    manifest: Path | None = None,
    rehearse: Path | None = None,
    as_json: Annotated[bool, Parameter(name="--json")] = False,
) -> None:
    """Turn touches from a moving base into points of the world with their ellipsoids.

    Each touch is one point of an object that the base presses onto and stands at, at several poses; touches of one
    point are recognised and fused. Without --out a line a point; with it DIR/points.csv, .ply, .html (to turn by the
    mouse) and .svg. How to press: docs/exploring.md.

    Args:
        bundle: the frozen probe, NAME.probe.json.
        recording: MCAP, a ROS 2 bag, or CSV with named units; see docs/recording-format.md.
        pose: of the base: FILE.csv or .jsonl, a ROS 2 bag or udp://:PORT, as for `live`.
        tare_s: START:END in seconds from the first reading: the probe is free then, take the bias there.
        source: instead of a recording, as for `live`; ends with the source, at --seconds or with Ctrl-C.
        out: the folder to write.
        force: replace the files that stand there.
        average: take means of so many readings.
        apart_mm: the object's points lie at least so far apart; touches that are surely nearer may be one point. 0
            fuses none.
        pose_latency_ms: by which a pose arrives later than a reading of the same moment.
        gravity_world: in the world's axes [m/s²], as 0,0,-9.81, which it is unless said.
        seconds: end so many seconds after the first reading.
        mend: go on with a recording that lacks something: lines, or its end.
        topic: of a bag's wrenches, if there are several.
        moment_unit: of a bag whose publisher does not keep to N·m.
        other_probe: read a recording that was made with another probe.
        manifest: manifest.json of the printed parts, to check that the probe is theirs.
        rehearse: write the recording and the poses of a simulated card house to this folder, to try with, and end.
        as_json: print one JSON document: the points and all that is to know of them.
    """
    from probedesign.deployment import load_estimator
    from probedesign.estimator.unknowns import Unknowns
    from probedesign.exploring.explore import Exploration, check_apart, check_poses, play
    from probedesign.exploring.table import document_of, lines_of
    from probedesign.live.plan import Plan
    from probedesign.live.pose.spec import open_poses
    from probedesign.live.recorded import Choice
    from probedesign.live.source import open_source
    from probedesign.live.tare import parse_window
    from probedesign.live.warm_up import warm_up

    if rehearse is not None:
        return _rehearse(bundle, rehearse, force, manifest)
    if (recording is None) == (source is None):
        raise InputError("explore takes a recording, or --source for a run that is live: one of them")
    if tare_s is None:
        raise InputError(
            "a touch is told from the sensor's bias by a tare: say --tare-s START:END, when the probe is free"
        )
    plan = Plan(parse_window(tare_s), average, seconds=seconds, estimates=False)
    apart = check_apart(apart_mm)
    _check_out(out, force)
    estimator = load_estimator(bundle, manifest)
    model = estimator.model
    poses = check_poses(open_poses(pose, pose_latency_ms, gravity_world, _say), None)
    with working("loading the rod kernels"):
        warm_up(estimator, _say, fusing=True)
        opened: Source
        if recording is not None:
            opened = played = play(
                recording, model, mend, Choice(topic, moment_unit=moment_unit, other_probe=other_probe)
            )
            check_poses(poses, played.span)
        else:
            opened = open_source(str(source), model, _say)
    for note in (opened.title, *opened.notes, poses.title, *poses.notes):
        _say(note)
    exploration = Exploration(estimator, Unknowns.of(model), apart=apart)
    with ending_well(), suppress(KeyboardInterrupt):  # what was touched by then is told
        for touch in exploration.run(opened, plan, poses, _say):
            if source is not None:
                _say(f"touch {touch.series.number} is over: {touch.result}")
    if exploration.placeless:
        _say(
            f"{exploration.placeless} of {exploration.readings} readings have no pose of the base and count for nothing"
        )
    cloud = exploration.cloud()
    if out is not None:
        _write(out, cloud, f"{model.name} {model.fingerprint}", opened.title)
    if as_json:
        print_json(document_of(cloud))
    else:
        print("\n".join(lines_of(cloud)) or "no touch")
        print(_summary(cloud) + (f"; wrote {out}/{', '.join(FILES)}" if out is not None else ""))


def _summary(cloud: "Cloud") -> str:
    touches = sum(len(point.touches) for point in cloud.points)
    told = f"{counted(len(cloud.points), 'point')} by {touches} touch{'' if touches == 1 else 'es'}"
    lost = f", {len(cloud.unlocated)} not located" if cloud.unlocated else ""
    return f"{told}{lost}; E by them {cloud.stiffness:.3f} ± {cloud.std_stiffness:.3f} of the bundle's"


def _write(out: Path, cloud: "Cloud", probe: str, what: str) -> None:
    from probedesign.exploring.page import page_of
    from probedesign.exploring.picture import svg_of
    from probedesign.exploring.ply import ply_of
    from probedesign.exploring.table import csv_of
    from probedesign.files import write_atomically

    about = [what, f"probe {probe}", _summary(cloud), "Ellipsoids hold the true point in 95 of 100 cases, as far as "
             "stiffness, base, robot and bias are known as well as said; ± is the RMS distance."]  # fmt: skip
    contents = (csv_of(cloud), ply_of(cloud, f"probedesign explore, probe {probe}"),
                page_of(cloud, "Points touched", about), svg_of(cloud))  # fmt: skip
    for name, content in zip(FILES, contents, strict=True):
        write_atomically(out / name, content)


def _check_out(out: Path | None, force: bool) -> None:
    from probedesign.files import check_room

    if out is None:
        return
    if out.exists() and not out.is_dir():
        raise InputError(f"--out {out}: is a file; name a folder")
    check_room(out / FILES[0])
    standing = [name for name in FILES if (out / name).exists()]
    if standing and not force:
        raise InputError(f"{out}/{standing[0]}: exists; say --force to replace it, or name another folder")


def _rehearse(bundle: Path, folder: Path, force: bool, manifest: Path | None) -> None:
    """Write a simulated run to try with."""
    import numpy as np

    from probedesign.deployment import load_model
    from probedesign.exploring.card_house import spots
    from probedesign.exploring.rehearsal import rehearse
    from probedesign.exploring.rehearsal_files import write_rehearsal

    model = load_model(bundle, manifest)
    rng = np.random.default_rng(1)
    with working("touching a card house"):
        written = write_rehearsal(rehearse(model, spots(), rng), model, folder, rng, force)
    print(f"wrote {', '.join(map(str, written))}")


def _say(note: str) -> None:
    print(f"note: {note}", file=sys.stderr)
