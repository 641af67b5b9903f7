"""Simulation of sensors, robots, cameras and campaigns for a probe whose ground truth is known."""
