"""`probedesign live`: locate contacts in real time."""

import os
import sys
from contextlib import ExitStack, closing, suppress
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from probedesign.cli.console import interrupt_on_termination
from probedesign.cli.options import FrozenProbe, JsonOutput, Method, Tare

if TYPE_CHECKING:
    from collections.abc import Callable, Generator

    from probedesign.estimation.estimator import Estimator
    from probedesign.live.outputs.options import OutputOptions
    from probedesign.live.processing.chain import ProcessingOptions
    from probedesign.live.processing.estimates import EstimateUpdate


def live(
    bundle: FrozenProbe,
    /,
    *,
    source: str,
    record: Path | None = None,
    split_mb: float | None = None,
    split_minutes: float | None = None,
    force: bool = False,
    tare_s: str | None = None,
    tare: Tare | None = None,
    average: int | None = None,
    filter_hz: float | None = None,
    pose: str = "fixed",
    pose_latency_ms: float = 0.0,
    gravity_world: str | None = None,
    rate_hz: float = 20.0,
    count: int | None = None,
    seconds: float | None = None,
    publish: str | None = None,
    foxglove: str | bool = False,
    control: str | None = None,
    view: bool = False,
    view_host: str = "127.0.0.1",
    view_port: int = 8080,
    open_: Annotated[bool, Parameter(name="--open", negative="--no-open")] = True,
    manifest: Path | None = None,
    exact_model: bool = False,
    method: Method = "ml",
    friction: float | None = None,
    lines: bool = False,
    as_json: JsonOutput = False,
) -> None:
    """Locate contacts in real time: a live table on a terminal, otherwise one line per estimate.

    Ends with the source, at --count or --seconds, or with Ctrl-C, and prints the number of estimates per result code.
    Options of the sources, such as "sim:?force_mN=50&seconds=60" or "replay:FILE?speed=max", and the tare:
    docs/live.md.

    Args:
        bundle: the frozen probe: NAME.probe.json, its folder, or NAME of exports/NAME.
        source: netft://HOST (a Net F/T box or an Axia), "daq://Dev1/ai0:5?cal=FILE" (a sensor at a DAQ card),
            replay:FILE (a recording), udp://:PORT (wrenches in JSON or MessagePack), ros2://TOPIC, or sim: (a simulated
            contact that moves along the probe).
        record: record everything to NAME.mcap, or raw readings to NAME.csv.
        split_mb: continue the recording in NAME-2, NAME-3, ... after this many megabytes.
        split_minutes: the same after this many minutes.
        force: replace an existing recording.
        tare_s: START:END of the tare in seconds after the first reading. The probe must be free then.
        tare: without --tare-s: auto takes the first second at rest, when the probe must be free; none trusts the
            sensor's own zero, taken without the probe. Default: that zero only if readings agree with the free probe.
        average: number of readings per mean; each mean is one estimate. Default: by rate and noise of the first
            readings, so that a mean has the noise that BUNDLE states.
        filter_hz: cutoff frequency (-3 dB) of a low-pass filter before the estimates [Hz]; its delay is printed.
        pose: poses of the base: fixed, FILE.csv or .jsonl, a ROS 2 bag (BAG?topic=/pose or BAG?world=map&base=probe),
            udp://:PORT, tf://WORLD/BASE, ur://HOST or franka://HOST. With poses, touches are fused to points of the
            world.
        pose_latency_ms: delay of a pose relative to a reading of the same time [ms].
        gravity_world: X,Y,Z of gravity in world axes [m/s²]. Default: 0,0,-9.81.
        rate_hz: largest rate of the estimates [Hz]; readings in between are not located.
        count: end after this number of estimates.
        seconds: end this many seconds after the first reading, by the source's clock or the wall clock.
        publish: send each estimate as a JSON datagram to udp://HOST:PORT, or all messages to the node of ROS 2 at
            ros2://HOST:PORT.
        control: receive commands (tare, mark, start and stop recording, stop) as datagrams at udp://[HOST]:PORT.
        foxglove: serve the messages of a recording to Foxglove and PlotJuggler, at HOST:PORT. Default:
            127.0.0.1:8765.
        view: show the probe, the contact and charts on a page in the browser.
        view_host: address on which the page is served. 0.0.0.0 makes it accessible from the network.
        view_port: port of the page, or the next free one.
        open_: open the page in a browser, if the output is a terminal.
        manifest: manifest.json of the printed parts; its geometry must be the bundle's.
        exact_model: treat probe, mount and bench as exactly known; sensor noise, drift of its bias and the friction
            prior remain. Default: all tolerances of BUNDLE.
        method: ml (maximum a posteriori, with friction) or force_moment, the published method.
        friction: standard deviation of tangential over normal force, instead of BUNDLE's. 0: the force is normal to
            the surface; inf: any direction.
        lines: print one line per estimate on a terminal, too.
        as_json: print each estimate as one line of JSON.
    """
    from probedesign import pipeline
    from probedesign.live.datagrams import parse_listen_address
    from probedesign.live.outputs.foxglove import parse_foxglove_address
    from probedesign.live.outputs.options import OutputOptions
    from probedesign.live.outputs.recording import SplitLimits
    from probedesign.live.processing.chain import ProcessingOptions
    from probedesign.live.processing.tare import parse_tare

    window, zero = parse_tare(tare_s, tare)
    processing = ProcessingOptions(window, average, rate_hz, count, seconds, filter_hz, method=method, zero=zero)
    estimator = pipeline.load_estimator(bundle, manifest, exact_model, friction)
    settings = {
        "source": source,
        "tare_s": tare_s,
        "tare": tare,
        "average": average,
        "rate_hz": rate_hz,
        "exact_model": exact_model,
        "method": method,
        "friction": estimator.model.friction,
        "filter_hz": filter_hz,
        "pose": pose,
        "pose_latency_ms": pose_latency_ms,
        "gravity_world": gravity_world,
    }
    outputs = OutputOptions(
        record=record,
        force=force,
        publish=publish,
        page=(view_host, view_port) if view else None,
        terminal=not (lines or as_json) and _is_terminal(),
        parts_folder=bundle if bundle.is_dir() else bundle.parent,
        metadata={name: _setting_text(value) for name, value in settings.items()},
        split=SplitLimits.of_options(split_mb, split_minutes),
        foxglove=None if foxglove is False else parse_foxglove_address("" if foxglove is True else foxglove),
        open_browser=open_ and _is_terminal(),
    )
    outputs.check(source)
    if control is not None:
        parse_listen_address(f"--control {control}")  # before anything is compiled
    _run(estimator, processing, outputs, source, (pose, pose_latency_ms, gravity_world), control, as_json)


def _run(
    estimator: "Estimator",
    processing: "ProcessingOptions",
    outputs: "OutputOptions",
    source: str,
    pose: tuple[str, float, str | None],
    control: str | None,
    as_json: bool,
) -> None:
    """Open the source, poses and outputs, print the estimates until the end, and close everything.

    Args:
        estimator: estimator of the probe.
        processing: how readings are processed.
        outputs: outputs that the user selected.
        source: specification of the source.
        pose: poses of the base, their latency [ms], and gravity in world axes.
        control: address at which commands are received.
        as_json: print JSON.
    """
    from probedesign import pipeline
    from probedesign.live.outputs.sinks import SinkGroup, StderrSink
    from probedesign.live.poses.open import open_poses
    from probedesign.live.processing.commands import CommandQueue, open_inputs
    from probedesign.live.run import warm_up
    from probedesign.live.sources.source import open_source

    with closing(SinkGroup(StderrSink())) as sinks, ExitStack() as inputs, interrupt_on_termination():
        opened_source = open_source(source, estimator.model, sinks.log)
        poses = open_poses(*pose, sinks.log)
        publisher = outputs.publisher(estimator.model, sinks.log)
        warm_up(estimator, sinks.log, fusing=True)
        sinks.log(f"{opened_source.title}; probe {estimator.model.name} {estimator.model.fingerprint}")
        for note in (*opened_source.notes, *((poses.title, *poses.notes) if poses is not None else ())):
            sinks.log(note)
        commands = CommandQueue()
        outputs.connect(sinks, commands, estimator, opened_source, poses, publisher)
        for command_input in open_inputs(commands, sinks.log, control, keys=outputs.terminal):
            inputs.enter_context(closing(command_input))
        updates = pipeline.live(estimator, opened_source, processing, sinks.log, sinks, commands, poses)
        source_ended = _print(updates, sinks.log, as_json, outputs.terminal)
        sinks.on_end()
        if outputs.page is not None and source_ended and _is_terminal():
            sinks.log("the run ended; the page stays open until Ctrl-C")
            with suppress(KeyboardInterrupt):
                Event().wait()


def _setting_text(value: object) -> str:
    """Return the value of an option as a recording states it; empty if it is not given."""
    if isinstance(value, bool):
        return str(value).lower()
    return "" if value is None else f"{value:g}" if isinstance(value, float) else str(value)


def _print(
    updates: "Generator[EstimateUpdate, None, None]", log: "Callable[[str], None]", as_json: bool, live_table: bool
) -> bool:
    """Print one line per estimate and, after the end or Ctrl-C, the number of estimates per result code.

    Returns:
        Whether the estimates ended without an interruption.
    """
    from probedesign.live.processing.estimates import estimate_row, json_line, readable_line, world_row
    from probedesign.live.run import count_results, describe_counts

    results: list[str] = []
    complete = False
    try:
        with closing(updates):
            for update in updates:
                reading, estimate = update.reading, update.estimate
                results.append(estimate.result)
                if as_json:
                    world = world_row(update) if update.fused is not None else {}
                    print(json_line(estimate_row(reading, estimate) | world), flush=True)
                elif not live_table:
                    print(readable_line(reading.time, reading, estimate, update), flush=True)
        complete = True
    except KeyboardInterrupt:
        pass
    log(describe_counts(count_results(results)))
    return complete


def _is_terminal() -> bool:
    return sys.stdout.isatty() and os.environ.get("TERM") != "dumb"
