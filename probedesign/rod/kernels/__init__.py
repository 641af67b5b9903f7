"""The compiled rod: sweeps from the free tip to the base with exact sensitivities, and the solver on top of them.

Read `equations` first, then `verner` and `steps`: one step of the state and of its sensitivities. `sweep` integrates
one rod with all outputs, `lanes` and `lane_sweep` integrate as many rods side by side as a vector register has lanes.
`newton` finds the section of the tip, `solve` runs many cases through it and is called from Python, and `sensitivities`
evaluates a finished sweep. All of it works on flat arrays and tuples and allocates nothing: the caller provides the
memory, `ScratchBuffers`.
"""

from probedesign.rod.kernels.equations import (
    ALL_COLUMNS,
    CONE,
    CONTACT_COLUMNS,
    DENSITY,
    GENERAL,
    LOAD,
    LOAD_COLUMNS,
    NOT_CONVERGED,
    OK,
    PARAMETERS,
    STEP_LIMIT,
    UNSTABLE,
    Body,
)
from probedesign.rod.kernels.newton import COLD, WARM, WARM_ONLY
from probedesign.rod.kernels.sensitivities import states_at
from probedesign.rod.kernels.solve import (
    FIXED,
    ROW_CONTACT,
    ROW_COUNT,
    ROW_LENGTH,
    ROW_MARGIN,
    ROW_MOMENT,
    ROW_RESIDUAL,
    ROW_STATUS,
    ROW_TIP,
    solve_cases,
)
from probedesign.rod.kernels.steps import BLOCK, COLUMN, STATE, WIDE, WORK
from probedesign.rod.kernels.sweep import lane_of

__all__ = [
    "ALL_COLUMNS",
    "BLOCK",
    "COLD",
    "COLUMN",
    "CONE",
    "CONTACT_COLUMNS",
    "DENSITY",
    "FIXED",
    "GENERAL",
    "LOAD",
    "LOAD_COLUMNS",
    "NOT_CONVERGED",
    "OK",
    "PARAMETERS",
    "ROW_CONTACT",
    "ROW_COUNT",
    "ROW_LENGTH",
    "ROW_MARGIN",
    "ROW_MOMENT",
    "ROW_RESIDUAL",
    "ROW_STATUS",
    "ROW_TIP",
    "STATE",
    "STEP_LIMIT",
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
