"""The box's page `netftapi2.xml` over HTTP."""

from collections.abc import Callable
from dataclasses import fields
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from xml.sax.saxutils import escape

from probedesign.live.netft.configuration import TAGS, Configuration
from probedesign.live.netft.wire import PAGE


def page_of(configuration: Configuration) -> bytes:
    """The page that tells a configuration."""
    lines = ['<?xml version="1.0" encoding="UTF-8"?>', "<netft>"]
    for name in (f.name for f in fields(configuration)):
        lines.append(f"<{TAGS[name]}>{escape(_text(getattr(configuration, name)))}</{TAGS[name]}>")
    return "\n".join([*lines, "</netft>", ""]).encode()


def _text(value: object) -> str:
    if isinstance(value, tuple):
        return ";".join(f"{v:.9g}" for v in value)
    return f"{value:.9g}" if isinstance(value, float) else str(value)


class PageServer(ThreadingHTTPServer):
    """Serves the page as long as there is one."""

    daemon_threads = True
    block_on_close = False

    def __init__(self, address: tuple[str, int], page: Callable[[], bytes | None]) -> None:
        """Listen.

        Args:
            address: host and port; port 0 lets the system choose.
            page: what to serve; None answers nothing, as a box does that is off.
        """
        self.page = page
        super().__init__(address, _Handler)


class _Handler(BaseHTTPRequestHandler):
    server: PageServer
    timeout = 5.0  # of a client that says nothing

    def do_GET(self) -> None:
        page = self.server.page()
        if page is None:
            self.close_connection = True
            return
        found = self.path.partition("?")[0] == PAGE
        body = page if found else b""
        self.send_response(200 if found else 404)
        self.send_header("Content-Type", "text/xml")
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Connection", "close")
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: object) -> None:
        """Nothing is told of what clients ask."""
