"""Who may talk to the server: pages of its own address alone, and with its key alone.

The Host header is checked, so that no name that a foreign site lets point at this machine leads here. The Origin header
of a socket is checked, so that no page of another site opens one. The key is what other users of the machine lack.
"""

import time
from typing import Any
from urllib.parse import parse_qs

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

NAMES = ("127.0.0.1", "localhost")
"""By which a browser on this machine may call the server."""


class Guard:
    """Refuses requests with a foreign Host or Origin, and tells browsers to load nothing from elsewhere."""

    def __init__(self, app: ASGIApp, port: int):
        self.app = app
        self._hosts = {f"{name}:{port}" for name in NAMES}
        self._origins = {f"http://{host}" for host in self._hosts}
        sockets = " ".join(f"ws://{host}" for host in sorted(self._hosts))
        self._headers = {
            "content-security-policy": (
                f"default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; "
                f"connect-src 'self' {sockets}; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
            ),
            "x-content-type-options": "nosniff",
            "x-frame-options": "DENY",
            "referrer-policy": "no-referrer",
            "cross-origin-resource-policy": "same-origin",
            "cross-origin-opener-policy": "same-origin",
            "cache-control": "no-store",
        }

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self.app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        hosts, origins = headers.getlist("host"), headers.getlist("origin")
        known = len(hosts) == 1 and hosts[0].lower() in self._hosts
        asked = len(origins) == 1 and origins[0].lower() in self._origins
        if not known or not (asked or (scope["type"] == "http" and not origins)):
            if scope["type"] == "websocket":
                await send({"type": "websocket.close", "code": 1008})
            else:
                text = "manywake play: got another Host or Origin, wanted this machine's own address\n"
                await PlainTextResponse(text, 403)(scope, receive, send)
            return

        async def sending(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message).update(self._headers)
            await send(message)

        await self.app(scope, receive, sending)


def key(scope: Scope) -> str:
    """Return the key that a socket's address has, or nothing."""
    given: dict[str, Any] = parse_qs(scope["query_string"].decode("latin-1"), max_num_fields=4)
    return given.get("key", [""])[0]


class Bucket:
    """Bounds a rate: `burst` at once, `rate` a second."""

    def __init__(self, rate: float, burst: float):
        self._rate, self._burst = rate, burst
        self._left, self._last = burst, time.monotonic()

    def take(self) -> bool:
        """Return whether one more may pass."""
        now = time.monotonic()
        self._left = min(self._left + (now - self._last) * self._rate, self._burst)
        self._last = now
        if self._left < 1:
            return False
        self._left -= 1
        return True
