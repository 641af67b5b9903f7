"""`probedesign estimate` and `probedesign recover`: the contacts of a recording, and repair of a recording."""

import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from probedesign.cli.console import print_json, print_note, show_progress
from probedesign.cli.options import EstimatorOptions, FrozenProbe, JsonOutput, Tare
from probedesign.core.errors import InputError
from probedesign.core.files import check_overwrite, write_atomically

MAX_PRINTED = 20  #: Number of touches that are printed.

if TYPE_CHECKING:
    from probedesign.live.blocks import WrenchReading


def estimate(
    bundle: FrozenProbe,
    recording: Path,
    /,
    *,
    out: Path | None = None,
    page: Path | None = None,
    force: bool = False,
    tare_s: str | None = None,
    tare: Tare | None = None,
    average: int | None = None,
    mend: bool = False,
    topic: str = "",
    moment_unit: Literal["Nm", "Nmm"] = "Nm",
    other_probe: bool = False,
    options: EstimatorOptions | None = None,
    as_json: JsonOutput = False,
) -> None:
    """Locate the contacts of a recording, one estimate per row.

    The rows are CSV on standard output, or in the file of --out; with --out or --page a summary of the touches is
    printed instead. A row has a position only if its result is ok. See docs/live.md.

    Args:
        recording: MCAP, a ROS 2 bag, or CSV with named units; see docs/recording-format.md.
        out: output file, CSV.
        page: write a page with the touches, a replay in three dimensions and charts to this file.
        force: replace existing output files.
        tare_s: START:END of the tare in seconds after the first reading. The probe must be free then.
        tare: without --tare-s: auto takes the first second at rest, when the probe must be free; none trusts the
            sensor's own zero, taken without the probe. Default: that zero only if readings agree with the free probe.
        average: number of readings per mean; each mean is one estimate. Default: by rate and noise of the first
            readings, so that a mean has the noise that BUNDLE states.
        mend: continue with a recording that lacks lines or its end.
        topic: topic of the wrenches in a bag that has several.
        moment_unit: unit of the moments in a bag whose publisher does not use N·m.
        other_probe: accept a recording that was made with another probe.
    """
    from probedesign.live.processing.tare import parse_tare
    from probedesign.live.run import describe_counts, estimate_recording, warm_up
    from probedesign.live.sources.replay import RecordingOptions, check_readable
    from probedesign.reports.recording_page import recording_page, touches_in

    for target in (path for path in (out, page) if path is not None):
        if target.exists() and recording.exists() and target.samefile(recording):
            raise InputError(f"{target} is the recording itself; choose another output file")
        check_overwrite(target, force)
    if out is not None and out == page:
        raise InputError(f"--out and --page both name {out}; choose two files")
    check_readable(recording)
    window, zero = parse_tare(tare_s, tare)
    chosen = options or EstimatorOptions()
    estimator = chosen.load(bundle)
    with show_progress("loading the rod kernels"):
        warm_up(estimator, print_note)
    reading = RecordingOptions(topic, moment_unit=moment_unit, other_probe=other_probe)
    estimates = estimate_recording(
        estimator, recording, window, average, progress=_track, allow_incomplete=mend, options=reading,
        method=chosen.method, zero=zero,
    )  # fmt: skip
    for note in estimates.notes:
        print_note(note)
    if out is not None:
        write_atomically(out, estimates.csv().encode())
    if page is not None:
        write_atomically(page, recording_page(estimates))
    if as_json:
        print_json(estimates.document())
    elif out is page is None:
        sys.stdout.write(estimates.csv())
    else:
        print(f"wrote {', '.join(str(file) for file in (out, page) if file)}: {describe_counts(estimates.counts)}")
        touches = touches_in(estimates.rows)
        for number, touch in enumerate(touches[:MAX_PRINTED], 1):
            print(f"  touch {number}: {touch.words}")
        if len(touches) > MAX_PRINTED:
            print(f"  and {len(touches) - MAX_PRINTED} more touches")


def _track(readings: "list[WrenchReading]") -> "Iterable[WrenchReading]":
    if not sys.stderr.isatty():
        return readings
    from rich.console import Console
    from rich.progress import track

    return track(readings, "estimating", console=Console(stderr=True), transient=True)


def recover(recording: Path, /, *, out: Path | None = None, force: bool = False, as_json: JsonOutput = False) -> None:
    """Copy the intact parts of an MCAP recording that was cut off or is damaged into a new file.

    If a recorder is killed or the disk is full, the file has no end. replay and estimate read it up to there; other
    tools refuse it, but open the new file. The original is not changed. See docs/recording-format.md.

    Args:
        recording: the MCAP file.
        out: output file. Default: NAME-recovered.mcap.
        force: replace an existing output file.
    """
    from probedesign.live.recordings import require_mcap

    require_mcap()
    from probedesign.live.recordings.mcap_read import recover as write_recovered

    recovered = write_recovered(recording, out or recording.with_name(f"{recording.stem}-recovered.mcap"), force)
    if as_json:
        print_json(recovered)
        return
    extent = f"{recovered.messages} messages over {recovered.seconds:.3f} s"
    if recovered.path is None:
        print(f"{recording} is complete: {extent}; no file was written")
    else:
        print(f"wrote {recovered.path}: {extent}; damage of {recording}: {recovered.damage}")
