"""`probedesign recover`: an MCAP recording that was cut off, made whole."""

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
    """Save what is whole of an MCAP recording that was cut off.

    A recorder that was killed, or whose disk was full, leaves a file that replay and estimate read up to its end
    but other tools refuse. What can be read goes into a new file that all of them open; the old one is left as
    it is. See docs/recording-format.md.

    Args:
        recording: the MCAP file.
        out: the new file; NAME-recovered.mcap if not said.
        force: replace the file that --out names.
        as_json: print one JSON document.
    """
    from probedesign.live.recordings import require

    require()
    from probedesign.live.recordings.mcap_read import recover as save

    saved = save(recording, out or recording.with_name(f"{recording.stem}-recovered.mcap"), force)
    if as_json:
        print_json(saved)
    elif saved.path is None:
        print(
            f"{recording} is whole: {saved.messages} messages over {saved.seconds:.3f} s; nothing to recover"
        )
    else:
        print(
            f"wrote {saved.path}: {saved.messages} messages over {saved.seconds:.3f} s; there {saved.damage}"
        )
