"""Step 8: film the day's tows: what is in order before, what is seen and named meanwhile, what the day's tows tell afterwards."""

from __future__ import annotations

import html
import json
from datetime import date
from functools import partial
from pathlib import Path
from typing import Any, Literal

from nicegui import ui

from ..live.folder import STATIC
from ..record.day_file import DayFile, DayNext
from ..report.format import SYMBOLS_TEXT, plus_minus
from .filming import FilmStatus, Order
from .live_view import Live, TowRow
from .page_parts import Plots, button, say
from .page_window import Step

KIND = {"good": "good", "warning": "warn", "fault": "bad"}
"""Classes of what was named, by its level."""
WORD = {"good": "over", "warning": "look", "fault": "FAULT"}
"""What is said beside the colour."""
SHOW = """
    const next = new Image();
    next.onload = () => { const shown = getHtmlElement(ELEMENT); if (shown) shown.src = next.src; };
    next.src = (window.path_prefix || "") + "/live/PLACE/DRAWN.jpg";
"""
"""The picture changes when the new one is there: none flickers, and one that is late is not waited for."""
OLD_S = 2.0
"""A picture older than this is said to be, while a tow is filmed."""
SHOWN_EVENTS, MOST_NAMED = 9, 3
"""Of what was named: what the panel has room for, newest first; and of a tow in the list."""


class LiveStep(Step):
    """The page beside the tank."""

    title = "Live"
    with_viewer = False
    for_pairs = True

    def build(self) -> None:
        """Draw the panel: what films, what is in order, the rolling plot, the day."""
        if self.session.live is None:
            doc = self.session.doc
            self.session.live = Live.beside(doc.folder, date.today().isoformat(), len(doc.cameras) or 1)
        self._seen: dict[str, Any] = {}
        with ui.element("div").style("display: flex; gap: 22px; height: 100%"):
            with ui.element("div").style("flex: 0 0 430px; overflow-y: auto; padding-right: 6px"):
                self._orders()
                ui.html("<h3>In order?</h3>", sanitize=False)
                self._ready = ui.html("", sanitize=False)
                ui.html("<h3>Named</h3>", sanitize=False)
                self._events = ui.html("", sanitize=False)
                if len(self._cameras) > 1:
                    ui.html("<h3>The two together</h3>", sanitize=False)
                self._pair = ui.html("", sanitize=False)
            with ui.element("div").style("flex: 1; min-width: 0; overflow-y: auto"):
                self._now = ui.label("").classes("livenow")
                self._now.props["aria-label"] = "Values now"
                with ui.element("div").classes("livebox pair" if len(self._cameras) > 1 else "livebox"):
                    with ui.element("div").classes("livepictures"):
                        self._shown = [self._figure(name) for name in self._cameras]
                    with ui.element("div"):
                        self._plots = Plots(
                            "Nothing is filmed yet. Say where the pictures come from, and press Film a tow."
                        )
                self._steady = ui.html("", sanitize=False)
                self._verdict = ui.html("", sanitize=False)
                self._verdict.props["aria-live"] = "polite"
                with ui.element("div").style("display: flex; gap: 26px; align-items: flex-start"):
                    self._wishes = ui.html("", sanitize=False)
                    self._tows = ui.html("", sanitize=False).style("flex: 1; min-width: 0")
        self.tick()

    @property
    def _live(self) -> Live:
        assert self.session.live is not None
        return self.session.live

    @property
    def _cameras(self) -> tuple[str, ...]:
        """Of the set-up: ("",) of one."""
        return self.session.doc.cameras or ("",)

    def _figure(self, name: str) -> tuple[Any, Any, Any]:
        """What one camera sees: the figure, its picture, and what is said of it."""
        with ui.element("figure") as figure:
            whose = f"camera {name}" if name else "the camera"
            picture = ui.element("img").props(f'alt="The tow as {whose} sees it"')
            said = ui.label("")
        figure.set_visibility(False)
        return figure, picture, said

    def _orders(self) -> None:
        live = self._live
        hint = "0, rtsp://..., udp://..., http://..., or a film"
        for label, text, hint in (
            *((f"Source {name}".strip(), text, hint) for name, text in zip(self._cameras, live.sources, strict=True)),
            ("Day", str(live.day.folder), "folder of the day's tows"),
            ("Plan", live.plan, "plan.toml, with the wish; may be empty"),
        ):
            with ui.element("div").style("display: flex; align-items: center; gap: 8px; margin-bottom: 4px"):
                ui.label(label).style("min-width: 56px; font-weight: 700")
                field = ui.input(value=text, placeholder=hint, on_change=lambda e, label=label: self._typed(label, e))
                field.props("outlined dense").style("flex: 1").props["aria-label"] = label
        with ui.row().style("gap: 8px; margin-top: 6px"):
            self._film = button("Film a tow", lambda: self._start("tow"), "main", "Film a tow")
            tip = "Hold the model still for 20 s: what the picture says of it then is the measurement's own noise"
            self._static = button("Static record", lambda: self._start("static"), "plain", "Static record", tip)
            tip = "Of the tows that are there, as after a crash, or with another wish"
            self._fit = button("Fit", lambda: self._start("fit"), "plain", "Fit the day's tows", tip)
            self._stop = button("End", self.session.filming.stop, "stop", "End the tow")
        self._state = say("", "", 2)
        self._state.props["aria-live"] = "polite"

    def _typed(self, label: str, event: Any) -> None:
        text = str(event.value or "").strip()
        if label.startswith("Source"):
            self._live.sources[self._cameras.index(label.removeprefix("Source").strip())] = text
        elif label == "Plan":
            self._live.plan = text
        elif text:
            self._live.turn_to(Path(text).expanduser())

    def _start(self, what: Literal["tow", "static", "fit"]) -> None:
        from ..live.filming import STATIC_S

        live = self._live
        if not all(live.sources) and what != "fit":
            missing = self._cameras[live.sources.index("")]
            self.window.tell(f"Say where the pictures come from: {f'Source {missing}'.strip()}", "warning")
            return
        if live.plan and not Path(live.plan).expanduser().is_file():
            self.window.tell(f"{live.plan}: no such file", "negative")
            return
        if not self.window.save():
            return
        plan = Path(live.plan).expanduser() if live.plan else None
        order = Order(self.session.doc.folder, tuple(live.sources), live.day.folder, plan, what)
        if not self.session.filming.start(order, STATIC_S if what == "static" else None):
            self.window.tell("Something is filmed already", "warning")
        self.tick()

    # what is new ---------------------------------------------------------------------------------------------------------

    def tick(self) -> None:
        """Show what is new."""
        live, status = self._live, self.session.filming.poll()
        there = status.folder is not None and status.folder.parent == live.day.folder
        live.follow(status.folder if there else None)
        self._put("state", (status, live.tail is not None), lambda: self._show_state(status))
        tail = live.tail
        self._put("tail", (None if tail is None else (tail.folder, tail.version)), self._show_tail)
        filmed = there and status.phase == "filming"
        for place, name in enumerate(self._cameras):
            drawn, age_s = (0, 0.0) if tail is None else tail.picture(name)
            key = drawn, filmed, filmed and age_s > OLD_S
            self._put(f"picture {name}", key, partial(self._show_picture, place, drawn, filmed, age_s))
        standing, wrong = live.day.standing()
        self._put("day", (live.day.version, status.phase), lambda: self._show_day(standing, wrong))

    def _put(self, name: str, key: Any, show: Any) -> None:
        if self._seen.get(name, self) != key:
            self._seen[name] = key
            show()

    def _show_picture(self, place: int, drawn: int, filmed: bool, age_s: float) -> None:
        (figure, picture, said), name = self._shown[place], self._cameras[place]
        figure.set_visibility(drawn > 0)
        if drawn:
            code = SHOW.replace("PLACE", str(place)).replace("DRAWN", str(drawn))
            ui.run_javascript(code.replace("ELEMENT", str(picture.id)))
            late = "No new picture: frames come late, or none does." if age_s > OLD_S else ""
            text = late if filmed else "The last picture."
            said.text = f"{name}{'. ' if text else ''}{text}" if name else text

    def _show_state(self, status: FilmStatus) -> None:
        self._film.set_enabled(not status.running)
        self._static.set_enabled(not status.running and len(self._cameras) == 1)
        self._fit.set_enabled(not status.running)
        self._stop.set_enabled(status.phase in ("preparing", "filming") and not status.stopping)
        name = "" if status.folder is None else status.folder.name
        said = {
            "": ("Nothing is filmed.", ""),
            "preparing": (f"Preparing: {status.words}", ""),
            "filming": (f"Filming {name}" + (", ending" if status.stopping else ""), "good"),
            "fitting": (f"{status.words}Fitting the day's tows ...", ""),
            "done": (status.words, "good"),
            "failed": (status.words, "bad"),
        }
        self._state.text, kind = said[status.phase]
        self._state.classes(replace=f"say {kind}")

    def _show_tail(self) -> None:
        tail = self._live.tail
        if tail is None:
            return
        curves = tail.curves()
        self._plots.props["curves_json"] = json.dumps(curves) if curves else ""
        self._now.text = f"{tail.folder.name}   {tail.now()}"
        ready = tail.ready.items()
        rows = [("good" if good else "warn", "✓" if good else "look", f"{k}: {words}") for k, (words, good) in ready]
        self._ready.content = _lines(rows, "Readiness")
        pair = tail.pair
        kind = "" if pair is None else "good" if pair["agree"] else "warn"
        rows = [(kind, "✓" if kind == "good" else "look", words) for words in ([] if pair is None else pair["cameras"])]
        self._pair.content = _lines(rows, "The two cameras")
        steady = tail.steady
        kind = "" if steady is None else "good" if steady["stands"] else "warn" if steady["settled"] else ""
        self._steady.content = "" if steady is None else _verdict(kind, steady["steady"])
        new = list(tail.events)[-SHOWN_EVENTS:][::-1]
        self._events.content = (
            _lines([(KIND[e["level"]], WORD[e["level"]], f"{e['t_s']:.1f} s: {e['words']}") for e in new], "Named")
            or '<p class="soft">Nothing.</p>'
        )

    def _show_day(self, standing: DayFile | None, wrong: str) -> None:
        live = self._live
        if wrong:
            self._verdict.content = _verdict("warn", wrong)
        elif standing is None:
            self._verdict.content = ""
        elif standing.enough:
            self._verdict.content = _verdict("good", "Enough: every wish is met.")
        elif standing.next_tow is not None:
            self._verdict.content = _verdict("warn", f"Not enough yet. {_next_words(standing.next_tow)}")
        elif standing.problem:
            self._verdict.content = _verdict("warn", standing.problem)
        else:
            self._verdict.content = ""
        self._wishes.content = "" if standing is None else _wish_table(standing)
        status = self.session.filming.poll()
        filmed = status.folder if status.phase == "filming" else None
        rows = [_tow_line(row, standing, row.folder == filmed) for row in reversed(live.day.rows())]
        self._tows.content = _lines(rows, "Tows of the day") or '<p class="soft">No tow yet.</p>'


def _tow_line(row: TowRow, standing: DayFile | None, filmed: bool) -> tuple[str, str, str]:
    """Class, name and words of a tow in the list."""
    name, long = row.folder.name, "" if row.seconds is None else f"{row.seconds:.0f} s. "
    if filmed:
        return "good", name, "Being filmed."
    if name.startswith(STATIC):
        return "good", name, f"{long}The model held still."
    # runs are named as the set-up is, and after their folder
    why = "" if standing is None else next((text for key, text in standing.repeat.items() if key.endswith(name)), "")
    if why:
        return "bad", name, f"{long}Repeat it: {why}"
    if row.named:
        return "warn", name, f"{long}Look at it, or repeat it: {'; '.join(row.named[:MOST_NAMED])}"
    fitted = standing is not None and any(key.endswith(name) for key in standing.tows)
    return ("good", name, f"{long}Fitted.") if fitted else ("", name, f"{long}Not fitted yet.")


def _lines(rows: list[tuple[str, str, str]], label: str) -> str:
    """Class, word and sentence of each, as a table; "" without any."""
    cells = "".join(
        f'<tr class="{kind}"><td>{html.escape(word)}</td><td>{html.escape(text)}</td></tr>' for kind, word, text in rows
    )
    return f'<table class="lines" aria-label="{label}">{cells}</table>' if rows else ""


def _verdict(kind: str, text: str) -> str:
    return f'<div class="verdict {kind}">{html.escape(text)}</div>'


def _next_words(plan: DayNext) -> str:
    return (
        f"The tow that helps most: X_T {plan.tow_point_m:.3f} m, L {plan.line_length_m:.2f} m, U {plan.speed_m_s:g} m/s, released "
        f"at y {plan.release_y_m:+.2f} m, beta {plan.release_beta_rad:+.3f} rad "
        f"(then ± {max(plan.percent.values()):.1f} % or better)."
    )


def _wish_table(standing: DayFile) -> str:
    """The six, and X_v, with their intervals against the wish."""
    rows = []
    for name, wish in standing.derivatives.items():
        symbol = SYMBOLS_TEXT.get(name, name)
        wished = "" if wish.wished_percent is None else f"{wish.wished_percent:g} %"
        state, kind = {True: ("met", "good"), False: ("not yet", "warn"), None: ("", "")}[wish.met]
        if wish.value is None or wish.std is None:
            cells = (symbol, "not determined", "", "", wished, state)
        else:
            value = plus_minus(wish.value, wish.std)
            cells = (symbol, value, wish.unit, f"± {wish.percent:.2f} %", wished, state)
        rows.append((cells, kind))
    if standing.x_v_m is not None:
        rows.append((("X_v", plus_minus(standing.x_v_m.value, standing.x_v_m.std), "m", "", "", ""), ""))
    body = "".join(
        "<tr>" + "".join(f'<td class="{kind if c is cells[-1] else ""}">{html.escape(c)}</td>' for c in cells) + "</tr>"
        for cells, kind in rows
    )
    head = (
        "<tr>" + "".join(f"<th align='left'>{h}</th>" for h in ("", "value ± sd", "", "95 %", "wished", "")) + "</tr>"
    )
    return f'<table class="found" aria-label="Against the wish">{head}{body}</table>'


__all__ = ["LiveStep"]
