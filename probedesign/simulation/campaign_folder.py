"""Writing a synthetic campaign: its tables as a laboratory would fill them, and the truth beside them."""

import os
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from probedesign.errors import InputError
from probedesign.estimation.model import ProbeModel
from probedesign.simulation.ground_truth import World
from probedesign.simulation.plan import Plan
from probedesign.simulation.stereo_rig import Sight
from probedesign.simulation.table_texts import manifest_of, markers_of, tests_of, truth_of, wrenches_of

TRUTH = "truth.json"


@dataclass(frozen=True, eq=False)
class Made:
    """A campaign that was made.

    Attributes:
        folder: of it.
        files: in it, by name.
        tests: how many.
        world: the truth.
    """

    folder: Path
    files: tuple[str, ...]
    tests: int
    world: World


def make_campaign(
    model: ProbeModel,
    folder: Path,
    plan: Plan,
    force: bool = False,
    tell: Callable[[str, float | None], None] = lambda step, share: None,
) -> Made:
    """Make a synthetic campaign.

    Args:
        model: of the probe as designed.
        folder: to write; made whole aside first.
        plan: how it is measured.
        force: replace a campaign that stands there.
        tell: told the step at work and the share done.

    Raises:
        InputError: something stands there, or the probe or the plan is no good.
    """
    _check_place(folder, force)
    rng = np.random.default_rng(plan.seed)
    world = World.draw(model, plan, rng)
    states = world.states()
    sight = Sight(world)
    tables = {
        "campaign.toml": manifest_of(world, sight),
        "tests.csv": tests_of(world, states, rng),
        "wrenches.csv": wrenches_of(world, states, rng),
        **markers_of(sight, states, rng),
        TRUTH: truth_of(world, states),
    }
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        aside = Path(tempfile.mkdtemp(dir=folder.parent, prefix=f".{folder.name}."))
    except OSError as error:
        raise InputError(f"{folder}: cannot be written: {error.strerror}") from None
    try:
        for name, text in tables.items():
            (aside / name).write_bytes(text.encode())
        if plan.images:
            from probedesign.simulation.photographs import take_photographs

            take_photographs(sight, states, aside / "images", plan.seed, tell)
        os.chmod(aside, 0o755)
        _put(aside, folder)
    except OSError as error:
        raise InputError(f"{folder}: cannot be written: {error.strerror}") from None
    finally:
        shutil.rmtree(aside, ignore_errors=True)
    names = sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())
    return Made(folder, tuple(names), len(states), world)


def _check_place(folder: Path, force: bool) -> None:
    """Only a campaign of ours is ever replaced."""
    if not folder.exists():
        return
    if not folder.is_dir() or (any(folder.iterdir()) and not (folder / TRUTH).exists()):
        raise InputError(
            f"{folder}: holds no {TRUTH}, so it is no synthetic campaign and not replaced; name another"
        )
    if any(folder.iterdir()) and not force:
        raise InputError(f"{folder}: exists already; --force replaces it, or name another folder")


def _put(aside: Path, folder: Path) -> None:
    """Into place; what stood there goes once the new stands."""
    old = None
    if folder.exists():
        old = aside.with_name(f"{aside.name}.old")
        os.replace(folder, old)
    os.replace(aside, folder)
    if old is not None:
        shutil.rmtree(old, ignore_errors=True)
