"""Who may talk to the page: the browser that was let in, at the page's own address, and no other page in it.

An ASGI layer around everything that is served, web sockets too. A token that is good once lets a browser in. From then on two
secrets together say who asks: a cookie, which the browser also sends to every other port of this machine, and the first part
of the page's path, which it sends nowhere else. A request under another host's name, from another page's origin, or without
both gets 403.

Pages of results were written by whoever made the run folder. They stand at addresses of their own that hold neither secret, in
a sandbox: no script, no request, no form, no origin.
"""

from __future__ import annotations

import hmac
import re
import secrets
from collections.abc import Awaitable, Callable, MutableMapping
from typing import Any
from urllib.parse import parse_qs

from .address import HOSTS, RESULTS, TOKEN

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]
Served = Callable[[Scope, Receive, Send], Awaitable[None]]

MOST_BODY = 1 << 20
"""Bytes of a request; nothing is uploaded."""
MOST_FORM = 4096
"""Bytes of the form that brings a token."""
LENGTH = re.compile(r"[0-9]{1,15}")
SAFE = ("GET", "HEAD")
FORWARDED = b"x-forwarded-prefix"
"""How NiceGUI is told the path that stands before its own."""
CLOSE = (b"connection", b"close")
KEPT_HERE = [(b"x-content-type-options", b"nosniff"), (b"referrer-policy", b"no-referrer")]
ALONE = (
    "sandbox; default-src 'none'; img-src data:; style-src 'unsafe-inline'; "
    "connect-src 'none'; form-action 'none'; base-uri 'none'"
)
"""What a page of results may do: show its text, its own styles and the pictures that stand in it."""


def new_token() -> str:
    """A token that nobody guesses."""
    return secrets.token_urlsafe(32)


class Guard:
    """Lets through what comes from the session's own page, and pages of results to whoever has their address.

    Parameters
    ----------
    served : the ASGI application behind it
    taken : told a token; whether it lets in (it does so once)
    port : that the page is served at, on 127.0.0.1
    known : told the connection (host, port) of one that was let through
    """

    def __init__(
        self,
        served: Served,
        taken: Callable[[str], bool],
        port: int,
        known: Callable[[tuple[str, int]], None] = lambda _: None,
    ) -> None:
        self._served, self._taken, self._known = served, taken, known
        self._session, self._place = new_token(), new_token()
        self.cookie = f"towline_{port}"
        self._hosts = {f"{host}:{port}" for host in HOSTS}
        self._origins = {f"http://{host}" for host in self._hosts}
        own = " ".join(sorted(self._origins))
        self._page = _headers(
            "default-src 'self' data: blob: 'unsafe-inline' 'unsafe-eval'; "
            f"connect-src 'self' {' '.join(f'ws://{host}' for host in sorted(self._hosts))}; "
            "object-src 'none'; base-uri 'self'; form-action 'self'; frame-ancestors 'self'",
            (b"cross-origin-opener-policy", b"same-origin"),
        )
        self._result = _headers(f"{ALONE}; frame-ancestors {own}", (b"x-dns-prefetch-control", b"off"))

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] not in ("http", "websocket"):
            await self._served(scope, receive, send)
            return
        head = _head(scope)
        if head.get("host", "") not in self._hosts:
            await _refuse(scope, send, 403, "wrong host")
        elif scope["type"] == "http" and scope["path"] == "/":
            await self._door(scope, head, receive, send)
        elif scope["type"] == "http" and scope["path"].startswith(RESULTS):
            await self._show_result(scope, receive, send)
        else:
            await self._serve(scope, head, receive, send)

    async def _door(self, scope: Scope, head: dict[str, str], receive: Receive, send: Send) -> None:
        """Let in who brings a token, in the address or by a form (from whatever page: it has no secret but the token)."""
        given = ""
        if scope["method"] == "GET":
            given = _field(scope.get("query_string", b""))
        elif scope["method"] == "POST" and _length(head, MOST_FORM):
            given = _field(await _body(receive, MOST_FORM))
        if given and self._taken(given):
            self._pass(scope)
            await self._admit(send)
        else:
            why = "this token was used, or is none" if given else "open the address that towline app printed"
            await _refuse(scope, send, 403, why)

    async def _show_result(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["method"] not in SAFE:
            await _refuse(scope, send, 405, "results are only read")
            return

        async def sent(message: MutableMapping[str, Any]) -> None:
            if message["type"] == "http.response.start":
                if message["status"] == 200:
                    self._pass(scope)
                message["headers"] = [*message.get("headers", []), *self._result]
            await send(message)

        await self._served(scope, _bounded(receive), sent)

    async def _serve(self, scope: Scope, head: dict[str, str], receive: Receive, send: Send) -> None:
        """The page itself, its parts and its socket."""
        why = self._refused(scope, head)
        if why:
            await _refuse(scope, send, 403, why)
        elif not _length(head, MOST_BODY):
            await _refuse(scope, send, 413, "too large")
        else:
            self._pass(scope)
            self._strip(scope)
            receive = _bounded(receive) if scope["type"] == "http" else receive
            await self._served(scope, receive, _adding(send, self._page))

    def _refused(self, scope: Scope, head: dict[str, str]) -> str:
        """Why a request to the page is refused; "" = it is not."""
        origin = head.get("origin")
        if origin is None and (scope["type"] == "websocket" or scope["method"] not in SAFE):
            return "no origin"
        if origin is not None and origin not in self._origins:
            return "foreign origin"
        place = scope["path"].split("/", 2)[1:2]
        if not place or not _same(place[0], self._place):
            return "open the address that towline app printed"
        cookies = [value for name, value in _cookies(head.get("cookie", "")) if name == self.cookie]
        if not any(_same(value, self._session) for value in cookies):
            return "open the address that towline app printed"
        return ""

    def _strip(self, scope: Scope) -> None:
        """Take the page's place off the path; NiceGUI puts it before every address that it hands out.

        The scope itself is changed: layers outside this one look at its path after they were answered.
        """
        before = f"/{self._place}"
        scope["path"] = scope["path"].removeprefix(before) or "/"
        scope["raw_path"] = scope.get("raw_path", b"").removeprefix(before.encode()) or b"/"
        kept = [(name, value) for name, value in scope["headers"] if name.lower() != FORWARDED]
        scope["headers"] = [*kept, (FORWARDED, before.encode())]

    def _pass(self, scope: Scope) -> None:
        if scope.get("client"):
            self._known(tuple(scope["client"]))

    async def _admit(self, send: Send) -> None:
        """Hand out the cookie, and a page that goes on to the page.

        It goes on by itself, so that the browser takes that for the page's own wish: after a redirection of a form that came
        from a file it would keep the cookie back.
        """
        cookie = f"{self.cookie}={self._session}; HttpOnly; SameSite=Strict; Path=/"
        body = (
            f'<!doctype html><meta charset="utf-8"><meta http-equiv="refresh" content="0; url=/{self._place}/">'
            f'<title>towline</title><p><a href="/{self._place}/">towline</a></p>\n'
        ).encode()
        headers = [
            (b"content-type", b"text/html; charset=utf-8"),
            (b"set-cookie", cookie.encode()),
            (b"cache-control", b"no-store"),
            *_headers("default-src 'none'; frame-ancestors 'none'"),
            (b"content-length", str(len(body)).encode()),
        ]
        await send({"type": "http.response.start", "status": 200, "headers": headers})
        await send({"type": "http.response.body", "body": body})


def _headers(policy: str, *more: tuple[bytes, bytes]) -> list[tuple[bytes, bytes]]:
    return [
        (b"content-security-policy", policy.encode()),
        (b"cross-origin-resource-policy", b"same-origin"),
        *KEPT_HERE,
        *more,
    ]


def _adding(send: Send, added: list[tuple[bytes, bytes]]) -> Send:
    async def sent(message: MutableMapping[str, Any]) -> None:
        if message["type"] == "http.response.start":
            message["headers"] = [*message.get("headers", []), *added]
        await send(message)

    return sent


def _head(scope: Scope) -> dict[str, str]:
    return {name.decode("latin-1").lower(): value.decode("latin-1") for name, value in scope.get("headers", [])}


def _cookies(text: str) -> list[tuple[str, str]]:
    """All of them: another port may have set one of the same name."""
    pairs = (part.strip().partition("=") for part in text.split(";"))
    return [(name, value) for name, _, value in pairs]


def _same(one: str, other: str) -> bool:
    return hmac.compare_digest(one.encode("utf-8", "replace"), other.encode())


def _length(head: dict[str, str], most: int) -> bool:
    """What is said of the body's length is a number within bounds."""
    said = head.get("content-length", "0")
    return bool(LENGTH.fullmatch(said)) and int(said) <= most


def _field(form: bytes) -> str:
    """The token in a query or a form."""
    try:
        return parse_qs(form.decode("latin-1"), max_num_fields=10).get(TOKEN, [""])[0]
    except ValueError:
        return ""


async def _body(receive: Receive, most: int) -> bytes:
    """The whole body; empty where it is longer."""
    body, more = b"", True
    while more:
        message = await receive()
        body += message.get("body", b"")
        more = message["type"] == "http.request" and message.get("more_body", False)
        if len(body) > most:
            return b""
    return body


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
    """Say so and hang up: what comes after is not read."""
    if scope["type"] == "websocket":
        await send(
            {"type": "websocket.close", "code": 4403, "reason": why}
        )  # before it was accepted: the client sees 403
        return
    body = f"{status}: {why}\n".encode()
    length = (b"content-length", str(len(body)).encode())
    headers = [(b"content-type", b"text/plain; charset=utf-8"), length, CLOSE, *KEPT_HERE]
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": body})


__all__ = ["MOST_BODY", "Guard", "new_token"]
