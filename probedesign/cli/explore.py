"""`probedesign explore`: touches from a moving base into points of the world."""

import sys
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from probedesign.cli.base_options import BaseOptions
from probedesign.cli.console import working
from probedesign.cli.ending import ending_well
from probedesign.cli.explored_files import check_out, write_cloud
from probedesign.cli.explored_lines import print_cloud, summary
from probedesign.cli.options import ReadingOptions
from probedesign.cli.rehearsal_options import RehearsalOptions

if TYPE_CHECKING:
    from probedesign.estimation.estimator import Estimator
    from probedesign.exploring.explore import Exploration
    from probedesign.frames import Array
    from probedesign.live.poses.base_poses import BasePoses
    from probedesign.live.processing.scheduler import ProcessingOptions
    from probedesign.live.sources.source import Source


def explore(
    bundle: Path,
    recording: Path | None = None,
    /,
    *,
    out: Path | None = None,
    force: bool = False,
    apart_mm: float = 5.0,
    manifest: Path | None = None,
    reading: ReadingOptions | None = None,
    base: BaseOptions | None = None,
    rehearsal: RehearsalOptions | None = None,
    as_json: Annotated[bool, Parameter(name="--json")] = False,
) -> None:
    """Turn touches from a moving base into points of the world with their ellipsoids.

    Each touch is one point of an object that the base presses onto and stands at, at several poses; touches of one
    point are recognised and fused. Without --out a line a point; with it DIR/points.csv, .ply, .html (to turn by the
    mouse) and .svg. How to press: docs/exploring.md.

    Args:
        bundle: the frozen probe, NAME.probe.json.
        recording: MCAP, a ROS 2 bag, or CSV with named units; see docs/recording-format.md.
        out: the folder to write.
        force: replace the files that stand there.
        apart_mm: the object's points lie at least so far apart; touches that are surely nearer may be one point. 0
            fuses none.
        manifest: manifest.json of the printed parts, to check that the probe is theirs.
        as_json: print one JSON document: the points and all that is to know of them.
    """
    from probedesign.deployment import load_estimator, load_model
    from probedesign.exploring.explore import Exploration, check_apart
    from probedesign.exploring.scene import Scene

    reading, base = reading or ReadingOptions(), base or BaseOptions()
    if rehearsal is not None and rehearsal.rehearse is not None:
        model = load_model(bundle, manifest)
        written = rehearsal.write(rehearsal.rehearse, model, base.base(model), force)
        return print(f"wrote {', '.join(map(str, written))}")
    plan, apart = reading.plan(recording), check_apart(apart_mm)
    if out is not None:
        check_out(out, force)
    estimator = load_estimator(bundle, manifest)
    model, known = estimator.model, base.base(estimator.model)
    opened, poses = _opened(estimator, recording, reading, base)
    for note in (opened.title, *opened.notes, poses.title, *poses.notes, known.line):
        _say(note)
    exploration = Exploration(estimator, known.priors(estimator.priors), apart)
    _run(exploration, opened, plan, poses, tells=recording is None)
    cloud, probe = exploration.cloud(), f"{model.name} {model.fingerprint}"
    if out is not None:
        about = [opened.title, f"probe {probe}", summary(cloud), known.short]
        write_cloud(out, Scene(cloud, _truth(opened)), probe, about)
    print_cloud(cloud, out, as_json)


def _opened(
    estimator: "Estimator", recording: Path | None, reading: ReadingOptions, base: BaseOptions
) -> "tuple[Source, BasePoses]":
    """Readings and poses, and everything compiled before the first is read."""
    from probedesign.exploring.explore import check_poses
    from probedesign.live.run import warm_up

    poses = check_poses(base.poses(_say), None)
    with working("loading the rod kernels"):
        warm_up(estimator, _say, fusing=True)
        return reading.opened(recording, estimator.model, poses, _say), poses


def _run(
    exploration: "Exploration", opened: "Source", plan: "ProcessingOptions", poses: "BasePoses", tells: bool
) -> None:
    """Until the source ends or Ctrl-C; what was touched by then is told.

    Args:
        exploration: takes the touches.
        opened: gives readings.
        plan: what to do with them.
        poses: of the base.
        tells: say of each touch when it is over.
    """
    with ending_well(), suppress(KeyboardInterrupt):
        for touch in exploration.run(opened, plan, poses, _say):
            if tells:
                _say(f"touch {touch.series.number} is over: {touch.result}")
    if exploration.placeless:
        _say(
            f"{exploration.placeless} of {exploration.readings} readings have no pose of the base and count for nothing"
        )


def _truth(opened: "Source") -> "tuple[Array, ...]":
    """Outlines of what was touched, where a rehearsal tells them [m], (k, 3) each."""
    from probedesign.exploring.card_house import true_outlines
    from probedesign.exploring.explore import Played
    from probedesign.live.sources.replay import ReplaySource

    return true_outlines(opened.recorded_from) if isinstance(opened, Played | ReplaySource) else ()


def _say(note: str) -> None:
    print(f"note: {note}", file=sys.stderr)
