"""Prediction of contact errors and forces of a design before it is printed."""
