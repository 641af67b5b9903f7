"""Made-up campaigns of the paper's probes, each made once."""

from collections.abc import Callable
from pathlib import Path

import pytest

from probedesign import build_probe, load_design
from probedesign.campaigns import Campaign, read_campaign
from probedesign.estimation.model import ProbeModel
from probedesign.simulation.campaign_folder import make_campaign
from probedesign.simulation.ground_truth import CampaignPlan

DESIGNS = Path(__file__).parents[2] / "designs"
NAMES = ("small", "medium", "large")


@pytest.fixture(scope="module")
def models() -> dict[str, ProbeModel]:
    return {name: build_probe(load_design(DESIGNS / f"{name}.toml")).model for name in NAMES}


@pytest.fixture(scope="module")
def made(models, tmp_path_factory) -> Callable[..., Campaign]:
    """A campaign of one of the three probes, made once."""
    folder, kept = tmp_path_factory.mktemp("made"), dict[str, Campaign]()

    def make(name: str, plan: CampaignPlan) -> Campaign:
        key = f"{name}-{plan.kind}-{plan.exact}-{plan.marker_noise}"
        if key not in kept:
            kept[key] = read_campaign(make_campaign(models[name], folder / key, plan).folder)
        return kept[key]

    return make
