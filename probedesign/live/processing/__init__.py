"""TODO processing/__init__."""
