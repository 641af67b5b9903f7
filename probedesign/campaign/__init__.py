"""A campaign: what a laboratory measured of one probe, read from a folder of tables. See docs/measurements.md."""

from probedesign.campaign.campaign import Campaign, Markers, Test, Weighing
from probedesign.campaign.reading import read_campaign

__all__ = ["Campaign", "Markers", "Test", "Weighing", "read_campaign"]
