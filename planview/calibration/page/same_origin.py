"""Who may talk to the page's server: the page itself."""

from __future__ import annotations

from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Receive, Scope, Send


class SameOriginOnly:
    """ASGI middleware that refuses requests and websockets of other pages.

    ``Host`` must be this machine's, which a name that an attacker points to 127.0.0.1 is not; ``Origin``, which
    browsers send with every websocket and which pages cannot forge, must be the page's own where there is one.
    """

    def __init__(self, app: ASGIApp, port: int) -> None:
        self._app = app
        self._hosts = {f"{name}:{port}".encode() for name in ("127.0.0.1", "localhost")}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass on what is the page's own."""
        kind, headers = scope["type"], scope.get("headers", ())
        hosts = [value for name, value in headers if name == b"host"]
        origins = [value.removeprefix(b"http://") for name, value in headers if name == b"origin"]
        own = len(hosts) == 1 and self._hosts.issuperset(hosts + origins)
        if own or kind not in ("http", "websocket"):
            await self._app(scope, receive, send)
        elif kind == "http":
            await PlainTextResponse("expected a request of the page itself\n", 403)(scope, receive, send)
        else:
            # Closed before it is accepted: the handshake is answered with 403.
            await send({"type": "websocket.close", "code": 1008})
