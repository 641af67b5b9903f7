"""`probedesign sweep`: a grid of designs."""

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from probedesign.cli.console import counted, print_json, telling
from probedesign.cli.task import TaskOptions
from probedesign.errors import InputError

if TYPE_CHECKING:
    from probedesign.search.sweep import Swept


def sweep(
    design: Path,
    /,
    *,
    vary: Annotated[list[str], Parameter(negative=(), consume_multiple=False)],
    out: Path | None = None,
    scheduler: str | None = None,
    workers: int | None = None,
    options: TaskOptions | None = None,
    as_json: Annotated[bool, Parameter(name="--json")] = False,
) -> None:
    """Compute every combination of some keys of a design; the same command goes on where it stopped.

    Writes sweep.jsonl as results come, then sweep.csv and sweep.parquet. A design that cannot be is a row with its
    reason. Needs the extra 'sweep'. More: docs/search.md.

    Args:
        design: the design file that the other keys come from.
        vary: KEY=START:STOP:STEP or KEY=A,B,C with a key of the design file; again for more keys.
        out: folder for the results; by default exports/NAME/sweep.
        scheduler: address of a dask scheduler, tcp://HOST:PORT; by default workers of this machine.
        workers: processes of this machine; by default one a processor.
        options: what the designs are judged by.
        as_json: print one JSON document.
    """
    from probedesign.search.workers import prepare

    if workers is not None and not 1 <= workers <= 1024:
        raise InputError(f"--workers {workers} must lie in 1 ... 1024")
    if scheduler is None:
        prepare()  # before all that takes its time to import

    from probedesign import pipeline
    from probedesign.search.grid import parse_axis

    axes, task = [parse_axis(text) for text in vary], (options or TaskOptions()).task()
    try:
        with telling() as tell:
            swept = pipeline.sweep(design, axes, task, out, scheduler, workers or os.cpu_count() or 1, tell)
    except KeyboardInterrupt:
        raise KeyboardInterrupt("interrupted; nothing is lost: the same command goes on from here") from None
    for note in swept.notes:
        print(f"note: {note}", file=sys.stderr)
    if as_json:
        print_json({"task": task, "computed": swept.computed, "files": swept.files, "points": swept.records})
    else:
        _print(swept, [axis.key for axis in axes], task.text)


def _print(swept: "Swept", keys: list[str], task: str) -> None:
    done, failed = len(swept.records), swept.failed
    print(f"{counted(done, 'design')}, {swept.computed} computed now; {task}")
    good = sorted((r for r in swept.records if r["result"] == "ok"), key=lambda r: r["error_mm"])
    if good:
        print("\nbest by error_mm")
        wide = {key: max(16, len(key.rpartition(".")[2]) + 2) for key in [*keys, *_SHOWN]}
        print("".join(f"{key.rpartition('.')[2]:>{width}}" for key, width in wide.items()))
        for record in good[:8]:
            print("".join(f"{_cell(record[key]):>{width}}" for key, width in wide.items()))
    for record in failed[:5]:
        print(f"  point {record['point']}: {record['result']}: {record['reason']}")
    if len(failed) > 5:
        print(f"  and {len(failed) - 5} more that are not ok; their reasons are in the tables")
    print("wrote", ", ".join(map(str, swept.files)))


_SHOWN = ("error_mm", "detectable_mN", "sag_mm", "print_errors")


def _cell(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, int | float) else str(value)
