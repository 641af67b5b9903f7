"""Options of `explore` that make up a run to try with."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from cyclopts import Parameter

from probedesign.cli.console import working
from probedesign.errors import InputError

if TYPE_CHECKING:
    from probedesign.estimation.model import ProbeModel
    from probedesign.exploring.base import Base


@Parameter(name="*")
@dataclass
class RehearsalOptions:
    """A simulated run."""

    rehearse: Path | None = None
    """Write what touching a simulated card house would tell to this folder, and end; off as bundle and options say."""
    seed: int = 1
    """Of what is off in it."""
    friction: float = 0.5
    """Median friction coefficient of the simulated cards; contacts stick and slip. 0 is without friction."""
    friction_spread: float = 0.2
    """Standard deviation of its logarithm from touch to touch."""

    def write(self, folder: Path, model: "ProbeModel", base: "Base", force: bool) -> tuple[Path, ...]:
        """Make the run up and write its files.

        Raises:
            InputError: seed or friction make no sense, the probe cannot touch the house, or files stand there already.
        """
        import numpy as np

        from probedesign.exploring.card_house import spots
        from probedesign.exploring.rehearsal import Errors, rehearse
        from probedesign.exploring.rehearsal_files import write_rehearsal
        from probedesign.rod.friction import MAX_FRICTION

        if self.seed < 0:
            raise InputError(f"--seed {self.seed} must not be negative")
        if not 0.0 <= self.friction <= MAX_FRICTION:
            raise InputError(f"--friction {self.friction:g} must lie in 0 ... {MAX_FRICTION:g}")
        if not 0.0 <= self.friction_spread <= 1.0:
            raise InputError(f"--friction-spread {self.friction_spread:g} must lie in 0 ... 1")
        rng = np.random.default_rng(self.seed)
        with working("touching a card house"):
            house = rehearse(model, spots(), rng, Errors.of(model, base, self.friction, self.friction_spread))
            return write_rehearsal(house, model, folder, rng, force)
