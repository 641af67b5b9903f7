"""Campaigns of prints whose E is known."""

from pathlib import Path

import pytest

from probedesign import build_probe, load_design
from probedesign.campaigns import Campaign, read_campaign
from probedesign.estimation.model import ProbeModel
from probedesign.simulation.campaign_folder import make_campaign
from probedesign.simulation.ground_truth import CampaignPlan

ROOT = Path(__file__).parents[2]
LARGE = ROOT / "designs/large.toml"
TRUE_E = 2.6e6  #: 12 % from the design's 2.32 MPa.


@pytest.fixture(scope="session")
def model() -> ProbeModel:
    return build_probe(load_design(LARGE)).model


@pytest.fixture(scope="session")
def stage_folder(model: ProbeModel, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Places to 0.05 mm; the print is as designed but for E."""
    folder = tmp_path_factory.mktemp("data") / "stage"
    plan = CampaignPlan("stage", 5, TRUE_E, None, None, 5, True)
    make_campaign(model, folder, plan)
    return folder


@pytest.fixture(scope="session")
def stage(stage_folder: Path) -> Campaign:
    return read_campaign(stage_folder)


@pytest.fixture(scope="session")
def cameras(model: ProbeModel, tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    """Markers to 1 mm on each axis, weights and touches; the print is as designed but for E."""
    folder = tmp_path_factory.mktemp("data") / "cameras"
    plan = CampaignPlan("cameras", 6, TRUE_E, None, 1e-3, 5, True)
    make_campaign(model, folder, plan)
    return read_campaign(folder)
