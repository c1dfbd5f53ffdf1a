"""The page: widgets bound to a session, nothing more."""

from __future__ import annotations

import asyncio
import base64
import logging
import math
import socket
import tempfile
from collections.abc import Awaitable, Callable
from dataclasses import replace
from functools import partial, reduce
from pathlib import Path
from typing import Any

from nicegui import app, events, run, ui
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Receive, Scope, Send

from calib.errors import InputError
from calib.ground_camera import LENS_K_320
from calib.images import encode_image, focal_share
from calib.people.model import KnownValues
from calib.people.samples import read_image_size, read_samples
from calib.types import U8
from planview.calibration.page.overlay import overlay
from planview.calibration.page.session import GRAB_PX, CalibrationSession, Tool

log = logging.getLogger(__name__)
VIEWER = Path(__file__).with_name("viewer.html")
"""Program of the browser: zoom, pan, loupe."""
LENSES = {"": "try all lenses", **{lens: lens for lens in LENS_K_320}}
KNOWN = {
    "focal_px": "focal length [px]",
    "field_deg": "or view across [°]",
    "height_m": "camera height [m]",
    "person_height_m": "people's height [m]",
}
TOOLS = {"person": "Person (p)", "select": "Select (s)", "floor": "Floor points (f)"}
KEYS: dict[str, Tool] = {"p": "person", "s": "select", "f": "floor"}
ARROWS = {"ArrowLeft": (-1.0, 0.0), "ArrowRight": (1.0, 0.0), "ArrowUp": (0.0, -1.0), "ArrowDown": (0.0, 1.0)}
HELP = (
    "wheel, + - 0: zoom; right button: pan; l: loupe; arrows: move what is selected, else the frame before or after; "
    "Delete; Ctrl+Z; Esc"
)


FLAT = "dense flat no-caps"


def _picker(text: str, accept: str, on_upload: Callable[[events.UploadEventArguments], Awaitable[None]]) -> None:
    """A button that takes a file."""
    upload = ui.upload(auto_upload=True, on_upload=on_upload).props(f"accept={accept}").classes("hidden")

    def pick() -> None:
        upload.reset()
        upload.run_method("pickFiles")

    ui.button(text, on_click=pick).props(FLAT)


class Page:
    """The page's widgets and what they do."""

    def __init__(self, session: CalibrationSession, folder: Path) -> None:
        self._session = session
        self._folder = folder
        self._asked = 0
        self._solving = False
        self._everywhere = False
        self._listed: object = None
        ui.add_body_html(VIEWER.read_text(encoding="utf-8"))
        ui.keyboard(on_key=self._on_key)
        with ui.column().classes("w-full h-screen gap-0 no-wrap"):
            with ui.row().classes("items-center w-full q-px-sm q-py-xs gap-2"):
                tools = {name: text for name, text in TOOLS.items() if session.view is None or name != "person"}
                self._tool = ui.toggle(tools, value=session.tool, on_change=self._on_tool).props("dense no-caps")
                ui.button("Undo", on_click=self.undo).props(FLAT)
                ui.button("Delete", on_click=self.remove).props(FLAT)
                ui.space()
                ui.label(f"calibration of {session.name}").classes("text-caption")
                ui.button("Export", on_click=self._on_export).props("dense no-caps")
            with ui.row().classes("w-full gap-0 no-wrap pv-row"):
                with ui.element("div").classes("pv-view"), ui.element("div").classes("pv-stage"):
                    self._image = ui.interactive_image(
                        _source(session.frames[session.shown]), on_mouse=self._on_mouse, cross="#ffffff80",
                        events=["mousedown", "mousemove", "mouseup"], size=session.size, sanitize=False,
                    )  # fmt: skip
                self._add_panel()
            with ui.row().classes("items-center w-full q-px-sm gap-3 no-wrap"):
                self._status = ui.label().classes("text-subtitle1")
                ui.space()
                ui.label("?").classes("text-caption").tooltip(HELP)
                if len(session.frames) > 1:
                    self._frame_text = ui.label().classes("text-caption").style("white-space: nowrap")
                    last = len(session.frames) - 1
                    self._slider = ui.slider(min=0, max=last, value=session.shown, on_change=self._on_frame)
                    self._slider.style("width: 300px; flex: none")
        self.refresh()

    def _add_panel(self) -> None:
        """The side panel: values and people; of one camera also the lens, known values and files of samples."""
        with ui.column().classes("pv-side q-pa-sm gap-2 no-wrap h-full"):
            with ui.row().classes("items-center gap-2"):
                self._spinner = ui.spinner(size="1.2em")
                self._busy = ui.label("solving").classes("text-caption")
                self._count = ui.label().classes("text-caption")
            self._assessment = ui.label().classes("w-full q-pa-sm rounded-borders text-white")
            self._values = ui.column().classes("w-full gap-0")
            self._people = ui.column().classes("w-full gap-0")
            if self._session.view is not None:
                return
            ui.checkbox("draw people all over the floor", on_change=self._on_everywhere).props("dense")
            ui.label("known values").classes("text-caption q-mt-sm")
            with ui.grid(columns=2).classes("w-full gap-x-2 gap-y-0"):
                self._known = {}
                for name, text in KNOWN.items():
                    field = ui.number(text, value=getattr(self._session.known, name), on_change=self._on_known)
                    self._known[name] = field.props("dense debounce=600 clearable")
            lens = ui.select(LENSES, value=self._session.lens or "", on_change=self._on_lens, label="lens")
            lens.props("dense").classes("w-full")
            self._note = ui.label().classes("text-caption")
            with ui.row().classes("gap-1"):
                _picker("Focal length of a photo", "image/*", self._on_photo)
                _picker("Load samples", ".json,.csv", self._on_samples)
                ui.button("Save samples", on_click=lambda: self.export(False)).props(FLAT)

    def refresh(self) -> None:
        """Show the session as it is."""
        session = self._session
        assessment = self._session.solution.assessment()
        self._image.content = overlay(session, self._everywhere)
        self._tool.value = session.tool
        self._status.text = session.message
        if len(session.frames) > 1:
            self._frame_text.text = f"frame {session.indices[session.shown]}"
            self._slider.value = session.shown
        self._spinner.visible = self._busy.visible = self._solving
        points = f", {len(session.floor_points)} floor points" if session.floor_points else ""
        people = f"{len(session.samples)} {'person' if len(session.samples) == 1 else 'people'}"
        self._count.text = f"{people if session.view is None else 'floor of a stereo recording'}{points}"
        self._assessment.visible = assessment is not None
        if assessment is not None:
            self._assessment.text = assessment.sentence
            colour = "#1b7f3b" if assessment.enough else "#b54708"
            self._assessment.style(f"background: {colour}; opacity: {0.5 if self._solving else 1}")
        # Rebuilt only when changed: the page refreshes with every movement of the mouse.
        listed = (session.solution, tuple(session.samples), session.shown, session.selected)
        if listed != self._listed:
            self._listed = listed
            self._values.clear()
            with self._values:
                for name, value, deviation in session.solution.rows(session.plain_floor):
                    with ui.row().classes("w-full no-wrap items-baseline gap-2"):
                        ui.label(name).classes("text-caption grow")
                        ui.label(value).classes("text-weight-medium")
                        ui.label(deviation).classes("text-caption")
            self._people.clear()
            with self._people:
                self._list_people()

    def _list_people(self) -> None:
        session = self._session
        found = self._session.solution.found
        odd = [i for i in (found.odd if found else ()) if i < len(session.samples)]
        errors = found.sample_errors if found else ()
        for title, numbers in (("on this frame", [n for n, _ in session.here()]), ("look at again", odd)):
            if numbers:
                ui.label(title).classes("text-caption")
            for number in numbers:
                error = f", error {errors[number]:.2f}" if number < len(errors) else ""
                chosen = session.tool == "select" and session.selected and session.selected.number == number
                colour = "negative" if number in odd else "primary" if chosen else "grey-8"
                text = f"{number + 1}: frame {session.samples[number].frame}{error}"
                ui.button(text, on_click=partial(self.show_sample, number)).props(f"{FLAT} color={colour}")
        first = {s.frame: i for i, s in reversed(list(enumerate(session.samples)))}
        others = [frame for frame in sorted(first) if frame != session.indices[session.shown]]
        if others:
            ui.label("people on other frames").classes("text-caption")
            with ui.row().classes("gap-0 w-full"):
                for frame in others:
                    go = partial(self.show_sample, first[frame])
                    ui.button(str(frame), on_click=go).props(f"{FLAT} color=grey-8")

    async def solve(self) -> None:
        """Compute the solution of the marks; what changes meanwhile is solved next, once."""
        self._asked += 1
        if self._solving:
            self.refresh()
            return
        self._solving = True
        try:
            while self._asked:
                self._asked = 0
                self.refresh()
                # In a thread: the page must keep answering, or the browser takes it for dead.
                solution = await run.io_bound(self._session.solve)
                # None when the server is going down.
                self._session.solution = solution or self._session.solution
        finally:
            self._solving = False
            self.refresh()

    async def undo(self) -> None:
        if self._session.undo():
            await self.solve()
        self.refresh()

    async def remove(self) -> None:
        if self._session.remove_selected():
            await self.solve()
        self.refresh()

    def show(self, number: int) -> None:
        self._session.show(number)
        self._reload()

    def show_sample(self, number: int) -> None:
        self._session.show_sample(number)
        self._reload()

    async def load(self, name: str, content: bytes) -> None:
        """Take samples from a file in place of the marks."""
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"samples{Path(name).suffix}"
            path.write_bytes(content)
            try:
                self._session.load(read_samples(path), read_image_size(path))
            except InputError as error:
                self._session.message = str(error).replace(str(path), name)
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
        u = event.image_x - 0.5
        v = event.image_y - 0.5
        if event.type == "mousedown" and event.button == 0:
            session.press(u, v, GRAB_PX * session.size[0] / 1000)
        elif event.type == "mouseup" and event.button == 0 and session.release(u, v):
            await self.solve()
        elif event.type == "mousemove" and event.buttons == 1:
            session.drag(u, v)
        elif event.type != "mouseup" or event.button:
            return
        self.refresh()

    async def _on_key(self, event: events.KeyEventArguments) -> None:
        if not event.action.keydown:
            return
        session = self._session
        key = str(event.key)
        if event.modifiers.ctrl or event.modifiers.meta:
            if key.lower() == "z":
                await self.undo()
        elif key.lower() in KEYS and KEYS[key.lower()] in self._tool.options:
            session.choose(KEYS[key.lower()])
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
        assessment = self._session.solution.assessment()
        solution = self._session.solution
        if (solution.found or solution.fit) and assessment is not None and not assessment.enough:
            self._ask(assessment.sentence)
        else:
            self.export()

    def export(self, solution: bool = True) -> None:
        """Write files, and name them."""
        try:
            self._session.export(self._folder, solution)
        except InputError as error:
            self._session.message = str(error)
        self.refresh()

    def _ask(self, sentence: str) -> None:
        """A solution that is not enough is written only on request."""
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

    def _on_everywhere(self, event: events.ValueChangeEventArguments[Any]) -> None:
        self._everywhere = bool(event.value)
        self.refresh()

    async def _on_lens(self, event: events.ValueChangeEventArguments[Any]) -> None:
        self._session.lens = event.value or None
        await self.solve()

    async def _on_known(self) -> None:
        given = {name: field.value for name, field in self._known.items() if field.value not in (None, "")}
        self._note.text = ""
        try:
            known = KnownValues(**{name: float(value) for name, value in given.items()})
        except ValueError as error:
            self._note.text = reduce(lambda text, item: text.replace(*item), KNOWN.items(), str(error))
            return
        if known != self._session.known:
            self._session.known = known
            await self.solve()

    async def _on_photo(self, event: events.UploadEventArguments) -> None:
        width, height = self._session.size
        try:
            focal_px = focal_share(await event.file.read()) * math.hypot(width, height)
        except InputError as error:
            self._note.text = str(error)
            return
        field = 2 * math.degrees(math.atan(width / 2 / focal_px))
        self._session.known = replace(self._session.known, focal_px=focal_px, field_deg=None)
        self._known["field_deg"].value = None
        self._known["focal_px"].value = round(focal_px, 1)
        self._note.text = f"{focal_px:.0f} px, {field:.0f}° across; videos of a phone often show less than its photos"
        await self.solve()

    async def _on_samples(self, event: events.UploadEventArguments) -> None:
        await self.load(event.file.name, await event.file.read())


class SameOriginOnly:
    """ASGI middleware that refuses requests and websockets of other pages.

    ``Host`` must be this machine's, which a name that an attacker points to 127.0.0.1 is not; ``Origin``, which
    browsers send with every websocket and which pages cannot forge, must be the page's own where there is one.
    """

    def __init__(self, app: ASGIApp, port: int) -> None:
        self._app = app
        self._hosts = {f"{name}:{port}".encode() for name in ("127.0.0.1", "localhost")}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass on what is the page's own."""
        kind = scope["type"]
        headers = scope.get("headers", ())
        hosts = [value for name, value in headers if name == b"host"]
        origins = [value.removeprefix(b"http://") for name, value in headers if name == b"origin"]
        own = len(hosts) == 1 and self._hosts.issuperset(hosts + origins)
        if own or kind not in ("http", "websocket"):
            await self._app(scope, receive, send)
        elif kind == "http":
            await PlainTextResponse("expected a request of the page itself\n", 403)(scope, receive, send)
        else:
            # Closed before it is accepted: the handshake is answered with 403.
            await send({"type": "websocket.close", "code": 1008})


def refuse_used(port: int) -> None:
    """Raise InputError for a port on which another program listens."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except OSError as error:
            problem = f"{port} is in use by another program; choose another, e.g. {port + 1}"
            raise InputError(problem, argument="port") from error


def serve(session: CalibrationSession, folder: Path, port: int) -> None:
    """Serve the page on this machine only, until interrupted."""

    @ui.page("/")
    def index() -> None:
        Page(session, folder)

    app.add_middleware(SameOriginOnly, port=port)
    # A warning is seen where nobody has set up logging.
    log.warning("open http://127.0.0.1:%d/ in a browser; Ctrl-C ends", port)
    ui.run(host="127.0.0.1", port=port, show=False, reload=False, title="planview", show_welcome_message=False)


def _source(frame: U8) -> str:
    return "data:image/jpeg;base64," + base64.b64encode(encode_image(frame)).decode("ascii")
