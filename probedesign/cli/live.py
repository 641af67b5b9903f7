"""`probedesign live`: contacts as the sensor reads them."""

from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from probedesign.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable, Generator

    from probedesign.live.answer import Answer


def live(
    bundle: Path,
    /,
    *,
    source: str,
    record: Path | None = None,
    force: bool = False,
    tare_s: str | None = None,
    average: int = 1,
    rate_hz: float = 20.0,
    count: int | None = None,
    seconds: float | None = None,
    publish: str | None = None,
    view: bool = False,
    view_host: str = "127.0.0.1",
    view_port: int = 8080,
    manifest: Path | None = None,
    exact_model: bool = False,
    as_json: Annotated[bool, Parameter(name="--json")] = False,
) -> None:
    """Locate contacts as the sensor reads them, one line an estimate.

    Ends with the source, at --count or --seconds, or with Ctrl-C, and then says how many estimates had which
    result. What sources take, as in "sim:?force_mN=50&seconds=60" or "replay:FILE?speed=max", and what a
    tare is: docs/live.md.

    Args:
        bundle: the frozen probe, NAME.probe.json.
        source: netft://HOST (a Net F/T box), replay:FILE (a recording) or sim: (a simulated contact that moves
            along the probe).
        record: write every reading to this recording.
        force: replace the file that --record names.
        tare_s: START:END in seconds from the first reading: the probe is free then, take the bias there.
        average: estimate from the mean of so many readings.
        rate_hz: at most so many estimates a second; readings between are left out.
        count: end after so many estimates.
        seconds: end so many seconds after the first reading.
        publish: udp://HOST:PORT, which each estimate is sent to as a JSON datagram.
        view: show the probe, the contact and charts on a page in the browser.
        view_host: address that the page listens on; 0.0.0.0 opens it to the network.
        view_port: its port, or the next free one.
        manifest: manifest.json of the printed parts, to check that the probe is theirs.
        exact_model: take the probe for exactly what BUNDLE says, so that ellipsoids hold the sensor's noise alone;
            else they hold the tolerances of material, print and mount too.
        as_json: print each estimate as one line of JSON.
    """
    from probedesign.deployment import load_estimator
    from probedesign.live.publish import Publisher
    from probedesign.live.recorder import Recorder
    from probedesign.live.requests import Requests
    from probedesign.live.run import Plan, estimate_stream
    from probedesign.live.sinks import RawRecording, Sinks, Spoken
    from probedesign.live.source import open_source
    from probedesign.live.tare import parse_window
    from probedesign.live.view.view import View
    from probedesign.live.warm_up import warm_up

    replayed = Path(source.partition("?")[0].removeprefix("replay:"))
    if record is not None and record.exists() and replayed.exists() and record.samefile(replayed):
        raise InputError(f"--record {record} is the recording that is replayed; name another file")
    window = parse_window(tare_s) if tare_s is not None else None
    plan = Plan(window, average, rate_hz, count, seconds)
    estimator = load_estimator(bundle, manifest)
    estimator = estimator if exact_model else estimator.with_tolerances()
    if record is not None and record.exists() and not force:
        raise InputError(f"{record}: exists already; --force replaces it, or name another file")
    requests = Requests()
    with closing(Sinks(Spoken())) as sinks:
        opened = open_source(source, estimator.model, sinks.say)
        warm_up(estimator, sinks.say, fusing=True)
        sinks.say(f"{opened.title}; probe {estimator.model.name} {estimator.model.fingerprint}")
        for note in opened.notes:
            sinks.say(note)
        if record is not None:
            sinks.add(RawRecording(Recorder(record, force=force)))
        if publish is not None:
            sinks.add(Publisher(publish, sinks.say))
        if view:
            counts = getattr(opened, "counts", {})
            sinks.add(View(estimator, bundle.parent, requests, sinks.say, view_host, view_port, counts))
        _print(estimate_stream(estimator, opened, plan, sinks.say, sinks, requests), sinks.say, as_json)


def _print(answers: "Generator[Answer, None, None]", say: "Callable[[str], None]", as_json: bool) -> None:
    """A line for each estimate; at the end, Ctrl-C included, a summary."""
    from probedesign.live.row import json_line, readable_line, row
    from probedesign.live.run import count_results, describe_counts

    results: list[str] = []
    start: float | None = None
    try:
        with closing(answers):
            for answer in answers:
                reading, estimate = answer.reading, answer.estimate
                start = reading.time if start is None else start
                results.append(estimate.result)
                if as_json:
                    print(json_line(row(reading, estimate)), flush=True)
                else:
                    print(readable_line(reading.time - start, reading, estimate), flush=True)
    except KeyboardInterrupt:
        pass
    say(describe_counts(count_results(results)))
