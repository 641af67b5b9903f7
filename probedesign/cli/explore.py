"""`probedesign explore`: touches from a moving base into points of the world."""

import sys
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from probedesign.cli.base_options import BaseOptions
from probedesign.cli.ending import ending_well
from probedesign.cli.explored_files import FILES, check_out, write_cloud
from probedesign.cli.output import counted, print_json, working
from probedesign.errors import InputError

if TYPE_CHECKING:
    from probedesign.estimator.model import ProbeModel
    from probedesign.exploring.base import Base
    from probedesign.exploring.cloud import Cloud
    from probedesign.live.pose.poses import Poses
    from probedesign.live.source import Source


@Parameter(name="*")
@dataclass
class ReadingOptions:
    """What is read, and how."""

    source: str | None = None
    """Instead of a recording, as for `live`; ends with the source, at --seconds or with Ctrl-C."""
    mend: bool = False
    """Go on with a recording that lacks something: lines, or its end."""
    topic: str = ""
    """Of a bag's wrenches, if there are several."""
    moment_unit: Literal["Nm", "Nmm"] = "Nm"
    """Of a bag whose publisher does not keep to N·m."""
    other_probe: bool = False
    """Read a recording that was made with another probe."""

    def opened(self, recording: Path | None, model: "ProbeModel", poses: "Poses") -> "Source":
        """The recording or the source, and that its time is that of the poses.

        Raises:
            InputError: it is not.
        """
        from probedesign.exploring.explore import check_poses, play
        from probedesign.live.recorded import Choice
        from probedesign.live.source import open_source

        if recording is None:
            return open_source(str(self.source), model, _say)
        choice = Choice(self.topic, moment_unit=self.moment_unit, other_probe=self.other_probe)
        played = play(recording, model, self.mend, choice)
        check_poses(poses, played.span)
        return played


def explore(
    bundle: Path,
    recording: Path | None = None,
    /,
    *,
    tare_s: str | None = None,
    out: Path | None = None,
    force: bool = False,
    average: int = 1,
    apart_mm: float = 5.0,
    seconds: float | None = None,
    manifest: Path | None = None,
    reading: ReadingOptions | None = None,
    base: BaseOptions | None = None,
    rehearse: Path | None = None,
    seed: int = 1,
    as_json: Annotated[bool, Parameter(name="--json")] = False,
) -> None:
    """Turn touches from a moving base into points of the world with their ellipsoids.

    Each touch is one point of an object that the base presses onto and stands at, at several poses; touches of one
    point are recognised and fused. Without --out a line a point; with it DIR/points.csv, .ply, .html (to turn by the
    mouse) and .svg. How to press: docs/exploring.md.

    Args:
        bundle: the frozen probe, NAME.probe.json.
        recording: MCAP, a ROS 2 bag, or CSV with named units; see docs/recording-format.md.
        tare_s: START:END in seconds from the first reading: the probe is free then, take the bias there.
        out: the folder to write.
        force: replace the files that stand there.
        average: take means of so many readings.
        apart_mm: the object's points lie at least so far apart; touches that are surely nearer may be one point. 0
            fuses none.
        seconds: end so many seconds after the first reading.
        manifest: manifest.json of the printed parts, to check that the probe is theirs.
        rehearse: write the recording and the poses of a simulated card house to this folder, to try with, and end;
            stiffness and base are off as the bundle and the options say.
        seed: of what is off in it.
        as_json: print one JSON document: the points and all that is to know of them.
    """
    from probedesign.deployment import load_estimator, load_model
    from probedesign.exploring.explore import Exploration, Played, check_apart, check_poses
    from probedesign.exploring.scene import Scene
    from probedesign.live.plan import Plan
    from probedesign.live.tare import parse_window
    from probedesign.live.warm_up import warm_up

    reading, base = reading or ReadingOptions(), base or BaseOptions()
    if rehearse is not None:
        model = load_model(bundle, manifest)
        return _rehearse(model, base.base(model), rehearse, seed, force)
    if (recording is None) == (reading.source is None):
        raise InputError("explore takes a recording, or --source for a run that is live: one of them")
    if tare_s is None:
        raise InputError(
            "a touch is told from the sensor's bias by a tare: say --tare-s START:END, when the probe is free"
        )
    plan = Plan(parse_window(tare_s), average, seconds=seconds, estimates=False)
    apart = check_apart(apart_mm)
    if out is not None:
        check_out(out, force)
    estimator = load_estimator(bundle, manifest)
    model, known = estimator.model, base.base(estimator.model)
    poses = check_poses(base.poses(_say), None)
    with working("loading the rod kernels"):
        warm_up(estimator, _say, fusing=True)
        opened = reading.opened(recording, model, poses)
    for note in (opened.title, *opened.notes, poses.title, *poses.notes, known.line):
        _say(note)
    exploration = Exploration(estimator, known.unknowns(model), known.turn, apart)
    with ending_well(), suppress(KeyboardInterrupt):  # what was touched by then is told
        for touch in exploration.run(opened, plan, poses, _say):
            if recording is None:
                _say(f"touch {touch.series.number} is over: {touch.result}")
    if exploration.placeless:
        _say(
            f"{exploration.placeless} of {exploration.readings} readings have no pose of the base and count for nothing"
        )
    cloud = exploration.cloud()
    if out is not None:
        probe = f"{model.name} {model.fingerprint}"
        scene = Scene(cloud, opened.truth if isinstance(opened, Played) else ())
        write_cloud(out, scene, probe, [opened.title, f"probe {probe}", _summary(cloud), known.short])
    _print(cloud, out, as_json)


def _print(cloud: "Cloud", out: Path | None, as_json: bool) -> None:
    from probedesign.exploring.table import document_of, lines_of

    if as_json:
        print_json(document_of(cloud))
        return
    print("\n".join(lines_of(cloud)) or "no touch")
    print(_summary(cloud) + (f"; wrote {out}/{', '.join(FILES)}" if out is not None else ""))


def _summary(cloud: "Cloud") -> str:
    located, lost = sum(len(point.touches) for point in cloud.points), len(cloud.unlocated)
    by = f"{located}{f' of {located + lost}' if lost else ''} touch{'' if located + lost == 1 else 'es'}"
    told = f"{counted(len(cloud.points), 'point')} by {by}"
    return f"{told}; E by them {cloud.stiffness:.3f} ± {cloud.std_stiffness:.3f} of the bundle's"


def _rehearse(model: "ProbeModel", base: "Base", folder: Path, seed: int, force: bool) -> None:
    """Write a simulated run to try with."""
    import numpy as np

    from probedesign.exploring.card_house import spots
    from probedesign.exploring.rehearsal import Errors, rehearse
    from probedesign.exploring.rehearsal_files import write_rehearsal

    if seed < 0:
        raise InputError(f"--seed {seed} must not be negative")
    rng = np.random.default_rng(seed)
    with working("touching a card house"):
        house = rehearse(model, spots(), rng, Errors.of(model, base))
        written = write_rehearsal(house, model, folder, rng, force)
    print(f"wrote {', '.join(map(str, written))}")


def _say(note: str) -> None:
    print(f"note: {note}", file=sys.stderr)
