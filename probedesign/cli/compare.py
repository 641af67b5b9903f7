"""`probedesign compare`: compare several designs."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from probedesign.cli.console import print_json, show_progress
from probedesign.cli.options import TaskOptions


def compare(
    designs: Annotated[list[Path], Parameter(consume_multiple=True)],
    /,
    *,
    out: Path | None = None,
    page: Annotated[bool, Parameter(negative="--no-page")] = True,
    options: TaskOptions | None = None,
    as_json: Annotated[bool, Parameter(name="--json")] = False,
) -> None:
    """Compare several designs in a table and on a page with common axes.

    Args:
        designs: two to six design files.
        out: HTML file of the page. Default: exports/compare-NAME-NAME.html.
        page: write the page.
        options: the task for which the designs are compared.
        as_json: print one JSON document.
    """
    from probedesign import pipeline

    task = (options or TaskOptions()).task()
    with show_progress("comparing designs"):
        compared, file = pipeline.compare(designs, task, out, page)
    if as_json:
        document = [{"name": one.design.name, **one.metrics.as_dict()} for one in compared]
        print_json({"task": task, "designs": document, "page": file})
        return
    from probedesign.reports.comparison_page import comparison_table

    table = comparison_table(compared)
    print(task.text)
    for row in (table.head, *table.rows):
        print(f"  {row[0]:<16}" + "".join(f"{cell:>18}" for cell in row[1:]))
    print(f"wrote {file}" if file else "no page was written")
