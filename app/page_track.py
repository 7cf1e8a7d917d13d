"""Step 6: tracking with its progress, then alpha, beta and y_CG over time, tied to the frame that is shown."""

from __future__ import annotations

import json
from typing import Any

from nicegui import ui

from .motion_view import curves, marks_at, value_at
from .page_correct import CorrectPanel, PlayBar
from .page_parts import Plots, bullets, button, colour_of, keys_line, say
from .page_window import Step
from .worker import Status


class Progress:
    """A bar and a line about the job under way."""

    def __init__(self) -> None:
        self._box = ui.element("div").classes("bar").style("margin: 8px 0 4px 0")
        with self._box:
            self._fill = ui.element("div").classes("fill").style("width: 0%")
        self._text = say("")
        self._text.props["aria-live"] = "polite"
        self._last = ""

    def put(self, status: Status) -> None:
        """Show how it stands."""
        self._box.set_visibility(status.running)
        share = 100 * status.done / status.total if status.total else 100.0 * (status.took_s % 2.0) / 2.0
        if status.running:
            self._fill.style(f"width: {min(share, 100):.1f}%")
            count = f"{status.done} of {status.total} frames, " if status.total else ""
            text, kind = f"{status.text}: {count}{status.took_s:.0f} s", "say"
        elif status.error:
            text, kind = status.error, "say bad"
        elif status.stopped:
            text, kind = f"Stopped after {status.took_s:.1f} s; what was finished is kept.", "say warn"
        elif status.found is not None:
            text, kind = f"{status.found.title} done in {status.took_s:.1f} s.", "say good"
        else:
            text, kind = "", "say"
        if text != self._last:
            self._text.text = self._last = text
            self._text.classes(replace=kind)


class TrackStep(Step):
    """The motion."""

    title = "Track"

    def __init__(self, window: Any) -> None:
        super().__init__(window)
        self.bar, self.panel = PlayBar(self), CorrectPanel(self)
        self._view = "curves"

    @property
    def picks(self) -> bool:  # pyright: ignore
        """A click means something."""
        return self._view == "correct" and self.panel.mode != "look"

    def _turn(self, event: Any) -> None:
        self._view = str(event.value)
        self._turned()

    def _turned(self) -> None:
        self._correct.set_visibility(self._view == "correct")
        self._box.set_visibility(self._view == "curves")
        if self.window.viewer is not None:
            self.window.viewer.props["mode"] = "pick" if self.picks else "look"

    def build(self) -> None:
        """Draw the panel of tracking."""
        with ui.row().style("gap: 10px; align-items: center"):
            self._go = button("Track", self.start, "main", "Track")
            self._stop = button("Stop", self.session.worker.stop, "stop", "Stop")
            self._fresh = ui.checkbox("again from the start", value=False)
            self._fresh.props["aria-label"] = "Track again"
        self.bar.build()
        with ui.row().style("gap: 10px; align-items: center"):
            views = ui.radio({"curves": "Curves", "correct": "Correct"}, value=self._view, on_change=self._turn)
            views.props("inline dense").props["aria-label"] = "Curves or corrections"
        self._correct = ui.element("div")
        with self._correct:
            self.panel.build()
        self._progress = Progress()
        self._state = say("")
        self._said = ui.element("div")
        self._value = ui.label("").style("font-weight: 700; font-size: 17px; white-space: pre; margin-top: 6px")
        self._box = ui.element("div").classes("plotbox")
        with self._box:
            self._plots = Plots("No motion yet. Fill in the facts, datum and marks, then press Track.")
            self._plots.on("seek", lambda e: self._seek(float(e.args["t"])))
        keys_line(("space", "play"), ("[ ]", "speed"), ("N P", "losses"), ("W", "worst"), ("← →", "frame"))
        self._turned()
        self._number = -1
        self._read()
        self.tick()

    def changed(self) -> None:
        """The button says that it saves."""
        missing = len(self.session.doc.faults())
        self._go.text = "Save and track" if self.session.dirty else "Track"
        running = self.session.worker.poll().running
        self._go.set_enabled(not missing and not running)
        self._stop.set_visibility(running)
        if missing:
            self._state.text = f"{missing} things are missing or wrong in run.toml; step 1 lists them."
            self._state.classes(replace="say warn")
        else:
            shown = self.session.shown()
            self._state.text = shown.words
            self._state.classes(replace="say warn")
        self.panel.changed()

    def start(self) -> None:
        """Save, and track with all corrections."""
        if self.window.save() and self.session.worker.start(
            "track", [self.session.doc.folder], fresh=bool(self._fresh.value)
        ):
            self._said.clear()
            self.tick()

    def tick(self) -> None:
        """Follow the job."""
        self.panel.tick()
        status = self.session.worker.poll()
        if status.name == "track" or status.running:
            self._progress.put(status)
        else:
            self._progress.put(Status())
        if status.number != self._number or status.running != self._running:
            self._number, self._running = status.number, status.running
            self.changed()
            if status.name == "track" and status.found is not None:
                self._said.clear()
                with self._said:
                    bullets(status.found.sentences)
                self._read()

    _running = False

    def _read(self) -> None:
        shown = self.session.shown()
        self._plots.props["curves_json"] = "" if shown.motion is None else json.dumps(curves(shown.motion))
        self.changed()
        self.window.overlay()
        self.moved()

    def _seek(self, t_s: float) -> None:
        if self.session.frames is not None:
            self.window.go(self.session.frames.at_time(t_s))

    def moved(self) -> None:
        """The frame's time on the plots."""
        frames, shown = self.session.frames, self.session.shown()
        if frames is None:
            return
        t_s = frames.time_s(self.session.index)
        self._plots.run_method("at", t_s)
        self._value.text = "" if shown.motion is None else value_at(shown.motion, t_s)
        self.bar.moved()
        self.panel.changed()

    async def pick(self, u_px: float, v_px: float, zoom: float) -> None:
        """A click into the frame."""
        if self._view == "correct":
            await self.panel.pick(u_px, v_px, zoom)

    async def key(self, name: str) -> bool:
        """Space, speed and jumps; where corrections are made, theirs too."""
        calls = {
            "play": self.bar.toggle,
            "next": lambda: self.bar.loss(1),
            "previous": lambda: self.bar.loss(-1),
            "worst": lambda: self.bar.worst(1),
            "worst back": lambda: self.bar.worst(-1),
        }
        if name in calls:
            await calls[name]()
            return True
        if name in ("slower", "faster"):
            self.bar.speed(1 if name == "faster" else -1)
            return True
        if name in ("back", "on", "back25", "on25", "first", "last"):
            await self.bar.stop()
        return self._view == "correct" and await self.panel.key(name)

    def moving(self) -> dict[str, Any]:
        """The marks as tracked, with their last places."""
        tracks = self.session.shown().tracks
        if tracks is None:
            return {"marks": self.panel.over([], [])}
        places, trails = marks_at(tracks, self.session.index)
        order = {str(name): k for k, name in enumerate(tracks["marker"].unique())}
        marks = [
            {"u": u, "v": v, "name": name, "label": name, "colour": colour_of(order[name]), "shape": "ring"}
            for name, (u, v) in places.items()
        ]
        lines = [{"points": points, "colour": colour_of(order[name])} for name, points in trails.items()]
        return {"marks": self.panel.over(marks, list(order)), "lines": lines}


__all__ = ["Progress", "TrackStep"]
