"""Readings in, contacts out: sources of readings, the tare, recordings, and the loop that estimates."""
