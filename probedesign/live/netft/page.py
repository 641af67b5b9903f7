"""Fetching the box's page over HTTP: bounded in size and time, and watching it for changes."""

import threading
from http.client import HTTPConnection, HTTPException
from time import monotonic

from probedesign.errors import InputError
from probedesign.live.netft.configuration import Configuration, differences, parse_configuration
from probedesign.live.netft.wire import PAGE

MOST_BYTES = 65536
"""Of the page; a real one has some ten thousand."""
PATIENCE = 2.0
"""For the page [s]."""


def fetch_configuration(host: str, port: int) -> Configuration:
    """What the box says of itself now.

    Args:
        host: of the box.
        port: of its HTTP server.

    Raises:
        InputError: nobody answers, or not with a page of a Net F/T box.
    """
    return parse_configuration(fetch_page(host, port))


def fetch_page(host: str, port: int, patience: float = PATIENCE) -> bytes:
    """The page as it is.

    Args:
        host: of the box.
        port: of its HTTP server.
        patience: longest to wait [s].

    Raises:
        InputError: nobody answers, or not with a page.
    """
    address = f"http://{host}:{port}{PAGE}"
    connection = HTTPConnection(host, port, timeout=patience)
    try:
        connection.request("GET", PAGE, headers={"Connection": "close"})
        answer = connection.getresponse()
        page = b""
        deadline = monotonic() + patience
        while chunk := answer.read1(MOST_BYTES + 1 - len(page)):
            page += chunk
            if len(page) > MOST_BYTES or monotonic() > deadline:
                raise InputError(f"{address}: is too long or too slow for a Net F/T box")
    except (OSError, HTTPException, UnicodeError) as error:
        why = getattr(error, "strerror", None) or str(error) or type(error).__name__
        raise InputError(f"{address}: {why}; is the box on, and this its address and HTTP port?") from None
    finally:
        connection.close()
    if answer.status != 200:
        raise InputError(f"{address}: answers {answer.status}; is this a Net F/T box?")
    return page


class Watch:
    """Looks at the page now and then, for a configuration that changes while records stream.

    Attributes:
        changed: what is another now; empty as long as nothing is.
        period: of looking [s].
    """

    def __init__(self, host: str, port: int, first: Configuration, period: float) -> None:
        """Nothing runs yet.

        Args:
            host: of the box.
            port: of its HTTP server.
            first: what it said when it was opened.
            period: of looking [s].
        """
        self.changed: list[str] = []
        self.period = period
        self._host, self._port, self._first = host, port, first
        self._ended = threading.Event()

    def look(self) -> bool:
        """Look now; whether the page could be read."""
        try:
            page = fetch_page(self._host, self._port)
        except InputError:
            return False
        try:
            self.changed = differences(self._first, parse_configuration(page))
        except InputError as error:
            self.changed = [str(error)]
        return True

    def __enter__(self) -> "Watch":
        threading.Thread(target=self._watch, name="netft-watch", daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()

    def _watch(self) -> None:
        while not self._ended.wait(self.period) and not self.changed:
            self.look()
