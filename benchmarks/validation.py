"""Coverage of the errors that `validate` states, in simulated campaigns.

Each campaign has its own probe drawn from the tolerances. Touches are located with the prior on friction; weights are
located along the probe by the force–moment method.
"""

import tempfile
from pathlib import Path

import numpy as np

from benchmarks.error_statistics import proportion_interval
from benchmarks.timing import print_table
from benchmarks.touches import paper_models
from probedesign.campaigns import read_campaign
from probedesign.core.units import MILLINEWTON, MM
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.model import ProbeModel
from probedesign.simulation.campaign_folder import make_campaign
from probedesign.simulation.ground_truth import CampaignKind, CampaignPlan
from probedesign.validation.validate import ValidatedTest, validate

CAMPAIGNS = 150
#: Reference measurement, and median friction coefficient of the touches.
KINDS: tuple[tuple[CampaignKind, float], ...] = (("cameras", 0.0), ("stage", 0.0), ("cameras", 0.3), ("stage", 0.3))


def report() -> None:
    """Print the tables."""
    rows, weights = [], []
    for kind, friction in KINDS:
        for name, model in paper_models().items():
            tests = [
                test for seed in range(CAMPAIGNS) for test in _tests(model, CampaignPlan(kind, seed, friction=friction))
            ]
            rows.append(
                [
                    f"{name}, {kind}, friction {friction:g}",
                    *_statistics([test for test in tests if test.kind == "touch"]),
                ]
            )
            for weight in sorted({test.test.name for test in tests if test.kind == "weight" and not friction}):
                here = [test for test in tests if test.test.name == weight]
                mean = np.mean([[test.force / MILLINEWTON, test.fraction] for test in here], axis=0)
                weights.append([f"{name}, {mean[0]:.3g} mN at {mean[1]:.1f} L", *_statistics(here)])
    head = ["probe, reference", "touches", "located", "in 95 %", "95 % interval", "NEES/dof", "RMS error", "stated RMS"]
    print_table(f"Simulated campaigns, {CAMPAIGNS} probes each", head, rows)
    print_table("Weights of the campaigns without friction", ["probe, weight", "weights", *head[2:]], weights)


def _tests(model: ProbeModel, plan: CampaignPlan) -> tuple[ValidatedTest, ...]:
    """Return the validated tests of one simulated campaign."""
    with tempfile.TemporaryDirectory() as folder:
        make_campaign(model, Path(folder) / "data", plan)
        return validate(Estimator(model), read_campaign(Path(folder) / "data")).tests


def _statistics(tests: list[ValidatedTest]) -> list[str]:
    errors = [test.contact_error for test in tests if test.contact_error is not None]
    if not errors:
        return [f"{len(tests)}", "0%", *["-"] * 5]
    inside = sum(error.within_95 for error in errors)
    low, high = proportion_interval(inside, len(errors))
    nees = np.mean([error.nees / error.dof for error in errors])
    rms, stated = (np.sqrt(np.mean(np.square(values))) / MM for values in
                   ([error.size for error in errors], [error.expected for error in errors]))  # fmt: skip
    return [f"{len(tests)}", f"{len(errors) / len(tests):.0%}", f"{inside / len(errors):.1%}",
            f"{low:.0%} to {high:.0%}", f"{nees:.2f}", f"{rms:.2f} mm", f"{stated:.2f} mm"]  # fmt: skip
