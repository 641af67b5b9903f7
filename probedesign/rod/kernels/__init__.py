"""The compiled rod: sweeps from the free tip to the base with exact sensitivities, and the solve on top of them.

Read `equations` first, then `steps`, `sweep`, `newton`, `solve`; `outputs` and `batch` stand on those. Everything
works on flat arrays and tuples, and allocates nothing: the memory is the caller's.
"""

from probedesign.rod.kernels.batch import (
    CONTACT,
    COUNT,
    FOUND,
    MARGIN,
    MOMENT,
    RESIDUAL,
    STATUS,
    TIP,
    solve_cases,
)
from probedesign.rod.kernels.body import (
    ALL_COLUMNS,
    CONE,
    CONSTANTS,
    CONTACT_COLUMNS,
    DENSITY,
    LOAD,
    LOAD_COLUMNS,
    NOT_CONVERGED,
    OK,
    PARAMETERS,
    STEP_LIMIT,
    UNSTABLE,
    Body,
)
from probedesign.rod.kernels.outputs import states_at
from probedesign.rod.kernels.solve import COLD, SCRATCH, WARM, WARM_ONLY
from probedesign.rod.kernels.steps import BLOCK, COLUMN, STATE, WIDE, WORK
from probedesign.rod.kernels.sweep import lane_of

__all__ = [
    "ALL_COLUMNS",
    "BLOCK",
    "COLD",
    "COLUMN",
    "CONE",
    "CONSTANTS",
    "CONTACT",
    "CONTACT_COLUMNS",
    "COUNT",
    "DENSITY",
    "FOUND",
    "LOAD",
    "LOAD_COLUMNS",
    "MARGIN",
    "MOMENT",
    "NOT_CONVERGED",
    "OK",
    "PARAMETERS",
    "RESIDUAL",
    "SCRATCH",
    "STATE",
    "STATUS",
    "STEP_LIMIT",
    "TIP",
    "UNSTABLE",
    "WARM",
    "WARM_ONLY",
    "WIDE",
    "WORK",
    "Body",
    "lane_of",
    "solve_cases",
    "states_at",
]
