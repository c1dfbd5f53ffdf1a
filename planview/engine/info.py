"""Camera and floor of an engine, as ``run.json`` has them."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field, field_validator


class InfoPart(BaseModel):
    """Part of run.json; unknown keys are kept out by their writer, and ignored by an older reader."""

    model_config = ConfigDict(extra="ignore", ser_json_inf_nan="null")

    @field_validator("*", mode="before")
    @classmethod
    def _writable(cls, value: object) -> object:
        """Names of files that are not UTF-8 are written out, since JSON cannot hold them."""
        return value.encode("utf-8", "backslashreplace").decode() if isinstance(value, str) else value


class FloorInfo(InfoPart):
    """The floor that was found, or given by world.toml."""

    height_m: float
    """Height of the left camera above the floor [m]."""
    tilt_deg: float
    """Angle of the optical axis from straight down [degrees]."""
    roll_deg: float
    """Angle of the image's x axis to the floor [degrees]."""
    inlier_fraction: float | None = None
    """Share of the floor's points within tolerance; None when the floor was given."""
    residual_m: float | None = None
    """Root mean square distance of the inliers [m]."""
    world_SE3_left: list[list[float]] | None = None
    """Pose of the rectified left camera, (4, 4), for a stereo recording."""
    source: str = "found"
    """"found" in the recording, or the file that gave it."""


class CameraInfo(InfoPart):
    """The (rectified left) camera, enough to draw its view on the floor."""

    width: int
    height: int
    """Image size [px]."""
    focal_px: float | None = None
    lens: str | None = None
    """Class of lens of a single camera (camera.toml); None for others."""
    baseline_m: float | None = None
    """Between left and right camera; None for one camera."""
    depth_sensor: str | None = None
    """How the depth of images with depth was measured; None for others."""
    calibration: str | None = None
    """File or folder the calibration came from."""
    correction: str | None = None
    """How the recording corrects that calibration, in a sentence; None where that was not looked at."""
    vertical_residual_px: float | None = None
    """Median row offset that the corrected calibration leaves [px]."""
    view_m: list[tuple[float, float]] = Field(default_factory=list)
    """Outline of the view on the floor, world frame (x, y) [m], when known."""
    name: str = ""
    """Of a head among several."""
    at_m: tuple[float, float] = (0.0, 0.0)
    """Where on the floor the camera is, world frame (x, y) [m]."""
    heads: list[CameraInfo] = Field(default_factory=list)
    """All cameras of a recording with several heads, the first one included."""
