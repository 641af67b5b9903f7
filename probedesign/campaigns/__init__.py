"""Campaigns: what a laboratory measured of one probe, read from a folder of tables. See docs/measurements.md."""

from probedesign.campaigns.campaign import Campaign, Markers, Test, Weighing
from probedesign.campaigns.reading import read_campaign

__all__ = ["Campaign", "Markers", "Test", "Weighing", "read_campaign"]
