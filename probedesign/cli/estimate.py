"""`probedesign estimate`: a recording in, one estimate a row out."""

import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from probedesign.cli.console import print_json, working
from probedesign.errors import InputError

if TYPE_CHECKING:
    from probedesign.live.processing.blocks import WrenchReading


def estimate(
    bundle: Path,
    recording: Path,
    /,
    *,
    out: Path | None = None,
    force: bool = False,
    tare_s: str | None = None,
    average: int = 1,
    mend: bool = False,
    topic: str = "",
    moment_unit: Literal["Nm", "Nmm"] = "Nm",
    other_probe: bool = False,
    manifest: Path | None = None,
    exact_model: bool = False,
    method: Literal["ml", "force_moment", "paper"] = "ml",
    friction: float | None = None,
    as_json: Annotated[bool, Parameter(name="--json")] = False,
) -> None:
    """Locate the contacts of a recording, one estimate a row.

    The rows are CSV on standard output, or in a file with --out; notes go to standard error. A row has a
    position only if its result is ok. See docs/live.md.

    Args:
        bundle: the frozen probe, NAME.probe.json.
        recording: MCAP, a ROS 2 bag, or CSV with named units; see docs/recording-format.md.
        out: the CSV to write.
        force: replace the file that --out names.
        tare_s: START:END in seconds from the first reading: the probe is free then, take the bias there.
        average: estimate from the means of so many readings.
        mend: go on with a recording that lacks something: lines, or its end.
        topic: of a bag's wrenches, if there are several.
        moment_unit: of a bag whose publisher does not keep to N·m.
        other_probe: read a recording that was made with another probe.
        manifest: manifest.json of the printed parts, to check that the probe is theirs.
        exact_model: take probe, mount and bench for exactly what BUNDLE says; the sensor's noise, the drift of its bias
            and the prior on friction remain. Otherwise all tolerances of BUNDLE count.
        method: ml (maximum a posteriori, with friction) or force_moment, the published one (also called paper).
        friction: standard deviation of tangential over normal force instead of BUNDLE's; 0: the force is normal to the
            surface; inf: its direction is free.
        as_json: print one JSON document: the rows and all that is to know of them.
    """
    from probedesign.cli.estimators import loaded_estimator
    from probedesign.files import write_atomically
    from probedesign.live.offline import estimate_recording
    from probedesign.live.processing.tare import parse_window
    from probedesign.live.run import describe_counts, warm_up
    from probedesign.live.sources.replay import RecordingOptions

    _check_free(out, recording, force)
    window = parse_window(tare_s) if tare_s is not None else None
    estimator = loaded_estimator(bundle, manifest, exact_model, friction)
    with working("loading the rod kernels"):
        warm_up(estimator, _say)
    choice = RecordingOptions(topic, moment_unit=moment_unit, other_probe=other_probe)
    estimates = estimate_recording(estimator, recording, window, average, _progress, mend, choice, method)
    for note in estimates.notes:
        _say(note)
    if out is not None:
        write_atomically(out, estimates.csv().encode())
    if as_json:
        print_json(estimates.document())
    elif out is not None:
        print(f"wrote {out}: {describe_counts(estimates.counts)}")
    else:
        sys.stdout.write(estimates.csv())


def _check_free(out: Path | None, recording: Path, force: bool) -> None:
    """Refuse to replace a file unasked, and the recording itself at all."""
    if out is None or not out.exists():
        return
    if recording.exists() and out.samefile(recording):
        raise InputError(f"{out}: is the recording itself; name another file")
    if not force:
        raise InputError(f"{out}: exists; say --force to replace it, or name another file")


def _say(note: str) -> None:
    print(f"note: {note}", file=sys.stderr)


def _progress(readings: "list[WrenchReading]") -> "Iterable[WrenchReading]":
    """The readings, with a bar on a terminal."""
    if not sys.stderr.isatty():
        return readings
    from rich.console import Console
    from rich.progress import track

    return track(readings, "estimating", console=Console(stderr=True), transient=True)
