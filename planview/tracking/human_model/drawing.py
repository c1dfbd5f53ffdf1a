"""What the tracker shows when asked why."""

from __future__ import annotations

import numpy as np

from planview.tracking.base import Drawing, TrackerDebug
from planview.tracking.human_model.scene import ModelScene
from planview.tracking.human_model.target import Target


def draw(targets: list[Target], scene: ModelScene) -> TrackerDebug:
    """Hulls with ids and states in the image, footprints on the floor."""
    strips, labels = [], []
    for target in targets:
        hull = scene.hull(target.foot_px, target.drawn)
        if hull is not None:
            strips.append(np.vstack([hull, hull[:1]]).astype(np.float32))
            seated = " seated" if target.seat is not None else ""
            labels.append(f"{target.track_id}{seated} {target.motion} {target.stability} M={target.score:.2f}")
    feet = tuple(t.kalman.state[None, :2].astype(np.float32) for t in targets)
    return TrackerDebug(
        (
            Drawing("models", "image", tuple(strips), tuple(labels)),
            Drawing("footprints", "floor", feet, tuple(str(t.track_id) for t in targets)),
        )
    )
