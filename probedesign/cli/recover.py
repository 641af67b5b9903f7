"""`probedesign recover`: repair an MCAP recording that was cut off."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from probedesign.cli.console import print_json


def recover(
    recording: Path,
    /,
    *,
    out: Path | None = None,
    force: bool = False,
    as_json: Annotated[bool, Parameter(name="--json")] = False,
) -> None:
    """Copy the readable part of an MCAP recording that was cut off into a new file.

    If a recorder is killed or the disk is full, the file has no end. replay and estimate read it up to there; other
    tools refuse it, but open the new file. The original is not changed. See docs/recording-format.md.

    Args:
        recording: the MCAP file.
        out: output file. Default: NAME-recovered.mcap.
        force: replace an existing output file.
        as_json: print one JSON document.
    """
    from probedesign.live.recordings import require

    require()
    from probedesign.live.recordings.mcap_read import recover as write_recovered

    recovered = write_recovered(
        recording, out or recording.with_name(f"{recording.stem}-recovered.mcap"), force
    )
    if as_json:
        print_json(recovered)
        return
    extent = f"{recovered.messages} messages over {recovered.seconds:.3f} s"
    if recovered.path is None:
        print(f"{recording} is complete: {extent}; no file was written")
    else:
        print(f"wrote {recovered.path}: {extent}; damage of {recording}: {recovered.damage}")
