"""Solve many equilibria at once: rods and loads as arrays, results as arrays, on all cores."""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.rod.kernels.equations import DENSITY, LOAD, OK, Body
from probedesign.rod.kernels.newton import COLD, SOLUTION, scratch_buffers, solve_cases
from probedesign.rod.rod import RESULTS, TOLERANCES, Columns, Mode, Rod

#: Cases per task of a thread: a few milliseconds, so that interrupts are handled and all cores finish together.
CHUNK = 256
MIN_CHUNK = 32  #: Fewer cases per task cost more in threads than they save.


@dataclass(frozen=True)
class Batch:
    """Equilibria of n cases in base axes; rows of numbers are NaN unless `result` is "ok"."""

    result: np.ndarray[tuple[int], np.dtype[np.str_]]  #: "ok", "not_converged" or "unstable", (n,).
    margin: Array  #: stability margins, (n,).
    residual: Array  #: error of the tangent at the base [rad], (n,).
    tip: Array  #: the tip's section [tangent, x axis], (n, 6).
    wrench_base: Array  #: of the rod on its mount [N, N·m], (n, 6).
    p_contact_base: Array  #: where the force acts [m], (n, 3).
    d_moment: Array  #: derivatives of the base moment, (n, 3, k); k = 0 without columns.
    d_contact: Array  #: derivatives of the contact's [tangent, section x axis, position, section y axis], (n, 12, k).
    frame: Array  #: those four vectors, (n, 12); NaN without columns.

    def rows(self, of: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> "Batch":
        """Return the selected cases."""
        return Batch(**{name: value[of] for name, value in vars(self).items()})

    @property
    def ok(self) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Return which cases are solved, (n,)."""
        return np.asarray(self.result == "ok")


def solve_batch(
    rods: Rod | Sequence[Rod],
    gravity: ArrayLike,
    force: ArrayLike,
    s_contact: ArrayLike,
    *,
    couple: ArrayLike = (0.0, 0.0, 0.0),
    which: ArrayLike | None = None,
    mode: Mode = "fast",
    columns: Columns = "none",
    threads: int | None = None,
) -> Batch:
    """Solve for the equilibria of n cases, each as `Rod.solve` does from no load.

    Cases are independent: the results are identical to the bit for any number of threads.

    Args:
        rods: one for all cases, or several with equally many knots.
        gravity: base axes [m/s²], (n, 3) or (3,).
        force: base axes [N], (n, 3) or (3,).
        s_contact: [m], (n,) or a number.
        couple: base axes [N·m], (n, 3) or (3,).
        which: index of each case's rod, (n,); case i has rods[i] if None.
        mode: "fast" or "reference".
        columns: parameters of the sensitivities, as in `Rod.solve`.
        threads: all cores if None.

    Returns:
        The equilibria.

    Raises:
        InputError: shapes do not match, a number is not finite or a contact is off its rod.
    """
    several = (rods,) if isinstance(rods, Rod) else tuple(rods)
    if not several or any(len(rod.s) != len(several[0].s) for rod in several):
        raise InputError("a batch needs at least one rod, and all its rods equally many knots")
    lengths = np.array([rod.length for rod in several])
    loads, of = _cases(lengths, gravity, force, s_contact, couple, which, isinstance(rods, Rod))
    arrays = zip(*(rod.body for rod in several), strict=True)
    bodies = Body(*(np.ascontiguousarray(np.stack(rows)) for rows in arrays))
    n, k = len(loads), several[0].columns_of(columns)
    solutions, derivatives = np.empty(n, dtype=SOLUTION), np.full((n, 15, k + 1), np.nan)
    threads = threads or len(os.sched_getaffinity(0))
    chunk = min(CHUNK, max(-(-n // threads), MIN_CHUNK))

    def run(first: int) -> None:
        last = min(first + chunk, n)
        solve_cases(
            first, last, bodies, of, loads, COLD, False, *TOLERANCES[mode], scratch_buffers(k, 0), solutions,
            derivatives,
        )  # fmt: skip

    run(0)  # this thread compiles the kernels if that is necessary
    with ThreadPoolExecutor(threads) as pool:
        try:
            list(pool.map(run, range(chunk, n, chunk)))
        except BaseException:
            pool.shutdown(wait=True, cancel_futures=True)
            raise
    return _batch(solutions, derivatives, loads, bodies, of)


def _cases(
    lengths: Array,
    gravity: ArrayLike,
    force: ArrayLike,
    s_contact: ArrayLike,
    couple: ArrayLike,
    which: ArrayLike | None,
    one: bool,
) -> tuple[Array, Array]:
    """Return validated loads (n, 13) and the rod of each case, (n,), from the rods' lengths and the arguments."""
    vectors = {"gravity": gravity, "force": force, "couple": couple}
    given = {name: np.array(vector, dtype=float) for name, vector in vectors.items()}
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
    loads = np.zeros((n, LOAD))
    loads[:, 0:3], loads[:, 3:6], loads[:, 9:12] = given["force"], given["gravity"], given["couple"]
    loads[:, 12] = s
    length = lengths[of]
    good = np.isfinite(loads).all(axis=1) & (loads[:, 12] >= 0.0) & (loads[:, 12] <= length * (1 + 1e-12))
    if not good.all():
        i = int(np.argmin(good))
        raise InputError(
            f"case {i}: force, gravity and couple must be finite, s_contact = {loads[i, 12]} in 0 ... {length[i]:g} m"
        )
    loads[:, 12] = np.minimum(loads[:, 12], length)
    return loads, of.astype(np.int64)


def _batch(solutions: NDArray[Any], derivatives: Array, loads: Array, bodies: Body, of: Array) -> Batch:
    status = solutions["status"].astype(int)
    bad = status != OK
    mass = (bodies.constants[:, DENSITY] * bodies.volume_beyond[:, 0])[of]
    wrench = np.hstack([loads[:, 0:3] + mass[:, None] * loads[:, 3:6], solutions["moment"]])
    for numbers in (wrench, solutions["residual"], solutions["tip"], solutions["point"], derivatives):
        numbers[bad] = np.nan
    return Batch(
        result=np.array([RESULTS[code] for code in range(len(RESULTS))])[status], margin=solutions["margin"],
        residual=solutions["residual"], tip=solutions["tip"], wrench_base=wrench, p_contact_base=solutions["point"],
        d_moment=derivatives[:, :3, :-1], d_contact=derivatives[:, 3:, :-1], frame=derivatives[:, 3:, -1],
    )  # fmt: skip
