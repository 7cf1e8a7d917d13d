"""Names, of files and in them, as text that any output takes: a byte in a name that is no UTF-8 is written as \\xff."""

from __future__ import annotations

import codecs
import unicodedata

BYTES_SHOWN = "towline_bytes_shown"
"""The error handler (``errors=``) that does it."""
UNSEEN = ("Cc", "Zl", "Zp")
"""Unicode's categories of control letters (a terminal obeys them) and of what ends a line."""
TURNING = ("LRE", "RLE", "LRO", "RLO", "PDF", "LRI", "RLI", "FSI", "PDI")
"""Its directions of letters that turn what follows around: with one in a name the rest of the line reads backwards."""


def _shown_bytes(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    letters = error.object[error.start : error.end]
    return "".join(_shown_letter(ord(letter)) for letter in letters), error.end


def _shown_letter(code: int) -> str:
    """Python keeps byte B of a file's name that is no UTF-8 as letter 0xDC00 + B."""
    if 0xDC80 <= code <= 0xDCFF:
        return f"\\x{code - 0xDC00:02x}"
    return f"\\u{code:04x}" if code <= 0xFFFF else f"\\U{code:08x}"


codecs.register_error(BYTES_SHOWN, _shown_bytes)


def shown(text: str) -> str:
    """``text`` with such bytes written out; any other text as it is."""
    return text.encode("utf-8", BYTES_SHOWN).decode("utf-8")


def in_one_line(text: str) -> str:
    """``text`` as ``shown``, with every control letter, line break and turn of direction written out as well: a name may hold any,
    and a message that quotes it stays one line that steers no terminal and reads as it is.

    >>> print(in_one_line("t\\x0bow\\n"))
    t\\x0bow\\n
    """
    return shown("".join(ascii(c)[1:-1] if _unseen(c) else c for c in text))


def lines_joined(text: str) -> str:
    """``text`` ``in_one_line``, its line breaks and runs of blanks a blank each: a message in words.

    >>> print(lines_joined("no space\\n  left"))
    no space left
    """
    return in_one_line(" ".join(text.split()))


def _unseen(letter: str) -> bool:
    return unicodedata.category(letter) in UNSEEN or unicodedata.bidirectional(letter) in TURNING


def take_any_name(*streams: object) -> None:
    """Let standard output and standard error take names of files with any bytes."""
    for stream in streams:
        reconfigure = getattr(stream, "reconfigure", None)
        if reconfigure is not None:
            reconfigure(errors=BYTES_SHOWN)


__all__ = ["BYTES_SHOWN", "in_one_line", "lines_joined", "shown", "take_any_name"]
