"""`probedesign compare` and `probedesign sweep`: several designs side by side, and a grid of designs."""

import os
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from probedesign.cli.console import plural, print_columns, print_json, print_note, show_progress
from probedesign.cli.options import DesignFile, JsonOutput, TaskOptions
from probedesign.core.errors import InputError
from probedesign.core.files import exports_of, write_atomically
from probedesign.core.units import format_value


def compare(
    designs: Annotated[list[DesignFile], Parameter(consume_multiple=True)],
    /,
    *,
    out: Path | None = None,
    page: Annotated[bool, Parameter(negative="--no-page")] = True,
    options: TaskOptions | None = None,
    as_json: JsonOutput = False,
) -> None:
    """Compare several designs in a table and on a page with common axes.

    Args:
        designs: two to six design files, or their names.
        out: HTML file of the page. Default: exports/compare-NAME-NAME.html.
        page: write the page.
        options: the task for which the designs are compared.
    """
    from probedesign.design import load_design
    from probedesign.optimization.objective import METRICS
    from probedesign.reports.comparison_page import (
        best_design,
        comparison_page,
        comparison_table,
        comparison_verdict,
        directions_verdict,
    )
    from probedesign.reports.comparison_page import compare as side_by_side
    from probedesign.reports.html_page import check_page_target

    loaded, file = [load_design(path) for path in designs], None
    task = (options or TaskOptions()).task(any(design.probe.axis != "straight" for design in loaded))
    with show_progress("comparing designs"):
        if page and out is not None:
            check_page_target(out)
        compared = side_by_side(loaded, task)
        if page:
            name = f"compare-{'-'.join(entry.design.name for entry in compared)}.html"
            file = out or exports_of(designs[0]) / name
            write_atomically(file, comparison_page(compared, task))
    if as_json:
        document = [
            {"name": entry.design.name, **entry.metrics.as_dict(), "fused_headline": entry.fused} for entry in compared
        ]
        best = {name: best_design(compared, name) for name in METRICS}
        print_json({"task": task, "designs": document, "best": best, "page": file})
        return
    table = comparison_table(compared)
    print(comparison_verdict(compared))
    print(task.text)
    if directions := directions_verdict(compared):
        print(directions)
    print_columns(table.head, table.rows)
    print(f"wrote {file}" if file else "no page was written")


SHOWN = ("error_mm", "detectable_mN", "sag_mm", "print_errors")


def sweep(
    design: DesignFile,
    /,
    *,
    vary: Annotated[list[str], Parameter(negative=(), consume_multiple=False)],
    out: Path | None = None,
    scheduler: str | None = None,
    workers: int | None = None,
    options: TaskOptions | None = None,
    as_json: JsonOutput = False,
) -> None:
    """Evaluate every combination of values of some keys of a design.

    Writes sweep.jsonl during the run, then sweep.csv and a page, sweep.html. The same command resumes an interrupted
    sweep. An invalid design is a row with the reason. --scheduler needs the extra 'sweep'. More: docs/choosing.md.

    Args:
        vary: KEY=START:STOP:STEP or KEY=A,B,C with a key of the design file; repeat the option for more keys.
        out: output folder. Default: exports/NAME/sweep.
        scheduler: address of a dask scheduler, tcp://HOST:PORT. Default: processes on this machine.
        workers: number of processes on this machine. Default: one per processor.
        options: the task for which the designs are evaluated.
    """
    from probedesign.core.parallel import start_forkserver

    if workers is not None and not 1 <= workers <= 1024:
        raise InputError(f"--workers {workers} must lie in 1 ... 1024")
    if scheduler is None:
        # before the slow imports, so that they overlap
        start_forkserver(("probedesign.optimization.sweep",))

    from probedesign.design import load_design
    from probedesign.optimization import sweep as grid
    from probedesign.optimization.sweep import parse_axis
    from probedesign.reports.sweep_page import sweep_page

    axes = [parse_axis(text) for text in vary]
    keys, start = [key for key, _ in axes], load_design(design)
    task = (options or TaskOptions()).task(start.probe.axis != "straight" or any("axis" in key for key in keys))
    try:
        with show_progress() as on_progress:
            folder, count = out or exports_of(design) / start.name / "sweep", workers or os.cpu_count() or 1
            swept = grid.sweep(start, axes, task, folder, scheduler, count, on_progress)
    except KeyboardInterrupt:
        raise KeyboardInterrupt("interrupted; all results are kept. Run the same command again to resume") from None
    for note in swept.notes:
        print_note(note)
    page = folder / "sweep.html"
    write_atomically(page, sweep_page(swept.records, keys, task.text))
    swept.files.append(page)
    if as_json:
        print_json({"task": task, "computed": swept.computed, "files": swept.files, "points": swept.records})
        return
    print(f"{plural(len(swept.records), 'design')}, {swept.computed} computed in this run; {task.text}")
    failed, good = swept.failed, [record for record in swept.records if record["result"] == "ok"]
    if good:
        print("\nsmallest error_mm")
        shown = [*keys, *SHOWN]
        best = sorted(good, key=lambda record: record["error_mm"])[:8]
        rows = [[format_value(record[key]) for key in shown] for record in best]
        print_columns([key.rpartition(".")[2] for key in shown], rows)
    for record in failed[:5]:
        print(f"  point {record['point']}: {record['result']}: {record['reason']}")
    if len(failed) > 5:
        print(f"  and {len(failed) - 5} more failed designs; the reasons are in the tables")
    print("wrote", ", ".join(map(str, swept.files)))
