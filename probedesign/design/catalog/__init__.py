"""Resins, sensors, printers and robot flanges by name: what a design file refers to."""
