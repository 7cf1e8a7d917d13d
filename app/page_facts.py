"""Step 2: every key of run.toml but the datum and the markers, with its unit, its sentence and what is wrong with it."""

from __future__ import annotations

import html

from nicegui import ui

from ..record.run import leads_out
from .form import UNITS, FormField, FormTable, parsed, shown, tables
from .page_parts import Typed, button, choose, say
from .page_window import Step

OPEN = ("", "source", "camera", "tow", "model", "water")
TITLES = {
    "": "The run",
    "source": "Recording",
    "noise": "Noise",
    "camera": "Camera",
    "tow": "Tow",
    "model": "Model",
    "water": "Water",
    "priors": "What is known beside the recording",
}
NAMES = {
    "tow.speed_m_s": "carriage speed, U",
    "tow.line_length_m": "line length, L",
    "tow.tow_point_m": "tow point, X_T",
    "tow.tow_point_offset_m": "tow point to starboard, Y_T",
    "tow.post_m": "tow post, x and y",
    "tow.tension_n": "line tension, T",
    "model.length_pp_m": "length between perpendiculars",
    "model.mass_kg": "mass, m",
    "model.rudder_arm_m": "rudder ahead of LCG",
    "camera.image_size_px": "picture size",
    "camera.fx_px": "focal length along u",
    "camera.fy_px": "focal length along v",
    "camera.cx_px": "principal point, u",
    "camera.cy_px": "principal point, v",
    "camera.sd": "standard deviations",
    "source.span_s": "part to analyse, from and to",
}
FILES = (
    "source.video",
    "source.tracks",
    "source.motion",
    "noise.static",
    "camera.calibration",
    "tow.speed",
    "tow.tension",
    "tow.rudder",
)
"""Keys that name a file, from the run folder on."""
ORDER = ("", "tow", "model", "water", "camera", "source", "noise", "priors")


class FactsStep(Step):
    """The form."""

    title = "Facts"
    with_viewer = False

    def build(self) -> None:
        """Draw the panel of facts: model, tow, water and the rest of run.toml."""
        self._errors: dict[str, ui.label] = {}
        self._typed: dict[str, tuple[Typed, FormField]] = {}
        self._chosen: list[tuple[ui.select, FormField]] = []
        found = {table.name: table for table in tables()}
        first = [found[name] for name in ORDER if name in found]
        rest = [table for name, table in found.items() if name not in ORDER]
        say(
            "Metres, seconds, kilograms, newtons, radians. x ahead, y to starboard, depth downwards. Empty = left out.",
            "soft",
        )
        for table in first:
            if table.name in OPEN:
                self._table(table)
            else:
                with ui.expansion(TITLES[table.name]).classes("w-full"):
                    self._table(table)
        with ui.expansion("Priors on the derivatives").classes("w-full"):
            for table in rest:
                self._table(table)
        self.changed()

    def _table(self, table: FormTable) -> None:
        with ui.row().style("align-items: center; gap: 16px; margin-top: 14px"):
            name = TITLES.get(table.name, table.words)
            ui.html(f"<h2 style='margin:0'>{html.escape(name)}</h2>", sanitize=False)
            if table.name == "camera":
                say("Leave all of it empty where the lens bends nothing.", "soft")
                button("Picture size from the video", self._size, "plain small", "Picture size from the video")
        with ui.element("div").classes("form"):
            for field in table.fields:
                self._field(field)

    def _field(self, field: FormField) -> None:
        text = shown(self.session.doc.get(*field.where))
        with ui.element("div").classes("ffield"):
            star = " *" if field.needed else ""
            ui.html(f'<div class="name">{html.escape(_name(field))}{star} <span class="key">{field.key}</span></div>',
                    sanitize=False)  # fmt: skip
            with ui.element("div").classes("line"):
                if field.kind == "choice":
                    made = choose(field.key, field.choices, text or field.default, lambda v: self._put(field, v))
                    made.style("flex: 1")
                    self._chosen.append((made, field))
                else:
                    typed = Typed(
                        field.key,
                        text,
                        lambda said: self._put(field, said),
                        lambda words: self._wrong(field, words),
                        field.default,
                    )
                    self._typed[field.key] = typed, field
                if field.unit:
                    ui.label(field.unit).classes("unit")
            ui.label(field.words).classes("words")
            self._errors[field.key] = ui.label("").classes("error")

    def _put(self, field: FormField, text: str) -> None:
        if text == (shown(self.session.doc.get(*field.where)) or (field.default if field.kind == "choice" else "")):
            return
        value = parsed(field, text)
        if field.key in FILES and value is not None:
            if leads_out(value) and not self.session.doc.outside:
                raise ValueError(f"{value!r} leads out of the run folder; outside = true at the top allows it")
            if not (self.session.doc.folder / value).is_file():
                raise ValueError(f"no such file: {value} (paths start at the run folder)")
        self.session.doc.set(field.where, value)
        self.window.changed()

    def _wrong(self, field: FormField, words: str) -> None:
        label = self._errors.get(field.key)
        if label is not None:
            label.text = words

    def _size(self) -> None:
        if self.session.frames is not None:
            self.session.doc.set(("camera", "image_size_px"), list(self.session.size_px))
            self.window.redraw()

    def refilled(self) -> bool:
        """The fields stand; their texts are put in."""
        for typed, field in self._typed.values():
            if typed.pending is None or not typed.wrong:
                self._wrong(field, "")
            typed.put(shown(self.session.doc.get(*field.where)))
        for made, field in self._chosen:
            made.value = shown(self.session.doc.get(*field.where)) or field.default
        self.changed()
        return True

    def changed(self) -> None:
        """Faults of the whole file at their fields; a text that was refused keeps its own words."""
        faults = self.session.doc.faults()
        for key, label in self._errors.items():
            typed = self._typed.get(key)
            if typed is not None and typed[0].wrong:
                continue
            words = faults.get(key, "")
            table_begun = "." not in key or self.session.doc.get(*key.split(".")[:-1]) is not None
            label.text = words if table_begun else ""


def _name(field: FormField) -> str:
    """The key's own words without its unit."""
    name = str(field.where[-1])
    for ending in sorted(UNITS, key=len, reverse=True):
        if name.endswith("_" + ending):
            name = name.removesuffix("_" + ending)
            break
    words = NAMES.get(field.key, name.replace("_", " "))
    return words[:1].upper() + words[1:] + (" (file)" if field.words.startswith("history of") else "")


__all__ = ["FactsStep"]
