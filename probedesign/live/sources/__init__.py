"""TODO sources/__init__."""
