"""Simulated campaigns, each of its own drawn print: do the errors that `validate` states come true, and how does the
prediction of the paper's Table I compare with laws without mechanics?

Touches are located with the prior on friction, weights by the force–moment method and along the probe alone."""

import tempfile
from pathlib import Path

import numpy as np
from scipy.stats import binomtest

from benchmarks.timing import print_table
from benchmarks.touches import paper_models
from probedesign import pipeline
from probedesign.campaigns import read_campaign
from probedesign.core.units import MILLINEWTON, MM
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.model import ProbeModel
from probedesign.simulation.campaign_folder import make_campaign
from probedesign.simulation.ground_truth import CampaignKind, CampaignPlan
from probedesign.validation.validate import validate
from probedesign.validation.validated_test import ValidatedTest

CAMPAIGNS = 150
KINDS: tuple[tuple[CampaignKind, float], ...] = (
    ("cameras", 0.0),
    ("stage", 0.0),
    ("cameras", 0.3),
    ("stage", 0.3),
)
"""Reference and median friction of the touches."""


def report() -> None:
    """Print the table."""
    rows, weights = [], []
    for kind, friction in KINDS:
        for name, model in paper_models().items():
            trials = [
                trial
                for seed in range(CAMPAIGNS)
                for trial in _trials(model, CampaignPlan(kind, seed, friction=friction))
            ]
            rows.append(
                [
                    f"{name}, {kind}, friction {friction:g}",
                    *_statistics([trial for trial in trials if trial.kind == "touch"]),
                ]
            )
            for of in sorted(
                {trial.test.name for trial in trials if trial.kind == "weight" and not friction}
            ):
                here = [trial for trial in trials if trial.test.name == of]
                mean = np.mean([[trial.force / MILLINEWTON, trial.fraction] for trial in here], axis=0)
                weights.append([f"{name}, {mean[0]:.3g} mN at {mean[1]:.1f} L", *_statistics(here)])
    head = ["probe, reference", "touches", "ok", "in 95 %", "of which tell", "squares", "RMS error", "stated"]
    print_table(f"Made-up campaigns, {CAMPAIGNS} prints each", head, rows)
    print_table("Weights of the campaigns without friction", ["probe, weight", "weights", *head[2:]], weights)
    _table_one()


def _table_one() -> None:
    """Print the agreement of the model and of laws without mechanics with the paper's Table I."""
    comparison = pipeline.predict_table_one().comparison
    rows = []
    for what, scores in (("fitted to the table or stated", comparison.fitted),
                         ("fitted to the other two probes", comparison.left_out)):  # fmt: skip
        rows += [[score.setting, str(score.constants), what, f"{score.within} of {score.predicted}",
                  f"{score.typical_factor:.2f}",
                  "-" if score.rank_correlation is None else f"{score.rank_correlation:.2f}"]
                 for score in scores]  # fmt: skip
    print_table("Contact errors of the paper's Table I, 23 rows",
                ["law", "constants", "which are", "within a factor of 2", "typical factor", "rank correlation"],
                rows)  # fmt: skip
    beyond = ", ".join(f"{name} {value:.2f}" for name, value in comparison.beyond_lever.items())
    print(f"  rank correlation of what the lever law leaves, measured with predicted: {beyond}")


def _trials(model: ProbeModel, plan: CampaignPlan) -> tuple[ValidatedTest, ...]:
    """One campaign, validated."""
    with tempfile.TemporaryDirectory() as folder:
        make_campaign(model, Path(folder) / "data", plan)
        return validate(Estimator(model), read_campaign(Path(folder) / "data")).tests


def _statistics(trials: list[ValidatedTest]) -> list[str]:
    misses = [trial.contact_error for trial in trials if trial.contact_error is not None]
    within = sum(miss.within_95 for miss in misses)
    share = binomtest(within, len(misses)).proportion_ci(0.95)
    squares = np.mean([miss.nees / miss.dof for miss in misses])
    rms, stated = (np.sqrt(np.mean(np.square(values))) / MM for values in
                   ([miss.size for miss in misses], [miss.expected for miss in misses]))  # fmt: skip
    return [f"{len(trials)}", f"{len(misses) / len(trials):.0%}", f"{within / len(misses):.1%}",
            f"{share.low:.0%} to {share.high:.0%}", f"{squares:.2f}", f"{rms:.2f} mm", f"{stated:.2f} mm"]  # fmt: skip
