"""Foundations that every package may use: they do not depend on what a probe is."""
