"""The server of a local page: who may use it, and what it adds to viser's page.

Only the page's own origin may connect and, beyond this machine, only with a token. viser has no options for this: the
guard replaces `websockets.asyncio.server.serve`, which viser calls, so viser is pinned to its minor version.
"""

import gzip
import hmac
import http
import re
from collections.abc import Callable
from html import escape
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs, quote, urlsplit

import viser
from websockets.asyncio import server
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from probedesign.web import LOOPBACK

Handler = Callable[[server.ServerConnection, Request], Response | None]

#: Headers of every response: no other page may show this one in a frame, under its own buttons.
HEADERS = {
    "Content-Security-Policy": "frame-ancestors 'none'",
    "X-Frame-Options": "DENY",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
}
NEEDS_TOKEN = "This page needs the address with its token, which the terminal of the run shows.\n"
_ICON = (
    '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 32 32"><rect width="32" height="32" rx="6" fill="#26547c"/>'
    '<path d="M5 10h4v12H5z" fill="#d5dbe1"/><path d="M9 11l18 4v2L9 21z" fill="#ec9242"/>'
    '<circle cx="20" cy="13" r="3" fill="#c81e28"/></svg>'
)
FAVICON = f"data:image/svg+xml,{quote(_ICON)}"  #: The probe with a contact, as the address of the icon.
#: Cookie with the size of the browser's window, and that pattern.
WINDOW, _SIZE = "probedesign_window", re.compile(r"(\d{1,5})x(\d{1,5})")
#: States the size of the window, of which viser knows only what the panels leave, and in drawn pixels. Follows the
#: browser's colour scheme. A tablet draws one pixel of the scene for each of the page. A browser without a GPU draws
#: without antialiasing, a third of a frame's time.
SCRIPT = """
(function () {
  document.cookie = 'probedesign_window=' + innerWidth + 'x' + innerHeight + '; SameSite=Strict; Path=/';
  var query = new URLSearchParams(location.search);
  if (matchMedia('(prefers-color-scheme: dark)').matches) query.set('darkMode', '');
  if (matchMedia('(pointer: coarse)').matches) query.set('fixedDpr', '1');
  history.replaceState(null, '', location.pathname + '?' + query.toString());
  var context = HTMLCanvasElement.prototype.getContext, software = null;
  HTMLCanvasElement.prototype.getContext = function (kind, options) {
    if (kind !== 'webgl2') return context.call(this, kind, options);
    if (software === null) {
      var gl = context.call(document.createElement('canvas'), kind);
      var named = gl && gl.getExtension('WEBGL_debug_renderer_info');
      software = !!named && /swiftshader|llvmpipe|software/i.test(gl.getParameter(named.UNMASKED_RENDERER_WEBGL));
      if (gl) gl.getExtension('WEBGL_lose_context').loseContext();
    }
    return context.call(this, kind, software ? Object.assign({}, options, {antialias: false}) : options);
  };
})();
"""


class LoopbackServer(viser.ViserServer):
    """A server without viser's tunnel to the internet, which any client could request."""

    def request_share_url(self, verbose: bool = True) -> None:
        """Do nothing: there is no public address."""


class Window:
    """The window of the browser that connected last."""

    size: tuple[float, float] = (1280.0, 720.0)  #: Width and height in pixels of the page.


def protect(title: str, token: str = "", head: str = "") -> Window:
    """Guard every server that viser starts from now on in this process.

    Args:
        title: title of the page in the browser.
        token: secret that a browser must know; empty on an address of this machine only.
        head: HTML that is added to the head of the page.

    Returns:
        The window of the browser that connects last.
    """
    original, window = server.serve, Window()

    def serve(handler: object, host: str, port: int, *, process_request: Handler | None, **options: object) -> object:
        request_filter = RequestFilter(title, token, port, head, process_request, window)
        return original(handler, host, port, process_request=request_filter, **options)  # type: ignore[arg-type]  # viser's

    server.serve = serve  # type: ignore[misc, assignment]
    return window


class RequestFilter:
    """Decides about each request, and completes the responses of viser's own handler."""

    def __init__(
        self, title: str, token: str, port: int, head: str, serve_file: Handler | None, window: Window
    ) -> None:
        self._token, self._serve_file, self._window = token, serve_file, window
        self._head = f"<title>{escape(title)}</title><script>{SCRIPT}</script>{head}"
        self._cookie = f"probedesign_view_{port}"  # a browser sends cookies to all ports of a host
        self._pages: dict[int, bytes] = {}

    def __call__(self, connection: server.ServerConnection, request: Request) -> Response | None:
        """Return the response to a request; None accepts a WebSocket."""
        host = request.headers.get("Host", "")
        if not self._token and _name(host) not in LOOPBACK:
            return _refusal("This page is open to this machine only.\n")  # a name that was bound to 127.0.0.1
        upgrade = request.headers.get("Upgrade", "").lower() == "websocket"
        origins = (f"http://{host}".lower(), f"https://{host}".lower())
        if upgrade and not (host and request.headers.get("Origin", "").lower() in origins):
            return _refusal("Only the page itself may connect.\n")
        if self._token and not self._is_known(request):
            tokens = parse_qs(urlsplit(request.path).query).get("token", [])
            if not upgrade and any(map(self._matches, tokens)):
                cookie = f"{self._cookie}={self._token}; HttpOnly; SameSite=Strict; Path=/"
                headers = Headers({"Location": "/", "Set-Cookie": cookie, "Content-Length": "0"} | HEADERS)
                return Response(http.HTTPStatus.SEE_OTHER, "See Other", headers)
            return _refusal(NEEDS_TOKEN)
        if upgrade and (size := _SIZE.fullmatch(_cookie(request, WINDOW))):
            self._window.size = float(size[1]), float(size[2])
        if upgrade or self._serve_file is None:
            return None
        accepted = request.headers.get("Accept-Encoding", "")
        plain = Headers(
            [(name, value) for name, value in request.headers.raw_items() if name.lower() != "accept-encoding"]
        )
        response = self._serve_file(connection, Request(request.path, plain))
        return None if response is None else self._complete(response, "gzip" in accepted)

    def _is_known(self, request: Request) -> bool:
        return self._matches(_cookie(request, self._cookie))

    def _matches(self, text: str) -> bool:
        return hmac.compare_digest(text.encode(), self._token.encode())

    def _complete(self, response: Response, zipped: bool) -> Response:
        """Return a response of viser with our headers, and its page with our title, icon, style and script."""
        body = bytes(response.body or b"")
        if response.headers.get("Content-Type", "").startswith("text/html"):
            key = len(body) * 2 + zipped
            if key not in self._pages:
                page = self._page(body.decode()).encode()
                self._pages[key] = gzip.compress(page) if zipped else page
            body = self._pages[key]
        else:
            zipped = False
        ours = {"Content-Length": str(len(body)), "Content-Encoding": "gzip" if zipped else "identity"} | HEADERS
        kept = {name: value for name, value in response.headers.raw_items() if name.title() not in ours}
        headers = Headers(kept | ours)
        return Response(response.status_code, response.reason_phrase, headers, body)

    def _page(self, text: str) -> str:
        text = re.sub("<link[^>]*/>", f'<link rel="icon" href="{FAVICON}" />', text, count=1)
        before, _, after = text.partition("<title>Viser</title>")
        return f"{before}{self._head}{after}"


def _cookie(request: Request, name: str) -> str:
    """Return the value of a cookie; empty if the request has none."""
    try:
        cookies = SimpleCookie("; ".join(request.headers.get_all("Cookie")))
    except CookieError:
        return ""
    return cookies[name].value if name in cookies else ""


def _name(host: str) -> str:
    try:
        return urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return ""


def _refusal(text: str) -> Response:
    body = text.encode()
    about = {"Content-Type": "text/plain; charset=utf-8", "Content-Length": str(len(body))}
    return Response(http.HTTPStatus.FORBIDDEN, "Forbidden", Headers(about | HEADERS), body)
