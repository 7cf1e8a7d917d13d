"""Part of step 6: play the recording, jump to losses and worst frames, set points right by clicks, seed marks and track on."""

from __future__ import annotations

import time
from typing import Any

from nicegui import ui

from ..record.corrections import HAND_SIGMA_PX
from ..record.errors import TowlineError
from ..record.tables import BY_HAND
from .correcting import Correcting
from .jumps import losses, next_of, worst
from .page_parts import Typed, button, choose, colour_of, keys_line, say, sigma_of
from .playing import SPEEDS, TURN_S, Player, other_speed

MODES = {"look": "Look", "move": "Move a point", "seed": "Seed"}
"""What a click into the frame does."""


class PlayBar:
    """Play, speed, and the jumps."""

    def __init__(self, step: Any) -> None:
        self.step, self.window, self.session = step, step.window, step.session
        self.player = Player()
        self._worst_at = self._told_at = -1

    def build(self) -> None:
        """Draw it."""
        self.player.stop()
        with ui.row().style("gap: 6px; align-items: center; margin-top: 8px; flex-wrap: nowrap"):
            self._play = button("Play", self.toggle, "plain small", "Play", "Play or stop (space)").style("width: 62px")
            names = [f"{speed:g}x" for speed in SPEEDS]
            self._speed = choose("Speed", names, f"{self.player.speed:g}x", self._at_speed).style("width: 84px")
            button("◀ Loss", lambda: self.loss(-1), "plain small", "Previous loss", "P")
            button("Loss ▶", lambda: self.loss(1), "plain small", "Next loss", "N")
            button("◀ Worst", lambda: self.worst(-1), "plain small", "Previous worst", "Shift+W")
            button("Worst ▶", lambda: self.worst(1), "plain small", "Next worst", "W")
        self._said = say("", "soft", lines=1)
        self._timer = ui.timer(TURN_S, self._turn, active=False)

    async def toggle(self) -> None:
        """Play, or stop."""
        frames = self.session.frames
        if self.player.running:
            await self.stop()
        elif frames is not None:
            last = self.session.index >= frames.count - 1
            self.player.start(self.session.go(0) if last else self.session.index, time.monotonic())
            self._show()

    async def stop(self) -> None:
        """Stay at the frame that is seen, which may be behind the one that is due by the clock."""
        if self.player.running:
            self.player.stop()
            self._show()
            await self.window.stay()

    def speed(self, way: int) -> None:
        """Faster or slower."""
        self._speed.value = f"{other_speed(self.player.speed, way):g}x"

    async def loss(self, way: int) -> None:
        """Go to the next or the previous loss."""
        await self.stop()
        tracks = self.session.shown().tracks
        found = [] if tracks is None else losses(tracks)
        there = next_of(found, self.session.index, way)
        if there is None:
            which = (
                "no tracks yet" if tracks is None else "no loss " + ("after" if way > 0 else "before") + " this frame"
            )
            self._said.text = which[0].upper() + which[1:]
            return
        self.window.go(there[0])
        self._told_at = self.session.index
        self._said.text = f"Loss {found.index(there) + 1} of {len(found)}: {there[1]}"

    async def worst(self, way: int) -> None:
        """Go through the worst frames."""
        await self.stop()
        tracks = self.session.shown().tracks
        found = [] if tracks is None else worst(tracks)
        if not found:
            self._said.text = "No tracks yet"
            return
        self._worst_at = (self._worst_at + way) % len(found) if self._worst_at >= 0 or way > 0 else len(found) - 1
        frame, words = found[self._worst_at]
        self.window.go(frame)
        self._told_at = self.session.index
        self._said.text = f"Worst {self._worst_at + 1} of {len(found)}: {words}"

    def moved(self) -> None:
        """What was said of a frame goes with it."""
        if self._told_at not in (-1, self.session.index):
            self._told_at, self._said.text = -1, ""

    def _at_speed(self, text: str) -> None:
        self.player.at_speed(float(text.removesuffix("x")), self.session.index, time.monotonic())

    def _turn(self) -> None:
        frames = self.session.frames
        if frames is None or not self.player.running:
            self._timer.active = False
            return
        self.window.go(
            self.player.due(self.session.index, time.monotonic(), frames.rate_hz or frames.info.rate_hz, frames.count)
        )
        if not self.player.running:
            self._show()

    def _show(self) -> None:
        self._timer.active = self.player.running
        self._play.text = "Stop" if self.player.running else "Play"


class CorrectPanel:
    """Points moved and removed, marks seeded, by clicks."""

    def __init__(self, step: Any) -> None:
        self.step, self.window, self.session = step, step.window, step.session
        self.mode, self.marker, self.sigma_px, self.snapping = "look", "", HAND_SIGMA_PX, False
        self._version, self._drawn = -1, False

    def build(self) -> None:
        """Draw it."""
        self._drawn = False
        try:
            correcting = self.session.correcting()
        except TowlineError as error:
            say(f"Nothing can be corrected yet: {error}", "warn")
            return
        self._drawn = True
        names = [marker.name for marker in correcting.markers]
        self.marker = self.marker if self.marker in names else names[0]
        with ui.row().style("gap: 10px; align-items: center; flex-wrap: nowrap"):
            say("A click:")
            self._modes = ui.radio(MODES, value=self.mode, on_change=lambda e: self.set_mode(str(e.value)))
            self._modes.props("inline dense").props["aria-label"] = "What a click does"
        with ui.row().style("gap: 8px; align-items: center; margin-top: 6px; flex-wrap: nowrap"):
            say("Mark")
            self._names = choose("Mark to correct", names, self.marker, self._choose).style("width: 120px")
            say("clicked to")
            Typed("Sigma of a correction", f"{self.sigma_px:g}", self._sigma).element.style("width: 66px")
            say("px")
            snap = ui.checkbox(
                "Snap", value=self.snapping, on_change=lambda e: setattr(self, "snapping", bool(e.value))
            )
            snap.props["aria-label"] = "Snap corrections"
        with ui.row().style("gap: 6px; margin-top: 6px; flex-wrap: nowrap"):
            button("Remove", self.remove, "plain small", "Remove point", "Lost in this frame (Del)")
            button(
                "As tracked", self.release, "plain small", "As tracked", "Neither set, removed nor seeded in this frame"
            )
            self._undo = button("Undo", self.undo, "plain small", "Undo correction", "Ctrl+Z")
            self._redo = button("Redo", self.redo, "plain small", "Redo correction", "Ctrl+Y")
            self._on = button("Track on from here", self.step.start, "main small", "Track on from here")
        self._here = say("", "soft", lines=2)
        self._count = say("", lines=1)
        keys_line(("M", "move"), ("D", "seed"), ("X", "next mark"), ("Del", "remove"), ("Esc", "look"))
        self.changed()

    def made(self) -> Correcting | None:
        """The corrections; None where the run is not complete yet."""
        try:
            return self.session.correcting()
        except TowlineError as error:
            self.window.tell(str(error), "warning")
            return None

    def set_mode(self, mode: str) -> None:
        """Say what a click does."""
        if self.mode != mode:
            self.mode = mode
            self._modes.value = mode
        if self.window.viewer is not None:
            self.window.viewer.props["mode"] = "look" if mode == "look" else "pick"

    def _choose(self, name: str) -> None:
        self.marker = name
        self.window.overlay()

    def _next_mark(self) -> None:
        correcting = self.made()
        if correcting is not None:
            names = [marker.name for marker in correcting.markers]
            self._names.value = names[(names.index(self.marker) + 1) % len(names)]

    def _sigma(self, text: str) -> None:
        self.sigma_px = sigma_of(text)

    # what the person does ----------------------------------------------------------------------------------------------

    async def pick(self, u_px: float, v_px: float, zoom: float) -> None:
        """A click sets the chosen mark's point, or its seed, in the frame it was made in."""
        frame, marker, correcting = self.session.index, self.marker, self.made()
        if self.mode == "look" or correcting is None or not self._analysed(frame):
            return
        # a picture that is shown smaller than it is cannot be clicked to less than a pixel of the screen
        place, sigma = (u_px, v_px), min(self.sigma_px / min(zoom, 1.0), 100.0)
        if self.snapping:
            found = await self.window.snapped(u_px, v_px, zoom, True)
            if found is None:
                return
            if found.found:
                place, sigma = found.pixel_px, found.sigma_px
            else:
                self.window.tell("Nothing to snap to; taken as clicked", "warning")
        if self.mode == "move":
            correcting.move(frame, marker, place, sigma)
        else:
            correcting.seed(frame, marker, place, sigma)
            rest = [m.name for m in correcting.markers if m.name not in correcting.seeds(frame)]
            if rest:
                self._names.value = rest[0]
        self.after()

    def remove(self) -> None:
        """The chosen mark is not where it was measured."""
        correcting = self.made()
        if correcting is not None and self._analysed(self.session.index):
            correcting.remove(self.session.index, self.marker)
            self.after()

    def release(self) -> None:
        """The chosen mark as the tracker has it."""
        correcting = self.made()
        if correcting is not None and correcting.release(self.session.index, self.marker):
            self.after()

    def undo(self) -> bool:
        """Take the last correction back; whether there was one."""
        return self._again(True)

    def redo(self) -> bool:
        """Do again what was taken back."""
        return self._again(False)

    def _again(self, back: bool) -> bool:
        correcting = self.made()
        what = "" if correcting is None else correcting.undo() if back else correcting.redo()
        if what:
            self.window.tell(f"{'Undone' if back else 'Done again'}: {what}")
            self.after()
        return bool(what)

    def _analysed(self, frame: int) -> bool:
        if self.session.analysed(frame):
            return True
        self.window.tell(f"Frame {frame} lies outside source.span_s; it is not analysed", "warning")
        return False

    def after(self) -> None:
        """Show what has changed."""
        self.window.state()
        self.window.overlay()
        self.changed()

    def tick(self) -> None:
        """Another window may have changed them."""
        kept = self.session.corrections
        if kept is not None and self._version >= 0 and kept.version != self._version:
            self.after()

    # what is shown -----------------------------------------------------------------------------------------------------

    def changed(self) -> None:
        """What there is, and what stands in this frame."""
        correcting = self.session.corrections
        if correcting is None or not self._drawn:
            return
        self._version = correcting.version
        self._count.text = correcting.words
        frame, tracks = self.session.index, self.session.shown().tracks
        rows = None if tracks is None else tracks[tracks["frame"] == frame]
        said = [self._said_of(correcting, frame, marker.name, rows) for marker in correcting.markers]
        self._here.text = "; ".join(said)
        self._undo.set_enabled(correcting.can_undo)
        self._redo.set_enabled(correcting.can_redo)
        ready = bool(correcting.seeds(frame)) and not self.session.worker.poll().running
        self._on.set_enabled(ready and not self.session.doc.faults())

    @staticmethod
    def _said_of(correcting: Correcting, frame: int, name: str, rows: Any) -> str:
        seed = ", seeded" if name in correcting.seeds(frame) else ""
        if (point := correcting.point(frame, name)) is not None:
            return f"{name} by hand, ±{point.sigma_px:g} px{seed}"
        if correcting.removed(frame, name):
            return f"{name} removed{seed}"
        own = None if rows is None else rows[rows["marker"] == name]
        if own is None or own.empty:
            return f"{name} not tracked{seed}"
        row = own.iloc[0]
        if row["status"] == "lost":
            why = row["reason"] if "reason" in own and isinstance(row["reason"], str) else ""
            return f"{name} lost{f' ({why})' if why else ''}{seed}"
        word = "by hand" if row["status"] == BY_HAND else row["status"]
        return f"{name} {word}, ±{max(row['sigma_u_px'], row['sigma_v_px']):.2g} px{seed}"

    def over(self, marks: list[dict[str, Any]], names: list[str]) -> list[dict[str, Any]]:
        """The marks of a frame with what is corrected in it: crosses where a person set them, none where one was removed."""
        correcting, frame = self.session.corrections, self.session.index
        if correcting is None:
            return marks
        order = [marker.name for marker in correcting.markers]
        colours = {name: colour_of(k) for k, name in enumerate([*names, *(n for n in order if n not in names)])}
        shown = [
            mark
            for mark in marks
            if correcting.point(frame, mark["name"]) is None and not correcting.removed(frame, mark["name"])
        ]
        for name in order:
            if (point := correcting.point(frame, name)) is not None:
                shown.append(_cross(point.pixel_px, f"{name} by hand", colours[name]))
        for name, seed in correcting.seeds(frame).items():
            shown.append(_cross(seed.pixel_px, f"{name} seed", colours.get(name, colour_of(0))))
        return shown

    async def key(self, name: str) -> bool:
        """A key of the page; whether it is one of these."""
        modes = {"move": "move", "seed": "seed", "escape": "look"}
        if not self._drawn:
            return False
        if name in modes:
            self.set_mode(modes[name])
            return name != "escape"
        if name == "undo":
            return self.undo()
        if name == "redo":
            return self.redo()
        calls = {"mark": self._next_mark, "remove": self.remove}
        if name in calls:
            calls[name]()
        return name in calls


def _cross(place_px: tuple[float, float], label: str, colour: str) -> dict[str, Any]:
    return {"u": place_px[0], "v": place_px[1], "label": label, "colour": colour, "shape": "cross"}


__all__ = ["CorrectPanel", "PlayBar"]
