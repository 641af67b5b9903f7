"""What the buttons of the studio do beyond the page: save, export, deploy, improve."""

import math
import threading
from collections.abc import Callable
from pathlib import Path

from probedesign.core.errors import InputError, MissingDependencyError
from probedesign.design import Design, check_design
from probedesign.design.io import render_design, write_design
from probedesign.optimization.constraints import OptimizationProblem, parse_limit
from probedesign.optimization.design_space import INFEASIBLE, FreeParameter, design_dict
from probedesign.optimization.objective import Task
from probedesign.reports.chart import COLOURS, Chart, ChartAxis

FREE: dict[str, tuple[FreeParameter, ...]] = {
    "cone": ("cone",),
    "taper": ("taper",),
    "cone and length": ("cone", "length"),
}
"""What a search may change, by its name on the page."""
DESIGNS, EXPORTS = Path("designs"), Path("exports")


def checked(design: Design) -> Design:
    """Return the design, checked as its file would be.

    Raises:
        InputError: a value is wrong, such as a name that is no file name.
    """
    return check_design(design_dict(design))


def save(design: Design, replace: bool) -> str:
    """Write designs/NAME.toml and return a message."""
    path = DESIGNS / f"{design.name}.toml"
    write_design(render_design(design), path, replace)
    return f"wrote {path}"


def export(design: Design, replace: bool) -> str:
    """Write the parts to print and return a message."""
    from probedesign import pipeline

    try:
        manifest = pipeline.export(design, None, lambda _: None)
    except MissingDependencyError as error:
        raise InputError(str(error)) from None
    return f"wrote {manifest['folder']}: {len(manifest['files']) + 1} files; open assembly.html"


def deploy(design: Design, replace: bool) -> str:
    """Write the frozen probe and return a message."""
    from probedesign.frozen_probe import check_manifest, check_replaceable, write_frozen
    from probedesign.probe import build_probe

    path = EXPORTS / design.name / f"{design.name}.probe.json"
    check_replaceable(path)
    model = build_probe(design).model
    manifest = path.parent / "manifest.json"
    if manifest.exists():
        check_manifest(model.fingerprint, manifest)
    write_frozen(model, path)
    return f"wrote {path}"


Action = Callable[[Design, bool], str]
ACTIONS: dict[str, Action] = {
    "Save the design": save,
    "Export the parts": export,
    "Deploy the estimator": deploy,
}
"""Label of a button and what it does."""


class Improvement:
    """A search for a better design from a start, in a thread of its own.

    Attributes:
        design: the result; None while it runs, and if nothing satisfies the limits.
        text: state of the search in one line.
    """

    def __init__(
        self, start: Design, free: tuple[FreeParameter, ...], force_N: float, touches: int, max_sag_mm: float,
        on_change: Callable[[], None],
    ) -> None:  # fmt: skip
        """Start the search.

        Args:
            start: the design to improve.
            free: what of it may change.
            force_N: contact force of the task.
            touches: fused touches of the task.
            max_sag_mm: largest sag of the tip.
            on_change: called when the state has changed.
        """
        self.design: Design | None = None
        self.text = "searching"
        self._on_change = on_change
        task = Task(forces_N=(force_N,), touches=touches)
        limits = (parse_limit(f"sag_mm<={max_sag_mm:g}"),)
        self._problem = OptimizationProblem(start, free, task, "error-at-force", None, limits)
        self._thread = threading.Thread(target=self._search, name="improve", daemon=True)
        self._thread.start()

    @property
    def running(self) -> bool:
        """Whether the search has not ended."""
        return self._thread.is_alive()

    def wait(self) -> None:
        """Wait until the search has ended."""
        self._thread.join()

    def _search(self) -> None:
        from probedesign.optimization.optimum import optimum

        name = f"{self._problem.start.name.removesuffix('-best')}-best"
        try:
            found = optimum(self._problem, name, self._progress)
        except InputError as error:
            self.text = str(error)
        else:
            before, after = found.before.error_mm, found.after.error_mm
            was = "not located" if before is None else f"{before:.3g} mm"
            now = "not located" if after is None else f"{after:.3g} mm"
            self.text = f"{self._problem.task.touches_text}: {was} before, {now} after"
            self.design = found.design
        self._on_change()

    def _progress(self, step: str, fraction: float | None) -> None:
        self.text = step
        self._on_change()

    def chart(self) -> Chart | None:
        """Return the errors of the evaluated designs in order; None before the second."""
        found = self._problem.problem.evaluator.errors_mm
        path = [error if error < INFEASIBLE["error_mm"] else math.nan for error in found]
        if sum(map(math.isfinite, path)) < 2:
            return None
        chart = Chart(
            ChartAxis("evaluated designs", 0.0, float(len(path))),
            ChartAxis.spanning("error of the task [mm]", path, log=True),
        )
        chart.line(range(1, len(path) + 1), path, COLOURS[1])
        return chart
