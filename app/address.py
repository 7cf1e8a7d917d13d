"""Addresses: where the page and its parts stand, and the ways in, which are good once.

The way in that the browser is given is a private file, so that no token stands among the arguments of a process, where every
user of the machine can read it.
"""

from __future__ import annotations

import contextlib
import hmac
import os
import secrets
import shutil
import tempfile
from pathlib import Path
from urllib.parse import quote

HOST = "127.0.0.1"
HOSTS = (HOST, "localhost")
TOKEN = "token"
RESULTS = "/result/"
PAGE = """<!doctype html>
<meta charset="utf-8">
<meta name="referrer" content="no-referrer">
<title>towline</title>
<form method="post" action="http://{host}:{port}/">
<input type="hidden" name="{name}" value="{token}">
<button>Open towline</button>
</form>
<script>document.forms[0].submit()</script>
"""
"""Sends the token in a form's body: no history, list of processes or other machine sees it."""


class WaysIn:
    """The link that is printed, good once, and the private file that opens the page, anew each time.

    Parameters
    ----------
    port : of the page

    Attributes
    ----------
    link : for whoever opens it by hand (another browser, a forwarded port)
    file : for the browser; only this user can read it, and a token in it that was used is replaced
    """

    def __init__(self, port: int) -> None:
        self._port = port
        self._once = secrets.token_urlsafe(32)
        self._filed = ""
        self._folder = Path(tempfile.mkdtemp(prefix="towline-"))
        self.link = f"http://{HOST}:{port}/?{TOKEN}={self._once}"
        self.file = self._folder / "open.html"
        self._renew()

    def taken(self, token: str) -> bool:
        """Whether a token lets in; the same one does not again."""
        if _same(token, self._once):
            self._once = ""
            return True
        if _same(token, self._filed):
            self._renew()
            return True
        return False

    def _renew(self) -> None:
        self._filed = secrets.token_urlsafe(32)
        text = PAGE.format(host=HOST, port=self._port, name=TOKEN, token=self._filed)
        with contextlib.suppress(
            OSError
        ):  # somebody tidied the temporary files, or the disk is full: the printed link remains
            new = self._folder / "new.html"
            with open(os.open(new, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "w", encoding="utf-8") as stream:
                stream.write(text)
            os.replace(new, self.file)

    def close(self) -> None:
        """Remove the file."""
        shutil.rmtree(self._folder, ignore_errors=True)


def result_address(key: str, name: str) -> str:
    """Where a page of results stands.

    Parameters
    ----------
    key : of the result
    name : of its file
    """
    return f"{RESULTS}{key}/{quote(name)}"


def _same(one: str, other: str) -> bool:
    return bool(other) and hmac.compare_digest(one.encode("utf-8", "replace"), other.encode())


__all__ = ["HOST", "HOSTS", "RESULTS", "TOKEN", "WaysIn", "result_address"]
