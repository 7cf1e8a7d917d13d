"""Step 4: the markers on the model, clicked where they are in the first analysed frame; what the detector sees."""

from __future__ import annotations

import json
from contextlib import suppress
from typing import Any

from nicegui import ui

from ..record.errors import TowlineError
from ..record.looks import LOOKS
from .form import parsed, row_fields, shown
from .page_parts import Typed, button, choose, colour_of, keys_line, say
from .page_window import Step
from .sight import Detected

FIELDS = {str(field.where[-1]): field for field in row_fields("marker")}
"""The schema's fields of a marker, by key: the last part of their place."""


class MarksStep(Step):
    """Marks on the model."""

    title = "Marks"
    picks = True

    def __init__(self, window: Any) -> None:
        super().__init__(window)
        self.detector = True
        self._seen: Detected | None = None
        self._wanted = (-1, -1)
        self._looking = False
        self._words, self._kind = "", ""
        self._before = 0

    def build(self) -> None:
        """Draw the panel of markers."""
        session = self.session
        self._what = ui.label("").classes("big")
        self._said = say("", "soft", lines=1)
        with ui.row().style("gap: 18px; align-items: center"):
            snap = ui.checkbox("Snap to the mark", value=session.snapping, on_change=self._snap)
            made = ui.checkbox("Show what the detector sees", value=self.detector, on_change=self._set_detector)
            snap.props["aria-label"], made.props["aria-label"] = "Snap", "Detector"
        self._detector = say(self._words, self._kind, lines=2)
        for number, row in enumerate(session.doc.rows("marker")):
            self._row(number, row)
        with ui.row().style("margin-top: 12px"):
            button("First analysed frame", lambda: self.window.go(session.first_analysed()), "plain small")
            button("Add without a click", self._add, "plain small", "Add a marker")
        say("Ahead: from LCG towards the bow. Depth: below the datum plane, negative above it.", "soft")
        keys_line(("S", "snap"), ("Esc", "new mark"))
        self.changed()

    def _row(self, number: int, row: dict[str, Any]) -> None:
        name = str(row.get("name") or f"mark {number + 1}")
        chosen = " chosen" if number == self.session.selected["marker"] else ""
        with ui.element("div").classes(f"prow{chosen}").style("padding: 8px 4px; margin-top: 8px"):
            with ui.element("div").classes("rowhead").style("grid-template-columns: 1.5fr 1fr 1fr 1fr"):
                for word in ("name", "ahead, m", "starboard, m", "depth, m"):
                    ui.label(word)
            with ui.element("div").classes("prow").style("grid-template-columns: 1.5fr 1fr 1fr 1fr; border-top: 0"):
                Typed(f"name of mark {number + 1}", name, lambda said: self._put(number, "name", said))
                body = row.get("body_m")
                texts = [shown(v) for v in body] if isinstance(body, list) and len(body) == 2 else ["", ""]
                for axis, word in enumerate(("ahead", "starboard")):
                    Typed(
                        f"{word} of {name}",
                        texts[axis],
                        lambda said, axis=axis: self._place(number, texts, axis, said),
                        placeholder="0" if axis else "?",
                    )
                depth = shown(row.get("depth_m"))
                Typed(f"depth of {name}", depth, lambda said: self._put(number, "depth_m", said), placeholder="?")
            with (
                ui.element("div")
                .classes("prow")
                .style("grid-template-columns: 1.2fr 1.2fr 1fr auto auto; border-top: 0")
            ):
                offered = tuple(look.example or look.name for look in LOOKS.all())
                choose(f"look of {name}", offered, str(row.get("look", "led")), lambda v: self._put(number, "look", v))
                colours = FIELDS["colour"].choices
                choose(
                    f"colour of {name}",
                    colours,
                    str(row.get("colour", "bright")),
                    lambda v: self._put(number, "colour", v),
                )
                choose(
                    f"on of {name}",
                    FIELDS["on"].choices,
                    str(row.get("on", "model")),
                    lambda v: self._put(number, "on", v),
                )
                button(
                    "◎", lambda: self._choose(number), "plain small", f"Click {name}", "The next click says where it is"
                )
                button("×", lambda: self._remove(number), "plain small", f"Remove {name}", "Remove")
            pixel = row.get("seen_at_px")
            with ui.row().style("align-items: center; gap: 10px"):
                if isinstance(pixel, list):
                    say(f"seen at {shown(pixel)} px", "soft")
                    button("Forget", lambda: self._forget(number), "plain small", f"Forget where {name} is")
                else:
                    say("not clicked: the detector tells by distance, colour and line", "soft")

    def _put(self, number: int, key: str, text: str) -> None:
        self.session.doc.set(("marker", number, key), parsed(FIELDS[key], text))
        self.window.changed()

    def _place(self, number: int, texts: list[str], axis: int, text: str) -> None:
        """A place is taken when it is known how far ahead; left empty, the mark stands on the centre line."""
        parsed(FIELDS["depth_m"], text)
        texts[axis] = text.strip()
        if texts[0]:
            value = parsed(FIELDS["body_m"], " ".join(part or "0" for part in texts))
            name = self.session.doc.get("marker", number, "name") or number + 1
            self.session.doc.set(("marker", number, "body_m"), value, f"place of {name}")
        else:
            self.session.doc.set(("marker", number, "body_m"), None)
        self.window.changed()

    def _choose(self, number: int) -> None:
        session = self.session
        session.selected["marker"] = -1 if session.selected["marker"] == number else number
        self.window.go(session.first_analysed())
        self.window.draw()

    def _forget(self, number: int) -> None:
        self.session.doc.set(("marker", number, "seen_at_px"), None)
        self.window.redraw()

    def _remove(self, number: int) -> None:
        self.session.doc.remove_row("marker", number)
        self.session.selected["marker"] = -1
        self.window.redraw()

    def _add(self) -> None:
        names = {row.get("name") for row in self.session.doc.rows("marker")}
        name = next(n for n in ("bow", "stern", *(f"mark {k}" for k in range(3, 99))) if n not in names)
        self.session.doc.add_row("marker", {"name": name, "look": "led"})
        self.window.redraw()

    def _snap(self, event: Any) -> None:
        self.session.snapping = bool(event.value)

    def _set_detector(self, event: Any) -> None:
        self.detector = bool(event.value)
        self._wanted = (-1, -1)
        self.window.overlay()
        self.changed()

    async def pick(self, u_px: float, v_px: float, zoom: float) -> None:
        """A click sets where a marker is."""
        first = self.session.first_analysed()
        if self.session.index != first:
            self.window.tell(
                f"seen_at_px is meant in the first analysed frame, {first}; that frame is shown now", "warning"
            )
            self.window.go(first)
            return
        found = await self.window.snapped(u_px, v_px, zoom, self.session.snapping)
        if found is None:
            return
        number = self.session.pick_marker(found)
        self.session.selected["marker"] = -1
        self.window.redraw()
        self._said.text = found.words
        name = self.session.doc.rows("marker")[number]["name"]
        self.window.select(f"ahead of {name}")

    async def key(self, name: str) -> bool:
        """S and Escape."""
        if name == "snap":
            self.session.snapping = not self.session.snapping
        elif name == "escape" and self.session.selected["marker"] >= 0:
            self.session.selected["marker"] = -1
        else:
            return False
        self.window.draw()
        return True

    def changed(self) -> None:
        """What the next click does."""
        rows = self.session.doc.rows("marker")
        chosen = self.session.selected["marker"]
        name = rows[chosen].get("name") if 0 <= chosen < len(rows) else None
        self._what.text = f"Click {name}" if name else "Click the bow's mark" if not rows else "Click to add a mark"
        if not self.detector:
            self._tell("")

    def moved(self) -> None:
        """Look with the detector, one look at a time."""
        session = self.session
        wanted = (session.doc.version, session.index)
        if not self.detector or self._looking or wanted == self._wanted or session.frames is None:
            return
        if session.frames.known(session.index):
            self._looking, self._wanted = True, wanted
            self.window.soon(self._look)

    def tick(self) -> None:
        """Also after a change, and once the frame was read."""
        self.moved()

    async def _look(self) -> None:
        wanted = self._wanted
        self._tell("Detector: looking", "soft")  # what it says of another frame is not left standing
        try:
            seen = await self.window.work(self.session.detect, wanted[1])
        except TowlineError as error:
            self._tell(str(error), "warn")
            return
        finally:
            self._looking = False
        if self.window.step is not self or seen is None:
            self._wanted = (-1, -1)  # looked at again when the step is shown again
            return
        if wanted != (self.session.doc.version, self.session.index):
            self.moved()
            return
        self._seen = seen
        self._tell(f"Detector: {seen.words}", "good" if seen.marks_px else "warn")
        if self.window.viewer is not None:
            self.window.viewer.run_method("over", json.dumps(self.moving()))
        await self._look_ahead(wanted[1])

    def _tell(self, words: str, kind: str = "") -> None:
        """What the detector says; it stays when the rows are drawn anew."""
        self._words, self._kind = words, kind
        self._detector.text = words
        self._detector.classes(replace=f"say {kind}")

    async def _look_ahead(self, index: int) -> None:
        """The frame that the next step of the same length asks for."""
        coming, self._before = 2 * index - self._before, index
        frames = self.session.frames
        if coming != index and frames is not None and frames.known(coming):
            with suppress(TowlineError):  # told when the frame is shown
                await self.window.work(self.session.detect, coming)

    def still(self) -> dict[str, Any]:
        """Where the markers were clicked."""
        marks = []
        for number, row in enumerate(self.session.doc.rows("marker")):
            pixel = row.get("seen_at_px")
            if isinstance(pixel, list) and len(pixel) == 2:
                marks.append(
                    {
                        "u": pixel[0],
                        "v": pixel[1],
                        "label": "",
                        "colour": "#ffffff",
                        "shape": "cross",
                        "chosen": number == self.session.selected["marker"],
                    }
                )
        return {"marks": marks}

    def moving(self) -> dict[str, Any]:
        """What the detector sees, once it has looked at this frame."""
        if not self.detector or self._seen is None or self._wanted != (self.session.doc.version, self.session.index):
            return {}
        marks = [
            {"u": u, "v": v, "label": name, "colour": colour_of(k), "shape": "ring"}
            for k, (name, (u, v)) in enumerate(self._seen.marks_px.items())
        ]
        return {"spots": self._seen.spots_px.round(1).tolist(), "marks": marks}


__all__ = ["MarksStep"]
