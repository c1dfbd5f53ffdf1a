"""The panel beside the picture: verdict, values, known values, people of the frame shown, files."""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable
from dataclasses import replace
from functools import partial
from typing import Any, Protocol

from nicegui import events, ui

from calib.errors import InputError
from calib.ground_camera import LENS_K_320
from calib.images import focal_share
from calib.people.model import KnownValues
from planview.calibration.browser.session import CalibrationSession

LENSES = {"": "try all lenses", **{lens: lens for lens in LENS_K_320}}
KNOWN = {
    "focal_px": "focal length [px]",
    "field_deg": "or view across [°]",
    "height_m": "camera height [m]",
    "person_height_m": "people's height [m]",
}


class Host(Protocol):
    """What the panel asks of the page."""

    async def solve(self) -> None: ...

    async def load(self, name: str, content: bytes) -> None: ...

    def refresh(self) -> None: ...

    def show_sample(self, number: int) -> None: ...

    def export(self, solution: bool = True) -> None: ...


class Panel:
    """Widgets of the panel.

    Attributes:
        everywhere: whether people are drawn all over the floor.
    """

    def __init__(self, session: CalibrationSession, host: Host) -> None:
        self._session, self._host = session, host
        self.everywhere = False
        self._listed: object = None
        with ui.column().classes("pv-side q-pa-sm gap-2 no-wrap h-full"):
            with ui.row().classes("items-center gap-2"):
                self._spinner = ui.spinner(size="1.2em")
                self._busy = ui.label("solving").classes("text-caption")
                self._count = ui.label().classes("text-caption")
            self._verdict = ui.label().classes("w-full q-pa-sm rounded-borders text-white")
            self._values = ui.column().classes("w-full gap-0")
            self._people = ui.column().classes("w-full gap-0")
            if session.view is None:
                self._single_camera()

    def _single_camera(self) -> None:
        """What means something for one camera only: lens, known values, files of samples."""
        ui.checkbox("draw people all over the floor", on_change=self._on_everywhere).props("dense")
        ui.label("known values").classes("text-caption q-mt-sm")
        with ui.grid(columns=2).classes("w-full gap-x-2 gap-y-0"):
            self._known = {
                name: ui.number(text, value=getattr(self._session.known, name), on_change=self._on_known).props(
                    "dense debounce=600 clearable"
                )
                for name, text in KNOWN.items()
            }
        ui.select(LENSES, value=self._session.lens or "", on_change=self._on_lens, label="lens").props("dense").classes(
            "w-full"
        )
        self._told = ui.label().classes("text-caption")
        with ui.row().classes("gap-1"):
            _picker("Focal length of a photo", "image/*", self._on_photo)
            _picker("Load samples", ".json,.csv", self._on_samples)
            ui.button("Save samples", on_click=lambda: self._host.export(False)).props("dense flat no-caps")

    def refresh(self, solving: bool) -> None:
        """Show the session as it is."""
        session = self._session
        self._spinner.visible = self._busy.visible = solving
        points = f", {len(session.floor_points)} floor points" if session.floor_points else ""
        people = f"{len(session.samples)} people" if session.view is None else "floor of a stereo recording"
        self._count.text = f"{people}{points}"
        verdict = session.solution.verdict()
        self._verdict.visible = verdict is not None
        if verdict is not None:
            self._verdict.text = verdict.sentence
            colour = "#1b7f3b" if verdict.enough else "#b54708"
            self._verdict.style(f"background: {colour}; opacity: {0.5 if solving else 1}")
        # Rebuilt only when changed: the page refreshes with every movement of the mouse.
        listed = (session.solution, tuple(session.samples), session.shown, session.selected)
        if listed != self._listed:
            self._listed = listed
            self._list_values()
            self._list_people()

    def _list_values(self) -> None:
        self._values.clear()
        with self._values:
            for name, value, deviation in self._session.solution.rows(self._session.plain_floor):
                with ui.row().classes("w-full no-wrap items-baseline gap-2"):
                    ui.label(name).classes("text-caption grow")
                    ui.label(value).classes("text-weight-medium")
                    ui.label(deviation).classes("text-caption")

    def _list_people(self) -> None:
        session, found = self._session, self._session.solution.found
        self._people.clear()
        with self._people:
            here = {number for number, _ in session.here()}
            odd = [i for i in (found.odd if found else ()) if i < len(session.samples)]
            for title, numbers in (("on this frame", sorted(here)), ("look at again", odd)):
                if numbers:
                    ui.label(title).classes("text-caption")
                for number in numbers:
                    self._person(number, number in odd)
            self._other_frames()

    def _other_frames(self) -> None:
        """A button for every other frame with people."""
        session = self._session
        first = {s.frame: i for i, s in reversed(list(enumerate(session.samples)))}
        others = [frame for frame in sorted(first) if frame != session.indices[session.shown]]
        if not others:
            return
        ui.label("people on other frames").classes("text-caption")
        with ui.row().classes("gap-0 w-full"):
            for frame in others:
                go = partial(self._host.show_sample, first[frame])
                ui.button(str(frame), on_click=go).props("dense flat no-caps color=grey-8")

    def _person(self, number: int, odd: bool) -> None:
        session, found = self._session, self._session.solution.found
        errors = found.sample_errors if found else ()
        error = f", error {errors[number]:.2f}" if number < len(errors) else ""
        text = f"{number + 1}: frame {session.samples[number].frame}{error}"
        chosen = session.selected is not None and session.selected.number == number and session.tool == "select"
        colour = "negative" if odd else "primary" if chosen else "grey-8"
        ui.button(text, on_click=lambda: self._host.show_sample(number)).props(f"dense flat no-caps color={colour}")

    def _on_everywhere(self, event: events.ValueChangeEventArguments[Any]) -> None:
        self.everywhere = bool(event.value)
        self._host.refresh()

    async def _on_lens(self, event: events.ValueChangeEventArguments[Any]) -> None:
        self._session.choose_lens(event.value or "")
        await self._host.solve()

    async def _on_known(self) -> None:
        values = {
            name: None if field.value in (None, "") else float(field.value) for name, field in self._known.items()
        }
        try:
            known = KnownValues(**values)
        except ValueError as error:
            text = str(error)
            for name, meaning in KNOWN.items():
                text = text.replace(name, meaning)
            self._told.text = text
            return
        self._told.text = ""
        if known != self._session.known:
            self._session.known = known
            await self._host.solve()

    async def _on_photo(self, event: events.UploadEventArguments) -> None:
        width, height = self._session.size
        try:
            focal_px = focal_share(await event.file.read()) * math.hypot(width, height)
        except InputError as error:
            self._told.text = str(error)
            return
        field = 2 * math.degrees(math.atan(width / 2 / focal_px))
        self._session.known = replace(self._session.known, focal_px=focal_px, field_deg=None)
        self._known["field_deg"].value, self._known["focal_px"].value = None, round(focal_px, 1)
        self._told.text = f"{focal_px:.0f} px, {field:.0f}° across; videos of a phone often show less than its photos"
        await self._host.solve()

    async def _on_samples(self, event: events.UploadEventArguments) -> None:
        await self._host.load(event.file.name, await event.file.read())


def _picker(text: str, accept: str, on_upload: Callable[[events.UploadEventArguments], Awaitable[None]]) -> None:
    """A button that takes a file."""
    upload = ui.upload(auto_upload=True, on_upload=on_upload).props(f"accept={accept}").classes("hidden")

    def pick() -> None:
        upload.reset()
        upload.run_method("pickFiles")

    ui.button(text, on_click=pick).props("dense flat no-caps")
