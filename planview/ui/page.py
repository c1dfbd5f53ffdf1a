"""The page: widgets bound to a session, nothing more."""

from __future__ import annotations

import asyncio
import base64
from pathlib import Path
from typing import Any

import cv2
from nicegui import events, run, ui

from calib.errors import InputError
from calib.ground_camera import LENS_K_320
from calib.types import U8
from planview.ui.overlay import overlay
from planview.ui.session import CalibrationSession

TOOLS = {"box": "Box", "head": "Head", "foot": "Foot", "floor": "Floor points"}
LENSES = {"": "try all lenses", **{lens: lens for lens in LENS_K_320}}


def build_page(session: CalibrationSession, folder: Path) -> None:
    """Lay out the page.

    Args:
        session: what is calibrated.
        folder: where Export writes.
    """
    # One at a time: what is exported is the camera of everybody drawn so far, and its message stays.
    solving = asyncio.Lock()

    def refresh() -> None:
        image.content = overlay(session)
        tool.value = session.tool
        status.text = session.message
        count.text = f"{len(session.samples)} people, {len(session.floor_points)} floor points"

    async def solve() -> None:
        refresh()
        # In a thread: the page must go on answering, or the browser takes it for dead.
        async with solving:
            await run.io_bound(session.solve)
            refresh()

    async def on_mouse(event: events.MouseEventArguments) -> None:
        if event.type == "mousedown":
            session.press(event.image_x, event.image_y)
        elif event.type == "mouseup":
            if session.release(event.image_x, event.image_y):
                await solve()
        elif event.buttons:
            session.drag(event.image_x, event.image_y)
        else:
            return
        refresh()

    def on_frame(event: events.ValueChangeEventArguments[Any]) -> None:
        session.show(int(event.value))
        image.set_source(_source(session.frames[session.shown]))
        refresh()

    def on_tool(event: events.ValueChangeEventArguments[Any]) -> None:
        if event.value in TOOLS:
            session.tool = event.value

    async def on_lens(event: events.ValueChangeEventArguments[Any]) -> None:
        session.choose_lens(event.value or "")
        await solve()

    async def on_undo() -> None:
        session.remove_last()
        await solve()

    async def on_export() -> None:
        async with solving:
            try:
                session.export(folder)
            except InputError as error:
                session.message = str(error)
            refresh()

    ui.label(f"planview calibration of {session.name}").classes("text-h6")
    with ui.row().classes("items-center"):
        tool = ui.toggle(TOOLS, value=session.tool, on_change=on_tool)
        ui.select(LENSES, value=session.lens or "", on_change=on_lens, label="Lens").classes("w-48")
        ui.button("Undo", on_click=on_undo)
        ui.button("Export", on_click=on_export)
        count = ui.label()
    image = ui.interactive_image(
        _source(session.frames[session.shown]),
        on_mouse=on_mouse,
        events=["mousedown", "mousemove", "mouseup"],
        cross=True,
        size=session.size,
        sanitize=False,
    ).style(f"width: {session.size[0]}px; max-width: 100%")
    if len(session.frames) > 1:
        ui.slider(min=0, max=len(session.frames) - 1, value=session.shown, on_change=on_frame).props("label")
    status = ui.label().classes("text-subtitle1")
    refresh()


def serve(session: CalibrationSession, folder: Path, port: int) -> None:
    """Serve the page on this machine only, until interrupted."""

    @ui.page("/")
    def index() -> None:
        build_page(session, folder)

    ui.run(host="127.0.0.1", port=port, show=False, reload=False, title="planview", show_welcome_message=False)


def _source(frame: U8) -> str:
    _, coded = cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, 90])
    return "data:image/jpeg;base64," + base64.b64encode(coded.tobytes()).decode("ascii")
