"""`probedesign explore`: locate touches from a moving base as points of the world."""

import json
import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from time import monotonic
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
    check_names,
    frozen_probe,
)
from probedesign.core.errors import InputError, one_line
from probedesign.core.files import check_overwrite, check_writable

if TYPE_CHECKING:
    from probedesign.live.outputs.sinks import UdpPublisher
    from probedesign.live.processing.chain import ProcessingOptions
    from probedesign.mapping.contact_map import ContactMap
    from probedesign.mapping.explore import Exploration
    from probedesign.mapping.known_object import KnownObject, ObjectPose
    from probedesign.mapping.next_touch import Suggestion
    from probedesign.mapping.shapes import Shape
    from probedesign.reports.map_page import MapScene

FILES = ("points.csv", "points.ply", "points.html", "points.svg", "shapes.json",
         *(["shapes.ply"] if find_spec("trimesh") is not None else []))  # fmt: skip
MAX_BEHIND = 1 << 16  #: Number of estimates that may arrive during one answer: five minutes at 200 Hz.
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
            further frozen probes whose touches make one map: of one recording of all, or of one recording each.
        out: output folder.
        force: replace existing files.
        apart_mm: smallest distance between points of the object [mm]. Touches that are significantly nearer to each
            other may be fused to one point. 0 fuses none.
        one_object: all touches are of one object, which yields by the same compliance everywhere. Without it each touch
            has its own.
        manifest: manifest.json of the printed parts; its geometry must be the bundle's.
        as_json: print one JSON document with the points and their uncertainty.
    """
    from probedesign.live.outputs.options import open_publisher
    from probedesign.mapping.touch_point import describe_base
    from probedesign.simulation import simulated_run
    from probedesign.simulation.scenes import SOURCE, true_outlines
    from probedesign.web.home import refresh_home

    reading, base, suggestion = reading or ReadingOptions(), base or BaseOptions(), suggestion or SuggestionOptions()
    rehearsing = rehearsal is not None and rehearsal.rehearse is not None
    bundles, recordings = _arguments([bundle, *more], manifest, out, force)
    processing = None if rehearsing else reading.processing(recordings)
    if len(bundles) > 1 and reading.source is not None:
        raise InputError("--source is read by one probe; run `live` with all of them, and here --follow")
    if not 0.0 <= apart_mm < math.inf:
        raise InputError(f"--apart-mm {apart_mm:g} must not be negative; 0 fuses no touches")
    mesh = suggestion.check()
    explorations = _explorations(bundles, manifest, base, 1e-3 * apart_mm, one_object)
    models = [each.estimator.model for each in explorations.values()]
    if rehearsal is not None and rehearsing:
        files = [str(file) for file in rehearsal.write(models, base, one_object, force)]
        return print_json({"files": files}) if as_json else print(f"wrote {', '.join(files)}")
    publisher, titles, sources = open_publisher(suggestion.publish, models, print_note), list[str](), set[str]()
    recorded = {name: recordings[min(i, len(recordings) - 1)] for i, name in enumerate(explorations) if recordings}
    answer = partial(_understood, explorations, suggestion, mesh, publisher, processing is None)
    if processing is None:
        _follow(explorations, reading, base, answer)
    else:
        for name in explorations:
            title, source = _explore(explorations, name, recorded.get(name), reading, base, processing)
            titles, sources = [*titles, title], sources | {source}
    scene, document = answer()
    if publisher is not None:
        publisher.close()
    cloud, rehearsed = scene.contact_map, sources == {SOURCE}
    if out is not None:
        probe = ", ".join(f"{model.name} {model.fingerprint}" for model in models)
        uncertainty = [describe_base(base.priors(each.estimator.priors)) for each in explorations.values()]
        notes = [*dict.fromkeys(titles), f"probe {probe}", _summary(cloud), *dict.fromkeys(uncertainty)]
        _write(out, replace(scene, truth=true_outlines(SOURCE) if rehearsed else ()), probe, notes, document)
        for model in models:
            refresh_home(model)
    if rehearsed and (score := simulated_run.score(cloud, recorded)):
        document["score"] = score
    _print(cloud, scene.lines, document, out, as_json)
    if "no_suggestion" in document and processing is not None:
        raise InputError(document["no_suggestion"])


def _arguments(
    paths: list[Path], manifest: Path | None, out: Path | None, force: bool
) -> tuple[list[Path], list[Path]]:
    """Return the frozen probes and the recordings of the command, after checking that all files can be used.

    A path is a recording by its suffix or its content.
    """
    from probedesign.live.sources.replay import check_readable
    from probedesign.live.sources.rosbag import is_bag

    bundles, recordings = list[Path](), list[Path]()
    for path in paths:
        named = path.suffix.lower() in (".csv", ".mcap", ".db3")  # also where there is no such file, which is reported
        recorded = named or is_bag(path) or (path.is_file() and path.suffix != ".json")
        (recordings if recorded and path != paths[0] else bundles).append(path)
    if manifest is not None and len(bundles) > 1:
        raise InputError("--manifest belongs to one probe; check each probe in a run of its own")
    if recordings and len(recordings) not in (1, len(bundles)):
        raise InputError(f"{len(recordings)} recordings of {len(bundles)} probes: give one of all, or one of each")
    if out is not None:
        if out.exists() and not out.is_dir():
            raise InputError(f"--out {out} is a file; choose a folder")
        check_writable(out / FILES[0])
        for name in FILES:
            check_overwrite(out / name, force)
    for path in recordings:
        check_readable(path)
    return [bundles[0], *map(frozen_probe, bundles[1:])], recordings


def _explorations(
    bundles: list[Path], manifest: Path | None, base: BaseOptions, apart: float, one_object: bool
) -> "dict[str, Exploration]":
    """Return an exploration without touches for each probe by its name.

    One object has the same prior of its compliance for all of them.
    """
    from probedesign.frozen_probe import load_estimator
    from probedesign.mapping.explore import Exploration

    loaded = [load_estimator(path, manifest) for path in bundles]
    check_names([each.model.name for each in loaded])
    softest = max(each.priors.object_compliance for each in loaded)
    priors = [base.priors(each.priors) for each in loaded]
    if one_object:
        priors = [replace(each, object_compliance=softest) for each in priors]
    return {
        each.model.name: Exploration(each, prior, apart, one_object) for each, prior in zip(loaded, priors, strict=True)
    }


def _explore(
    explorations: "Mapping[str, Exploration]",
    name: str,
    recording: Path | None,
    reading: ReadingOptions,
    base: BaseOptions,
    processing: "ProcessingOptions",
) -> tuple[str, str]:
    """Collect the touches of one probe; return the title of their source, and what was recorded, if it says so.

    All kernels are compiled before the first reading arrives.
    """
    from probedesign.live.run import warm_up
    from probedesign.mapping.touch_point import describe_base

    exploration, of = explorations[name], f"{name}: " if len(explorations) > 1 else ""
    estimator = exploration.estimator

    def log(line: str) -> None:
        print_note(of + line)

    if (poses := base.poses(log, list(explorations), name)) is None:
        raise InputError("--pose fixed: points need base poses; give --pose FILE.csv, a ROS 2 bag or udp://:PORT")
    with show_progress("loading the rod kernels"):
        warm_up(estimator, log, fusing=True)
        source = reading.open(recording, estimator.model, poses, log)
    stated = describe_base(base.priors(estimator.priors))
    change = "change it with --base-offset-mm, --base-repeat-mm, --tilt-deg, --clocking-deg"
    for note in (source.title, *source.notes, poses.title, *poses.notes, f"{stated}; {change}"):
        log(note)
    with interrupt_on_termination(), suppress(KeyboardInterrupt):
        for touch in exploration.run(source, processing, poses, log):
            if recording is None:
                log(f"touch {touch.segment.number} ended: {touch.result}")
    if exploration.n_without_pose:
        counts = f"{exploration.n_without_pose} of {exploration.n_readings} readings"
        log(f"{counts} have no base pose and are ignored")
    return source.title, getattr(source, "recorded_from", "")


def _follow(
    explorations: "Mapping[str, Exploration]",
    reading: ReadingOptions,
    base: BaseOptions,
    answer: Callable[[], tuple["MapScene", dict[str, Any]]],
) -> None:
    """Follow the estimates of a run of `live` until --seconds or Ctrl-C, and answer when a touch has ended."""
    from probedesign.live.datagrams import Listener, parse_listen_address
    from probedesign.live.poses.open import parse_gravity
    from probedesign.mapping.explore import followed_update

    first, option = next(iter(explorations)), f"--follow {reading.follow}"
    if base.pose is not None:
        raise InputError("--follow takes the poses of the run of `live`: no --pose")
    gravity = parse_gravity(base.gravity_world)
    for exploration in explorations.values() if gravity is not None else ():
        exploration.gravity_world = np.asarray(gravity)
    parse = partial(followed_update, explorations[first].gravity_world)
    listener = Listener(option, "estimates", parse_listen_address(option), parse, max_queued=MAX_BEHIND)
    print_note(" ".join(listener.notes))
    end, latest, other = monotonic() + (reading.seconds or math.inf), dict.fromkeys(explorations, (0, 0.0)), ""
    with interrupt_on_termination(), closing(listener):
        listener.start()
        with suppress(KeyboardInterrupt):
            while monotonic() < end:
                listener.wait(0.2)
                for line in listener.pop_messages():
                    print_note(line)
                ended = False
                for _, update, session in listener.pop():
                    name = first if update is None else update.probe or first
                    if update is None or name not in explorations:
                        if name not in explorations and not other:
                            other = name
                            print_note(f"estimates of probe {one_line(name, 60)} are not followed: name it as well")
                        continue
                    exploration, (before, time) = explorations[name], latest[name]
                    latest[name] = session, update.reading.time
                    new_run = session != before or update.reading.time < time
                    for touch in (*(exploration.finish(print_note) if new_run else ()),
                                  *exploration.take(update, print_note)):  # fmt: skip
                        ended = True
                        print_note(f"{name}: touch {touch.segment.number} ended: {touch.result}")
                if ended:  # once for all that ended while the last answer was computed
                    print_note("\n".join(answer()[0].lines) or "no touch is located yet")
    print_note(listener.summary)
    for exploration in explorations.values():
        list(exploration.finish(print_note))


def _write(out: Path, scene: "MapScene", probe: str, notes: list[str], document: dict[str, Any]) -> None:
    """Write table, points, page, picture and shapes; `notes` on the origin of the points are for the page."""
    from probedesign.mapping.contact_map import map_csv, map_ply
    from probedesign.reports.map_page import map_mesh, map_page, map_svg

    origin = f"probedesign explore, probe {probe}"
    contents = (map_csv(scene.contact_map), map_ply(scene.contact_map, origin),
                map_page(scene, "Points touched", [*notes, ELLIPSOIDS]), map_svg(scene),
                json.dumps(document, indent=1).encode(),
                *(map_mesh(scene) for name in FILES if name == "shapes.ply"))  # fmt: skip
    write_files(out, zip(FILES, contents, strict=True))


def _understood(
    explorations: "Mapping[str, Exploration]",
    options: SuggestionOptions,
    mesh: "KnownObject | None",
    publisher: "UdpPublisher | None",
    following: bool,
) -> "tuple[MapScene, dict[str, Any]]":
    """Return the map with its shapes and the next touch, and the latter for a JSON document, which is published.

    Where no suggestion is possible, the document says why, and while a run is followed a line does.
    """
    from probedesign.mapping.explore import joint_map
    from probedesign.mapping.shapes import ShapeFit, TouchSet, missing, shapes_document
    from probedesign.reports.map_page import MapScene

    cloud = joint_map(explorations) if len(explorations) > 1 else next(iter(explorations.values())).map()
    touched, friction = TouchSet.of(cloud), max(each.estimator.model.friction for each in explorations.values())
    shapes = ShapeFit(touched, friction).shapes()
    known = None if mesh is None else (mesh, options.located(mesh, touched, friction))
    lines, ghost = [*(shape.text for shape in shapes), missing(touched, shapes)], None
    document: dict[str, Any] = {"shapes": shapes_document(shapes)}
    if math.isfinite(cloud.object_compliance):
        document["object_compliance_m_N"] = cloud.object_compliance
        document["std_object_compliance_m_N"] = cloud.std_object_compliance
    if known is not None:
        at, lines = known[1], [*lines, known[1].text]
        document["object"] = {"T_world_object": at.T_world_object.tolist(), "cov": at.cov.tolist(),
                              "touches": at.touches, "left_out": at.left_out,
                              "contradicted": at.contradicted}  # fmt: skip
    if options.suggest:
        try:
            best = _suggested(options, explorations, shapes, known, cloud.std_object_compliance)
            document["suggestion"], lines, ghost = best.document, [*lines, *best.lines], best.axis_world
            rod = explorations[best.probe or next(iter(explorations))].estimator.model.rod
            radius = [float(rod.radius_at(s)) for s in np.linspace(0.0, rod.length, len(ghost))]
            ghost = np.column_stack([ghost, radius])
        except InputError as error:
            document["no_suggestion"] = str(error)
            lines = [*lines, str(error)] if following else lines
    if publisher is not None:
        publisher.send_map(document)
    return MapScene(cloud, (), tuple(shapes), tuple(line for line in lines if line), ghost), document


def _suggested(
    options: SuggestionOptions,
    explorations: "Mapping[str, Exploration]",
    shapes: "list[Shape]",
    known: "tuple[KnownObject, ObjectPose] | None",
    std_compliance: float,
) -> "Suggestion":
    """Return the next touch, by the probe that improves the goal most.

    Raises:
        InputError: the goal has nothing to improve, or no probe reaches a touch that does.
    """
    from probedesign.mapping.next_touch import suggest

    problem, best = InputError("--suggest needs a touch with a base at rest"), None
    for name, exploration in explorations.items():
        poses = [each.T_world_base for touch in exploration.touches for each in touch.segment.intervals]
        if not poses:
            continue
        try:
            proposal = suggest(exploration.estimator, np.array(poses), exploration.gravity_world, options.goal, shapes,
                               known, 1e-3 * options.force_limit_mN, std_compliance)  # fmt: skip
        except InputError as error:
            problem = error
            continue
        if best is None or proposal.after < best.after:
            best = replace(proposal, probe=name if len(explorations) > 1 else "")
    if best is None:
        raise problem
    return best


def _print(
    cloud: "ContactMap", lines: Sequence[str], document: dict[str, Any], out: Path | None, as_json: bool
) -> None:
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
