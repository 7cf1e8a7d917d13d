"""Step 5: bow and stern digitised by hand where no mark can be tracked."""

from __future__ import annotations

from typing import Any

from nicegui import ui

from ..record.errors import InputError
from .byhand import FILE, SIGMA_PX
from .page_parts import Typed, button, colour_of, keys_line, say, sigma_of
from .page_window import Step


class HandStep(Step):
    """Clicks on every n-th frame."""

    title = "By hand"
    picks = True

    def __init__(self, window: Any) -> None:
        super().__init__(window)
        self.sigma_px = SIGMA_PX

    def build(self) -> None:
        """Draw the panel of marks by hand."""
        try:
            hand = self.session.hand()
        except InputError as error:
            ui.label("By hand").classes("big")
            say(error.message, "warn")
            self._what = None
            return
        self._what = ui.label("").classes("big")
        self._said = say("", "soft", lines=1)
        say(
            "For a model without lights or discs: click each mark on every n-th frame; the frames go on by themselves.",
            "soft",
        )
        with ui.row().style("gap: 12px; align-items: center; margin-top: 10px"):
            say("Every")
            Typed("Every n frames", str(hand.every), self._every).element.style("width: 76px")
            say("frames, clicked to")
            Typed("Sigma of a click", f"{self.sigma_px:g}", self._sigma).element.style("width: 76px")
            say("px")
        snap = ui.checkbox("Snap to a mark or corner next to the click", value=False, on_change=self._snap)
        snap.props["aria-label"] = "Snap clicks"
        self._snapping = False
        with ui.row().style("gap: 8px; margin-top: 8px"):
            button("Undo click", self._undo, "plain", "Undo click")
            button("Redo click", self._redo, "plain", "Redo click")
            button("Previous", lambda: self._jump(-1), "plain", "Previous frame to click")
            button("Next", lambda: self._jump(1), "plain", "Next frame to click")
        self._count = say("")
        with ui.row().style("gap: 8px; margin-top: 10px"):
            button(f"Save as {FILE}", self._save, "plain", "Save clicks")
            self._use = button("Use as the run's tracks", self._use_tracks, "main", "Use the clicks")
        self._source = say("", "soft")
        keys_line(("N", "next"), ("P", "previous"), ("Ctrl+Z", "undo click"), ("Ctrl+Y", "redo click"))
        self.window.go(hand.frame)
        self.changed()

    def _every(self, text: str) -> None:
        value = int(text) if text.strip().isdigit() else 0
        if not 1 <= value <= 100000:
            raise ValueError("a whole number from 1 on is expected")
        self.session.hand().every = value

    def _sigma(self, text: str) -> None:
        self.sigma_px = sigma_of(text)

    def _snap(self, event: Any) -> None:
        self._snapping = bool(event.value)

    async def pick(self, u_px: float, v_px: float, zoom: float) -> None:
        """A click is the wanted mark."""
        if self._what is None:
            return
        clicked, sigma = self.session.index, self.sigma_px
        if self._snapping:
            found = await self.window.snapped(u_px, v_px, zoom, True)
            if found is None:
                return
            (u_px, v_px), sigma = found.pixel_px, found.sigma_px if found.found else sigma
            self._said.text = found.words
        hand = self.session.hand()
        hand.frame = clicked  # the person may have gone on meanwhile
        if not hand.wanted:
            self.window.tell("This frame has all of its marks; undo one, or go on", "warning")
            return
        done = hand.click(u_px, v_px, sigma)
        last = None if self.session.frames is None else self.session.frames.count - 1
        if done and not hand.next_frame(last):
            self._said.text = "That was the last frame."
        self._after()

    def _after(self) -> None:
        self.window.go(self.session.hand().frame)
        self.window.state()
        self.window.overlay()
        self.changed()

    def _undo(self) -> None:
        if self.session.hand().undo() is not None:
            self._after()

    def _redo(self) -> None:
        if self.session.hand().redo() is not None:
            self._after()

    def _jump(self, way: int) -> None:
        hand = self.session.hand()
        hand.frame = self.session.go(self.session.index + way * hand.every)
        self.window.show()
        self.changed()

    def _save(self) -> None:
        hand = self.session.hand()
        if self.session.frames is not None and hand.clicks:
            hand.write(self.session.doc.folder, self.session.frames.time_s)
            self.window.tell(f"Saved {FILE}", "positive")
            self.window.state()

    def _use_tracks(self) -> None:
        if self.session.doc.get("source", "tracks") == FILE:
            self.session.use_video()
        else:
            if not self.session.hand().clicks:
                self.window.tell("Nothing was clicked yet", "warning")
                return
            self._save()
            self.session.use_hand_tracks()
        self.window.changed()
        self.changed()

    async def key(self, name: str) -> bool:
        """N, P, Ctrl+Z, Ctrl+Y."""
        if self._what is None or name not in ("next", "previous", "undo", "redo"):
            return False
        {"next": lambda: self._jump(1), "previous": lambda: self._jump(-1), "undo": self._undo, "redo": self._redo}[
            name
        ]()
        return True

    def moved(self) -> None:
        """The frame that is looked at is the one that is clicked."""
        if getattr(self, "_what", None) is not None:
            self.session.hand().frame = self.session.index
            self.changed()

    def changed(self) -> None:
        """What is clicked next."""
        if self._what is None:
            return
        hand = self.session.hand()
        self._what.text = f"Click: {hand.wanted}" if hand.wanted else "Frame done"
        self._count.text = f"{len(hand.frames)} frames done, {len(hand.clicks)} clicks" + (
            ", not saved" if hand.dirty else ""
        )
        used = self.session.doc.get("source", "tracks") == FILE
        self._use.text = "Track the video instead" if used else "Use as the run's tracks"
        self._source.text = (
            f"source.tracks = {FILE}: step 6 works the motion out from the clicks."
            if used
            else "Five frames or more, please."
        )

    def still(self) -> dict[str, Any]:
        """All clicks of the marks, as their paths."""
        if self.session.by_hand is None:
            return {}
        lines = []
        for k, name in enumerate(self.session.by_hand.markers):
            rows = sorted((c.frame, c.u_px, c.v_px) for c in self.session.by_hand.clicks if c.marker == name)
            if len(rows) > 1:
                lines.append({"points": [[u, v] for _, u, v in rows], "colour": colour_of(k), "opacity": 0.6})
        return {"lines": lines}

    def moving(self) -> dict[str, Any]:
        """The clicks of this frame."""
        if self.session.by_hand is None:
            return {}
        names = list(self.session.by_hand.markers)
        marks = [
            {"u": c.u_px, "v": c.v_px, "label": c.marker, "colour": colour_of(names.index(c.marker)), "shape": "cross"}
            for c in self.session.by_hand.clicks
            if c.frame == self.session.index and c.marker in names
        ]
        return {"marks": marks}


__all__ = ["HandStep"]
