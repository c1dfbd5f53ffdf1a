"""Compiles the kernels that the tests run, in two processes: else every worker of pytest would compile all of them."""

import multiprocessing
import sys
import tempfile
from itertools import islice
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent), str(HERE), str(HERE / "integration")]


def stereo() -> None:
    from toy_stereo import ToyWorld, toy_rig, walking, write_toy_recording

    import planview

    world, rig = ToyWorld(), toy_rig()
    with tempfile.TemporaryDirectory() as place:
        pairs = [world.pair(rig, walking(i - 5) if i >= 5 else (), i) for i in range(16)]
        recording = write_toy_recording(Path(place) / "toy", rig, pairs)
        for tracker in ("joint", "template"):
            list(planview.open_engine(recording, tracker))


def one_camera() -> None:
    from crossing_video import CAMERA, CrossingVideo

    from planview.engine.config import Config
    from planview.engine.open import engine_of

    for name in ("human-model", "ellipse-particle"):
        engine = engine_of(CrossingVideo(), name, Config(), camera=CAMERA)
        list(islice(engine, 30))


if __name__ == "__main__":
    workers = [multiprocessing.Process(target=compile_some) for compile_some in (stereo, one_camera)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    sys.exit(max(worker.exitcode or 0 for worker in workers))
