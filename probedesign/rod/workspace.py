"""The memory that the kernels work in: they allocate nothing, so each caller, one thread, brings its own."""

from typing import NamedTuple

import numpy as np

from probedesign.frames import Array
from probedesign.rod import kernels
from probedesign.rod.kernels.compiled import announce

FIRST = np.zeros(1, dtype=np.int64)
"""The rod of a single case."""


class Workspace(NamedTuple):
    """In the order in which `kernels.solve_cases` takes them; its docstrings say what they are."""

    scratch: Array
    nodes: Array
    blocks: Array
    y: Array
    contact: Array
    turns: Array


def workspace(k: int, room: int, group: int = 1) -> Workspace:
    """Room for k sensitivities, so many nodes of the shape and so many cases side by side."""
    announce(kernels.solve_cases)
    chunks = chunks_of(k) if k else 0
    width = width_of(chunks)
    return Workspace(
        scratch=np.empty(kernels.FIXED + group * kernels.CASE),
        nodes=np.empty(room * width),
        blocks=np.empty(chunks * kernels.BLOCK),
        y=np.empty(kernels.STATE),
        contact=np.empty(width - 1),
        turns=np.empty((3, k)),
    )


def chunks_of(k: int) -> int:
    """How many blocks of columns hold k sensitivities and the three turns of the tip."""
    return -(-(3 + k) // kernels.WIDE)


def width_of(chunks: int) -> int:
    """Numbers of a node: arclength, state, columns."""
    return 1 + kernels.STATE + kernels.WIDE * kernels.COLUMN * chunks
