"""`probedesign compare`: compare several designs."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from probedesign.cli.console import print_json, show_progress
from probedesign.cli.options import EXPORTS, TaskOptions
from probedesign.core.files import write_atomically


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
    from probedesign.design import load_design
    from probedesign.reports.comparison_page import compare as side_by_side
    from probedesign.reports.comparison_page import comparison_page, comparison_table
    from probedesign.reports.html_page import check_page_target

    task, file = (options or TaskOptions()).task(), None
    with show_progress("comparing designs"):
        if page and out is not None:
            check_page_target(out)
        compared = side_by_side([load_design(path) for path in designs], task)
        if page:
            file = out or EXPORTS / f"compare-{'-'.join(one.design.name for one in compared)}.html"
            write_atomically(file, comparison_page(compared, task))
    if as_json:
        document = [{"name": one.design.name, **one.metrics.as_dict()} for one in compared]
        print_json({"task": task, "designs": document, "page": file})
        return
    table = comparison_table(compared)
    print(task.text)
    for row in (table.head, *table.rows):
        print(f"  {row[0]:<16}" + "".join(f"{cell:>18}" for cell in row[1:]))
    print(f"wrote {file}" if file else "no page was written")
