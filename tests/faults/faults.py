"""The list: at least sixty ways to damage a recording."""
# ruff: noqa: E501, I001

from pathlib import Path

import numpy as np
from faults.damage import (
    FRAMES, MIDDLE, Fault, blocks, bomb, both, claims_frames, cut, edited, images, instead, nothing, pipe,
    png_claiming, removed, replaced, right_shows, rows, sparse, swapped, videos,
)  # fmt: skip

from calib.pose import SE3
from calib.rig import Floor
from calib.world import save_world

L, R = f"left/{MIDDLE}", f"right/{MIDDLE}"
EVEN = [f"{i / 15:.6f}" for i in range(FRAMES)]
SHIFTED = [*EVEN[:12], EVEN[11], *EVEN[13:]]

FRAME_FAULTS = (
    Fault("left image missing", removed(L), skipped=1),
    Fault("both images missing", removed(L, R), skipped=1),
    Fault("first image missing", removed("left/000000.png"), skipped=1),
    Fault("image cut off", cut(L, 0.5), skipped=1),
    Fault("empty image", replaced(L, ""), skipped=1),
    Fault("text for an image", replaced(R, "no image"), skipped=1),
    Fault("image that claims 60000 x 60000", replaced(R, png_claiming(60_000, 60_000)), skipped=1),
    Fault("image of another size", replaced(L, png_claiming(100, 100)), skipped=1),
    Fault("folder for an image", instead(L, Path.mkdir), skipped=1),
    Fault("pipe for an image", instead(L, pipe), skipped=1),
    Fault("device for an image", instead(R, lambda p: p.symlink_to("/dev/zero")), skipped=1),
    Fault("link to nowhere for an image", instead(R, lambda p: p.symlink_to("nowhere")), skipped=1),
    Fault("image of 20 GB", sparse(L, 20_000_000_000), skipped=1),
)  # fmt: skip
FOLDER_FAULTS = (
    Fault("other files among the images", replaced("left/Thumbs.db", b"\0")),
    Fault("right folder missing", removed("right"), 2, "right"),
    Fault("all right images missing", both(removed("right"), lambda f: (f / "right").mkdir()), 2, "right"),
    Fault("half of the right images missing", removed(*(f"right/{i:06d}.png" for i in range(15))), 2, "15 in right"),
    Fault("every image claims 60000 x 60000", images(lambda i, n: i[:0].reshape(0, 160) if n < 0 else i[:60], ["right"]), 2, "160x60"),
    Fault("frame number of 30 digits", lambda f: [(f / i).rename(f / i.split("/")[0] / f"{'9' * 30}.png") for i in (L, R)]),
    Fault("sides swapped", swapped, 1, "left and right are exchanged"),
    Fault("right camera covered", images(lambda i, n: np.full_like(i, 2), ["right"]), 0, warns="matched corners"),
    Fault("left camera is noise", images(lambda i, n: np.random.default_rng(n).integers(0, 255, i.shape, np.uint8), ["left"]), 0, warns="matched corners"),
    Fault("not a recording", lambda f: [p.unlink() if p.is_file() else removed(p.name)(f) for p in f.iterdir()], 2, "empty folder"),
)  # fmt: skip
TIMING_FAULTS = (
    Fault("right images one frame late", right_shows(lambda i: max(0, i - 1)), warns="synchronisation"),
    Fault("left images two frames late", right_shows(lambda i: max(0, i - 2), ["left"]), warns="synchronisation"),
    Fault("right camera frozen", right_shows(lambda i: 0), warns="frozen camera"),
    Fault("right camera stalls", right_shows(lambda i: 10 if 10 < i < 22 else i), warns="stalled camera"),
    Fault("every third pair a copy", right_shows(lambda i: i * 2 // 3, ["left", "right"]), warns="repeated pairs"),
    Fault("late and strict", right_shows(lambda i: max(0, i - 1)), 2, "checks failed: .*synchronisation", words=("--strict",)),
)  # fmt: skip
IMAGE_FAULTS = (
    Fault("rows one pixel off", images(lambda i, n: np.roll(i, 1, axis=0), ["right"]), warns="row offset"),
    Fault("rows far off", images(lambda i, n: np.roll(i, 5, axis=0), ["right"]), 1, "one camera are shifted up or down"),
    Fault("compressed to blocks", images(blocks), warns="compression"),
    Fault("over-exposed", images(lambda i, n: np.clip(i.astype(np.float32) * 1.9, 0, 255).astype(np.uint8)), warns="over-exposure"),
    Fault("dark", images(lambda i, n: i // 6), warns="under-exposure"),
    Fault("one camera darker", images(lambda i, n: i // 3, ["right"]), warns="brightness match"),
)  # fmt: skip
RIG = "rig.toml"
CALIBRATION_FAULTS = (
    Fault("no calibration", removed(RIG), 2, "stereo calibration"),
    Fault("calibration cut off", cut(RIG, 0.6), 2, "rig.toml|stereo calibration"),
    Fault("key missing", edited(RIG, "fx = ", "gx = "), 2, "fx"),
    Fault("negative focal length", edited(RIG, "fx = ", "fx = -"), 2, "positive focal"),
    Fault("focal length not a number", edited(RIG, "fx = ", "fx = nan # "), 2, "finite"),
    Fault("focal length of 5000 digits", edited(RIG, "fx = ", f"fx = {'9' * 5000} # "), 2, "rig.toml"),
    Fault("focal length of another image", edited(RIG, "fx = ", "fx = 9"), 2, "focal length"),
    Fault("rotation that is none", edited(RIG, "rotation = [[1.0", "rotation = [[3.0"), 2, "rotation"),
    Fault("calibration for another image", edited(RIG, "width = 160", "width = 170"), 2, "170x120"),
    Fault("keys nested 5000 deep", replaced(RIG, "[right_SE3_left]\na" + ".a" * 5000 + " = 1"), 2, "nested"),
    Fault("calibration of 20 GB", sparse(RIG, 20_000_000_000), 2, "stereo calibration"),
    Fault("pipe for a calibration", instead(RIG, pipe), 2, "stereo calibration"),
    Fault("YAML bomb", both(removed(RIG), replaced("intrinsics.yml", bomb())), 2, "calibration"),
)  # fmt: skip
WORLD = "world.toml"
SIDE_FILE_FAULTS = (
    Fault("broken world.toml", replaced(WORLD, "[world"), 2, "world.toml"),
    Fault("camera that looks up", lambda f: save_world(Floor(SE3(np.eye(3), np.array([0.0, 0.0, 2.5]))), f / WORLD), 2, "world.toml.*sees the space between floor"),
    Fault("empty timestamps", replaced("timestamps.csv", ""), 2, "timestamps.csv"),
    Fault("time that stands", replaced("timestamps.csv", rows(SHIFTED)), 2, "increase"),
    Fault("binary timestamps", replaced("timestamps.csv", bytes(range(256))), 2, "timestamps.csv"),
    Fault("timestamps of fewer frames", replaced("timestamps.csv", rows(EVEN[:20]))),
    Fault("no timestamps", removed("timestamps.csv"), 2, "use --fps"),
    Fault("clock that jumps by 30 days", replaced("timestamps.csv", rows([*EVEN[:15], *(float(t) + 2.6e6 for t in EVEN[15:])]))),
)  # fmt: skip
VIDEO_FAULTS = (
    Fault("good videos", videos()),
    Fault("video cut off", videos(right=lambda d: d[: len(d) * 2 // 3])),
    Fault("text for a video", videos(left=lambda d: b"no video" * 100), 2, "left.avi"),
    Fault("videos that claim 2e9 frames", videos(claims_frames, claims_frames)),
)  # fmt: skip
OPTION_FAULTS = (
    Fault("setting out of range", nothing, 2, "cell_m", words=("--set", "maps.cell_m=1e-9")),
    Fault("binary settings", replaced("c", bytes(range(256))), 2, "TOML", words=("--config", "{}/c")),
    Fault("broken rules", replaced("r", "[["), 2, "rules.toml", words=("--rules", "{}/r")),
    Fault("negative number of frames", nothing, 2, "--frames", words=("--frames", "-1")),
    Fault("tracker that is none", nothing, 2, "telepathy", words=("--tracker", "telepathy")),
)  # fmt: skip

FAULTS = (
    *FRAME_FAULTS, *FOLDER_FAULTS, *TIMING_FAULTS, *IMAGE_FAULTS, *CALIBRATION_FAULTS, *SIDE_FILE_FAULTS,
    *VIDEO_FAULTS, *OPTION_FAULTS,
)  # fmt: skip
