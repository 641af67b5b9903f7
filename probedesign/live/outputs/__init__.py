"""Outputs of a run: sinks, the recording, and the options that select them."""
