"""The page's frame: name and state of the run on top, the steps, the recording on the left, what a step asks on the right."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

from nicegui import run, ui

from ..record.errors import TowlineError
from .page_parts import Viewer, add_head, button, typed_in
from .session import Session
from .snap import Snapped

TICK_S = 0.2
"""The page looks for news so often."""
STAY_S = 5.0
"""The page is asked which frame is seen, and is waited for as long."""
LARGE_STEP = 25
"""Frames to a large step, as its keys and buttons say."""


class Step:
    """One step of the work; what a page can do beside drawing itself."""

    title = ""
    with_viewer = True
    picks = False
    for_pairs = False
    """It also takes a run that two cameras film."""

    def __init__(self, window: Window) -> None:
        self.window, self.session = window, window.session

    def build(self) -> None:
        """Draw the panel."""

    def changed(self) -> None:
        """run.toml changed."""

    def refilled(self) -> bool:
        """Show another text of run.toml (undo, redo) without drawing anew; False where that is not enough."""
        return False

    def moved(self) -> None:
        """Another frame is shown."""

    def tick(self) -> None:
        """Called a few times a second."""

    def still(self) -> dict[str, Any]:
        """What is drawn over every frame."""
        return {}

    def moving(self) -> dict[str, Any]:
        """What is drawn over the frame that is shown."""
        return {}

    async def pick(self, u_px: float, v_px: float, zoom: float) -> None:
        """A click into the frame."""

    async def key(self, name: str) -> bool:
        """A key; whether the step took it."""
        return False


class Window:
    """The page of one browser window over the one session.

    Attributes
    ----------
    step : the one that is shown
    """

    def __init__(self, session: Session, kinds: list[Callable[[Window], Step]]) -> None:
        self.session = session
        self._steps = [kind(self) for kind in kinds]
        self.number = 0 if session.document is None else self.home
        self.viewer: Viewer | None = None
        self._slider: ui.slider | None = None
        self._now: ui.label | None = None
        self._seen = (-1, -1)
        self._told = ""
        self._count = 0
        self._busy = False
        self._drawn: tuple[int, tuple[int, int]] = (-1, (0, 0))

    @property
    def home(self) -> int:
        """The step where work at the open run begins: the facts, or, of a run of two cameras, the one that films it."""
        return len(self._steps) - 1 if self.session.document is not None and self.session.document.cameras else 1

    @property
    def step(self) -> Step:
        """The step that is shown."""
        return self._steps[self.number]

    def build(self) -> None:
        """Draw everything."""
        add_head()
        self._client = ui.context.client
        self._client.on_exception(lambda e: self.tell(f"A fault of the program: {type(e).__name__}: {e}", "negative"))
        with ui.element("div").classes("head"):
            ui.label("towline").classes("brand")
            self._name = ui.label("").classes("runname")
            self._pill = ui.label("").classes("pill")
            ui.element("div").classes("room")
            self._undo = button("Undo", self.undo, "plain", "Undo")
            self._redo = button("Redo", self.redo, "plain", "Redo")
            self._save = button("Save", self.save, "main", "Save", "Write run.toml (Ctrl+S)")
        with ui.element("nav").classes("steps"):
            self._tabs = [
                button(f"{k}  {step.title}", lambda k=k: self.go_step(k - 1), "step", f"Step {step.title}", f"Key {k}")
                for k, step in enumerate(self._steps, 1)
            ]
        with ui.element("div").classes("body"):
            self._left = ui.element("div").classes("left")
            self._panel = ui.element("div").classes("whole")
        ui.on("hall_key", lambda e: self.key(str(e.args)))
        ui.timer(TICK_S, self._tick)
        self.draw()

    # drawing -----------------------------------------------------------------------------------------------------------

    def go_step(self, number: int) -> None:
        """Show another step."""
        if self.session.document is None and number > 0:
            self.tell("Open a folder first", "warning")
            return
        if not self._steps[number].for_pairs and self.session.document is not None and self.session.document.cameras:
            self.tell(
                f"{self._steps[number].title} takes a run of one camera; one of two is filmed in step Live", "warning"
            )
            return
        self.number = number
        self.draw()

    def draw(self) -> None:
        """Draw the step anew; the frame with its zoom stays."""
        for k, tab in enumerate(self._tabs):
            tab.classes(add="here" if k == self.number else "", remove="" if k == self.number else "here")
        with_frame = self.step.with_viewer and self.session.document is not None
        if with_frame and (self.viewer is None or self._drawn != (self.session.opened, self.session.size_px)):
            self._draw_left()
        self._left.set_visibility(with_frame)
        self._panel.clear()
        self._panel.classes(replace="side" if with_frame else "whole")
        with self._panel:
            self.step.build()
        if self.viewer is not None:
            self.viewer.props["mode"] = "pick" if self.step.picks else "look"
            self.viewer.props["empty"] = self.session.video_problem or "reading the recording ..."
        self.state()
        self.overlay()
        self.show()

    def _draw_left(self) -> None:
        self._left.clear()
        self._drawn = (self.session.opened, self.session.size_px)
        with self._left:
            self.viewer = Viewer(self.session.size_px)
            self.viewer.on("pick", self._picked)
            with ui.element("div").classes("scrub"):
                button("◀", lambda: self.go(self.session.index - 1), "plain small", "Frame back", "One frame back (←)")
                button("▶", lambda: self.go(self.session.index + 1), "plain small", "Frame on", "One frame on (→)")
                self._count = self._frames()
                self._slider = ui.slider(min=0, max=max(self._count - 1, 1), value=self.session.index, step=1)
                self._slider.props["aria-label"] = "Frame"
                self._slider.on("update:model-value", lambda e: self.go(int(e.args)), throttle=0.03)
                self._now = ui.label("").classes("now")

    def _frames(self) -> int:
        return 0 if self.session.frames is None else self.session.frames.count

    def state(self) -> None:
        """The head: name, saved or not, what undo would do."""
        session = self.session
        document = session.document
        self._name.text = "" if document is None else f"{document.get('name') or document.folder.name}"
        self._name.props["title"] = "" if document is None else str(document.folder)
        dirty = session.dirty
        self._pill.text = "" if document is None else "Not saved" if dirty else "Saved"
        self._pill.classes(add="unsaved" if dirty else "saved", remove="saved" if dirty else "unsaved")
        self._pill.set_visibility(document is not None)
        undo = "" if document is None else document.undoable
        redo = "" if document is None else document.redoable
        for made, what, word in ((self._undo, undo, "Undo (Ctrl+Z)"), (self._redo, redo, "Redo (Ctrl+Y)")):
            made.set_enabled(bool(what))
            made.props["title"] = f"{word}: {what}" if what else word
        self._save.set_enabled(document is not None and dirty)
        self._seen = self._now_seen()
        self.javascript(f"document.body.dataset.unsaved = '{'yes' if dirty else 'no'}'")

    def _now_seen(self) -> tuple[int, int]:
        return self.session.opened, -1 if self.session.document is None else self.session.document.version

    def overlay(self) -> None:
        """Draw over the frame again."""
        if self.viewer is not None and self.step.with_viewer:
            self.viewer.props["overlay"] = json.dumps(self.step.still())
            self.viewer.run_method("over", json.dumps(self.step.moving()))

    def show(self) -> None:
        """Show the session's frame."""
        session = self.session
        if self.viewer is None or not self.step.with_viewer:
            return
        if session.frames is None:
            self.viewer.run_method("show", "", "")
            return
        url = f"/frame/{session.opened}/{session.index}.jpg"
        self.viewer.run_method("show", url, json.dumps(self.step.moving()))
        if self._slider is not None and self._slider.value != session.index:
            self._slider.value = session.index
        if self._now is not None:
            damaged = "  damaged" if session.frames.damaged(session.index) else ""
            self._now.text = f"frame {session.index}   {session.frames.time_s(session.index):.3f} s{damaged}"
        self.step.moved()

    # what the person does ----------------------------------------------------------------------------------------------

    def go(self, index: int) -> None:
        """Show another frame."""
        before = self.session.index
        if self.session.go(index) != before:
            self.show()

    async def stay(self) -> None:
        """Go to the frame that is seen: where pictures come slowly it is one before the session's."""
        before = self.session.index
        if self.viewer is None:
            return
        try:
            seen = await self.viewer.run_method("stay", timeout=STAY_S)
        except TimeoutError:
            seen = -1
        if self.session.index != before:
            return  # the person has gone elsewhere meanwhile
        if seen >= 0:
            self.go(seen)
        else:
            self.show()

    async def _picked(self, event: Any) -> None:
        given = event.args
        if self._busy or int(given.get("frame", -1)) != self.session.index:
            return  # a click into a picture that is no longer the one
        self._busy = True
        try:
            await self.step.pick(float(given["u"]), float(given["v"]), float(given["zoom"]))
        except TowlineError as error:
            self.tell(str(error), "negative")
        finally:
            self._busy = False

    async def key(self, name: str) -> None:
        """A key of the page."""
        if await self.step.key(name):
            return
        index = self.session.index
        moves = {"back": index - 1, "on": index + 1, "back25": index - LARGE_STEP, "on25": index + LARGE_STEP}
        moves |= {"first": 0, "last": 1 << 40}
        if name in moves:
            self.go(moves[name])
        elif name.startswith("step"):
            self.go_step(min(int(name[4:]), len(self._steps)) - 1)
        elif name in ("undo", "redo", "save"):
            {"undo": self.undo, "redo": self.redo, "save": self.save}[name]()
        elif self.viewer is not None and name in ("zoomin", "zoomout", "fit", "light"):
            if name in ("fit", "light"):
                self.viewer.run_method(name)
            else:
                self.viewer.run_method("zoomBy", 1.6 if name == "zoomin" else 1 / 1.6)

    def undo(self) -> None:
        """Take the last change of run.toml back."""
        if self.session.document is not None and (what := self.session.document.undo()):
            self.tell(f"Undone: {what}")
            self.redraw()

    def redo(self) -> None:
        """Do again what was taken back."""
        if self.session.document is not None and (what := self.session.document.redo()):
            self.tell(f"Done again: {what}")
            self.redraw()

    def redraw(self) -> None:
        """After a change that may have moved rows about."""
        if self.session.refresh_video() or not self.step.refilled():
            self.draw()
            return
        self.state()
        self.overlay()

    def _changed_elsewhere(self) -> None:
        """Another window changed run.toml, or opened another run: show that, and lose nothing that is being typed here."""
        fields = typed_in(self._panel)
        pending = {label: (text, field.read) for label, field in fields.items() if (text := field.pending) is not None}
        same_run = self._seen[0] == self.session.opened
        with ExitStack() as held:
            for field in fields.values():
                held.enter_context(field.held())
            if same_run and not self.session.refresh_video() and self.step.refilled():
                self.state()
                self.overlay()
                return
        self.draw()
        now = typed_in(self._panel) if same_run else {}
        for label, (text, read) in pending.items():
            if label in now:
                now[label].keep(text, read)
                self._cursor_into(label)
            else:
                self.tell(f"Another window changed what was shown here. Typed and not taken: {label}: {text}", "kept")

    def changed(self) -> None:
        """After a change that left the rows as they are."""
        if self.session.refresh_video():
            self.draw()
            return
        self.state()
        self.overlay()
        self.step.changed()

    def save(self, over: bool = False) -> bool:
        """Write what is not saved; whether all is written. ``over`` what another program wrote meanwhile."""
        session = self.session
        for field in typed_in(self._panel).values():
            field.take()
        if session.document is None or not session.dirty:
            return True
        if not over and session.document.changed_outside():
            self._ask_over()
            return False
        try:
            written = session.save()
        except (TowlineError, OSError) as error:
            self.tell(f"Not saved: {error}", "negative")
            return False
        faults = session.document.faults()
        names = ", ".join(path.name for path in written)
        if faults:
            self.tell(f"Saved {names}; still missing or wrong: {len(faults)} (step 1 lists them)", "warning")
        else:
            self.tell(f"Saved {names}", "positive")
        self.state()
        self.step.changed()
        return True

    def _ask_over(self) -> None:
        session = self.session

        def kept(mine: bool) -> bool:
            dialog.close()
            try:
                path = session.doc.keep_aside(mine)
            except (TowlineError, OSError) as error:
                self.tell(f"Nothing was changed: {error}", "negative")
                return False
            if path is not None:
                self.tell(f"The other text is kept in {path.name}", "kept")
            return True

        def write_mine() -> None:
            if kept(mine=False):
                self.save(over=True)

        def read_anew() -> None:
            if not kept(mine=True):
                return
            try:
                session.open(session.doc.folder)
            except TowlineError as error:
                self.tell(str(error), "negative")
            self.draw()

        with self._client, ui.dialog() as dialog, ui.card():
            ui.label("run.toml was changed by another program since it was opened here.").classes("say")
            ui.label("Whichever you take, the other text is kept beside it.").classes("say")
            with ui.row():
                button("Write mine, keep theirs aside", write_mine, "stop")
                button("Read theirs, keep mine aside", read_anew, "plain")
                button("Stay", dialog.close, "main")
        dialog.open()

    def tell(self, text: str, kind: str = "info") -> None:
        """A short message; ``kind`` "kept": it stays until it is closed."""
        colours = {"negative": "red-10", "warning": "orange-10", "positive": "green-10", "info": "blue-grey-10"}
        wait_ms = {"negative": 7000, "kept": 0}.get(kind, 2500)
        with self._client:  # what asked for it may be gone
            ui.notify(
                text,
                position="bottom-right",
                color=colours.get(kind, "orange-10"),
                timeout=wait_ms,
                close_button="Close" if kind == "kept" else None,  # pyright: ignore
            )

    def javascript(self, code: str) -> None:
        """Have the browser do something."""
        self._client.run_javascript(code)

    def select(self, label: str) -> None:
        """Put the cursor into a field, its text selected."""
        self._focus(label, "e.select()")

    def _cursor_into(self, label: str) -> None:
        """Put the cursor behind the text of a field that was drawn anew while somebody typed into it."""
        self._focus(label, "e.setSelectionRange(e.value.length, e.value.length)")

    def _focus(self, label: str, then: str) -> None:
        """Put the cursor into a field; not where the person is typing into another by now: this may come late."""
        found = (
            f"[...document.querySelectorAll('input')].find(e => e.getAttribute('aria-label') === {json.dumps(label)})"
        )
        self.javascript(
            f"if (document.activeElement?.tagName !== 'INPUT') {{ const e = {found}; e?.focus(); e && {then}; }}"
        )

    def soon(self, call: Callable[[], Any]) -> None:
        """Call something after this."""
        with self._client:
            ui.timer(0.0, call, once=True)

    async def work(self, call: Callable[..., Any], *arguments: Any) -> Any:
        """Call something that takes a moment, without holding up the page."""
        return await run.io_bound(call, *arguments)

    async def snapped(self, u_px: float, v_px: float, zoom: float, to_mark: bool) -> Snapped | None:
        """Where a click into the shown frame landed; None where another run was opened before that was known."""
        opened = self.session.opened
        found = await self.work(self.session.snap, self.session.index, (u_px, v_px), zoom, to_mark)
        return found if self.session.opened == opened else None

    def _tick(self) -> None:
        frames = self.session.frames
        if self._seen != self._now_seen():
            self._changed_elsewhere()
        if frames is not None and frames.problem and frames.problem != self._told:
            self._told = frames.problem
            self.tell(frames.problem, "negative")
        if self._slider is not None and frames is not None:
            count = frames.count
            if count != self._count:
                self._count = count
                self._slider.props["max"] = max(count - 1, 1)
            if self.viewer is not None and frames.complete and self.viewer.props["count"] != count:
                self.viewer.props["count"] = count
            if self.session.unsure == self.session.index and (frames.known(self.session.index) or frames.complete):
                self.session.unsure = -1
                self.show()
        self.step.tick()


__all__ = ["Step", "Window"]
