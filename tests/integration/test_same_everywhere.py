"""The same input gives the same tracks whatever instructions the processor has."""

import os
import subprocess
import sys
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

import planview
from planview.maps.view import View
from planview.tracking.base import Observation
from planview.tracking.ellipse_particle import EllipseParticleParams, EllipseParticleTracker
from planview.tracking.ellipse_particle.fit import paint
from planview.tracking.ellipse_particle.tracker import EllipseSizeParams, ParticleFilterParams
from planview.tracking.template import TemplateTracker
from tests.human_model_world import BLUE, RED, run

ROOT = Path(__file__).resolve().parents[2]
FRAMES = 80


def every_track() -> list[str]:
    """A line per person and frame of each tracker, with all digits."""
    lines, template = [], TemplateTracker()
    for result in islice(planview.open_engine(ROOT / "data" / "synthetic" / "demo"), FRAMES):
        lines += [f"joint {vars(track)}" for track in result.tracks]
        lines += [f"template {vars(track)}" for track in template.update(result.observation)]
    _, states, _ = run(lambda t: [(-2.5 + 1.2 * t, 6.0, RED), (2.5 - 1.2 * t, 6.6, BLUE)], 3.0)
    lines += [f"human-model {vars(track)}" for frame in states for track in frame]
    size, particles = EllipseSizeParams(person_height_px=30), ParticleFilterParams(particles=300)
    ellipses = EllipseParticleTracker(EllipseParticleParams(size=size, filter=particles))
    for i in range(20):
        people = np.array([[20.0 + 2 * i, 60.0, 15.0, 5.0, 0.0], [140.0 - 2 * i, 66.0, 15.0, 5.0, 0.0]])
        mask = paint(people, (120, 160)).any(axis=0) * np.uint8(255)
        lines += [f"ellipse {vars(track)}" for track in ellipses.update(Observation(i, i / 10, (View.of_mask(mask),)))]
    return lines


@pytest.mark.slow
def test_tracks_are_the_same_to_the_bit_on_a_processor_without_any_special_instructions(tmp_path):
    generic = {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": "", "NUMBA_CACHE_DIR": str(tmp_path)}
    code = "from tests.integration.test_same_everywhere import every_track; print('\\n'.join(every_track()))"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "tests")]), **generic}
    other = subprocess.run([sys.executable, "-c", code], env=environment, cwd=ROOT, capture_output=True, text=True)
    here = every_track()
    assert {line.split()[0] for line in here} == {"joint", "template", "human-model", "ellipse"}, other.stderr
    assert other.stdout.splitlines() == here
