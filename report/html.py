"""HTML building blocks that escape by default: a plain ``str`` is text, an ``Html`` is markup."""

from __future__ import annotations

import base64
import html
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pandas as pd

FIGURES = "figures"
"""Stands in the links to a page's data until the page has a name: ``write_document`` puts the folder's in its place."""


@dataclass(frozen=True)
class Drawn:
    """What a picture was drawn from.

    Attributes
    ----------
    name : of the CSV beside the page, without its suffix; a page has each once
    what : in words
    table : every number that was drawn, in the picture's units, which stand in the columns' names
    """

    name: str
    what: str
    table: pd.DataFrame


class Html(str):
    """Markup that may go into a page as it stands, with the data of the pictures in it.

    ``tag`` and ``join`` hand the data on from part to whole, so that they reach whoever writes the page.
    """

    drawn: tuple[Drawn, ...]

    def __new__(cls, text: str, drawn: tuple[Drawn, ...] = ()) -> Html:
        made = super().__new__(cls, text)
        made.drawn = drawn
        return made


def safe(content: object) -> Html:
    """``content`` as markup: Html stays, everything else becomes escaped text."""
    return content if isinstance(content, Html) else Html(html.escape(str(content), quote=True))


def join(parts: Iterable[object], between: str = "") -> Html:
    """The parts one after another.

    Parameters
    ----------
    parts : put between
    between : what stands between them
    """
    whole = [safe(part) for part in parts]
    return Html(safe(between).join(whole), tuple(one for part in whole for one in part.drawn))


def tag(name: str, *content: object, **attributes: str) -> Html:
    """``<name attribute="...">content</name>``; a trailing underscore in an attribute's name is dropped.

    Parameters
    ----------
    name : of the tag
    content : escaped unless it is HTML
    """
    written = "".join(f' {key.rstrip("_")}="{safe(value)}"' for key, value in attributes.items())
    inner = join(content)
    return Html(f"<{name}{written}>{inner}</{name}>", inner.drawn)


def number(text: str) -> Html:
    """A number's ASCII text with typographic signs; powers of ten written out."""
    shown = safe(text).replace("+-", "±")
    shown = re.sub(r"(?<![\w.])-(?=\d)", "−", shown)
    shown = re.sub(r"(\d)e([+-])0*(\d+)", lambda m: f"{m[1]}·10<sup>{'−' if m[2] == '-' else ''}{m[3]}</sup>", shown)
    return Html("–" if shown == "-" else shown)


def unit(text: str) -> Html:
    """A unit with its exponent raised: ``kg m2`` reads kg m², ``1/s2`` 1/s²."""
    return Html(re.sub(r"\b([ms])([23])\b", lambda m: m[1] + "²³"[int(m[2]) - 2], safe(text)))


def symbols(text: object) -> Html:
    """Text with the symbols in it set as such: ``Y_v`` with v lowered, ``N_rdot`` with the dot above, ``+-`` as one sign."""
    shown = re.sub(
        r"\b([A-Z])_([A-Za-z]+?)(dot)?((?:\|[vr]\|)|\b)",
        lambda m: f"<i>{m[1]}</i><sub>{m[2]}{chr(0x307) if m[3] else ''}{m[4]}</sub>",
        number(safe(text)),
    )
    return Html(shown)


def table(head: Sequence[object], rows: Iterable[Sequence[object]], *, kind: str = "", caption: object = "") -> Html:
    """A table; the first cell of a row is its heading.

    Parameters
    ----------
    head : cells of the head
    rows : cells of the rows
    kind : class of the table
    caption : below it
    """
    top = tag("tr", join(tag("th", cell, scope="col") for cell in head))
    body = [tag("tr", tag("th", row[0], scope="row"), join(tag("td", cell) for cell in row[1:])) for row in rows]
    title = tag("caption", caption) if caption else ""
    inner = tag("table", title, tag("thead", top), tag("tbody", join(body)), class_=kind)
    return tag("div", inner, class_="scroll")


def figure(image: Html, caption: object, *, before: object = "", of: str = "") -> Html:
    """A picture with its caption below, which leads to its data, and an optional key above; ``of`` begins the data's name.

    Parameters
    ----------
    image : the picture
    caption : below it
    before : above it
    of : beginning of the names of its tables
    """
    drawn = tuple(replace(one, name=f"{of}-{one.name}" if of else one.name) for one in image.drawn)
    links = [Html(f' <a class="data" href="{FIGURES}/{one.name}.csv">{one.name}.csv</a>') for one in drawn]
    words = Html(safe(caption).replace(" %", "\u00a0%"))
    return tag("figure", before, Html(image, drawn), tag("figcaption", words, *links))


def image(data: bytes, media_type: str, alternative: str, drawn: tuple[Drawn, ...] = ()) -> Html:
    """An inline image; ``alternative`` is what a screen reader says.

    Parameters
    ----------
    data : the encoded picture
    media_type : as "image/svg+xml"
    alternative : text for those who do not see the picture
    drawn : tables of what it shows
    """
    coded = base64.b64encode(data).decode("ascii")
    return Html(f'<img src="data:{media_type};base64,{coded}" alt="{safe(alternative)}">', drawn)


def bullets(items: Iterable[object]) -> Html:
    """An unordered list; nothing for no items."""
    rows = [tag("li", item) for item in items]
    return tag("ul", *rows) if rows else Html("")
