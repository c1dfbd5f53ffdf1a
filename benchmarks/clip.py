"""A recording made ready for measuring: frames in memory, the engine, and plain OpenCV with the same settings."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from itertools import islice
from pathlib import Path

import cv2

from calib.errors import InputError, WorkError
from calib.images import as_grey
from calib.types import U8, AnyArray
from planview.engine.config import Config, load_config
from planview.engine.engine import FrameResult
from planview.engine.pipeline import Pipeline
from planview.engine.setup import set_up
from planview.synthetic.assets import DEMO
from stereo.matcher import make_sgbm
from stereo.readers import open_recording
from stereo.recording import Recording, StereoFrame


class Clip:
    """A recording and the engine on it.

    Attributes:
        recording, pipeline: ready to run.
        frames: the first pairs as recorded, decoded.
    """

    def __init__(
        self,
        source: Path | Recording | None,
        n_frames: int,
        width_px: int = 640,
        frames: Sequence[StereoFrame] | None = None,
        overrides: Sequence[str] = (),
    ) -> None:
        """Open a recording (the committed clip when None), or take an open one, and set the engine up for ``width_px``.

        Args:
            frames: its decoded frames where another clip has them already.
            overrides: parameters like ``analysis.width_px=1280``.
        Raises:
            InputError: no such recording, or too few frames.
        """
        source = source or DEMO
        if isinstance(source, Path) and not source.exists():
            raise InputError(f"{source}: expected a recording, found nothing; name one with --recording")
        self.recording: Recording = open_recording(source) if isinstance(source, Path) else source
        rectify = {"working_px": width_px}
        sized = Config.model_validate({"rectify": rectify, "analysis": {"width_px": min(width_px, 400)}})
        self.config = load_config(overrides=overrides, base=sized)
        self.setup = set_up(self.recording, self.config)
        self.pipeline = Pipeline(self.recording, self.setup, self.config)
        self.frames: Sequence[StereoFrame] = frames or list(islice(self.recording, n_frames))
        if len(self.frames) < 2:
            raise WorkError(f"{self.recording.path}: expected at least 2 frames, found {len(self.frames)}")

    def looped(self) -> Generator[FrameResult, None, None]:
        """The engine's results for ever: the recording starts again when it ends."""
        while True:
            yield from self.pipeline


class PlainOpenCV:
    """Bare remap and SGBM (3-way) with the sizes and parameters that the engine uses, and nothing else."""

    def __init__(self, clip: Clip) -> None:
        setup = clip.setup
        rig, geometry = setup.rectifier.rig, setup.rectifier.geometry
        left, right = rig.rectifying_rotations()
        self.size = geometry.size
        self._maps = [
            cv2.initUndistortRectifyMap(
                camera.matrix, camera.coefficients, rotation, geometry.matrix, self.size, cv2.CV_16SC2
            )
            for camera, rotation in ((rig.left, left), (rig.right, right))
        ]
        self.sgbm = plain_sgbm(clip)

    def remap(self, left: U8, right: U8) -> tuple[AnyArray, AnyArray]:
        """Both images rectified as they are, colour or grey."""
        images = [cv2.remap(i, *maps, cv2.INTER_LINEAR) for i, maps in zip((left, right), self._maps, strict=True)]
        return images[0], images[1]

    def __call__(self, left: U8, right: U8, grey: bool) -> AnyArray:
        """(H, W) int16 disparity in sixteenths; grey: convert before matching."""
        images = self.remap(left, right)
        if grey:
            images = as_grey(images[0]), as_grey(images[1])
        return self.sgbm.compute(*images)


def plain_sgbm(clip: Clip) -> cv2.StereoSGBM:
    """OpenCV's matcher with the engine's parameters, always three-way."""
    setup = clip.setup
    return make_sgbm(setup.rectifier.geometry, clip.config.sgbm, setup.disparities)
