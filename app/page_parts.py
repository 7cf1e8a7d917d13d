"""Parts that the pages share: the frame viewer, the plots, buttons, and a field that commits what was typed when it is left."""

from __future__ import annotations

import html
from collections.abc import Awaitable, Callable, Sequence
from pathlib import Path
from typing import Any

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
    """A button; ``kind``: main, plain, stop, with " small"."""
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
    lines : that room is kept for. What changes by itself above things to click would move them from under the pointer.
    """
    return ui.label(text).classes(f"say {kind}").style(f"min-height: {lines}lh")


def keys_line(*pairs: tuple[str, str]) -> None:
    """What keys do, in one line."""
    parts = "&ensp; ".join(f"<kbd>{html.escape(key)}</kbd>&thinsp;{html.escape(what)}" for key, what in pairs)
    ui.html(parts, sanitize=False).classes("say soft")


def bullets(sentences: Sequence[str], kind: str = "") -> None:
    """Sentences as a list."""
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
        self.wrong = False
        self.element = ui.input(value=text, placeholder=placeholder).props(
            "outlined dense hide-bottom-space no-error-icon"
        )
        self.element.props["aria-label"] = label
        self.element.props["autocomplete"] = "off"
        # the browser's own event, sent before any key that is pressed next; Quasar's "blur" comes later by a timer
        self.element.on("change", lambda event: self._leave(str(event.args or "")))

    def put(self, text: str) -> None:
        """Show another text that is already committed."""
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


def choose(label: str, options: Sequence[str], value: str, commit: Callable[[str], None]) -> ui.select:
    """A list to choose from."""
    known = [*options] if value in options else [*options, value]
    made = ui.select(known, value=value, on_change=lambda e: commit(str(e.value))).props("outlined dense options-dense")
    made.props["aria-label"] = label
    return made


COLOURS = ("#ffb000", "#58c4ff", "#3ddc97", "#ff8adf", "#ffe14d", "#ff7a4d", "#c9b6ff")
"""Of marks over a dark picture, in their order."""


def colour_of(number: int) -> str:
    """The colour of the n-th mark."""
    return COLOURS[number % len(COLOURS)]
