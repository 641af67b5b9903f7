"""Options of `explore` that make up a run to try with."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from cyclopts import Parameter

from probedesign.cli.output import working
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

    def write(self, folder: Path, model: "ProbeModel", base: "Base", force: bool) -> tuple[Path, ...]:
        """Make the run up and write its files.

        Raises:
            InputError: the seed is none, the probe cannot touch the house, or files stand there already.
        """
        import numpy as np

        from probedesign.exploring.card_house import spots
        from probedesign.exploring.rehearsal import Errors, rehearse
        from probedesign.exploring.rehearsal_files import write_rehearsal

        if self.seed < 0:
            raise InputError(f"--seed {self.seed} must not be negative")
        rng = np.random.default_rng(self.seed)
        with working("touching a card house"):
            house = rehearse(model, spots(), rng, Errors.of(model, base))
            return write_rehearsal(house, model, folder, rng, force)
