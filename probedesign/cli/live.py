"""`probedesign live`: contacts as the sensor reads them."""

import os
import sys
from contextlib import closing, suppress
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from probedesign.cli.ending import ending_well

if TYPE_CHECKING:
    from collections.abc import Callable, Generator

    from probedesign.live.processing.estimates import EstimateUpdate


def live(
    bundle: Path,
    /,
    *,
    source: str,
    record: Path | None = None,
    force: bool = False,
    tare_s: str | None = None,
    average: int = 1,
    filter_hz: float | None = None,
    pose: str = "fixed",
    pose_latency_ms: float = 0.0,
    gravity_world: str | None = None,
    rate_hz: float = 20.0,
    count: int | None = None,
    seconds: float | None = None,
    publish: str | None = None,
    view: bool = False,
    view_host: str = "127.0.0.1",
    view_port: int = 8080,
    manifest: Path | None = None,
    exact_model: bool = False,
    method: Literal["ml", "force_moment", "paper"] = "ml",
    friction: float | None = None,
    lines: bool = False,
    as_json: Annotated[bool, Parameter(name="--json")] = False,
) -> None:
    """Locate contacts as the sensor reads them: a table that is drawn anew on a terminal, else a line an estimate.

    Ends with the source, at --count or --seconds, or with Ctrl-C, and then says how many estimates had which
    result. What sources take, as in "sim:?force_mN=50&seconds=60" or "replay:FILE?speed=max", and what a
    tare is: docs/live.md.

    Args:
        bundle: the frozen probe, NAME.probe.json.
        source: netft://HOST (a Net F/T box), "daq://Dev1/ai0:5?cal=FILE" (a sensor at a DAQ card), replay:FILE (a
            recording) or sim: (a simulated contact that moves along the probe).
        record: write everything to NAME.mcap, or raw readings to NAME.csv.
        force: replace the file that --record names.
        tare_s: START:END in seconds from the first reading: the probe is free then, take the bias there.
        average: estimate from the mean of so many readings.
        filter_hz: low-pass before each estimate, down by 3 dB there; the delay is said.
        pose: of the base: fixed, FILE.csv or .jsonl, a ROS 2 bag (BAG?topic=/pose or BAG?world=map&base=probe) or
            udp://:PORT (JSON). With poses, touches are fused to points of the world.
        pose_latency_ms: by which a pose arrives later than a reading of the same moment.
        gravity_world: in the world's axes [m/s²], as 0,0,-9.81, which it is unless said.
        rate_hz: at most so many estimates a second; readings between are left out.
        count: end after so many estimates.
        seconds: end so many seconds after the first reading.
        publish: udp://HOST:PORT, which each estimate is sent to as a JSON datagram.
        view: show the probe, the contact and charts on a page in the browser.
        view_host: address that the page listens on; 0.0.0.0 opens it to the network.
        view_port: its port, or the next free one.
        manifest: manifest.json of the printed parts, to check that the probe is theirs.
        exact_model: take probe, mount and bench for exactly what BUNDLE says; the sensor's noise, the drift of its bias
            and the prior on friction remain. Otherwise all tolerances of BUNDLE count.
        method: ml (maximum a posteriori, with friction) or force_moment, the published one (also called paper).
        friction: standard deviation of tangential over normal force instead of BUNDLE's; 0: the force is normal to the
            surface; inf: its direction is free.
        lines: print a line an estimate on a terminal too.
        as_json: print each estimate as one line of JSON.
    """
    from probedesign.cli.estimators import loaded_estimator
    from probedesign.live.outputs.options import OutputOptions
    from probedesign.live.outputs.sinks import SinkGroup, StderrSink
    from probedesign.live.poses.open_poses import open_poses
    from probedesign.live.processing.scheduler import CommandQueue, ProcessingOptions
    from probedesign.live.processing.tare import parse_window
    from probedesign.live.run import estimate_stream, warm_up
    from probedesign.live.sources.source import open_source

    window = parse_window(tare_s) if tare_s is not None else None
    plan = ProcessingOptions(window, average, rate_hz, count, seconds, filter_hz, method=method)
    estimator = loaded_estimator(bundle, manifest, exact_model, friction)
    about = {"source": source, "tare_s": tare_s or "", "average": str(average), "rate_hz": f"{rate_hz:g}",
             "exact_model": str(exact_model).lower(), "method": method,
             "friction": f"{estimator.model.friction:g}", "filter_hz": "" if filter_hz is None else f"{filter_hz:g}",
             "pose": pose, "pose_latency_ms": f"{pose_latency_ms:g}", "gravity_world": gravity_world or ""}  # fmt: skip
    drawn = not (lines or as_json) and _on_terminal()
    page = (view_host, view_port) if view else None
    outlets = OutputOptions(record, force, publish, page, drawn, bundle.parent, about)
    outlets.check(source)
    with closing(SinkGroup(StderrSink())) as sinks, ending_well():
        opened = open_source(source, estimator.model, sinks.log)
        poses = open_poses(pose, pose_latency_ms, gravity_world, sinks.log)
        publisher = outlets.publisher(sinks.log)
        warm_up(estimator, sinks.log, fusing=True)
        sinks.log(f"{opened.title}; probe {estimator.model.name} {estimator.model.fingerprint}")
        for note in (*opened.notes, *((poses.title, *poses.notes) if poses is not None else ())):
            sinks.log(note)
        requests = CommandQueue()
        outlets.connect(sinks, requests, estimator, opened, poses, publisher)
        answers = estimate_stream(estimator, opened, plan, sinks.log, sinks, requests, poses)
        by_itself = _print(answers, sinks.log, as_json, drawn)
        if view and by_itself and _on_terminal():
            _stay(sinks.log)


def _print(
    answers: "Generator[EstimateUpdate, None, None]", say: "Callable[[str], None]", as_json: bool, drawn: bool
) -> bool:
    """A line for each estimate, if they are not drawn; at the end, Ctrl-C included, a summary.

    Returns:
        Whether it ended by itself.
    """
    from probedesign.live.processing.estimates import estimate_row, json_line, readable_line, world_row
    from probedesign.live.run import count_results, describe_counts

    results: list[str] = []
    start: float | None = None
    by_itself = False
    try:
        with closing(answers):
            for answer in answers:
                reading, estimate = answer.reading, answer.estimate
                start = reading.time if start is None else start
                results.append(estimate.result)
                if as_json:
                    world = world_row(answer) if answer.fused is not None else {}
                    print(json_line(estimate_row(reading, estimate) | world), flush=True)
                elif not drawn:
                    print(readable_line(reading.time - start, reading, estimate, answer), flush=True)
        by_itself = True
    except KeyboardInterrupt:
        pass
    say(describe_counts(count_results(results)))
    return by_itself


def _on_terminal() -> bool:
    """Whether a person looks who sees a table drawn anew."""
    return sys.stdout.isatty() and os.environ.get("TERM") != "dumb"


def _stay(say: "Callable[[str], None]") -> None:
    """Keep the page for who looks at it."""
    say("the run is over; the page stays until Ctrl-C")
    with suppress(KeyboardInterrupt):
        Event().wait()
