"""Step 1: open a run, or begin one from a video; what is still missing in it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from nicegui import ui

from ..record.errors import InputError, TowlineError
from .page_parts import button, keys_line, say
from .page_window import Step
from .places import Place, places_below

STEP_OF = {"datum": 2, "marker": 3}
"""Where on the page what is missing in run.toml is filled in: the step's place in the row, from 0."""


class RunStep(Step):
    """The folder."""

    title = "Run"
    with_viewer = False
    for_pairs = True

    def build(self) -> None:
        """Draw the panel of the run: open, begin, what is missing."""
        session = self.session
        ui.html("<h2>Open a folder</h2>", sanitize=False)
        say("A run is a folder with a run.toml and a video. A folder with only a video becomes a new run.", "soft")
        with ui.element("div").classes("placerow").style("border-top: 0"):
            said = getattr(self, "_said", str(session.start))
            self._path = (
                ui.input(value=said, placeholder="folder", on_change=self._say).props("outlined dense").style("flex: 1")
            )
            self._path.props["aria-label"] = "Folder"
            self._path.on("keydown.enter", lambda: self._open(str(self._path.value or "")))
            button("Open", lambda: self._open(str(self._path.value or "")), "main", "Open folder")
            button("List", lambda: self._list(), "plain", "List folders", "Runs in this folder and below")
        self._fault = say("", "bad")
        self._found = ui.element("div")
        self._list()
        if session.document is not None:
            self._todo()
        ui.html("<h3>Keys</h3>", sanitize=False)
        keys_line(
            ("1 ... 8", "steps"), ("Ctrl+S", "save"), ("Ctrl+Z", "undo"), ("Ctrl+Y", "redo"), ("Esc", "leave a field")
        )
        keys_line(
            ("← →", "frame"),
            ("Shift+← →", "25 frames"),
            ("Home End", "first, last"),
            ("+ − 0", "zoom"),
            ("wheel", "zoom"),
            ("B", "brighter"),
        )

    def _say(self, event: Any) -> None:
        """What is typed stays when another window has this one drawn anew."""
        self._said = str(event.value or "")

    def _todo(self) -> None:
        document = self.session.doc
        what = f"{len(document.cameras)} cameras" if document.cameras else f"{len(document.rows('datum'))} datum points"
        ui.html(f"<h2 style='margin-top:18px'>{what}, {len(document.rows('marker'))} markers</h2>", sanitize=False)
        say(f"{document.folder}", "soft")
        faults = document.faults()
        if not faults:
            say("run.toml is complete.", "good")
            return
        say("Still missing or wrong:", "warn")
        for key, words in faults.items():
            with ui.element("div").classes("placerow"):
                array = key.partition("[")[0] or words.partition(":")[0]
                number = STEP_OF.get(array.partition(".")[0], 1)
                ui.label(f"{key}: {words}" if key else words).classes("path")
                button(
                    "Go there",
                    lambda number=number: self.window.go_step(number),
                    "plain small",
                    f"Go to {key or words}",
                )

    def _list(self) -> None:
        self._found.clear()
        try:
            start = str(self._path.value or "")
            found: list[Place] = places_below(self.session.start if not start else _folder(start))
        except TowlineError as error:
            self._fault.text = str(error)
            return
        self._fault.text = ""
        with self._found:
            if not found:
                say("No run and no video in this folder or below it.", "warn")
            for each in found[:60]:
                with ui.element("div").classes("placerow"):
                    ui.label(str(each.folder)).classes("path")
                    what = (
                        "run" if each.has_run else f"{len(each.videos)} video{'s' * (len(each.videos) > 1)}, no run yet"
                    )
                    ui.label(what).classes("what")
                    if each.has_run or len(each.videos) == 1:
                        word = "Open" if each.has_run else "Begin a run"
                        button(
                            word, lambda f=each.folder: self._open(str(f)), "plain small", f"{word} {each.folder.name}"
                        )
                    else:
                        for name in each.videos[:4]:
                            button(
                                f"Begin with {name}", lambda f=each.folder, n=name: self._open(str(f), n), "plain small"
                            )

    def _open(self, folder: str, video: str = "") -> None:
        if self.session.dirty and not self._asked(folder, video):
            return
        try:
            self.session.open(folder, video)
        except TowlineError as error:
            self._fault.text = str(error)
            return
        pair = bool(self.session.doc.cameras)
        self.window.go_step(self.window.home if pair or self.session.doc.faults() else 5)

    def _asked(self, folder: str, video: str) -> bool:
        """Ask before what is not saved is lost."""
        with ui.dialog() as dialog, ui.card():
            say("This run has changes that are not saved.")
            with ui.row():
                button(
                    "Save and go on", lambda: (dialog.close(), self.window.save() and self._open(folder, video)), "main"
                )
                button("Drop them", lambda: (dialog.close(), self.session.close(), self._open(folder, video)), "stop")
                button("Stay", dialog.close)
        dialog.open()
        return False


def _folder(text: str) -> Path:
    path = Path(text).expanduser()
    if not path.is_dir():
        raise InputError(path, "", "no such folder")
    return path


__all__ = ["RunStep"]
