"""Identification of E, G and further parameters from a campaign of tests, by least squares on the full rod."""
