"""The search of `optimize` in the studio: its task and limits, its path, and what the result gains and loses."""

import math
import threading
from collections.abc import Callable
from html import escape
from typing import TYPE_CHECKING, Any

import viser

from probedesign.core.errors import InputError, report_defect
from probedesign.design import Design
from probedesign.reports.chart import COLOURS, Chart, ChartAxis
from probedesign.studio.figures import DesignFigures, styled, summary_table
from probedesign.studio.session import MOUNTINGS, PinnedDesign

if TYPE_CHECKING:  # the optimiser is loaded with the first search
    from probedesign.optimization.constraints import OptimizationProblem
    from probedesign.optimization.design_space import FreeParameter

#: What a search may change, by its name on the page.
FREE: "dict[str, tuple[FreeParameter, ...]]" = {
    "cone": ("cone",),
    "taper": ("taper",),
    "cone and length": ("cone", "length"),
}
PLACES = (0.4, 0.9)  #: First and last of `optimization.objective.FRACTIONS`.
AS_MOUNTED, ALL_MOUNTINGS = "as mounted", ", ".join(MOUNTINGS)


class Improvement:
    """A search for a better design from a start, in a thread of its own.

    Attributes:
        start: the design to improve.
        design: the result; None while it runs, and if nothing satisfies the limits.
        text: state of the search in one line.
    """

    def __init__(self, problem: "OptimizationProblem") -> None:
        """Start the search for the best design of a problem."""
        self.start = problem.start
        self.design: Design | None = None
        self.text = "searching"
        self._problem = problem
        self._thread = threading.Thread(target=self._search, name="improve", daemon=True)
        self._thread.start()

    @property
    def running(self) -> bool:
        """Whether the search has not ended."""
        return self._thread.is_alive()

    def _search(self) -> None:
        from probedesign.optimization.optimum import optimum

        name = f"{self.start.name.removesuffix('-best')}-best"
        try:
            best = optimum(self._problem, name, self._progress)
        except InputError as error:
            self.text = str(error)
        except Exception as error:  # the page shows it; nobody waits for this thread
            self.text = f"The search failed: {report_defect(error)}"
        else:
            before, after = best.before.error_mm, best.after.error_mm
            was = "not located" if before is None else f"{before:.3g} mm"
            now = "not located" if after is None else f"{after:.3g} mm"
            limited = ", ".join(best.active_constraints)
            self.text = f"{self._problem.task.text}: {was} before, {now} after" + (
                f"; limited by {limited}" if limited else ""
            )
            self.design = best.design

    def _progress(self, step: str, _: float | None) -> None:
        self.text = step

    def chart(self) -> Chart | None:
        """Return the errors of the evaluated designs in order; None before the second."""
        from probedesign.optimization.design_space import INFEASIBLE

        errors = self._problem.problem.evaluator.errors_mm
        path = [error if error < INFEASIBLE["error_mm"] else math.nan for error in errors]
        if sum(map(math.isfinite, path)) < 2:
            return None
        chart = Chart(
            ChartAxis("evaluated designs", 0.0, float(len(path))),
            ChartAxis.spanning("error of the task [mm]", path, log=True),
        )
        chart.line(range(1, len(path) + 1), path, COLOURS[1])
        return chart


class ImproveTab:
    """Controls of the search, its path and its result."""

    def __init__(self, gui: viser.GuiApi, on_start: Callable[[], None], on_accept: Callable[[Design], None],
                 on_drop: Callable[[], None]) -> None:  # fmt: skip
        """Add the controls; the callbacks are called in a thread of the page."""
        self._force: Any = gui.add_slider("force of the task [mN]", 1.0, 50.0, 0.5, 5.0)
        self._touches: Any = gui.add_slider("fused touches of the task", 1, 8, 1, 5)
        self._places: Any = gui.add_multi_slider("places, fractions of the length", 0.1, 1.0, 0.1, PLACES)
        self._mounting: Any = gui.add_dropdown("probe points", (AS_MOUNTED, ALL_MOUNTINGS))
        self._free: Any = gui.add_dropdown("what may change", tuple(FREE))
        self._sag: Any = gui.add_slider("largest tip sag [mm]", 1.0, 120.0, 1.0, 60.0)
        self._length: Any = gui.add_slider("largest length [mm]", 20.0, 250.0, 1.0, 200.0)
        self._margin: Any = gui.add_slider("largest force over the task's, at least", 1.0, 50.0, 1.0, 4.0)
        self._printable: Any = gui.add_checkbox("no warnings of the print check", True)
        start = gui.add_button("Improve from here")
        start.on_click(lambda _: on_start())
        self._path: Any = gui.add_html("")
        self._accept: Any = gui.add_button("Accept the result", visible=False)
        self._accept.on_click(lambda _: self._accepted(on_accept))
        self._drop: Any = gui.add_button("Drop the result", visible=False)
        self._drop.on_click(lambda _: on_drop())
        self.search: Improvement | None = None

    @property
    def running(self) -> bool:
        """Whether a search runs."""
        return self.search is not None and self.search.running

    def start(self, design: Design) -> None:
        """Start a search from a design; a search that runs goes on instead.

        Raises:
            InputError: the task or the limits contradict the design.
        """
        if self.running:
            return
        from probedesign.optimization.constraints import OptimizationProblem, parse_limit
        from probedesign.optimization.objective import Task

        low, high = self._places.value
        gravities = () if self._mounting.value == AS_MOUNTED else tuple(MOUNTINGS.values())
        task = Task(
            forces_N=(1e-3 * self._force.value,), touches=int(self._touches.value), gravities=gravities,
            fractions=tuple(k / 10.0 for k in range(round(10.0 * low), round(10.0 * high) + 1)),
        )  # fmt: skip
        free = FREE[self._free.value]
        limits = [f"sag_mm<={self._sag.value:g}", f"buckling_margin>={self._margin.value:g}"]
        limits += [f"length_mm<={self._length.value:g}"] if "length" in free else []
        limits += ["print_warnings<=0"] if self._printable.value else []
        problem = OptimizationProblem(design, free, task, "error-at-force", None, tuple(map(parse_limit, limits)))
        self.search = Improvement(problem)

    def drop(self) -> None:
        """Forget the search and its result."""
        self.search = None
        self._path.content, self._accept.visible, self._drop.visible = "", False, False

    def show(self, complete: Callable[[Design], DesignFigures]) -> None:
        """Show the path of the search, and its result beside its start.

        Args:
            complete: returns all figures of a design.
        """
        search = self.search
        if search is None:
            return
        chart, design = search.chart(), search.design
        content = f'<div class="note">{escape(search.text)}</div>'
        content += "" if chart is None else chart.svg().decode()
        if design is not None:
            start = PinnedDesign("start", search.start)
            content += summary_table(complete(design), [(start, complete(search.start))], "result")
        self._path.content = styled(content)
        self._accept.visible = self._drop.visible = design is not None

    def _accepted(self, on_accept: Callable[[Design], None]) -> None:
        if self.search is not None and self.search.design is not None:
            on_accept(self.search.design)
