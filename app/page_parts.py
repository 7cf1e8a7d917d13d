"""Parts that the pages share: the frame viewer, the plots, buttons, and a field that commits what was typed when it is left."""

from __future__ import annotations

import html
from collections.abc import Awaitable, Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

from nicegui import ui
from nicegui.element import Element

HOUSE = Path(__file__).parent
Handler = Callable[[], Any] | Callable[[], Awaitable[Any]]


class Viewer(Element, component="viewer.js"):
    """A frame with marks over it; emits ``pick`` with u, v, zoom and frame."""

    def __init__(self, size_px: tuple[int, int], empty: str = "") -> None:
        super().__init__()
        self.props["width"], self.props["height"] = size_px
        self.props["mode"], self.props["empty"], self.props["src"] = "look", empty, ""
        self.props["count"] = 0
        self.props["overlay"] = self.props["overlay_frame"] = ""


class Plots(Element, component="plots.js"):
    """Curves over time; emits ``seek`` with t."""

    def __init__(self, empty: str = "") -> None:
        super().__init__()
        self.props["curves_json"], self.props["empty"] = "", empty


def add_head() -> None:
    """Style and keys of the page."""
    ui.add_head_html(f"<style>{(HOUSE / 'page.css').read_text(encoding='utf-8')}</style>")
    ui.add_body_html(f"<script>{(HOUSE / 'keys.js').read_text(encoding='utf-8')}</script>")


def button(text: str, call: Handler, kind: str = "plain", label: str = "", tip: str = "") -> ui.button:
    """A button; ``kind``: main, plain, stop, with " small".

    Parameters
    ----------
    text : that is shown
    call : what a click does
    kind : class
    label : for those who hear the page
    tip : shown beside the mouse
    """
    made = ui.button(text, on_click=call, color=None).classes(kind).props("unelevated no-caps")
    if label:
        made.props["aria-label"] = label
    if tip:
        made.props["title"] = tip
    return made


def say(text: str, kind: str = "", lines: int = 0) -> ui.label:
    """A sentence.

    Parameters
    ----------
    text : that is shown
    kind : class
    lines : that room is kept for. What changes by itself above things to click would move them from under the pointer.
    """
    return ui.label(text).classes(f"say {kind}").style(f"min-height: {lines}lh")


def keys_line(*pairs: tuple[str, str]) -> None:
    """What keys do, in one line."""
    parts = "&ensp; ".join(f"<kbd>{html.escape(key)}</kbd>&thinsp;{html.escape(what)}" for key, what in pairs)
    ui.html(parts, sanitize=False).classes("say soft")


def bullets(sentences: Sequence[str], kind: str = "") -> None:
    """Sentences as a list.

    Parameters
    ----------
    sentences : one a point
    kind : class
    """
    if sentences:
        rows = "".join(f"<li>{html.escape(text)}</li>" for text in sentences)
        ui.html(f'<ul class="list {kind}">{rows}</ul>', sanitize=False)


class Typed:
    """An input that calls ``commit(text)`` when it is left or Enter is pressed, if its text changed.

    Parameters
    ----------
    label : for screen readers and tests
    commit : raises ValueError, whose words ``fault`` takes
    fault : shows what is wrong; "" = nothing
    """

    def __init__(
        self,
        label: str,
        text: str,
        commit: Callable[[str], None],
        fault: Callable[[str], None] | None = None,
        placeholder: str = "",
    ) -> None:
        self._commit, self._fault, self._last = commit, fault, text
        self.label, self.wrong = label, False
        self._held = False
        self.element = ui.input(value=text, placeholder=placeholder).props(
            "outlined dense hide-bottom-space no-error-icon"
        )
        self.element.props["aria-label"] = label
        self.element.props["autocomplete"] = "off"
        # the browser's own event, sent before any key that is pressed next; Quasar's "blur" comes later by a timer
        self.element.on("change", lambda event: self._leave(str(event.args or "")))
        # a text that was kept over a new drawing is none that the browser saw being typed: leaving the field tells nothing
        self.element.on("keydown.enter", lambda: self._leave(str(self.element.value or "")))
        _TYPED[self.element] = self

    @property
    def pending(self) -> str | None:
        """What was typed and is not taken; None = nothing."""
        text = str(self.element.value or "")
        return None if text == self._last else text

    @contextmanager
    def held(self) -> Iterator[None]:
        """What is being typed stays over the block; where it is told another text meanwhile, it says so."""
        self._held = self.pending is not None
        try:
            yield
        finally:
            self._held = False

    def keep(self, text: str, read: str) -> None:
        """Show a text that was typed into this field before it was drawn anew, when ``read`` was what stood in it."""
        theirs = self._last
        self.element.value = text
        if theirs != read:
            self._mark(_differs(theirs))

    def take(self) -> None:
        """Take what is pending, as when the field is left."""
        if (text := self.pending) is not None and not self.wrong:
            self._leave(text)

    @property
    def read(self) -> str:
        """The text that stands in run.toml, as far as this field was told."""
        return self._last

    def put(self, text: str) -> None:
        """Show another text that is already committed."""
        if self._held:
            if text != self._last:
                self._last = text
                self._mark("" if self.pending is None else _differs(text))
            return
        if text == self._last and not self.wrong and self.element.value == text:
            return
        self._last = text
        self.element.value = text
        self._mark("")

    def _leave(self, text: str) -> None:
        if text == self._last:
            return
        try:
            self._commit(text)
        except ValueError as error:
            self._mark(str(error))
            return
        self._last = text
        self._mark("")

    def _mark(self, words: str) -> None:
        self.wrong = bool(words)
        self.element.props["error"] = self.wrong
        self.element.props["title"] = words
        if self._fault is not None:
            self._fault(words)


_TYPED: WeakKeyDictionary[Element, Typed] = WeakKeyDictionary()


def typed_in(panel: Element) -> dict[str, Typed]:
    """The fields of a panel by their labels."""
    return {typed.label: typed for each in panel.descendants() if (typed := _TYPED.get(each)) is not None}


def _differs(theirs: str) -> str:
    return f"another window wrote {theirs or 'nothing'!r} here; yours is kept: Enter takes it, Undo brings theirs back"


def choose(label: str, options: Sequence[str], value: str, commit: Callable[[str], None]) -> ui.select:
    """A list to choose from.

    Parameters
    ----------
    label : for those who hear the page
    options : to choose from
    value : the present one
    commit : is given the new one
    """
    known = [*options] if value in options else [*options, value]
    made = ui.select(known, value=value, on_change=lambda e: commit(str(e.value))).props("outlined dense options-dense")
    made.props["aria-label"] = label
    return made


COLOURS = ("#ffb000", "#58c4ff", "#3ddc97", "#ff8adf", "#ffe14d", "#ff7a4d", "#c9b6ff")
"""Of marks over a dark picture, in their order."""


def sigma_of(text: str) -> float:
    """A point's standard deviation as a person types it, px.

    Parameters
    ----------
    text : what was typed

    Raises
    ------
    ValueError : no number, or not above 0 and at most 100, in words for the field
    """
    try:
        value = float(text)
    except ValueError:
        raise ValueError(f"{text!r} is no number") from None
    if not 0 < value <= 100:
        raise ValueError("above 0, at most 100 px")
    return value


def colour_of(number: int) -> str:
    """The colour of the n-th mark."""
    return COLOURS[number % len(COLOURS)]
