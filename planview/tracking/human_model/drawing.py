"""What the tracker shows when asked why."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planview.tracking.base import Drawing, TrackerDebug
from planview.tracking.human_model.scene import ModelScene
from planview.tracking.human_model.target import Target


def draw(targets: Sequence[Target], scene: ModelScene) -> TrackerDebug:
    """Hulls with ids and states in the image, footprints on the floor."""
    strips, labels = [], []
    for target in targets:
        hull = scene.hull(target.foot_px, target.model_scale)
        if hull is not None:
            strips.append(np.vstack([hull, hull[:1]]).astype(np.float32))
            seated = " seated" if target.seat is not None else ""
            states = f"{seated} {target.motion} {target.stability}"
            labels.append(f"{target.existence.track_id}{states} M={target.score:.2f}")
    feet = tuple(t.xy_m[None].astype(np.float32) for t in targets)
    return TrackerDebug(
        (
            Drawing("models", "image", tuple(strips), tuple(labels)),
            Drawing("footprints", "floor", feet, tuple(str(t.existence.track_id) for t in targets)),
        )
    )
