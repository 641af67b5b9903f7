"""Simulation of what a laboratory measures of a probe whose ground truth is known."""
