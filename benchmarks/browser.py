"""The Chromium of this machine, and how the measurements and the tests of the page start it."""

from __future__ import annotations

import shutil
from typing import Any

CHROMIUM = next(
    (path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), None
)
"""None: there is none."""
ARGUMENTS = [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]


def started(playwright: Any) -> Any:
    """A browser of ``playwright``, without a window."""
    return playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)


__all__ = ["CHROMIUM", "started"]
