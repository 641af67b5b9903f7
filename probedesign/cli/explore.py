"""`probedesign explore`: locate touches from a moving base as points of the world."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from probedesign.cli.console import interrupt_on_termination, plural, print_json, print_note, show_progress, write_files
from probedesign.cli.options import (
    BaseOptions,
    FrozenProbe,
    JsonOutput,
    ReadingOptions,
    RehearsalOptions,
    SuggestionOptions,
    frozen_probe,
)
from probedesign.core.errors import InputError
from probedesign.core.files import check_overwrite, check_writable

if TYPE_CHECKING:
    from probedesign.estimation.estimator import Estimator
    from probedesign.live.poses.base_poses import BasePoses
    from probedesign.live.processing.chain import ProcessingOptions
    from probedesign.live.sources.source import Source
    from probedesign.mapping.contact_map import ContactMap
    from probedesign.mapping.explore import Exploration
    from probedesign.mapping.known_object import KnownObject, ObjectPose
    from probedesign.mapping.next_touch import Suggestion
    from probedesign.mapping.shapes import Shape
    from probedesign.mapping.touch_point import LocatedTouch
    from probedesign.reports.map_page import MapScene

FILES = ("points.csv", "points.ply", "points.html", "points.svg", "shapes.json")
ELLIPSOIDS = (
    "The ellipsoids contain the true point with a probability of 95 %, given the stated uncertainty of stiffness, "
    "base, robot and bias. ± is the RMS distance."
)


def explore(
    bundle: FrozenProbe,
    /,
    *more: Path,
    out: Path | None = None,
    force: bool = False,
    apart_mm: float = 5.0,
    one_object: bool = False,
    manifest: Path | None = None,
    reading: ReadingOptions | None = None,
    base: BaseOptions | None = None,
    rehearsal: RehearsalOptions | None = None,
    suggestion: SuggestionOptions | None = None,
    as_json: JsonOutput = False,
) -> None:
    """Turn touches from a moving base into points of the world with their ellipsoids.

    Each touch is one point of an object that the base presses onto at several poses, with a stop at each. Touches of
    the same point are recognised and fused. Prints one line per point. With --out it writes DIR/points.csv, .ply,
    .html (a 3D view) and .svg. How to press: docs/exploring.md.

    Args:
        bundle: the frozen probe: NAME.probe.json, its folder, or NAME of exports/NAME.
        more: the recording: MCAP, a ROS 2 bag, or CSV with named units; see docs/recording-format.md. Before it,
            further frozen probes of a recording of several, whose touches make one map.
        out: output folder.
        force: replace existing files.
        apart_mm: smallest distance between points of the object [mm]. Touches that are significantly nearer to each
            other may be fused to one point. 0 fuses none.
        one_object: all touches are of one object, which yields by the same compliance everywhere. Without it each touch
            has its own.
        manifest: manifest.json of the printed parts; its geometry must be the bundle's.
        as_json: print one JSON document with the points and their uncertainty.
    """
    from probedesign import pipeline
    from probedesign.live.sources.replay import ReplaySource, check_readable
    from probedesign.mapping.explore import LoadedRecording, joint_map, parse_min_separation
    from probedesign.reports.map_page import MapScene
    from probedesign.simulation import simulated_run
    from probedesign.simulation.scenes import true_outlines
    from probedesign.web.home import refresh_home

    reading, base = reading or ReadingOptions(), base or BaseOptions()
    if rehearsal is not None and rehearsal.rehearse is not None:
        model = pipeline.load_estimator(bundle, manifest).model
        written = rehearsal.write(rehearsal.rehearse, model, base.base(model), force)
        return print(f"wrote {', '.join(map(str, written))}")
    bundles, recording = [bundle, *map(frozen_probe, more[:-1])], more[-1] if more else None
    if manifest is not None and len(bundles) > 1:
        raise InputError("--manifest belongs to one probe; check each probe in a run of its own")
    processing, apart = reading.processing(recording), parse_min_separation(apart_mm)
    (suggestion := suggestion or SuggestionOptions()).check()
    if out is not None:
        if out.exists() and not out.is_dir():
            raise InputError(f"--out {out} is a file; choose a folder")
        check_writable(out / FILES[0])
        for name in FILES:
            check_overwrite(out / name, force)
    if recording is not None:
        check_readable(recording)
    estimators = {each.model.name: each for each in (pipeline.load_estimator(path, manifest) for path in bundles)}
    if len(estimators) < len(bundles):
        raise InputError("two of the frozen probes have one name; a recording of several has one of each name")
    several, explorations = len(bundles) > 1, {}
    for name, estimator in estimators.items():
        explorations[name], source, uncertainty = _explored(
            estimator, recording, reading, base, (processing, apart, one_object), name if several else ""
        )
    cloud = joint_map(explorations) if several else explorations[name].map()
    shapes, best, lines, document = _understood(cloud, estimators, explorations, suggestion)
    recorded_from = source.recorded_from if isinstance(source, LoadedRecording | ReplaySource) else ""
    if out is not None:
        probe = ", ".join(f"{name} {each.model.fingerprint}" for name, each in estimators.items())
        notes = [source.title, f"probe {probe}", _summary(cloud), uncertainty]
        ghost = None if best is None else best.axis_world
        scene = MapScene(cloud, true_outlines(recorded_from), tuple(shapes), tuple(lines), ghost)
        _write(out, scene, probe, notes, document)
        for each in estimators.values():
            refresh_home(each.model)
    if score := simulated_run.score(cloud, recording, recorded_from):
        document["score"] = score
    _print(cloud, lines, document, out, as_json)


def _explored(
    estimator: "Estimator",
    recording: Path | None,
    reading: ReadingOptions,
    base: BaseOptions,
    processing: "tuple[ProcessingOptions, float, bool]",
    probe: str,
) -> "tuple[Exploration, Source, str]":
    """Return the touches of one probe, their source, and the uncertainty of the base in one line.

    Args:
        estimator: of the probe.
        recording: the recording; None for a live source.
        reading: how it is read.
        base: the poses of the base.
        processing: how the readings are processed, the least distance of points [m], and whether all are of one object.
        probe: name of the probe where there are several.
    """
    from probedesign import pipeline

    uncertainty, of = base.base(estimator.model), f"{probe}: " if probe else ""
    source, poses = _open(estimator, recording, reading, base, probe)
    for note in (source.title, *source.notes, poses.title, *poses.notes, uncertainty.notice):
        print_note(of + note)

    def on_touch(touch: "LocatedTouch") -> None:
        if recording is None:
            print_note(f"touch {touch.segment.number} ended: {touch.result}")

    options, apart, one_object = processing
    priors = uncertainty.apply_to(estimator.priors)
    with interrupt_on_termination():
        exploration = pipeline.explore(estimator, source, options, poses, print_note, priors, apart, on_touch,
                                       one_object=one_object)  # fmt: skip
    if exploration.n_without_pose:
        counts = f"{exploration.n_without_pose} of {exploration.n_readings} readings"
        print_note(f"{of}{counts} have no base pose and are ignored")
    return exploration, source, uncertainty.summary


def _open(
    estimator: "Estimator", recording: Path | None, reading: ReadingOptions, base: BaseOptions, probe: str
) -> "tuple[Source, BasePoses]":
    """Open readings and poses, with all kernels compiled before the first reading arrives.

    `probe` is the name of the probe where there are several.
    """
    from probedesign.live.run import warm_up
    from probedesign.mapping.explore import check_poses

    poses = check_poses(base.poses(print_note, probe), None)
    with show_progress("loading the rod kernels"):
        warm_up(estimator, print_note, fusing=True)
        return reading.open(recording, estimator.model, poses, print_note), poses


def _write(out: Path, scene: "MapScene", probe: str, notes: list[str], document: dict[str, Any]) -> None:
    """Write table, points, page, picture and shapes; `notes` on the origin of the points are for the page."""
    from probedesign.mapping.contact_map import map_csv, map_ply
    from probedesign.reports.map_page import map_page, map_svg

    origin = f"probedesign explore, probe {probe}"
    contents = (map_csv(scene.contact_map), map_ply(scene.contact_map, origin),
                map_page(scene, "Points touched", [*notes, ELLIPSOIDS]), map_svg(scene),
                json.dumps(document, indent=1).encode())  # fmt: skip
    write_files(out, zip(FILES, contents, strict=True))


def _understood(
    cloud: "ContactMap",
    estimators: "dict[str, Estimator]",
    explorations: "dict[str, Exploration]",
    options: SuggestionOptions,
) -> "tuple[list[Shape], Suggestion | None, list[str], dict[str, Any]]":
    """Return the shapes and the next touch, and both with a known object as lines and for a JSON document."""
    from probedesign.mapping.shapes import ShapeFit, TouchSet, missing, shapes_document

    touched, friction = TouchSet.of(cloud), max(each.model.friction for each in estimators.values())
    shapes, known = ShapeFit(touched, friction).shapes(), options.known(touched, friction)
    lines = [*(shape.text for shape in shapes), missing(touched, shapes)]
    document: dict[str, Any] = {"shapes": shapes_document(shapes)}
    if known is not None:
        at, lines = known[1], [*lines, known[1].text]
        document["object"] = {"T_world_object": at.T_world_object.tolist(), "cov": at.cov.tolist(),
                              "touches": at.touches, "left_out": at.left_out}  # fmt: skip
    best = None
    if options.suggest:
        best = _suggested(options, estimators, explorations, shapes, known)
        document["suggestion"], lines = best.document, [*lines, *best.lines]
    return shapes, best, [line for line in lines if line], document


def _suggested(
    options: SuggestionOptions,
    estimators: "dict[str, Estimator]",
    explorations: "dict[str, Exploration]",
    shapes: "list[Shape]",
    known: "tuple[KnownObject, ObjectPose] | None",
) -> "Suggestion":
    """Return the next touch, by the probe that improves the goal most.

    Raises:
        InputError: the goal has nothing to improve, or no probe reaches a touch that does.
    """
    from probedesign.mapping.next_touch import suggest

    problem, best = InputError("--suggest needs a touch with a base at rest"), None
    for name, estimator in estimators.items():
        poses = [each.T_world_base for touch in explorations[name].touches for each in touch.segment.intervals]
        if not poses:
            continue
        try:
            found = suggest(estimator, np.array(poses), explorations[name].gravity_world, options.goal, shapes, known,
                            1e-3 * options.force_limit_mN)  # fmt: skip
        except InputError as error:
            problem = error
            continue
        if best is None or found.after < best.after:
            best = replace(found, probe=name if len(estimators) > 1 else "")
    if best is None:
        raise problem
    return best


def _print(cloud: "ContactMap", lines: list[str], document: dict[str, Any], out: Path | None, as_json: bool) -> None:
    """Print one JSON document, or one line per point, `lines` on the shapes, and a summary."""
    from probedesign.mapping.contact_map import map_document, map_lines

    if as_json:
        return print_json({**map_document(cloud), **document})
    print("\n".join([*map_lines(cloud), *lines]) or "no touch")
    print(_summary(cloud) + (f"; wrote {out}/{', '.join(FILES)}" if out is not None else ""))
    if "score" in document:
        print(document["score"])


def _summary(cloud: "ContactMap") -> str:
    """Return the number of points and touches, and the estimated stiffness scale."""
    located, lost = sum(len(point.touches) for point in cloud.points), len(cloud.unlocated)
    touches = f"{located}{f' of {located + lost}' if lost else ''} touch{'' if located + lost == 1 else 'es'}"
    known = math.isfinite(cloud.stiffness)
    stiffness = f"; stiffness scale {cloud.stiffness:.3f} ± {cloud.std_stiffness:.3f}" if known else ""
    if math.isfinite(cloud.object_compliance):
        stiffness += f"; object yields by {cloud.object_compliance:.3f} ± {cloud.std_object_compliance:.3f} m/N"
    return f"{plural(len(cloud.points), 'point')} from {touches}{stiffness}"
