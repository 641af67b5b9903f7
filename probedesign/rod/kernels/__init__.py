"""The compiled rod: sweeps from the free tip to the base with exact sensitivities, and the solve on top of them.

Read `equations` first. The tip is sought in `lanes`, a register's width of cases at a time: `lane_sweep`, `newton`,
`search`, `solve`. What is asked for beside it comes of one more `sweep` with `steps`, and of `outputs`; `batch` is the
door to all. Everything
works on flat arrays and tuples, and allocates nothing: the memory is the caller's.
"""

from probedesign.rod.kernels.batch import (
    CONTACT,
    COUNT,
    FOUND,
    MARGIN,
    MOMENT,
    TIP,
    solve_cases,
)
from probedesign.rod.kernels.batch import (
    ROW_RESIDUAL as RESIDUAL,
)
from probedesign.rod.kernels.batch import (
    ROW_STATUS as STATUS,
)
from probedesign.rod.kernels.body import (
    ALL_COLUMNS,
    BEND_X,
    BEND_Y,
    CONE,
    CONSTANTS,
    CONTACT_COLUMNS,
    DENSITY,
    GENERAL,
    LOAD,
    LOAD_COLUMNS,
    NOT_CONVERGED,
    OK,
    PARAMETERS,
    SHEAR,
    STEP_LIMIT,
    STRETCH,
    TWIST,
    UNSTABLE,
    Body,
)
from probedesign.rod.kernels.outputs import states_at
from probedesign.rod.kernels.search import COLD, WARM, WARM_ONLY
from probedesign.rod.kernels.solve import CASE, FIXED
from probedesign.rod.kernels.steps import BLOCK, COLUMN, STATE, WIDE, WORK
from probedesign.rod.kernels.sweep import lane_of

__all__ = [
    "ALL_COLUMNS",
    "BEND_X",
    "BEND_Y",
    "BLOCK",
    "CASE",
    "COLD",
    "COLUMN",
    "CONE",
    "CONSTANTS",
    "CONTACT",
    "CONTACT_COLUMNS",
    "COUNT",
    "DENSITY",
    "FIXED",
    "FOUND",
    "GENERAL",
    "LOAD",
    "LOAD_COLUMNS",
    "MARGIN",
    "MOMENT",
    "NOT_CONVERGED",
    "OK",
    "PARAMETERS",
    "RESIDUAL",
    "SHEAR",
    "STATE",
    "STATUS",
    "STEP_LIMIT",
    "STRETCH",
    "TIP",
    "TWIST",
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
