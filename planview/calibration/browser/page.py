"""The page: widgets bound to a session, nothing more."""

from __future__ import annotations

import asyncio
import base64
from pathlib import Path
from typing import Any

from nicegui import app, events, run, ui

from calib.errors import InputError
from calib.ground_camera import LENS_K_320
from calib.images import encode_image
from calib.types import U8
from planview.calibration.browser.overlay import overlay
from planview.calibration.browser.own_page import OwnPageOnly
from planview.calibration.browser.session import CalibrationSession

TOOLS = {"box": "Box", "head": "Head", "foot": "Foot", "floor": "Floor points"}
LENSES = {"": "try all lenses", **{lens: lens for lens in LENS_K_320}}


class Page:
    """The page's widgets and what they do.

    Args:
        session: what is calibrated.
        folder: where Export writes.
    """

    def __init__(self, session: CalibrationSession, folder: Path) -> None:
        self._session, self._folder = session, folder
        # One at a time: what is exported is the camera of everybody drawn so far, and its message stays.
        self._solving = asyncio.Lock()
        ui.label(f"planview calibration of {session.name}").classes("text-h6")
        with ui.row().classes("items-center"):
            self._tool = ui.toggle(TOOLS, value=session.tool, on_change=self._on_tool)
            ui.select(LENSES, value=session.lens or "", on_change=self._on_lens, label="Lens").classes("w-48")
            ui.button("Undo", on_click=self._on_undo)
            ui.button("Export", on_click=self._on_export)
            self._count = ui.label()
        self._image = ui.interactive_image(
            _source(session.frames[session.shown]),
            on_mouse=self._on_mouse,
            events=["mousedown", "mousemove", "mouseup"],
            cross=True,
            size=session.size,
            sanitize=False,
        ).style(f"width: {session.size[0]}px; max-width: 100%")
        if len(session.frames) > 1:
            last = len(session.frames) - 1
            ui.slider(min=0, max=last, value=session.shown, on_change=self._on_frame).props("label")
        self._status = ui.label().classes("text-subtitle1")
        self._refresh()

    def _refresh(self) -> None:
        session = self._session
        self._image.content = overlay(session)
        self._tool.value = session.tool
        self._status.text = session.message
        self._count.text = f"{len(session.samples)} people, {len(session.floor_points)} floor points"

    async def _solve(self) -> None:
        self._refresh()
        # In a thread: the page must go on answering, or the browser takes it for dead.
        async with self._solving:
            await run.io_bound(self._session.solve)
            self._refresh()

    async def _on_mouse(self, event: events.MouseEventArguments) -> None:
        session = self._session
        if event.type == "mousedown":
            session.press(event.image_x, event.image_y)
        elif event.type == "mouseup":
            if session.release(event.image_x, event.image_y):
                await self._solve()
        elif event.buttons:
            session.drag(event.image_x, event.image_y)
        else:
            return
        self._refresh()

    def _on_frame(self, event: events.ValueChangeEventArguments[Any]) -> None:
        self._session.show(int(event.value))
        self._image.set_source(_source(self._session.frames[self._session.shown]))
        self._refresh()

    def _on_tool(self, event: events.ValueChangeEventArguments[Any]) -> None:
        if event.value in TOOLS:
            self._session.tool = event.value

    async def _on_lens(self, event: events.ValueChangeEventArguments[Any]) -> None:
        self._session.choose_lens(event.value or "")
        await self._solve()

    async def _on_undo(self) -> None:
        self._session.remove_last()
        await self._solve()

    async def _on_export(self) -> None:
        async with self._solving:
            try:
                self._session.export(self._folder)
            except InputError as error:
                self._session.message = str(error)
            self._refresh()


def serve(session: CalibrationSession, folder: Path, port: int) -> None:
    """Serve the page on this machine only, until interrupted."""

    @ui.page("/")
    def index() -> None:
        Page(session, folder)

    app.add_middleware(OwnPageOnly, port=port)
    ui.run(host="127.0.0.1", port=port, show=False, reload=False, title="planview", show_welcome_message=False)


def _source(frame: U8) -> str:
    return "data:image/jpeg;base64," + base64.b64encode(encode_image(frame)).decode("ascii")
