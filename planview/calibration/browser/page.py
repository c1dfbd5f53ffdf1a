"""The page: widgets bound to a session, nothing more."""

from __future__ import annotations

import asyncio
import base64
import tempfile
from pathlib import Path
from typing import Any

from nicegui import app, events, run, ui

from calib.errors import InputError
from calib.images import encode_image
from calib.people.samples import read_image_size, read_samples
from calib.types import U8
from planview.calibration.browser.opening import frames_at
from planview.calibration.browser.overlay import overlay
from planview.calibration.browser.own_page import OwnPageOnly
from planview.calibration.browser.panel import Panel
from planview.calibration.browser.session import GRAB_PX, CalibrationSession
from planview.calibration.browser.solution import solve
from planview.calibration.browser.viewer import SCRIPT, STYLE

TOOLS = {"person": "Person (p)", "select": "Select (s)", "floor": "Floor points (f)"}
KEYS = {"p": "person", "s": "select", "f": "floor"}
ARROWS = {"ArrowLeft": (-1.0, 0.0), "ArrowRight": (1.0, 0.0), "ArrowUp": (0.0, -1.0), "ArrowDown": (0.0, 1.0)}
HELP = (
    "wheel, + - 0: zoom; right button: pan; l: loupe; arrows: move what is selected, else the frame before or after; "
    "Delete; Ctrl+Z; Esc"
)


class Page:
    """The page's widgets and what they do.

    Args:
        session: what is calibrated.
        folder: where Export writes.
        source: video that frames of loaded samples are read from.
    """

    def __init__(self, session: CalibrationSession, folder: Path, source: Path | None = None) -> None:
        self._session, self._folder, self._source = session, folder, source
        self._asked, self._solving = 0, False
        ui.add_head_html(STYLE)
        ui.add_body_html(SCRIPT)
        ui.keyboard(on_key=self._on_key)
        with ui.column().classes("w-full h-screen gap-0 no-wrap"):
            self._toolbar()
            with ui.row().classes("w-full gap-0 no-wrap pv-row"):
                self._picture()
                self._panel = Panel(session, self)
            self._footer()
        self.refresh()

    def _toolbar(self) -> None:
        session = self._session
        with ui.row().classes("items-center w-full q-px-sm q-py-xs gap-2"):
            tools = {name: text for name, text in TOOLS.items() if session.view is None or name != "person"}
            self._tool = ui.toggle(tools, value=session.tool, on_change=self._on_tool).props("dense no-caps")
            ui.button("Undo", on_click=self.undo).props("dense flat no-caps")
            ui.button("Delete", on_click=self.remove).props("dense flat no-caps")
            ui.space()
            ui.label(f"calibration of {session.name}").classes("text-caption")
            ui.button("Export", on_click=self._on_export).props("dense no-caps")

    def _picture(self) -> None:
        session = self._session
        with ui.element("div").classes("pv-view"), ui.element("div").classes("pv-stage"):
            self._image = ui.interactive_image(
                _source(session.frames[session.shown]),
                on_mouse=self._on_mouse,
                events=["mousedown", "mousemove", "mouseup"],
                cross="#ffffff80",
                size=session.size,
                sanitize=False,
            )

    def _footer(self) -> None:
        with ui.row().classes("items-center w-full q-px-sm gap-3 no-wrap"):
            self._status = ui.label().classes("text-subtitle1")
            ui.space()
            ui.label("?").classes("text-caption").tooltip(HELP)
            if len(self._session.frames) > 1:
                self._frame_text = ui.label().classes("text-caption").style("white-space: nowrap")
                last = len(self._session.frames) - 1
                self._slider = ui.slider(min=0, max=last, value=self._session.shown, on_change=self._on_frame)
                self._slider.style("width: 300px; flex: none")

    def refresh(self) -> None:
        """Show the session as it is."""
        session = self._session
        self._image.content = overlay(session, self._panel.everywhere)
        self._tool.value = session.tool
        self._status.text = session.message
        self._panel.refresh(self._solving)
        if len(session.frames) > 1:
            self._frame_text.text = f"frame {session.indices[session.shown]}"
            self._slider.props(f"max={len(session.frames) - 1}")
            self._slider.value = session.shown

    async def solve(self) -> None:
        """Compute the solution of what is drawn; what changes meanwhile is solved next, once."""
        self._asked += 1
        if self._solving:
            self.refresh()
            return
        self._solving = True
        try:
            while self._asked:
                self._asked = 0
                self.refresh()
                # In a thread: the page must go on answering, or the browser takes it for dead.
                solution = await run.io_bound(solve, self._session.task())
                # None when the server is going down.
                self._session.solution = solution or self._session.solution
        finally:
            self._solving = False
            self.refresh()

    async def undo(self) -> None:
        """Take back the last change."""
        if self._session.undo():
            await self.solve()
        self.refresh()

    async def remove(self) -> None:
        """Delete what is selected."""
        if self._session.remove_selected():
            await self.solve()
        self.refresh()

    def show(self, number: int) -> None:
        """Show a frame."""
        self._session.show(number)
        self._reload()

    def show_sample(self, number: int) -> None:
        """Show and select a person."""
        self._session.show_sample(number)
        self._reload()

    async def load(self, name: str, content: bytes) -> None:
        """Take samples from a file in place of those drawn."""
        session = self._session
        try:
            with tempfile.TemporaryDirectory() as folder:
                path = Path(folder) / f"samples{Path(name).suffix}"
                path.write_bytes(content)
                try:
                    session.load(read_samples(path), read_image_size(path))
                except InputError as error:
                    raise InputError(str(error).replace(str(path), name)) from error
            missing = session.missing_frames()
            if missing and self._source is not None:
                session.add_frames(await run.io_bound(frames_at, self._source, missing) or [])
        except InputError as error:
            session.message = str(error)
            self.refresh()
            return
        self._reload()
        await self.solve()

    def _reload(self) -> None:
        self._image.set_source(_source(self._session.frames[self._session.shown]))
        self.refresh()

    async def _on_mouse(self, event: events.MouseEventArguments) -> None:
        session = self._session
        # The mouse counts from the corner of the first pixel, coordinates from its centre.
        u, v = event.image_x - 0.5, event.image_y - 0.5
        if event.type == "mousedown" and event.button == 0:
            session.press(u, v, GRAB_PX * session.size[0] / 1000)
        elif event.type == "mouseup" and event.button == 0:
            if session.release(u, v):
                await self.solve()
        elif event.type == "mousemove" and event.buttons == 1:
            session.drag(u, v)
        else:
            return
        self.refresh()

    async def _on_key(self, event: events.KeyEventArguments) -> None:
        if not event.action.keydown:
            return
        session, key = self._session, str(event.key)
        if event.modifiers.ctrl or event.modifiers.meta:
            if key.lower() == "z":
                await self.undo()
        elif key.lower() in KEYS and KEYS[key.lower()] in self._tool.options:
            session.choose(KEYS[key.lower()])  # type: ignore[arg-type]
        elif key == "Escape":
            session.cancel()
        elif key in ("Delete", "Backspace"):
            await self.remove()
        elif key in ARROWS and session.selected is not None:
            session.nudge(*ARROWS[key])
            await self.solve()
        elif key in ("ArrowLeft", "ArrowRight"):
            self.show(session.shown + (1 if key == "ArrowRight" else -1))
        else:
            return
        self.refresh()

    def _on_frame(self, event: events.ValueChangeEventArguments[Any]) -> None:
        if int(event.value) != self._session.shown:
            self.show(int(event.value))

    def _on_tool(self, event: events.ValueChangeEventArguments[Any]) -> None:
        if event.value in TOOLS and event.value != self._session.tool:
            self._session.choose(event.value)
            self.refresh()

    async def _on_export(self) -> None:
        while self._solving:
            await asyncio.sleep(0.05)
        verdict, solution = self._session.solution.verdict(), self._session.solution
        if (solution.found or solution.fit) and verdict is not None and not verdict.enough:
            self._ask(verdict.sentence)
        else:
            self.export()

    def export(self, solution: bool = True) -> None:
        """Write files, and say which."""
        try:
            self._session.export(self._folder, solution)
        except InputError as error:
            self._session.message = str(error)
        self.refresh()

    def _ask(self, sentence: str) -> None:
        """A solution that is not enough is written only when that is wanted."""
        with ui.dialog(value=True) as dialog, ui.card():
            ui.label(sentence)

            def answer(solution: bool) -> None:
                dialog.close()
                self.export(solution)

            with ui.row():
                if self._session.samples:
                    ui.button("Write samples only", on_click=lambda: answer(False)).props("no-caps")
                ui.button("Write it all the same", on_click=lambda: answer(True)).props("no-caps flat color=negative")
                ui.button("Go on", on_click=dialog.close).props("no-caps flat")


def serve(session: CalibrationSession, folder: Path, port: int, source: Path | None = None) -> None:
    """Serve the page on this machine only, until interrupted."""

    @ui.page("/")
    def index() -> None:
        Page(session, folder, source)

    app.add_middleware(OwnPageOnly, port=port)
    ui.run(host="127.0.0.1", port=port, show=False, reload=False, title="planview", show_welcome_message=False)


def _source(frame: U8) -> str:
    return "data:image/jpeg;base64," + base64.b64encode(encode_image(frame)).decode("ascii")
