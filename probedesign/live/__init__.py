"""Live contact estimation: sources of wrench readings, tare, recordings, base poses, and the loop that estimates."""

from collections.abc import Callable
from urllib.parse import urlsplit

Log = Callable[[str], None]  #: Takes a message for the user.


def split_address(address: str, scheme: str) -> tuple[str, int | None]:
    """Return host, empty if absent, and port, None if absent, of `SCHEME://HOST:PORT`.

    Raises:
        ValueError: the address is not of this form.
    """
    parts = urlsplit(address)
    if (
        not address.startswith(f"{scheme}://")
        or parts.path.strip("/")
        or parts.query
        or parts.fragment
        or parts.username
    ):
        raise ValueError(f"{address} is not {scheme}://HOST:PORT")
    return parts.hostname or "", parts.port
