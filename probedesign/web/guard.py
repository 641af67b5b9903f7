"""The server of a local page: who may use it, and what it adds to viser's page.

Only the page's own origin may connect and, beyond this machine, only with a token. viser has no options for this: the
guard replaces `websockets.asyncio.server.serve`, which viser calls, so viser is pinned to its minor version.
"""

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
#: Reads a link's state no second time. States the size of the window, of which viser knows only what the panels leave,
#: and in drawn pixels. Follows the browser's colour scheme, with the
#: labels of the scene, which viser draws black on white. A tablet draws one pixel of the scene for each of the page.
#: A browser without a GPU draws without antialiasing, a third of a frame's time.
SCRIPT = """
(function () {
  document.cookie = 'probedesign_window=' + innerWidth + 'x' + innerHeight + '; SameSite=Strict; Path=/';
  var query = new URLSearchParams(location.search);
  query.delete('state');
  if (matchMedia('(prefers-color-scheme: dark)').matches) {
    query.set('darkMode', '');
    var source = WebGL2RenderingContext.prototype.shaderSource;
    WebGL2RenderingContext.prototype.shaderSource = function (shader, text) {
      return source.call(this, shader, text.replace('vec4(1.0, 1.0, 1.0, 0.85', 'vec4(0.08, 0.08, 0.08, 0.85')
        .replace('vec4(0.0, 0.0, 0.0, a)', 'vec4(0.9, 0.9, 0.9, a)'));
    };
  }
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


PHONE_WIDTH, PHONE_SCENE = 576, 0.45  #: Up to this width [px] viser has a sheet; share of the height above it.
#: Legible text; viser's note on a missing GPU as one line; on a phone the scene above a sheet of the full width.
STYLE = """
html { font-size: 16px !important; --mantine-font-size-xs: 14px; --mantine-font-family: system-ui, sans-serif }
body, input, button, textarea { font-family: system-ui, sans-serif !important; font-variant-numeric: tabular-nums }
[style*="letter-spacing"] { letter-spacing: 0 !important; font-size: 14px !important; line-height: 1.3 !important }
label { color: light-dark(#4d5761, #a9b2bb) !important }
.mantine-Slider-markLabel { font-size: 12px !important }
#webgl-software-rendering .mantine-Notification-description { display: none }
#webgl-software-rendering .mantine-Notification-title { font-size: 0 }
#webgl-software-rendering .mantine-Notification-title::after { content: "Drawn without a GPU"; font-size: 14px }
.mantine-Notifications-root { --notifications-container-width: 220px !important }
@media (max-width: PHONE_WIDTHpx) {
  div[style*="background-color"][style*="flex-grow"] { height: SCENE% !important }
  .mantine-Paper-root[style*="60%"] { width: 100% !important; height: SHEET%; max-height: SHEET% !important }
  .mantine-Paper-root [style*="width: 20em"] { width: 100% !important }
}
""".replace("PHONE_WIDTH", str(PHONE_WIDTH)).replace("SCENE", f"{100 * PHONE_SCENE:g}")
STYLE = STYLE.replace("SHEET", f"{100 * (1 - PHONE_SCENE):g}")


class LoopbackServer(viser.ViserServer):
    """A server without viser's tunnel to the internet, which any client could request."""

    def request_share_url(self, verbose: bool = True) -> None:
        """Do nothing: there is no public address."""


class Window:
    """The window of the browser that connected last."""

    size: tuple[float, float] = (1280.0, 720.0)  #: Width and height in pixels of the page.


def protect(title: str, token: str = "", head: str = "", on_link: Callable[[str], None] | None = None) -> Window:
    """Guard every server that viser starts from now on in this process.

    Args:
        title: title of the page in the browser.
        token: secret that a browser must know; empty on an address of this machine only.
        head: HTML that is added to the head of the page.
        on_link: receives `state` of the address at which a user opens the page; a link in another page has none.

    Returns:
        The window of the browser that connects last.
    """
    original, window = server.serve, Window()

    def serve(handler: object, host: str, port: int, *, process_request: Handler | None, **options: object) -> object:
        request_filter = RequestFilter(title, token, port, head, process_request, window, on_link)
        return original(handler, host, port, process_request=request_filter, **options)  # type: ignore[arg-type]  # viser's

    server.serve = serve  # type: ignore[misc, assignment]
    return window


class RequestFilter:
    """Decides about each request, and completes the responses of viser's own handler."""

    def __init__(
        self, title: str, token: str, port: int, head: str, serve_file: Handler | None, window: Window,
        on_link: Callable[[str], None] | None = None,
    ) -> None:  # fmt: skip
        self._token, self._serve_file, self._window, self._on_link = token, serve_file, window, on_link
        self._head = f"<title>{escape(title)}</title><script>{SCRIPT}</script><style>{STYLE}</style>{head}"
        self._cookie = f"probedesign_view_{port}"  # a browser sends cookies to all ports of a host

    def __call__(self, connection: server.ServerConnection, request: Request) -> Response | None:
        """Return the response to a request; None accepts a WebSocket."""
        host = request.headers.get("Host", "")
        if not self._token and _name(host) not in LOOPBACK:
            return _refusal("This page is open to this machine only.\n")  # a name that was bound to 127.0.0.1
        upgrade = request.headers.get("Upgrade", "").lower() == "websocket"
        origins = (f"http://{host}".lower(), f"https://{host}".lower())
        if upgrade and not (host and request.headers.get("Origin", "").lower() in origins):
            return _refusal("Only the page itself may connect.\n")
        if self._token and not self._matches(_cookie(request, self._cookie)):
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
        state = parse_qs(urlsplit(request.path).query).get("state")
        if state and self._on_link and request.headers.get("Sec-Fetch-Site", "none") in ("none", "same-origin"):
            self._on_link(state[-1])
        # viser's page is changed, so it must not come compressed.
        plain = [(name, value) for name, value in request.headers.raw_items() if name.lower() != "accept-encoding"]
        response = self._serve_file(connection, Request(request.path, Headers(plain)))
        if response is None:
            return None
        body = bytes(response.body or b"")
        if response.headers.get("Content-Type", "").startswith("text/html"):
            page = re.sub("<link[^>]*/>", f'<link rel="icon" href="{FAVICON}" />', body.decode(), count=1)
            body = page.replace("<title>Viser</title>", self._head, 1).encode()
        ours = {"Content-Length": str(len(body)), "Content-Encoding": "identity"} | HEADERS
        kept = {name: value for name, value in response.headers.raw_items() if name.title() not in ours}
        return Response(response.status_code, response.reason_phrase, Headers(kept | ours), body)

    def _matches(self, text: str) -> bool:
        return hmac.compare_digest(text.encode(), self._token.encode())


def _cookie(request: Request, name: str) -> str:
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
