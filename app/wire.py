"""The wire below the page: connections of strangers are few, short, and bounded in what they hold.

Any user of the machine can connect. Until a connection has shown that it is the session's own (``Strangers.known``) it counts
as a stranger's: it is hung up on after a few seconds, and, of too many, the oldest. A head of a request holds at most
``MOST_HEAD`` bytes. So nobody can use up memory or files that are open, nor keep the session's own browser out.
"""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from typing import Any

MOST_HEAD = 16 << 10
"""Bytes of a request's first line and headers."""
MOST_STRANGERS = 200
"""Connections that are open at a time beside the session's own."""
WAIT_S = 10.0
"""For a stranger to show that it is none."""
Client = tuple[str, int]


def most_strangers() -> int:
    """How many connections of strangers may be open: a quarter of the files that this process may open, at most."""
    try:
        import resource

        soft = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    except (ImportError, OSError, ValueError):
        return MOST_STRANGERS
    return MOST_STRANGERS if soft < 0 else max(8, min(MOST_STRANGERS, soft // 4))


class Strangers:
    """Connections of which nobody knows yet who asks.

    Parameters
    ----------
    most : that are open at a time
    wait_s : for each to become known
    """

    def __init__(self, most: int = MOST_STRANGERS, wait_s: float = WAIT_S) -> None:
        self.most, self._wait_s = most, wait_s
        self._open: OrderedDict[Client, tuple[Any, asyncio.TimerHandle]] = OrderedDict()

    def came(self, client: Client, transport: Any, loop: asyncio.AbstractEventLoop) -> None:
        """A connection was made; where there are too many, the oldest goes."""
        self.known(client)
        self._open[client] = transport, loop.call_later(self._wait_s, self._hang_up, client)
        if len(self._open) > self.most:
            self._hang_up(next(iter(self._open)))

    def known(self, client: Client) -> None:
        """It is the session's own, or gone."""
        found = self._open.pop(client, None)
        if found is not None:
            found[1].cancel()

    def _hang_up(self, client: Client) -> None:
        found = self._open.pop(client, None)
        if found is not None:
            found[1].cancel()
            found[0].abort()

    def __len__(self) -> int:
        return len(self._open)


def protocol(strangers: Strangers) -> type[asyncio.Protocol]:
    """Uvicorn's protocol by h11 (which bounds the head), with a watch over strangers."""
    from uvicorn.protocols.http.h11_impl import H11Protocol
    from uvicorn.protocols.websockets.wsproto_impl import WSProtocol

    class Bounded(asyncio.Protocol):
        client: Client | None
        transport: Any

        def connection_lost(self, exc: Exception | None) -> None:
            if self.client is not None:
                strangers.known(self.client)
            super().connection_lost(exc)

        def data_received(self, data: bytes) -> None:
            try:
                super().data_received(data)
            except Exception:  # bytes that are no request, handshake or frame: whatever the parser made of them
                self.transport.abort()

    class Socket(Bounded, WSProtocol):
        pass

    class Watched(Bounded, H11Protocol):
        def connection_made(self, transport: Any) -> None:
            super().connection_made(transport)
            self.ws_protocol_class = Socket
            if self.client is not None:
                strangers.came(self.client, transport, self.loop)

    return Watched


__all__ = ["MOST_HEAD", "MOST_STRANGERS", "WAIT_S", "Strangers", "most_strangers", "protocol"]
