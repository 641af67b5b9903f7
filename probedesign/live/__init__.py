"""Live contact estimation: sources of wrench readings, tare, recordings, base poses, and the loop that estimates."""

from collections.abc import Callable

Log = Callable[[str], None]
"""Takes a message for the user."""
