"""TODO outputs/__init__."""
