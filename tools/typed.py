"""Type every command of README.md and docs/ that needs nothing but the demo clip, and record what each printed.

Run: python tools/typed.py [RECORD.md]
"""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
CANNOT_RUN = {
    r"planview demo": "test_demo.py runs it",
    r"planview run my_recording --out out$": "it has been run before the others",
    r"planview check my_recording$": "tutorial.md runs it with pictures",
    r"planview .*video\.mp4": "needs a long video of one camera: test_single_camera_run.py, test_run_kinds.py",
    r"planview .*photos/": "needs photographs of a board: test_calibrate_commands.py",
    r"planview .*\bhall\b(?!\.)": "needs two heads in one room: test_run_kinds.py",
    r"planview sweep": "needs many recordings or a cluster: test_sweep.py, test_sweep_cluster.py",
    r"planview edit out --(join|delete|region|list) ": "names ids and files of an imaginary run: test_export.py",
    r"planview render out --frame 240": "the short clip ends before",
    r"planview view": "opens a window",
    r".*my_program": "pipes into a program of the reader",
}
"""Commands that are only parsed, and why."""
SHORT = ["--frames", "60:240"]
"""What runs are given on top: a part of the clip in which people come and go."""
RULES = '[[tripwire]]\nname = "door"\nfrom_m = [-2, 4]\nto_m = [2, 4]\n'


def blocks(page: Path) -> list[tuple[str, str]]:
    """(language, text) of every code block of a page."""
    return re.findall(r"^```(\w*)\n(.*?)^```", page.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)


def commands(text: str) -> list[str]:
    """The commands of planview in a block, without comments."""
    return [line.split("  #")[0].strip() for line in text.splitlines() if line.startswith("planview ")]


def words(command: str) -> list[str]:
    """What follows the program's name, up to a pipe."""
    return shlex.split(command.split(" | ")[0])[1:]


def cannot_run(command: str) -> bool:
    """Whether a command needs more than the demo clip."""
    return any(re.match(pattern, command) for pattern in CANNOT_RUN)


def main() -> int:
    """Run the commands page by page in one folder; the number of those that failed."""
    record, failed = ["# Every command of the documents, and what it printed\n"], 0
    with tempfile.TemporaryDirectory() as temporary:
        place = Path(temporary)
        demo = place / "data" / "synthetic" / "demo"
        shutil.copytree(ROOT / "data" / "synthetic" / "demo", demo)
        shutil.copytree(demo, place / "my_recording")
        shutil.copy(demo / "truth.csv", place)
        (place / "rules.toml").write_text(RULES, encoding="utf-8")
        record.append(_typed("planview run my_recording --out out", place)[1])
        for page in PAGES:
            listed = [c for language, text in blocks(page) if not language for c in commands(text)]
            record.append(f"\n## {page.relative_to(ROOT)}\n")
            for command in listed:
                if cannot_run(command):
                    continue
                status, text = _typed(command, place)
                failed += status != 0
                record.append(text)
    path = Path(sys.argv[1] if len(sys.argv) > 1 else ROOT / "out" / "commands.md")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(record), encoding="utf-8")
    print(f"{path}: {failed} commands failed")
    return failed


def _typed(command: str, place: Path) -> tuple[int, str]:
    """Exit status of a command, and the command with what it printed as a block."""
    start_s = time.monotonic()
    typed = [*words(command), *(SHORT if command.startswith("planview run ") else [])]
    done = subprocess.run(
        [sys.executable, "-m", "planview", *typed], cwd=place, text=True, check=False,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    )  # fmt: skip
    took = f"exit status {done.returncode}, {time.monotonic() - start_s:.1f} s"
    print(f"{command}: {took}", flush=True)
    return done.returncode, f"```\n$ {command}\n{done.stdout[-4000:].rstrip()}\n```\n{took}\n"


if __name__ == "__main__":
    raise SystemExit(main())
