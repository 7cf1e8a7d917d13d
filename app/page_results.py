"""Step 7: check, identify, steady, diagnose over one run or several, with the pages that the commands write."""

from __future__ import annotations

import html
from pathlib import Path

from nicegui import ui

from ..record.errors import InputError
from .address import result_address
from .jobs import Found
from .page_parts import bullets, button, choose, say
from .page_track import Progress
from .page_window import Step
from .places import page_file, places_below

FORMS = {"full sine and kinematics": "full", "linear": "linear"}
MOST_RUNS = 40
"""Of the runs beside the one that is open so many are offered: what a list can show."""


class ResultsStep(Step):
    """What the runs say together."""

    title = "Results"
    with_viewer = False

    def build(self) -> None:
        """Draw the panel of results: runs, commands, and the pages they write."""
        self._number, self._running = -1, False
        self._picked: dict[Path, ui.checkbox] = {}
        here = self.session.doc.folder
        with ui.element("div").style("display: flex; gap: 22px; height: 100%"):
            with ui.element("div").style("flex: 0 0 440px; overflow-y: auto; padding-right: 6px"):
                ui.html("<h2>Runs</h2>", sanitize=False)
                for place in self._runs(here):
                    name = place.name if place.parent == here.parent else str(place)
                    box = ui.checkbox(name, value=place == here)
                    box.props["aria-label"] = f"Run {place.name}"
                    self._picked[place] = box
                ui.html("<h3>What to work out</h3>", sanitize=False)
                with ui.row().style("gap: 8px"):
                    button("Check", lambda: self._start("check"), "main", "Check", "Is the camera right?")
                    button("Identify", lambda: self._start("identify"), "main", "Identify", "The six derivatives")
                    button("Steady", lambda: self._start("steady"), "main", "Steady", "Neutral point of steady tows")
                    button("Diagnose", lambda: self._start("diagnose"), "main", "Diagnose", "Which effect is missing?")
                with ui.row().style("gap: 8px; align-items: center; margin-top: 8px"):
                    say("Equations:")
                    self._form = next(iter(FORMS))
                    choose("Equations", tuple(FORMS), self._form, self._set_form).style("width: 250px")
                self._stop = button("Stop", self.session.worker.stop, "stop", "Stop")
                self._progress = Progress()
                self._found = ui.element("div")
                self._reports = ui.element("div")
            with ui.element("div").style("flex: 1; min-width: 0; display: flex; flex-direction: column; gap: 6px"):
                self._frame_bar = ui.row().style("align-items: center; gap: 12px")
                self._hint = ui.label("The report of what is worked out stands here.").classes("hint")
                self._frame = ui.element("iframe").classes("result").style("flex: 1")
                self._frame.set_visibility(False)
                self._frame.props["title"] = "Report"
                self._frame.props["sandbox"] = ""
        self._list_reports()
        self.tick()

    def _runs(self, here: Path) -> list[Path]:
        beside = [p.folder for p in places_below(here.parent) if p.has_run][:MOST_RUNS]
        return beside if here in beside else [here, *beside]

    def _set_form(self, name: str) -> None:
        self._form = name

    def _start(self, name: str) -> None:
        folders = [path for path, box in self._picked.items() if box.value]
        if not folders:
            self.window.tell("Tick a run first", "warning")
            return
        if not self.window.save():
            return
        options = {"form": FORMS[self._form]} if name == "identify" else {}
        if not self.session.worker.start(name, folders, **options):
            self.window.tell("A job is under way", "warning")
        self.tick()

    def tick(self) -> None:
        """Follow the job."""
        status = self.session.worker.poll()
        self._progress.put(status)
        if (status.number, status.running) == (self._number, self._running):
            return
        self._number, self._running = status.number, status.running
        self._stop.set_visibility(status.running)
        self._found.clear()
        if status.found is not None:
            with self._found:
                self._show(status.found)
            self._list_reports()
            if status.found.pages:
                self._open(status.found.pages[0])

    def _show(self, found: Found) -> None:
        ui.html(f"<h3>{html.escape(found.title)}</h3>", sanitize=False)
        if found.rows:
            rows = "".join(f"<tr>{''.join(f'<td>{html.escape(cell)}</td>' for cell in row)}</tr>" for row in found.rows)
            ui.html(f'<table class="found" aria-label="{found.title} result">{rows}</table>', sanitize=False)
        bullets(found.sentences)
        bullets([f"{name}: {why}" for name, why in found.failed.items()], "bad")

    def _list_reports(self) -> None:
        """Pages that lie in out/ already."""
        self._reports.clear()
        folder = self.session.doc.folder
        places = [folder / "out", folder.parent / "out"]
        known = sorted({*(p for place in places for p in place.glob("*.html")), *self.session.pages.values()})
        with self._reports:
            if known:
                ui.html("<h3>Reports</h3>", sanitize=False)
            for path in known:
                name = f"{path.parent.parent.name}: {path.name}"
                try:
                    page_file(path, path.name)
                except InputError as error:
                    say(f"{name}: not shown, {error.message}", "warn")
                    continue
                button(name, lambda path=path: self._open(path), "plain small", f"Report {name}").style(
                    "margin: 3px 6px 3px 0"
                )

    def _open(self, path: Path) -> None:
        try:
            url = f"{result_address(self.session.show_page(path), path.name)}?at={path.stat().st_mtime_ns}"
        except (InputError, OSError) as error:
            self.window.tell(str(error), "negative")
            return
        self._frame.props["src"] = url
        self._frame.set_visibility(True)
        self._hint.set_visibility(False)
        self._frame_bar.clear()
        with self._frame_bar:
            name = ui.label("/".join(path.parts[-3:])).style("font-weight: 650; overflow-wrap: anywhere")
            name.props["title"] = str(path)
            link = ui.element("a").style("font-weight: 650; color: var(--blue)")
            link.props["href"], link.props["target"], link.props["rel"] = url, "_blank", "noopener noreferrer"
            with link:
                ui.label("Open in a tab of its own")


__all__ = ["ResultsStep"]
