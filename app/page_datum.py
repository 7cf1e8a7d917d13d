"""Step 3: datum points clicked in the frame, with their places in the tank; grid, residuals and the view from above at once."""

from __future__ import annotations

from typing import Any

from nicegui import ui

from .form import FormField, parsed, row_fields, shown
from .page_parts import Typed, bullets, button, keys_line, say
from .page_window import Step
from .sight import arrows_of, grid_of

FIELDS = {str(field.where[-1]): field for field in row_fields("datum")}
"""The schema's fields of a datum point, by key: the last part of their place."""
NUMBER = FormField(("marker", "depth_m"), "m", "", "number", False, "")
"""What one coordinate may be."""
DEPTH = 2
"""Place of the depth in tank_m."""
X_INK, Y_INK = "#6fd3ff", "#7dffa0"
EVERY_POINT = 8
"""Of a grid line, so many of its points are drawn."""


class DatumStep(Step):
    """Points of known place."""

    title = "Datum"
    picks = True

    def __init__(self, window: Any) -> None:
        super().__init__(window)
        self.grid = True

    def build(self) -> None:
        """Draw the panel of datum points."""
        session = self.session
        self._what = ui.label("").classes("big")
        self._said = say("", "soft", lines=1)
        with ui.row().style("gap: 18px; align-items: center"):
            snap = ui.checkbox("Snap to the mark", value=session.snapping, on_change=self._snap)
            grid = ui.checkbox("Grid", value=self.grid, on_change=self._set_grid)
            snap.props["aria-label"], grid.props["aria-label"] = "Snap", "Grid"
        self._fit = say("", lines=2)
        with ui.element("div").classes("rowhead datumrow").style("margin-top: 8px"):
            for word in ("point", "x, m", "y, m", "depth, m", "left over", "", ""):
                ui.label(word)
        self._left: list[ui.label] = []
        self._rows: list[ui.element] = []
        self._typed: list[tuple[str, list[Typed], list[str]]] = []
        self._before = -1
        self._list = ui.element("div")
        with self._list:
            for number, row in enumerate(session.doc.rows("datum")):
                self._row(number, row)
        self._top = ui.element("img").classes("top")
        self._top.props["alt"] = "view from above"
        self._notes = ui.element("div")
        keys_line(("G", "grid"), ("S", "snap"), ("Esc", "new point"))
        self.changed()

    def _row(self, number: int, row: dict[str, Any]) -> None:
        name = str(row.get("name") or f"point {number + 1}")
        with ui.element("div").classes("prow datumrow") as line:
            self._rows.append(line)
            Typed(f"name {number + 1}", str(row.get("name") or ""), lambda said: self._put(number, "name", said))
            texts = _texts(row)
            places = []
            for axis, word in enumerate(("x", "y", "depth")):
                places.append(
                    Typed(
                        f"{word} of {name}",
                        texts[axis],
                        lambda said, axis=axis: self._place(number, texts, axis, said),
                        placeholder="0" if axis == DEPTH else "?",
                    )
                )
            self._typed.append((str(row.get("name") or ""), places, texts))
            self._left.append(ui.label("").classes("left-over"))
            button(
                "◎",
                lambda: self._choose(number),
                "plain small",
                f"Pick {name} again",
                "Pick again: the next click moves it",
            )
            button("×", lambda: self._remove(number), "plain small", f"Remove {name}", "Remove")

    def _put(self, number: int, key: str, text: str) -> None:
        self.session.doc.set(("datum", number, key), parsed(FIELDS[key], text))
        self.window.changed()

    def _place(self, number: int, texts: list[str], axis: int, text: str) -> None:
        """A place is taken when x and y are there; a depth left empty is the datum plane's own, 0."""
        new = [*texts]
        new[axis] = text.strip()
        parsed(NUMBER, new[axis])
        texts[axis] = new[axis]
        if texts[0] and texts[1]:
            value = parsed(FIELDS["tank_m"], " ".join(part or "0" for part in texts))
            name = self.session.doc.get("datum", number, "name") or number + 1
            self.session.doc.set(("datum", number, "tank_m"), value, f"place of {name}")
        else:
            self.session.doc.set(("datum", number, "tank_m"), None)
        self.window.changed()

    def _choose(self, number: int) -> None:
        session = self.session
        session.selected["datum"] = -1 if session.selected["datum"] == number else number
        pixel = session.doc.get("datum", number, "pixel_px")
        if session.selected["datum"] == number and isinstance(pixel, list) and self.window.viewer is not None:
            self.window.viewer.run_method("zoomTo", pixel[0], pixel[1], 6)
        self.window.overlay()
        self.changed()

    def _remove(self, number: int) -> None:
        self.session.doc.remove_row("datum", number)
        self.session.selected["datum"] = -1
        self.window.redraw()

    def _snap(self, event: Any) -> None:
        self.session.snapping = bool(event.value)

    def _set_grid(self, event: Any) -> None:
        self.grid = bool(event.value)
        self.window.overlay()

    async def pick(self, u_px: float, v_px: float, zoom: float) -> None:
        """A click sets or moves a point."""
        found = await self.window.snapped(u_px, v_px, zoom, self.session.snapping)
        if found is None:
            return
        new = self.session.selected["datum"] < 0
        number = self.session.pick_datum(found)
        self.session.selected["datum"] = -1
        if new and self.window.step is self:  # the person may have gone on meanwhile
            rows = self.session.doc.rows("datum")
            with self._list:
                self._row(number, rows[number])
            self.window.changed()
            name = rows[number]["name"]
            self.window.select(f"x of {name}")
        else:
            self.window.changed()
        self._said.text = found.words

    async def key(self, name: str) -> bool:
        """G, S and Escape."""
        if name == "grid":
            self.grid = not self.grid
        elif name == "snap":
            self.session.snapping = not self.session.snapping
        elif name == "escape" and self.session.selected["datum"] >= 0:
            self.session.selected["datum"] = -1
        else:
            return False
        self.window.draw()
        return True

    def changed(self) -> None:
        """Residuals, the view from above, what the next click does."""
        session = self.session
        seen = session.sight()
        rows = session.doc.rows("datum")
        chosen = session.selected["datum"]
        if 0 <= chosen < len(rows):
            self._what.text = f"Click {rows[chosen].get('name') or chosen + 1} again"
        else:
            self._what.text = f"Click point {len(rows) + 1}" if len(rows) < 4 else "Click to add a point"
        for number, (label, line) in enumerate(zip(self._left, self._rows, strict=True)):
            label.text = self._left_over(number, rows[number])
            line.classes(add="chosen" if number == chosen else "", remove="" if number == chosen else "chosen")
        fit = seen.fit
        self._top.set_visibility(fit is not None)
        if fit is None:
            self._fit.text = seen.words[-1] if seen.words else ""
            self._fit.classes(replace="say warn")
        else:
            self._look_from_above()
            times = arrows_of(seen)[0]
            drawn = f" Yellow: what is left over, {times:g} times as large." if times else ""
            self._fit.text = (
                f"The points fit to {fit.rms_px:.2f} px rms (chi² {fit.chi_square:.1f} of {fit.degrees}).{drawn}"
            )
            self._fit.classes(replace="say good" if not fit.notes else "say")
        self._notes.clear()
        with self._notes:
            bullets([] if fit is None else list(seen.words), "warn")

    def _left_over(self, number: int, row: dict[str, Any]) -> str:
        seen = self.session.sight()
        sigma = row.get("sigma_px", 0.5)
        text = f"± {sigma:.2g} px" if isinstance(sigma, (int, float)) else ""
        if "tank_m" not in row:
            return f"type its place\n{text}"
        if seen.fit is None or number not in seen.numbers:
            return text
        k = seen.numbers.index(number)
        du, dv = seen.fit.residual_px[k]
        dx, dy = 1e3 * seen.fit.residual_m[k]
        out = "LEFT OUT " if k in seen.fit.excluded else ""
        off_px, off_mm = (du**2 + dv**2) ** 0.5, (dx**2 + dy**2) ** 0.5
        return f"{off_px:.{2 if off_px < 10 else 0}f} px, {off_mm:.{1 if off_mm < 100 else 0}f} mm\n{out}{text}"

    def tick(self) -> None:
        """The frame from above, once it stands still."""
        if self.session.index == self._before and self.session.sight().fit is not None:
            self._look_from_above()
        self._before = self.session.index

    def _look_from_above(self) -> None:
        url = f"top/{self.session.opened}/{self.session.doc.version}/{self.session.index}.jpg"
        if self._top.props.get("src") != url:
            self._top.props["src"] = url

    def refilled(self) -> bool:
        """The same rows with other numbers."""
        rows = self.session.doc.rows("datum")
        if len(rows) != len(self._typed):
            return False
        for row, (name, places, texts) in zip(rows, self._typed, strict=True):
            if str(row.get("name") or "") != name:
                return False
            texts[:] = _texts(row)
            for typed, text in zip(places, texts, strict=True):
                typed.put(text)
        self.changed()
        return True

    def still(self) -> dict[str, Any]:
        """Points with their enlarged residuals, and the grid."""
        seen = self.session.sight()
        arrows = arrows_of(seen)[1]
        along = {number: [du, dv] for number, du, dv in arrows}
        marks = []
        for number, row in enumerate(self.session.doc.rows("datum")):
            pixel = row.get("pixel_px")
            if not (isinstance(pixel, list) and len(pixel) == 2):
                continue
            marks.append(
                {
                    "u": pixel[0],
                    "v": pixel[1],
                    "label": row.get("name") or f"point {number + 1}",
                    "colour": "#ffffff",
                    "shape": "cross",
                    "chosen": number == self.session.selected["datum"],
                    "arrow": along.get(number),
                }
            )
        lines, texts = self._grid() if self.grid else ([], [])
        return {"marks": marks, "lines": lines, "texts": texts}

    def _grid(self) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
        import numpy as np

        lines, texts = [], []
        for line in grid_of(self.session.sight())[0]:
            points = line.pixel_px[::EVERY_POINT]
            points = points[np.isfinite(points).all(axis=1)]
            if len(points) < 2:
                continue
            ink = X_INK if line.axis == "x" else Y_INK
            lines.append({"points": points.round(1).tolist(), "colour": ink})
            end = points[np.argmax(points[:, 0])] if line.axis == "x" else points[np.argmax(points[:, 1])]
            texts.append(
                {"u": float(end[0]), "v": float(end[1]), "colour": ink, "text": f"{line.axis} {line.value_m:.4g}"}
            )
        return lines, texts


def _texts(row: dict[str, Any]) -> list[str]:
    tank = row.get("tank_m")
    return [shown(v) for v in tank] if isinstance(tank, list) and len(tank) == 3 else ["", "", ""]


__all__ = ["DatumStep"]
