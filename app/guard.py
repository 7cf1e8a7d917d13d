"""Who may talk to the page: this machine's browser that was given the start address, and no other page in it.

An ASGI layer around everything that is served, web sockets too. The start address carries a token once; from then on a cookie
of the session says who asks. A request under another host's name, from another page's origin, or without the cookie gets 403.
"""

from __future__ import annotations

import hmac
import re
import secrets
from collections.abc import Awaitable, Callable, MutableMapping
from typing import Any
from urllib.parse import parse_qs

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]
Served = Callable[[Scope, Receive, Send], Awaitable[None]]

MOST_BODY = 1 << 20
"""Bytes of a request; nothing is uploaded."""
LENGTH = re.compile(r"[0-9]{1,15}")
TOKEN = "token"
SAFE = ("GET", "HEAD")


def new_token() -> str:
    """A token that nobody guesses."""
    return secrets.token_urlsafe(32)


class Guard:
    """Lets through what comes from the session's own page.

    Parameters
    ----------
    served : the ASGI application behind it
    token : of the start address
    port : that the page is served at, on 127.0.0.1
    """

    def __init__(self, served: Served, token: str, port: int) -> None:
        self._served, self._token = served, token
        self._session = new_token()
        self.cookie = f"towline_{port}"
        self._hosts = {f"127.0.0.1:{port}", f"localhost:{port}"}
        self._origins = {f"http://{host}" for host in self._hosts}
        self._policy = "; ".join(
            [
                "default-src 'self' data: blob: 'unsafe-inline' 'unsafe-eval'",
                "connect-src 'self' " + " ".join(f"ws://{host}" for host in sorted(self._hosts)),
                "object-src 'none'; base-uri 'self'; form-action 'self'; frame-ancestors 'self'",
            ]
        )

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] not in ("http", "websocket"):
            await self._served(scope, receive, send)
            return
        head = _head(scope)
        why = self._refused(scope, head)
        if why:
            await _refuse(scope, send, 403, why)
            return
        given = parse_qs(scope.get("query_string", b"").decode("latin-1")).get(TOKEN, [""])[0]
        if scope["type"] == "http" and given:
            if scope["path"] == "/" and scope["method"] == "GET" and _same(given, self._token):
                await self._admit(send)
            else:
                await _refuse(scope, send, 403, "wrong token")
            return
        if not _same(_cookies(head.get("cookie", "")).get(self.cookie, ""), self._session):
            await _refuse(scope, send, 403, "open the address that towline app printed")
            return
        if not LENGTH.fullmatch(head.get("content-length", "0")) or int(head.get("content-length", "0")) > MOST_BODY:
            await _refuse(scope, send, 413, "too large")
            return
        await self._served(scope, _bounded(receive) if scope["type"] == "http" else receive, self._with_policy(send))

    def _refused(self, scope: Scope, head: dict[str, str]) -> str:
        """Why a request is not even looked at; "" = it is."""
        if head.get("host", "") not in self._hosts:
            return "wrong host"
        origin = head.get("origin")
        changes = scope["type"] == "websocket" or scope["method"] not in SAFE
        if origin is None and changes:
            return "no origin"
        if origin is not None and origin not in self._origins:
            return "foreign origin"
        return ""

    async def _admit(self, send: Send) -> None:
        """Hand out the cookie and go on without the token in the address."""
        cookie = f"{self.cookie}={self._session}; HttpOnly; SameSite=Strict; Path=/"
        headers = [
            (b"location", b"/"),
            (b"set-cookie", cookie.encode()),
            (b"cache-control", b"no-store"),
            (b"referrer-policy", b"no-referrer"),
            (b"content-length", b"0"),
        ]
        await send({"type": "http.response.start", "status": 303, "headers": headers})
        await send({"type": "http.response.body", "body": b""})

    def _with_policy(self, send: Send) -> Send:
        added = [
            (b"content-security-policy", self._policy.encode()),
            (b"x-content-type-options", b"nosniff"),
            (b"referrer-policy", b"no-referrer"),
        ]

        async def sent(message: MutableMapping[str, Any]) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message.get("headers", []), *added]
            await send(message)

        return sent


def _head(scope: Scope) -> dict[str, str]:
    return {name.decode("latin-1").lower(): value.decode("latin-1") for name, value in scope.get("headers", [])}


def _cookies(text: str) -> dict[str, str]:
    pairs = (part.strip().partition("=") for part in text.split(";"))
    return {name: value for name, _, value in pairs}


def _same(one: str, other: str) -> bool:
    return hmac.compare_digest(one.encode("utf-8", "replace"), other.encode())


def _bounded(receive: Receive) -> Receive:
    """A body that says nothing of its length is cut off when it is too long."""
    taken = 0

    async def received() -> MutableMapping[str, Any]:
        nonlocal taken
        message = await receive()
        taken += len(message.get("body", b""))
        return {"type": "http.disconnect"} if taken > MOST_BODY else message

    return received


async def _refuse(scope: Scope, send: Send, status: int, why: str) -> None:
    if scope["type"] == "websocket":
        await send(
            {"type": "websocket.close", "code": 4403, "reason": why}
        )  # before it was accepted: the client sees 403
        return
    body = f"{status}: {why}\n".encode()
    headers = [(b"content-type", b"text/plain; charset=utf-8"), (b"content-length", str(len(body)).encode())]
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": body})


__all__ = ["MOST_BODY", "Guard", "new_token"]
