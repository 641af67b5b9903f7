"""`probedesign live`: locate contacts in real time."""

import math
import os
import re
import sys
from contextlib import ExitStack, closing, suppress
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from probedesign.cli.console import interrupt_on_termination
from probedesign.cli.options import EstimatorOptions, FrozenProbe, Tare, check_names
from probedesign.core.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable, Generator

    from probedesign.estimation.estimator import Estimator
    from probedesign.live.outputs.options import OutputOptions
    from probedesign.live.processing.chain import ProcessingOptions
    from probedesign.live.processing.estimates import EstimateUpdate


def live(
    bundle: FrozenProbe,
    /,
    *more: Annotated[
        FrozenProbe,
        Parameter(
            help="further probes of the same run. The i-th source and pose belong to the i-th probe, whose name is the "
            "prefix of its topics and frames."
        ),
    ],
    source: list[str],
    record: Path | None = None,
    force: bool = False,
    tare_s: str | None = None,
    tare: Tare | None = None,
    average: int | None = None,
    mains_hz: float | None = None,
    deadline_ms: float | None = None,
    pose: list[str] | None = None,
    pose_latency_ms: float = 0.0,
    gravity_world: str | None = None,
    rate_hz: float = 20.0,
    count: int | None = None,
    seconds: float | None = None,
    publish: str | None = None,
    foxglove: str | bool = False,
    control: str | None = None,
    guard: str | None = None,
    limit_force_N: Annotated[float, Parameter(name="--limit-force-N", show_default=False)] = math.inf,
    limit_moment_Nm: Annotated[float, Parameter(name="--limit-moment-Nm", show_default=False)] = math.inf,
    view: bool = False,
    view_host: str = "127.0.0.1",
    view_port: int = 8080,
    open_: Annotated[bool, Parameter(name="--open", negative="--no-open")] = True,
    options: EstimatorOptions | None = None,
    lines: bool = False,
    log: Path | None = None,
    as_json: Annotated[bool, Parameter(name="--json", help="print each estimate as one line of JSON.")] = False,
) -> None:
    """Locate contacts in real time: a live table on a terminal, otherwise one line per estimate.

    Ends with the source, at --count or --seconds, or with Ctrl-C, and prints the number of estimates per result code.
    Options of the sources, such as "sim:?force_mN=50&seconds=60" or "replay:FILE?speed=max", and the tare:
    docs/live.md.

    Args:
        source: netft://HOST (a Net F/T box or an Axia), "daq://Dev1/ai0:5?cal=FILE" (a sensor at a DAQ card),
            replay:FILE (a recording), udp://:PORT (wrenches in JSON or MessagePack), ros2://TOPIC, or sim: (a simulated
            contact that moves along the probe).
        record: record everything to NAME.mcap, or raw readings to NAME.csv.
        force: replace an existing recording.
        tare_s: START:END of the tare in seconds after the first reading. The probe must be free then.
        tare: without --tare-s: auto takes the first second at rest, when the probe must be free; none trusts the
            sensor's own zero, taken without the probe. Default: that zero only if readings agree with the free probe.
        average: number of readings per mean; each mean is one estimate. Default: by rate and noise of the first
            readings, so that a mean has the noise that BUNDLE states.
        mains_hz: frequency of the mains, 50 or 60: each mean covers whole periods of it, so that hum is removed.
        deadline_ms: readings that are older when their turn comes are not located if there are newer ones. Default: 12,
            or the duration of a burst in which they arrive.
        pose: poses of the base: fixed, FILE.csv or .jsonl, a ROS 2 bag (BAG?topic=/pose or BAG?world=map&base=probe),
            udp://:PORT, tf://WORLD/BASE, ur://HOST or franka://HOST. With poses, touches are fused to points of the
            world. Default: fixed.
        pose_latency_ms: delay of a pose relative to a reading of the same time [ms].
        gravity_world: X,Y,Z of gravity in world axes [m/s²]. Default: 0,0,-9.81.
        rate_hz: largest rate of the estimates [Hz]; readings in between are not located.
        count: end after this number of estimates.
        seconds: end this many seconds after the first reading, by the source's clock or the wall clock.
        publish: send each estimate as a JSON datagram to udp://HOST:PORT, or all messages to the node of ROS 2 at
            ros2://HOST:PORT.
        control: receive commands (tare, mark, start and stop recording, stop) as datagrams at udp://[HOST]:PORT.
        guard: send contacts, exceeded limits and a heartbeat at the rate of the samples to udp://HOST:PORT, or to the
            node of ROS 2 at ros2://HOST:PORT.
        limit_force_N: force of the contact beyond which the guard stops [N].
        limit_moment_Nm: moment about the base beyond which it stops [N·m].
        foxglove: serve the messages of a recording to Foxglove and PlotJuggler, at HOST:PORT. Default:
            127.0.0.1:8765.
        view: show the probe, the contact and charts on a page in the browser.
        view_host: address on which the page is served. 0.0.0.0 makes it accessible from the network.
        view_port: port of the page, or the next free one.
        open_: open the page in a browser, if the output is a terminal.
        lines: print one line per estimate on a terminal, too.
        log: append every message with its time to this file.
    """
    from probedesign.live.datagrams import parse_listen_address
    from probedesign.live.outputs.guard import Limits
    from probedesign.live.outputs.options import OutputOptions
    from probedesign.live.processing.chain import ProcessingOptions
    from probedesign.live.processing.tare import parse_tare

    window, zero = parse_tare(tare_s, tare)
    chosen = options or EstimatorOptions()
    processing = ProcessingOptions(
        window, average, rate_hz, count, seconds, method=chosen.method, zero=zero, mains_hz=mains_hz,
        deadline=None if deadline_ms is None else 1e-3 * deadline_ms,
    )  # fmt: skip
    bundles = (bundle, *more)
    if chosen.manifest is not None and more:
        raise InputError("--manifest belongs to one probe; check each probe in a run of its own")
    loaded = [chosen.load(each) for each in bundles]
    poses = pose or ["fixed"] * len(bundles)
    _check_pairs([estimator.model.name for estimator in loaded], source, poses)
    estimators = {estimator.model.name if more else "": estimator for estimator in loaded}
    settings = {
        "source": "; ".join(source),
        "tare_s": tare_s,
        "tare": tare,
        "average": average,
        "rate_hz": rate_hz,
        "exact_model": chosen.exact_model,
        "method": chosen.method,
        "friction": loaded[0].model.friction,
        "mains_hz": mains_hz,
        "deadline_ms": deadline_ms,
        "pose": "; ".join(poses),
        "pose_latency_ms": pose_latency_ms,
        "gravity_world": gravity_world,
    }
    foxglove_address = None
    if foxglove is not False:
        from probedesign.live.outputs.message_streams import parse_foxglove_address

        foxglove_address = parse_foxglove_address("" if foxglove is True else foxglove)
    outputs = OutputOptions(
        record=record,
        force=force,
        publish=publish,
        page=(view_host, view_port) if view else None,
        terminal=not (lines or as_json) and _is_terminal(),
        parts_folders=[each if each.is_dir() else each.parent for each in bundles],
        metadata={name: _setting_text(value) for name, value in settings.items()},
        foxglove=foxglove_address,
        guard=guard,
        limits=Limits(limit_force_N, limit_moment_Nm),
        open_browser=open_ and _is_terminal(),
    )
    outputs.check(source, several=bool(more))
    if control is not None:
        parse_listen_address(f"--control {control}")  # before anything is compiled
    if guard is None and not math.isinf(min(limit_force_N, limit_moment_Nm)):
        raise InputError("--limit-force-N and --limit-moment-Nm are watched by a guard; give --guard udp://HOST:PORT")
    for estimator in estimators.values():
        outputs.limits.check(estimator.model)
    specs = list(zip(source, poses, strict=True))
    _run(estimators, processing, outputs, specs, (pose_latency_ms, gravity_world), control, as_json, log)


#: Sources that several probes may share: a recording has the readings of each, and a simulation has no sensor.
_SHARED = ("sim:", "replay:")


def _check_pairs(names: list[str], sources: list[str], poses: list[str]) -> None:
    for option, values in (("--source", sources), ("--pose", poses)):
        if len(values) != len(names):
            raise InputError(
                f"{len(values)} {option} for {len(names)} probe{'s' * (len(names) > 1)}: give one for each, in the "
                "order of the probes"
            )
    check_names(names)
    sensors = [re.sub(r"//(localhost|127[.\d]+|\[::1\])", "//127.0.0.1", source) for source in sources]
    for i, source in enumerate(sources):
        if sensors[i] in sensors[:i] and not source.startswith(_SHARED):
            raise InputError(f"--source {source} is given twice; each probe has a sensor of its own")


def _run(
    estimators: "dict[str, Estimator]",
    processing: "ProcessingOptions",
    outputs: "OutputOptions",
    specs: list[tuple[str, str]],
    pose_options: tuple[float, str | None],
    control: str | None,
    as_json: bool,
    log: Path | None,
) -> None:
    """Open the sources, poses and outputs, print the estimates until the end, and close everything.

    Args:
        estimators: estimator of each probe by its name in the run, which is empty for a single probe.
        processing: how readings are processed.
        outputs: outputs that the user selected.
        specs: source and poses of each probe.
        pose_options: latency of the poses [ms], and gravity in world axes.
        control: address at which commands are received.
        as_json: print JSON.
        log: file to which every message is appended.
    """
    from probedesign.live.outputs.guard import Guard, GuardChannel, GuardedSource
    from probedesign.live.outputs.options import open_publisher
    from probedesign.live.outputs.sinks import LogFile, ProbeSink, SinkGroup, StderrSink
    from probedesign.live.poses.open import open_poses
    from probedesign.live.processing.commands import CommandQueue, DatagramInput, KeyInput, SharedCommands
    from probedesign.live.run import estimate_stream, merged, warm_up
    from probedesign.live.sources.source import open_source

    logs = () if log is None else (LogFile(log),)
    with closing(SinkGroup(*logs, StderrSink())) as sinks, ExitStack() as inputs, interrupt_on_termination():
        parts = [SinkGroup(ProbeSink(name, sinks)) if name else sinks for name in estimators]
        runs = list(zip(estimators.values(), specs, parts, strict=True))
        sources = [open_source(source, estimator.model, part.log) for estimator, (source, _), part in runs]
        poses = [open_poses(pose, *pose_options, part.log) for _, (_, pose), part in runs]
        publisher = open_publisher(outputs.publish, [estimator.model for estimator in estimators.values()], sinks.log)
        for estimator in estimators.values():
            warm_up(estimator, sinks.log, fusing=True)
        for (estimator, _, part), source, known in zip(runs, sources, poses, strict=True):
            part.log(f"{source.title}; probe {estimator.model.name} {estimator.model.fingerprint}")
            for note in (*source.notes, *((known.title, *known.notes) if known is not None else ())):
                part.log(note)
            if known is not None:
                known.on_pose = part.on_pose
        queues = [CommandQueue() for _ in runs]
        commands = SharedCommands(queues) if len(queues) > 1 else queues[0]
        readings = list(sources)
        if outputs.guard is not None:
            channel = GuardChannel(outputs.guard, sinks.log)
            inputs.callback(channel.close)
            for i, ((name, estimator), part, queue) in enumerate(zip(estimators.items(), parts, queues, strict=True)):
                watching = Guard(estimator, outputs.limits, channel.send, part.log, name)
                readings[i] = GuardedSource(sources[i], watching)
                part.add(watching)
                queue.register("reset", watching.reset)
        outputs.connect(sinks, commands, estimators, sources, publisher)
        if control is not None:
            inputs.enter_context(closing(DatagramInput(control, commands, sinks.log)))
        if outputs.terminal:
            inputs.enter_context(closing(KeyInput(commands, sinks.log)))
        streams = [
            estimate_stream(estimator, source, processing, part.log, part, queue, known)
            for (estimator, _, part), source, known, queue in zip(runs, readings, poses, queues, strict=True)
        ]
        updates = merged(streams, lambda: commands.put("stop"))
        source_ended = _print(updates, list(estimators), sinks.log, as_json, outputs.terminal)
        sinks.on_end()
        if outputs.page is not None and source_ended and _is_terminal():
            sinks.log("the run ended; the page stays open until Ctrl-C")
            with suppress(KeyboardInterrupt):
                Event().wait()


def _setting_text(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return "" if value is None else f"{value:g}" if isinstance(value, float) else str(value)


def _print(
    updates: "Generator[tuple[int, EstimateUpdate], None, None]",
    names: list[str],
    log: "Callable[[str], None]",
    as_json: bool,
    live_table: bool,
) -> bool:
    """Print one line per estimate and, after the end or Ctrl-C, the number of estimates per result code.

    Returns:
        Whether the estimates ended without an interruption.
    """
    from probedesign.live.processing.estimates import json_line, readable_line, update_row
    from probedesign.live.run import count_results, describe_counts

    results: dict[str, list[str]] = {name: [] for name in names}
    width = max(map(len, names))
    complete = False
    try:
        with closing(updates):
            for number, update in updates:
                name = names[number]
                results[name].append(update.estimate.result)
                if as_json:
                    of: dict[str, float | str] = {"probe": name} if name else {}
                    print(json_line(of | update_row(update)), flush=True)
                elif not live_table:
                    of_probe = f"{name:<{width}}  " if name else ""
                    print(of_probe + readable_line(update), flush=True)
        complete = True
    except KeyboardInterrupt:
        pass
    for name in names:
        log((f"{name}: " if name else "") + describe_counts(count_results(results[name])))
    return complete


def _is_terminal() -> bool:
    return sys.stdout.isatty() and os.environ.get("TERM") != "dumb"
