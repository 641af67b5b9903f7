"""A grid of designs, computed by workers of dask, kept as it comes."""

import csv
import io
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from probedesign.core.parallel import Journal, OnProgress, Record, fingerprint, ignore_sigint, start_method
from probedesign.design import Design, check_design
from probedesign.errors import InputError, MissingDependencyError
from probedesign.files import write_atomically
from probedesign.search.grid import Axis, points, tables_of, varied
from probedesign.search.task import Task
from probedesign.search.worth import FIGURES, worth

if TYPE_CHECKING:
    from distributed import Client

PROGRESS = "sweep.jsonl"
SCHEDULER_TIMEOUT_S = 10.0
_PIECE = 8
"""Designs a worker takes at a time: half a second of work, so little is lost and little is waited for."""


@dataclass(frozen=True)
class Swept:
    """What a sweep found.

    Attributes:
        records: one a point, in the grid's order: point, the keys varied, result, reason, figures.
        computed: how many of them this run computed.
        files: written.
        notes: what was mended.
    """

    records: list[Record]
    computed: int
    files: list[Path]
    notes: list[str]

    @property
    def failed(self) -> list[Record]:
        """Points without figures."""
        return [record for record in self.records if record["result"] != "ok"]


def sweep(
    design: Design,
    axes: list[Axis],
    task: Task,
    folder: Path,
    scheduler: str | None,
    workers: int,
    tell: OnProgress,
) -> Swept:
    """Compute what the folder does not hold yet, then write sweep.csv and sweep.parquet.

    Args:
        design: where the keys that do not vary come from.
        axes: the keys that do.
        task: that the designs are judged by.
        folder: for sweep.jsonl, which a later run goes on with, and the tables.
        scheduler: address of a dask scheduler; None for a cluster of this machine.
        workers: processes of that.
        tell: told what is at work and how much is done.

    Raises:
        InputError: the grid makes no sense, the scheduler does not answer, or the folder holds another sweep.
        MissingDependencyError: dask or pyarrow is not installed.
    """
    grid, base = points(axes), tables_of(design)
    _require_tables()
    asked = {"schema": 1, "name": design.name, "design": fingerprint(base), "task": _plain(task),
             "vary": {axis.key: list(axis.values) for axis in axes}}  # fmt: skip
    journal = Journal.open(folder / PROGRESS, asked)
    missing = [i for i in range(len(grid)) if i not in journal.results]
    if missing:
        with _client(scheduler, min(workers, -(-len(missing) // _PIECE)), tell) as client, \
                journal.appending() as appender:  # fmt: skip
            for done, record in enumerate(_computed(client, base, grid, missing, task), 1):
                appender.add(record)
                tell(f"sweep: {len(journal.results)} of {len(grid)} designs", done / len(missing))
    records = [journal.results[i] for i in range(len(grid))]
    return Swept(
        records, len(missing), _write_tables(records, [axis.key for axis in axes], folder), journal.notes
    )


def judged(base: dict[str, Any], number: int, point: dict[str, Any], task: Task) -> Record:
    """One record: a design that cannot be, or that does not stand, says why and stops nothing."""
    record: Record = {"point": number, **point, "result": "ok", "reason": ""}
    try:
        found = worth(check_design(varied(base, point)), task)
    except InputError as error:
        return record | {"result": "refused", "reason": str(error)} | dict.fromkeys(FIGURES)
    except Exception as error:  # a worker's trouble with one design must not cost the others
        reason = f"{type(error).__name__}: {error}"
        return record | {"result": "failed", "reason": reason} | dict.fromkeys(FIGURES)
    if found.error_mm is None:
        record |= {"result": "gives_way", "reason": "the probe cannot push back so hard everywhere"}
    elif not found.locates:
        reason = (
            f"at a place the error, {found.worst_error_mm:.3g} mm, is no less than with no reading at all"
        )
        record |= {"result": "unobservable", "reason": reason}
    elif found.sensor_use is not None and found.sensor_use > 1.0:
        reason = f"the readings take {found.sensor_use:.3g} of the sensor's range"
        record |= {"result": "out_of_range", "reason": reason}
    return record | found.as_dict()


def _judge_piece(base: dict[str, Any], piece: list[tuple[int, dict[str, Any]]], task: Task) -> list[Record]:
    return [judged(base, number, point, task) for number, point in piece]


def _computed(
    client: "Client", base: dict[str, Any], grid: list[dict[str, Any]], missing: list[int], task: Task
) -> Iterator[Record]:
    """Records in the order in which they are done."""
    from distributed import as_completed

    pieces = [
        [(i, grid[i]) for i in missing[start : start + _PIECE]] for start in range(0, len(missing), _PIECE)
    ]
    futures = [client.submit(_judge_piece, base, piece, task, pure=False) for piece in pieces]
    by_key = {future.key: piece for future, piece in zip(futures, pieces, strict=True)}
    for future in as_completed(futures):
        error = future.exception() if future.status == "error" else None
        if future.status == "finished":
            yield from future.result()
        else:  # the worker itself was lost, again and again
            for number, point in by_key[future.key]:
                lost = {"result": "failed", "reason": f"worker lost: {error or future.status}"}
                yield {"point": number, **point, **lost, **dict.fromkeys(FIGURES)}
        future.release()


@contextmanager
def _client(scheduler: str | None, workers: int, tell: OnProgress) -> Iterator["Client"]:
    """Workers: those of a scheduler, or processes of this machine.

    Raises:
        InputError: nobody answers there.
        MissingDependencyError: dask is not installed.
    """
    try:
        import dask
        from distributed import Client, LocalCluster
    except ModuleNotFoundError as error:
        raise _missing(error.name) from None
    with dask.config.set(
        {
            "distributed.worker.daemon": True,
            "distributed.worker.multiprocessing-method": start_method(),
            "distributed.comm.timeouts.connect": SCHEDULER_TIMEOUT_S,
        }
    ):
        if scheduler is not None:
            tell(f"reaching {scheduler}", None)
            try:
                client = Client(scheduler, timeout=SCHEDULER_TIMEOUT_S)
            except (OSError, ValueError, TypeError) as error:
                reason = (
                    f"does not answer within {SCHEDULER_TIMEOUT_S:g} s"
                    if isinstance(error, OSError)
                    else error
                )
                raise InputError(
                    f"--scheduler {scheduler}: {reason}; start one with: dask scheduler, or leave --scheduler out"
                ) from None
            with client:
                _await_workers(client, scheduler)
                yield client
            return
        tell(f"starting {workers} workers", None)
        local = {"threads_per_worker": 1, "dashboard_address": None, "silence_logs": 50}
        with ignore_sigint():
            made = LocalCluster(n_workers=workers, **local)
        with made as cluster, Client(cluster) as client:
            yield client


def _await_workers(client: "Client", scheduler: str) -> None:
    """A scheduler without workers would wait for ever.

    Raises:
        InputError: it has none.
    """
    try:
        client.wait_for_workers(1, timeout=SCHEDULER_TIMEOUT_S)
    except TimeoutError:
        raise InputError(
            f"--scheduler {scheduler}: has no workers; start some with: dask worker {scheduler}"
        ) from None


def _plain(task: Task) -> dict[str, Any]:
    lists = {name: list(getattr(task, name)) for name in ("forces_N", "fractions")}
    return asdict(task) | lists | {"gravities": [list(gravity) for gravity in task.gravities]}


def _require_tables() -> None:
    try:
        import pyarrow  # noqa: F401
    except ModuleNotFoundError as error:
        raise _missing(error.name) from None


def _missing(name: str | None) -> MissingDependencyError:
    return MissingDependencyError(f"sweep needs {name}: pip install 'probedesign[sweep]'")


def _write_tables(records: list[Record], keys: list[str], folder: Path) -> list[Path]:
    """The same table twice: CSV for people, Parquet for programs."""
    import pyarrow as pa
    from pyarrow import parquet

    columns = ["point", *keys, "result", "reason", *FIGURES]
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(records)
    rows = {name: _column([record[name] for record in records]) for name in columns}
    kinds = {name: pa.float64() for name in FIGURES} | {"point": pa.int64()}
    table = pa.table({name: pa.array(values, kinds.get(name)) for name, values in rows.items()})
    packed = io.BytesIO()
    parquet.write_table(table, packed)
    files = [folder / "sweep.csv", folder / "sweep.parquet"]
    write_atomically(files[0], text.getvalue().encode())
    write_atomically(files[1], packed.getvalue())
    return [*files, folder / PROGRESS]


def _column(values: list[Any]) -> list[Any]:
    """Of one kind, as Parquet has it: numbers, names or truths; text where they are mixed."""
    plain = [float(value) if type(value) is int else value for value in values]
    if len({type(value) for value in plain if value is not None}) > 1:
        return [None if value is None else str(value) for value in values]
    return plain
