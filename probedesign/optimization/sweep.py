"""Parameter sweep: a grid of designs, computed by processes of this machine or by dask workers, recorded one by one."""

import itertools
import math
from collections.abc import Iterator
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, nullcontext
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from probedesign.core import csv_tables
from probedesign.core.errors import InputError, MissingDependencyError, unknown_name
from probedesign.core.files import write_atomically
from probedesign.core.parallel import Journal, OnProgress, Record, fingerprint, process_map
from probedesign.core.statistics import UNIFORM_STD
from probedesign.design import Design, check_design
from probedesign.design.diagnostics import known_keys
from probedesign.design.edit import tables_of, with_values
from probedesign.optimization.objective import METRICS, Task, design_metrics

if TYPE_CHECKING:
    from distributed import Client


MAX_POINTS = 1_000_000
_HOW = "write KEY=START:STOP:STEP or KEY=A,B,C"


GridAxis = tuple[str, tuple[Any, ...]]  #: A key `table.key` that varies, and the values that it takes.


def parse_axis(text: str) -> GridAxis:
    """Parse `probe.tip_d_mm=1.5:4:0.25` or `sensor.calibration=si-12-0.12,si-25-0.25`; the end of a range is included.

    Raises:
        InputError: the key is unknown, or the range is invalid.
    """
    key, equals, values = (part.strip() for part in text.partition("="))
    if not equals or not values:
        raise InputError(f"--vary {text!r}: {_HOW}")
    keys = known_keys(Design)
    known = [name for name in keys if "." in name and not any(k.startswith(f"{name}.") for k in keys)]
    if key not in known:
        table = [name for name in known if name.partition(".")[0] == key.partition(".")[0]]
        raise unknown_name("--vary", key, table or known)
    if ":" in values:
        return key, _range(key, values)
    listed = tuple(_value(part.strip()) for part in values.split(","))
    if any(value == "" for value in listed):
        raise InputError(f"--vary {text!r}: an empty value; {_HOW}")
    return key, listed


def grid_points(axes: list[GridAxis]) -> list[dict[str, Any]]:
    """Return every combination of the axes' values, the last axis fastest.

    Raises:
        InputError: there is no axis, a key is given twice, or there are too many points.
    """
    keys = [key for key, _ in axes]
    twice = next((key for key in keys if keys.count(key) > 1), None)
    if not axes:
        raise InputError(f"nothing to vary; {_HOW}: --vary probe.tip_d_mm=1.5:4:0.25")
    if twice:
        raise InputError(f"--vary {twice}: given twice; put all its values into one")
    size = math.prod(len(values) for _, values in axes)
    if size > MAX_POINTS:
        raise InputError(f"{size} designs are too many; the maximum is {MAX_POINTS}: use coarser steps")
    return [dict(zip(keys, values, strict=True)) for values in itertools.product(*(values for _, values in axes))]


def _range(key: str, text: str) -> tuple[float | int, ...]:
    """Return the numbers of START:STOP:STEP, the end included; integers stay integers."""
    parts = [_value(part.strip()) for part in text.split(":")]
    if len(parts) != 3 or not all(isinstance(part, int | float) for part in parts):
        raise InputError(f"--vary {key}: {text!r} is not START:STOP:STEP in numbers")
    start, stop, step = parts
    if step == 0 or (stop - start) * step < 0:
        raise InputError(f"--vary {key}: the step of {text!r} has the wrong sign, or is zero")
    steps = (stop - start) / step
    if steps > MAX_POINTS:
        raise InputError(f"--vary {key}: {text!r} has more than {MAX_POINTS} values; use a coarser step")
    whole = all(isinstance(part, int) for part in parts)
    return tuple(start + i * step if whole else float(f"{start + i * step:.12g}")
                 for i in range(math.floor(steps + 1e-9) + 1))  # fmt: skip


def _value(text: str) -> Any:
    """Return the text as TOML would read it: a number, a boolean or a name."""
    for kind in (int, float):
        try:
            number = kind(text)
        except ValueError:
            continue
        return number if math.isfinite(number) else text
    return {"true": True, "false": False}.get(text, text)


PROGRESS = "sweep.jsonl"
SCHEDULER_TIMEOUT_S = 10.0
_Chunk = list[tuple[int, dict[str, Any]]]  #: Number and varied keys of some designs.
_CHUNK = 8  #: Designs that a worker takes at a time: half a second of work, so little is lost on interruption.


@dataclass(frozen=True)
class SweepResult:
    """Result of a sweep."""

    records: list[Record]  #: one per point, in the grid's order: point, the keys varied, result, reason, metrics.
    computed: int  #: number of points computed by this run.
    files: list[Path]  #: written.
    notes: list[str]  #: repairs of the journal.

    @property
    def failed(self) -> list[Record]:
        """Return the points without the result "ok"."""
        return [record for record in self.records if record["result"] != "ok"]


def sweep(
    design: Design, axes: list[GridAxis], task: Task, folder: Path, scheduler: str | None, workers: int,
    on_progress: OnProgress,
) -> SweepResult:  # fmt: skip
    """Compute the points that the folder does not contain yet, then write sweep.csv.

    Args:
        design: source of the keys that do not vary.
        axes: the keys that vary.
        task: by which the designs are judged.
        folder: for sweep.jsonl, with which a later run resumes, and sweep.csv.
        scheduler: address of a dask scheduler; None for processes of this machine.
        workers: their number.
        on_progress: receives the current step and the completed fraction.

    Raises:
        InputError: the grid is invalid, the scheduler does not respond, a process was ended from outside, or the folder
            contains another sweep.
        MissingDependencyError: there is a scheduler, and dask is not installed.
    """
    grid, base = grid_points(axes), tables_of(design)
    plain_task = asdict(task) | {
        name: list(getattr(task, name)) for name in ("forces_N", "fractions", "directions_deg")
    }
    plain_task["gravities"] = [list(gravity) for gravity in task.gravities]
    request = {"schema": 1, "name": design.name, "design": fingerprint(base), "task": plain_task,
             "vary": {key: list(values) for key, values in axes}}  # fmt: skip
    journal = Journal.open(folder / PROGRESS, request)
    missing = [i for i in range(len(grid)) if i not in journal.results]
    if missing:
        points = [(i, grid[i]) for i in missing]
        chunks = [points[start : start + _CHUNK] for start in range(0, len(points), _CHUNK)]
        reached = nullcontext() if scheduler is None else _client(scheduler, on_progress)
        with reached as client, journal.appending() as appender:
            if client is None:
                computed = _computed_here(base, task, chunks, workers, on_progress)
            else:
                computed = _computed_by_dask(client, base, task, chunks)
            for done, record in enumerate(computed, 1):
                appender.add(record)
                on_progress(f"sweep: {len(journal.results)} of {len(grid)} designs", done / len(missing))
    records = [journal.results[i] for i in range(len(grid))]
    columns = ["point", *(key for key, _ in axes), "result", "reason", *METRICS]
    write_atomically(folder / "sweep.csv", csv_tables.write(columns, records))
    return SweepResult(records, len(missing), [folder / "sweep.csv", folder / PROGRESS], journal.notes)


def evaluate_point(base: dict[str, Any], number: int, point: dict[str, Any], task: Task) -> Record:
    """Return the record of one design; an invalid or unstable one gives the reason and does not stop the sweep."""
    result, reason = "ok", ""
    try:
        metrics = design_metrics(check_design(with_values(base, point)), task)
    except InputError as error:
        return _without_metrics(number, point, "refused", str(error))
    except Exception as error:  # the failure of one design must not end the sweep
        return _without_metrics(number, point, "failed", f"{type(error).__name__}: {error}")
    if metrics.error_mm is None:
        result, reason = "gives_way", "the probe buckles under the force at one position or more"
    elif metrics.worst_error_mm is None or metrics.worst_error_mm >= metrics.length_mm * UNIFORM_STD:
        result = "unobservable"  # not less than the error of a uniform prior along the probe, L/√12
        reason = f"the largest error, {metrics.worst_error_mm:.3g} mm, is not smaller than without a reading"
    elif metrics.sensor_use is not None and metrics.sensor_use > 1.0:
        result, reason = "out_of_range", f"the readings take {metrics.sensor_use:.3g} times the sensor's range"
    return {"point": number, **point, "result": result, "reason": reason, **metrics.as_dict()}


def _without_metrics(number: int, point: dict[str, Any], result: str, reason: str) -> Record:
    return {"point": number, **point, "result": result, "reason": reason, **dict.fromkeys(METRICS)}


def _evaluate_chunk(base: dict[str, Any], task: Task, chunk: _Chunk) -> list[Record]:
    return [evaluate_point(base, number, point, task) for number, point in chunk]


def _computed_here(
    base: dict[str, Any], task: Task, chunks: list[_Chunk], workers: int, on_progress: OnProgress
) -> Iterator[Record]:
    count = min(workers, len(chunks))
    on_progress(f"starting {count} workers", None)
    evaluate = partial(_evaluate_chunk, base, task)
    try:
        for _, records in process_map(evaluate, chunks, count, preload=("probedesign.optimization.sweep",)):
            yield from records
    except BrokenProcessPool:
        raise InputError(
            f"a worker of --workers {count} was ended, perhaps for lack of memory; all results are kept. Run the same "
            "command again with fewer workers to resume"
        ) from None


def _computed_by_dask(client: "Client", base: dict[str, Any], task: Task, chunks: list[_Chunk]) -> Iterator[Record]:
    from distributed import as_completed

    futures = [client.submit(_evaluate_chunk, base, task, chunk, pure=False) for chunk in chunks]
    by_key = {future.key: chunk for future, chunk in zip(futures, chunks, strict=True)}
    for future in as_completed(futures):
        error = future.exception() if future.status == "error" else None
        if future.status == "finished":
            yield from future.result()
        else:  # the worker process died repeatedly
            for number, point in by_key[future.key]:
                yield _without_metrics(number, point, "failed", f"worker lost: {error or future.status}")
        future.release()


@contextmanager
def _client(scheduler: str, on_progress: OnProgress) -> Iterator["Client"]:
    try:
        import dask
        from distributed import Client
    except ModuleNotFoundError as error:
        raise MissingDependencyError.of_extra("sweep", str(error.name), "sweep") from None
    with dask.config.set({"distributed.comm.timeouts.connect": SCHEDULER_TIMEOUT_S}):
        on_progress(f"reaching {scheduler}", None)
        how = "start one with: dask scheduler, or omit --scheduler"
        try:
            client = Client(scheduler, timeout=SCHEDULER_TIMEOUT_S)
        except OSError:
            reason = f"does not respond within {SCHEDULER_TIMEOUT_S:g} s"
            raise InputError(f"--scheduler {scheduler}: {reason}; {how}") from None
        except (ValueError, TypeError) as error:
            raise InputError(f"--scheduler {scheduler}: {error}; {how}") from None
        with client:
            try:
                client.wait_for_workers(1, timeout=SCHEDULER_TIMEOUT_S)  # without them a sweep would wait forever
            except TimeoutError:
                how = f"start some with: dask worker {scheduler}"
                raise InputError(f"--scheduler {scheduler}: has no workers; {how}") from None
            yield client
