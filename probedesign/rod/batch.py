"""Many equilibria at once: rods and loads as arrays in, answers as arrays out, on all cores."""

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from probedesign.errors import InputError
from probedesign.frames import Array
from probedesign.rod import kernels
from probedesign.rod.kernels.solve import scratch_buffers
from probedesign.rod.rod import RESULTS, TOLERANCES, Columns, Mode, Rod

Indices = np.ndarray[tuple[int], np.dtype[np.int64]]
CHUNK = 256
"""Cases that a thread takes at a time: a few milliseconds, so that an interrupt is heard and cores end together."""
LEAST = 32
"""Fewer are not worth a thread."""


@dataclass(frozen=True)
class Batch:
    """Equilibria of n cases in base axes; rows of numbers are NaN unless `result` is "ok".

    Attributes:
        result: "ok", "not_converged" or "unstable", (n,).
        margin: of stability, (n,).
        residual: misfit of the base's tangent [rad], (n,).
        tip: the tip's section [tangent, x axis], (n, 6).
        wrench_base: what the rod does to its mount [N, N·m], (n, 6).
        p_contact_base: where the force acts [m], (n, 3).
        d_moment: of the base moment, (n, 3, k); k = 0 if no columns were asked for.
        d_contact: of the contact's [tangent, section x axis, position, section y axis], (n, 12, k).
        frame: those four themselves, (n, 12); NaN unless columns were asked for.
    """

    result: np.ndarray[tuple[int], np.dtype[np.str_]]
    margin: Array
    residual: Array
    tip: Array
    wrench_base: Array
    p_contact_base: Array
    d_moment: Array
    d_contact: Array
    frame: Array

    def rows(self, of: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> "Batch":
        """Some of the cases."""
        return Batch(**{name: value[of] for name, value in vars(self).items()})

    def among(self, of: Indices, result: np.ndarray[tuple[int], np.dtype[np.str_]]) -> "Batch":
        """These cases at their places among more, which have no numbers."""
        full = {
            name: np.full((len(result), *value.shape[1:]), np.nan)
            for name, value in vars(self).items()
            if name != "result"
        }
        for name, values in full.items():
            values[of] = getattr(self, name)
        return Batch(result=result, **full)

    def changed(self, of: Indices, rows: "Batch") -> "Batch":
        """The same with other answers of these cases."""
        full = {name: value.copy() for name, value in vars(self).items()}
        for name, value in full.items():
            value[of] = getattr(rows, name)
        return Batch(**full)

    def without(self, bad: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> "Batch":
        """The same, with no numbers for some."""
        kept = {
            name: np.where(bad.reshape(-1, *[1] * (value.ndim - 1)), np.nan, value)
            for name, value in vars(self).items()
            if name != "result"
        }
        return Batch(result=np.where(bad, "not_converged", self.result), **kept)

    @property
    def ok(self) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Which cases have an answer, (n,)."""
        return np.asarray(self.result == "ok")


@dataclass(frozen=True)
class Rods:
    """Rods with equally many knots, their arrays stacked once for many batches.

    Attributes:
        rods: one or more.
    """

    rods: tuple[Rod, ...]

    def __post_init__(self) -> None:
        """Raises InputError where they do not fit."""
        if not self.rods or any(len(rod.s) != len(self.rods[0].s) for rod in self.rods):
            raise InputError("the rods of a batch need equally many knots, and there must be one")

    @classmethod
    def of(cls, rods: "Rod | Sequence[Rod] | Rods") -> "Rods":
        """However they are given."""
        if isinstance(rods, Rods):
            return rods
        return cls((rods,) if isinstance(rods, Rod) else tuple(rods))

    def __len__(self) -> int:
        """How many."""
        return len(self.rods)

    def __iter__(self) -> Iterator[Rod]:
        """One by one."""
        return iter(self.rods)

    @cached_property
    def bodies(self) -> kernels.Body:
        """Their arrays, one row a rod."""
        arrays = zip(*(rod.body for rod in self.rods), strict=True)
        return kernels.Body(*(np.ascontiguousarray(np.stack(rows)) for rows in arrays))

    @cached_property
    def length(self) -> Array:
        """Of each [m]."""
        return np.array([rod.length for rod in self.rods])

    @cached_property
    def flank_end(self) -> Array:
        """Of each, the furthest arclength at which a touch acts [m]."""
        return np.array([rod.flank_end for rod in self.rods])


def solve_batch(
    rods: Rod | Sequence[Rod] | Rods,
    gravity: ArrayLike,
    force: ArrayLike,
    s_contact: ArrayLike,
    *,
    couple: ArrayLike = (0.0, 0.0, 0.0),
    which: ArrayLike | None = None,
    mode: Mode = "fast",
    columns: Columns = "none",
    guess: ArrayLike | None = None,
    guess_only: bool = False,
    threads: int | None = None,
    progress: Callable[[int], object] | None = None,
) -> Batch:
    """Equilibria of n cases, each as `Rod.solve` finds it from no load.

    Cases do not know of each other: the answers are the same to the bit whatever the number of threads.

    Args:
        rods: one for all cases, or several with equally many knots; `Rods` where they are used again.
        gravity: base axes [m/s²], (n, 3) or (3,).
        force: base axes [N], (n, 3) or (3,).
        s_contact: [m], (n,) or a number.
        couple: base axes [N·m], (n, 3) or (3,).
        which: index of each case's rod, (n,); case i has rods[i] if None.
        mode: "fast" or "reference".
        columns: which sensitivities to carry along, as for `Rod.solve`.
        guess: `tip` of a neighbouring equilibrium of each case, (n, 6), tried first.
        guess_only: give up where the guess does not lead to an answer, instead of starting cold.
        threads: all cores if None.
        progress: called with the number of cases just done.

    Returns:
        The equilibria.

    Raises:
        InputError: shapes do not fit, a number is not finite or a contact lies off its rod.
    """
    several = Rods.of(rods)
    loads, of = _cases(several.length, gravity, force, s_contact, couple, which, isinstance(rods, Rod))
    bodies = several.bodies
    n, k = len(loads), several.rods[0].columns_of(columns)
    found, derivatives = np.empty((n, kernels.ROW_LENGTH)), np.full((n, 15, k + 1), np.nan)
    tol, until = TOLERANCES[mode]
    order, kinds = _by_kind(bodies, of)
    loads, of = loads[order], of[order]
    start = kernels.COLD
    if guess is not None:
        start = kernels.WARM_ONLY if guess_only else kernels.WARM
        found[:, kernels.ROW_TIP : kernels.ROW_TIP + 6] = np.asarray(guess, dtype=float)[order]
    threads = threads or len(os.sched_getaffinity(0))
    chunk = min(CHUNK, max(-(-n // threads), LEAST))

    def run(first: int, last: int, directed: int | None) -> None:
        kernels.solve_cases(
            first,
            last,
            bodies,
            of,
            loads,
            directed,
            start,
            False,
            tol,
            until,
            *scratch_buffers(k, 0, CHUNK),
            found,
            derivatives,
        )
        if progress is not None:
            progress(last - first)

    chunks = [
        (first, min(first + chunk, end), directed)
        for begin, end, directed in kinds
        for first in range(begin, end, chunk)
    ]
    _done(run, chunks, threads)
    back = np.argsort(order)
    return _batch(found[back], derivatives[back], loads[back], bodies, of[back])


def _done(
    run: Callable[[int, int, int | None], None], chunks: list[tuple[int, int, int | None]], threads: int
) -> None:
    """Run all chunks, side by side where that is worth a pool of threads."""
    if len(chunks) <= 1 or threads == 1:
        for chunk in chunks:
            run(*chunk)
        return
    for directed in {directed for _, _, directed in chunks}:  # compiles, if anything has to be
        run(0, 0, directed)
    with ThreadPoolExecutor(threads) as pool:
        try:
            for _ in pool.map(lambda chunk: run(*chunk), chunks):
                pass
        except BaseException:
            pool.shutdown(wait=True, cancel_futures=True)
            raise


def _cases(
    lengths: Array,
    gravity: ArrayLike,
    force: ArrayLike,
    s_contact: ArrayLike,
    couple: ArrayLike,
    which: ArrayLike | None,
    one: bool,
) -> tuple[Array, Array]:
    """Loads (n, 13) and the rod of each case, (n,), checked; `lengths` of the rods."""
    given = {
        "gravity": np.array(gravity, float),
        "force": np.array(force, float),
        "couple": np.array(couple, float),
    }
    s = np.array(s_contact, dtype=float)
    sizes = [len(v) for v in given.values() if v.ndim == 2] + ([len(s)] if s.ndim else [])
    of = np.arange(len(lengths)) if which is None else np.array(which)
    if not one or which is not None:
        sizes.append(len(of))
    n = max(sizes, default=1)
    for name, v in given.items():
        if v.shape not in ((3,), (n, 3)):
            raise InputError(f"{name} has shape {v.shape}; it must be (3,) or ({n}, 3)")
    if s.shape not in ((), (n,)):
        raise InputError(f"s_contact has shape {s.shape}; it must be a number or ({n},)")
    of = np.zeros(n, dtype=np.int64) if one and which is None else of
    if of.shape != (n,) or of.dtype.kind != "i" or ((of < 0) | (of >= len(lengths))).any():
        raise InputError(f"which must be {n} indices of the {len(lengths)} rods, one a case")
    loads = np.zeros((n, kernels.LOAD))
    loads[:, 0:3], loads[:, 3:6], loads[:, 9:12], loads[:, 12] = (
        given["force"],
        given["gravity"],
        given["couple"],
        s,
    )
    length = lengths[of]
    good = np.isfinite(loads).all(axis=1) & (loads[:, 12] >= 0.0) & (loads[:, 12] <= length * (1 + 1e-12))
    if not good.all():
        i = int(np.argmin(good))
        raise InputError(
            f"case {i}: force, gravity and couple must be finite, "
            f"s_contact = {loads[i, 12]} in 0 ... {length[i]:g} m"
        )
    loads[:, 12] = np.minimum(loads[:, 12], length)
    return loads, of.astype(np.int64)


def _by_kind(bodies: kernels.Body, of: Array) -> tuple[Indices, list[tuple[int, int, int | None]]]:
    """An order of the cases in which those of round straight rods come first; where each kind begins and ends."""
    general = bodies.constants[of, kernels.GENERAL] != 0.0
    straight = int((~general).sum())
    kinds = [(0, straight, None), (straight, len(of), 0)]
    return np.argsort(general, kind="stable").astype(np.int64), [kind for kind in kinds if kind[0] < kind[1]]


def _batch(found: Array, derivatives: Array, loads: Array, bodies: kernels.Body, of: Array) -> Batch:
    """The kernels' rows by name."""
    status = found[:, kernels.ROW_STATUS].astype(int)
    bad = status != kernels.OK
    mass = (bodies.constants[:, kernels.DENSITY] * bodies.volume_beyond[:, 0])[of]
    moment = found[:, kernels.ROW_MOMENT : kernels.ROW_MOMENT + 3]
    wrench = np.hstack([loads[:, 0:3] + mass[:, None] * loads[:, 3:6], moment])
    for numbers in (wrench, found[:, kernels.ROW_RESIDUAL :], derivatives):
        numbers[bad] = np.nan
    return Batch(
        result=np.array([RESULTS[code] for code in range(len(RESULTS))])[status],
        margin=found[:, kernels.ROW_MARGIN],
        residual=found[:, kernels.ROW_RESIDUAL],
        tip=found[:, kernels.ROW_TIP : kernels.ROW_TIP + 6],
        wrench_base=wrench,
        p_contact_base=found[:, kernels.ROW_CONTACT + 3 : kernels.ROW_CONTACT + 6],
        d_moment=derivatives[:, :3, :-1],
        d_contact=derivatives[:, 3:, :-1],
        frame=derivatives[:, 3:, -1],
    )
