"""Live contact estimation: sources of wrench readings, tare, recordings, base poses, and the loop that estimates."""

from collections.abc import Callable
from urllib.parse import urlsplit

Log = Callable[[str], None]  #: Takes a message for the user.


def split_address(address: str, scheme: str) -> tuple[str, int | None] | None:
    """Return host, empty if absent, and port, None if absent, of `SCHEME://HOST:PORT`; None if it has another form."""
    try:
        parts = urlsplit(address)
        port = parts.port
    except ValueError:
        return None
    more = parts.path.strip("/") or parts.query or parts.fragment or parts.username
    if " " in address or not address.isprintable():
        return None
    return None if more or not address.startswith(f"{scheme}://") else (parts.hostname or "", port)
