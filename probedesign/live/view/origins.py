"""Who may talk to the page's server: the page itself, not whatever else a browser has open."""

import re
from functools import partial

from websockets.asyncio import server

LOCAL = ("127.0.0.1", "localhost", "::1")


def own_page_only(host: str) -> None:
    """Refuse, in this whole process, WebSockets that a page of another origin opens; any page of the internet could,
    to a server on the browser's own machine, and press its buttons. A server that is open to the network has names
    that nobody here knows, and is left as it is.

    Args:
        host: that is listened on.
    """
    if host not in LOCAL:
        return
    names = "|".join(re.escape(f"[{name}]" if ":" in name else name) for name in LOCAL)
    server.serve = partial(server.serve, origins=[re.compile(rf"http://({names})(:\d+)?")])  # type: ignore[misc, assignment]
