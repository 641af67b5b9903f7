"""Prediction of contact errors, forces and workspace of a design before it is printed."""
