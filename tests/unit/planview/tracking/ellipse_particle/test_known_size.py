"""What is known of the size of people before and while a recording is tracked."""

import re
from collections.abc import Iterator

import numpy as np
import pytest

from planview.engine.one_camera import one_camera_engine
from planview.tracking.base import Observation
from planview.tracking.ellipse_particle import ImagePlane, ImagePlaneParams, image_ellipse_tracker
from planview.tracking.ellipse_particle.fit.ellipses import paint_union
from stereo.recording import VideoFrame

SHAPE = (120, 160)
PAIR, ALONE = (20.0, 14.0), (20.0, 6.0)
"""Half length and half width [cells] of two who walk as one, and of one person."""


def seen(frame: int) -> Observation:
    """For five seconds two walk across as one, then five people one after the other."""
    half, breadth = PAIR if frame < 50 else ALONE
    x = 20.0 + 2.4 * (frame % 50)
    mask = paint_union(np.array([[x, 60.0, half, breadth, 0.0]]), SHAPE)
    return Observation(frame, frame / 10, foreground=(255 * mask).astype(np.uint8))


def expected(plane: ImagePlane, observation: Observation) -> float | None:
    """Width over length of people, as a frame is told it."""
    view = plane(observation)
    prior = None if view is None else plane.prior(view)
    return None if prior is None else prior.aspect


def test_who_comes_first_decides_nothing_where_the_beginning_was_studied():
    plain, studied = ImagePlane(ImagePlaneParams()), ImagePlane(ImagePlaneParams())
    studied.study(seen(frame) for frame in range(300))
    tracked = [expected(plain, seen(frame)) for frame in range(20)]
    assert tracked[0] is None
    assert tracked[-1] == pytest.approx(0.93, abs=0.1)
    # Painted ellipses are full, silhouettes fill theirs to three quarters.
    assert expected(studied, seen(0)) == pytest.approx(0.3 / 0.75, abs=0.05)


def test_a_studied_size_survives_reset_and_is_told():
    plane = ImagePlane(ImagePlaneParams())
    plane.study(seen(frame) for frame in range(300))
    before = expected(plane, seen(0))
    plane.reset()
    assert expected(plane, seen(0)) == before
    assert "learned from what moves" in plane.notes[0]


def test_no_more_is_studied_than_the_time_of_learning():
    taken: list[int] = []

    def frames() -> Iterator[Observation]:
        for frame in range(600):
            taken.append(frame)
            yield seen(frame)

    ImagePlane(ImagePlaneParams(learn_s=10.0)).study(frames())
    assert taken[-1] == 101


def test_a_given_size_needs_no_study():
    plane = ImagePlane(ImagePlaneParams(person_height_px=30))
    plane.study(seen(frame) for frame in range(300))
    view = plane(seen(0))
    assert view is not None
    assert plane.prior(view).half_length(60.0) == pytest.approx(15.0)
    assert plane.notes == ()


def test_where_nobody_shows_in_the_beginning_the_size_is_learned_in_tracking():
    plane = ImagePlane(ImagePlaneParams())
    plane.study(Observation(n, n / 10, foreground=np.zeros(SHAPE, np.uint8)) for n in range(50))
    assert expected(plane, seen(50)) is None
    assert [expected(plane, seen(frame)) for frame in range(51, 60)][-1] is not None


class WalkerVideo:
    """A dark walker over a grey image, 30 frames per second."""

    path, n_frames, fps, size, skipped = "walker", 120, 30.0, (160, 120), ()

    def __init__(self) -> None:
        self.read = 0

    def __iter__(self) -> Iterator[VideoFrame]:
        for i in range(self.n_frames):
            self.read += 1
            image = np.full((120, 160, 3), 150, np.uint8)
            if i >= 10:
                image[40:90, i : i + 20] = 40
            yield VideoFrame(i, i / self.fps, image)


def test_a_recording_is_looked_at_before_it_is_tracked():
    video = WalkerVideo()
    engine = one_camera_engine(video, image_ellipse_tracker(), overview=True)
    assert video.read == video.n_frames
    assert next(iter(engine)).frame == 0
    assert re.match(r"people are taken for 5[01] px high", engine.tracker.notes[0])
