"""The same words in a terminal, drawn anew a few times a second; what is told scrolls by above them."""

from typing import TYPE_CHECKING

from probedesign.live.view.keeper import Counts, Keeper
from probedesign.live.view.moment import Moment, Mood

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

A_SECOND = 8
STYLES: dict[Mood, str] = {"good": "bold green", "fair": "yellow", "bad": "bold red", "plain": ""}


class Terminal(Keeper):
    """A sink that draws what it is given at the bottom of a terminal until it is closed."""

    def __init__(self, title: str, counts: Counts = dict, console: "Console | None" = None) -> None:
        """Begin to draw.

        Args:
            title: of the table.
            counts: gives what the source counts: lost, dropped.
            console: where; standard output if None.
        """
        from rich.live import Live

        super().__init__(counts)
        self._title = title
        self._live = Live(console=console, get_renderable=self._table, refresh_per_second=A_SECOND)
        self._live.start()

    def close(self) -> None:
        """Leave the last words standing, and the cursor as it was."""
        self._live.stop()

    def _table(self) -> "Table":
        return table_of(self._title, self.moment(shaped=False))


def table_of(title: str, moment: Moment) -> "Table":
    """The words of a moment in two columns, and the touches so far."""
    from rich.table import Table
    from rich.text import Text

    table = Table(title=f"{title}, {moment.since:.1f} s", title_justify="left", show_header=False, box=None)
    for said in moment.words:
        table.add_row(Text(said.name, style="dim"), Text(said.text, style=STYLES[said.mood]))
    for place in moment.touches[-3:]:
        told = f"s {1e3 * place.s:.1f} ± {1e3 * place.std_s:.1f} mm"
        table.add_row(Text(f"touch {place.number}", style="dim"), Text(told))
    return table
