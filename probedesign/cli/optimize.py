"""`probedesign optimize`: optimize the shape of a probe for a task."""

import math
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from probedesign.cli.console import print_columns, print_json, show_progress, write_files
from probedesign.cli.new import DEFAULT_FLANGE
from probedesign.cli.options import DesignFile, JsonOutput, TaskOptions
from probedesign.core.errors import InputError
from probedesign.core.files import check_overwrite, check_writable
from probedesign.core.units import format_value

if TYPE_CHECKING:
    from probedesign.optimization.constraints import OptimizationProblem
    from probedesign.optimization.optimum import MonteCarloCheck, Optimum

DISTINCT = 3.0  #: Standard deviations between places, as in `distinction`, below which a search is warned about.
MAX_SAG = 0.2  #: Largest sag of an advised design over its reach (assumed).
#: Further limits of an advised design: touches stay where they are, prints vary (assumed).
ADVISED = ("slide_mm<=1", "buckling_margin>=2", "print_warnings<=0")
Over = Literal["cone", "taper", "length", "section", "axis"]


def optimize(
    design: DesignFile,
    /,
    *,
    goal: Literal["error-at-force", "force-for-error"] = "error-at-force",
    error_mm: float | None = None,
    subject_to: Annotated[list[str] | None, Parameter(negative=(), consume_multiple=False)] = None,
    over: Annotated[list[Over] | None, Parameter(negative=(), consume_multiple=True)] = None,
    options: TaskOptions | None = None,
    confirm: int = 0,
    seed: int = 1,
    out: Path | None = None,
    force: bool = False,
    as_json: JsonOutput = False,
) -> None:
    """Optimize the shape of a probe for a task, and write the optimum as a design file.

    The printing rules and the sensor's range are always constraints. Further constraints: FIGURE<=NUMBER or
    FIGURE>=NUMBER, such as "sag_mm<=60"; all figures: docs/choosing.md.

    Args:
        goal: minimize the error at --force-N, or the force that reaches --error-mm.
        error_mm: error to be reached [mm], for force-for-error.
        subject_to: a constraint such as "sag_mm<=60"; repeat the option for more.
        over: variables: cone (base and tip diameter), taper (a free profile), length, section, axis (bend, turns and
            azimuth of a helix). Default: cone.
        options: the task.
        confirm: check the result by a Monte Carlo simulation with this number of samples per case, with all error
            sources and friction.
        seed: seed of the Monte Carlo simulation.
        out: output design file. Default: designs/NAME-best.toml.
        force: replace an existing output file.
    """
    from probedesign.design import load_design
    from probedesign.optimization.constraints import OptimizationProblem, parse_limit

    if not 0 <= confirm <= 100_000:
        raise InputError(f"--confirm {confirm} must lie in 0 ... 100000")
    limits = [parse_limit(text) for text in subject_to or []]
    start = load_design(design)
    free: tuple[Over, ...] = tuple(over or ["cone"])
    task = (options or TaskOptions()).task("axis" in free or start.probe.axis != "straight")
    search = OptimizationProblem(start, free, task, goal, error_mm, tuple(limits))
    out = out or Path("designs") / f"{start.name}-best.toml"
    _run(search, out, force, as_json, draws=confirm, seed=seed)


def advise(
    name: str | None = None,
    /,
    *,
    force_mN: Annotated[float, Parameter(name="--force-mN")],
    reach_mm: float,
    stiffness_N_m: Annotated[float | None, Parameter(name="--stiffness-N-m")] = None,
    tip_mm: float | None = None,
    points: Literal["down", "up", "sideways"] = "sideways",
    resin: str = "elastic-50a",
    sensor: str = "nano17",
    printer: str = "form-3",
    force: bool = False,
    as_json: JsonOutput = False,
) -> None:
    """Find a design for an object, by a search over diameters and length, and write designs/NAME.toml.

    The largest error of five touches of one point, fused as the base presses on, at 0.4 to 0.9 of the length becomes as
    small as the limits allow: print without warnings, tip of 2 mm or more, sag of a fifth of the reach, slide along the
    probe of 1 mm, twice the force before it buckles.

    Args:
        name: name of the design. Default: composed of force and reach, such as advised-5mN-120mm.
        force_mN: largest force that the object bears [mN].
        reach_mm: smallest distance from the base to the tip of the probe as it hangs [mm].
        stiffness_N_m: stiffness of the object [N/m], such as 20 for a card. Default: unknown, softer than that of hard
            things.
        tip_mm: largest diameter at the tip [mm], such as the width of a gap.
        points: where the probe points as mounted.
        resin: a known resin.
        sensor: a known sensor, or one of its calibrations.
        printer: a known printer.
        force: replace existing files.
    """
    from probedesign.design.io import MIN_TIP_D_MM, TIP_RATIO, known_sensor, new
    from probedesign.mount.flange_adapter import fitting_flanges
    from probedesign.optimization.constraints import OptimizationProblem, parse_limit
    from probedesign.optimization.design_space import LENGTH_MM

    for option, value in (("--force-mN", force_mN), ("--reach-mm", reach_mm), ("--stiffness-N-m", stiffness_N_m)):
        if value is not None and not 0.0 < value < math.inf:
            raise InputError(f"{option} {value:g} must be positive")
    if tip_mm is not None and not tip_mm >= MIN_TIP_D_MM:
        raise InputError(f"--tip-mm {tip_mm:g} is below the {MIN_TIP_D_MM:g} mm that a soft tip needs to be printed")
    # The start bends under the force by the same fraction of its length as the paper's large probe under 5 mN.
    base = 12.0 * (force_mN / 5.0 * (reach_mm / 150.0) ** 2) ** 0.25
    start = new(
        name or f"advised-{force_mN:g}mN-{reach_mm:g}mm",
        shape="cone",
        length_mm=min(round(1.02 * reach_mm, 1), LENGTH_MM[1]),
        base_d_mm=round(base, 1),
        tip_d_mm=round(min(max(base / TIP_RATIO, MIN_TIP_D_MM), tip_mm or math.inf), 1),
        resin=resin,
        sensor=sensor,
        robot_flange=next(iter(fitting_flanges(known_sensor(sensor))), DEFAULT_FLANGE),
        points=points,
        printer=printer,
    )
    if stiffness_N_m is not None:
        contact = start.contact.model_copy(update={"object_compliance_m_N": 1.0 / stiffness_N_m})
        start = start.model_copy(update={"contact": contact})
    limits = [f"reach_mm>={reach_mm}", f"sag_mm<={MAX_SAG * reach_mm}", f"thinnest_mm>={MIN_TIP_D_MM}", *ADVISED]
    limits += [] if tip_mm is None else [f"thinnest_mm<={tip_mm}"]
    task = TaskOptions(force_N=[force_mN / 1e3], combine="worst").task()
    limited = tuple(map(parse_limit, limits))
    search = OptimizationProblem(start, ("cone", "length"), task, "error-at-force", None, limited)
    _run(search, Path("designs") / f"{start.name}.toml", force, as_json, advised=force_mN)


def _run(
    search: "OptimizationProblem", path: Path, force: bool, as_json: bool, *, draws: int = 0, seed: int = 1,
    advised: float | None = None,
) -> None:  # fmt: skip
    """Write the optimum to `path` with a comparison, checked by a Monte Carlo simulation of some draws per case."""
    from probedesign.design.edit import tables_of
    from probedesign.design.io import write_design
    from probedesign.optimization.optimum import MonteCarloCheck, confirm, design_text, optimum
    from probedesign.probe import build_probe
    from probedesign.reports.comparison_page import compare, comparison_page
    from probedesign.web.home import refresh_home

    check_overwrite(path, force)
    check_writable(path)  # before the search, which takes a minute
    with show_progress() as on_progress:
        best = optimum(search, path.stem, on_progress)
        write_design(design_text(search, best), path, force)  # first: the steps below may be interrupted or fail
        refresh_home(build_probe(best.design).model, path)
        confirmed = dict[str, MonteCarloCheck | None]()
        try:
            if draws:
                stable = best.before.error_mm is not None  # a start may buckle
                confirmed["start"] = confirm(search.start, best.task, draws, seed, on_progress) if stable else None
                confirmed["best"] = confirm(best.design, best.task, draws, seed, on_progress)
        except InputError as error:
            raise InputError(f"{path} is written, but {error}") from None
        page = comparison_page(compare([search.start, best.design], best.task), best.task)
        files = [path, *write_files(path.parent, [(f"{path.stem}-compared.html", page)])]
    if as_json:
        print_json({
            "schema": 1,
            "goal": search.goal,
            "task": asdict(best.task),
            "subject_to": [limit.text for limit in search.limits],
            "start": best.before.as_dict(),
            "best": best.after.as_dict(),
            "design": tables_of(best.design),
            "binding": list(best.active_constraints),
            "bodies_looked_at": best.n_evaluations,
            "confirmed": {name: check and asdict(check) for name, check in confirmed.items()} or None,
            "files": [str(file) for file in files],
        })  # fmt: skip
        return
    if advised is not None:
        print(
            f"Five touches of up to {advised:g} mN locate a point within {best.after.error_mm:.2g} mm RMS or better; "
            f"at 0.8 of the length one reading of {best.after.detectable_mN:.2g} mN is felt. Its stiffness is not "
            "measured yet."
        )
    _print(best, confirmed)
    print("wrote", ", ".join(map(str, files)))


def _print(best: "Optimum", confirmed: "dict[str, MonteCarloCheck | None]") -> None:
    print(f"{best.design.name}: {best.task.text}")
    before, after = best.before.as_dict(), best.after.as_dict()
    rows = [[name, format_value(before[name]), format_value(after[name])] for name in after
            if name not in ("tip_offset_mm", "distinction") or before[name] or after[name]]  # fmt: skip
    print_columns(["", "start", "optimum"], rows)
    if (distinct := best.after.distinction) is not None and distinct < 0.99 * DISTINCT:  # dimensions are rounded
        print(f"  readings differ from those of other places by {distinct:.2g} standard deviations only: some touches "
              "will be ambiguous or located at a wrong place; "
              f"--subject-to 'distinction>={DISTINCT:g}' excludes that")  # fmt: skip
    for name, check in confirmed.items():
        name = "optimum" if name == "best" else name
        if check is None:
            print(f"  Monte Carlo, {name}: not run, because the probe buckles")
            continue
        print(f"  Monte Carlo, {name}: {check.rms_mm:.3g} ± {check.standard_error_mm:.1g} mm RMS, predicted "
              f"{check.bound_mm:.3g} mm; {check.located} of {check.drawn} located, {check.inside} of them "
              "inside their 95 % ellipsoid")  # fmt: skip
    print(f"  active constraints: {', '.join(best.active_constraints) or 'none'}")
    print(f"  {best.n_evaluations} designs evaluated from {len(best.starts)} starts, objective: "
          f"{', '.join('infeasible' if v is None else f'{v:.4g}' for v in best.starts)}")  # fmt: skip
