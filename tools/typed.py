"""Type every command of README.md and docs/ that needs nothing but the demo clip, record what each printed, and compare
the figures that the text takes from it.

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
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
CANNOT_RUN = {
    r"planview demo": "test_demo.py runs it",
    r"planview run my_recording --out out$": "it has been run before the others",
    r"planview check my_recording$": "tutorial.md runs it with pictures",
    r"planview .*det\.txt": "needs the boxes of a detector: test_run_kinds.py",
    r"planview .*photos/": "needs photographs of a board: test_calibrate_commands.py",
    r"planview .*\bhall\b(?!\.)": "needs two sensors in one room: test_run_kinds.py",
    r"planview sweep": "needs many recordings or a cluster: test_sweep.py, test_sweep_cluster.py",
    r"planview edit out --(join|delete|region|list) ": "names ids and files of an imaginary run: test_export.py",
    r"planview view": "opens a window",
    r".*my_program": "pipes into a program of the reader",
}
"""Commands that are only parsed, and why."""
SHORT = ["--frames", "60:240"]
"""What runs are given on top: a part of the clip in which people come and go."""
RULES = '[[tripwire]]\nname = "door"\nfrom_m = [-2, 4]\nto_m = [2, 4]\n'


WHOLE = "planview run my_recording --out out"
"""The only run of the whole clip: its figures stand in the text."""
WORDS = {"one": "1", "two": "2", "three": "3", "four": "4"}


class Claim(NamedTuple):
    """Figures in the text, and where they are printed: the groups of both patterns are the same."""

    page: str
    text: str
    command: str
    printed: str


SCORES = r"MOTA ([\d.]+), IDF1 ([\d.]+), position error ([\d.]+) cm, height error ([\d.]+) cm"
EVALUATED = "planview evaluate out/tracks.csv my_recording/truth.csv"
CAMERA = r"([\d.]+) m above the floor, tilt ([\d.]+) deg"
CHECKS = r"found: (\d+) checks"
COUNTED = r"(\w+) people cross the line inwards and (\w+)\s+outwards, and the zone has (\w+) entries"
ENTRIES = r"(?s)in (\d+), out (\d+).*entries (\d+)"
CLAIMS = [
    Claim("README.md", SCORES, EVALUATED, SCORES),
    Claim("README.md", CAMERA, WHOLE, CAMERA),
    Claim("docs/results.md", r"\| ([\d.]+); ([\d.]+); \d+ \| - \| `make", EVALUATED, r"MOTA ([\d.]+), IDF1 ([\d.]+)"),
    Claim("docs/tutorial.md", r"clip ([\d.]+) m and ([\d.]+) degrees", WHOLE, CAMERA),
    Claim("docs/tutorial.md", CHECKS, "planview check my_recording --out pictures", CHECKS),
    Claim(
        "docs/tutorial.md", COUNTED, "planview count out --rules rules.toml", r"(?s)in (\d+), out (\d+).*entries (\d+)"
    ),
]
"""Of the demo clip."""


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
        shutil.copy(demo / "left.mp4", place / "video.mp4")
        (place / "rules.toml").write_text(RULES, encoding="utf-8")
        before = {command: _typed(command, place)[1] for command in (WHOLE, EVALUATED)}
        record += before.values()
        printed: dict[tuple[str, str], str] = {}
        for page in PAGES:
            # The rules of the tutorial are those that its figures count.
            if rules := [text for language, text in blocks(page) if language == "toml" and page.stem == "tutorial"]:
                (place / "rules.toml").write_text(rules[0], encoding="utf-8")
            listed = [c for language, text in blocks(page) if not language for c in commands(text)]
            record.append(f"\n## {page.relative_to(ROOT)}\n")
            for command in listed:
                if cannot_run(command):
                    continue
                status, text = _typed(command, place)
                failed += status != 0
                record.append(text)
                printed[page.relative_to(ROOT).as_posix(), command] = text
    path = Path(sys.argv[1] if len(sys.argv) > 1 else ROOT / "out" / "commands.md")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(record), encoding="utf-8")
    print(f"{path}: {failed} commands failed")
    wrong = []
    for claim in CLAIMS:
        text = printed.get((claim.page, claim.command)) or before.get(claim.command, "")
        wrong += filter(None, [difference(claim, text)])
    print("\n".join(wrong) or f"{len(CLAIMS)} figures in the text are those that the commands print")
    return failed + len(wrong)


def difference(claim: Claim, printed: str) -> str:
    """How the text of a page differs from what the command printed; "" where it does not."""
    said = re.search(claim.text, (ROOT / claim.page).read_text(encoding="utf-8"))
    found = re.search(claim.printed, printed)
    expected = tuple(WORDS.get(word, word) for word in said.groups()) if said else "no figures in the text"
    figures = found.groups() if found else "no figures printed"
    return "" if expected == figures else f"{claim.page}: {expected}, but {claim.command} prints {figures}"


def _typed(command: str, place: Path) -> tuple[int, str]:
    """Exit status of a command, and the command with what it printed as a block."""
    start_s = time.monotonic()
    is_short = command.startswith("planview run ") and command != WHOLE
    typed = [*words(command), *(SHORT if is_short else [])]
    done = subprocess.run(
        [sys.executable, "-m", "planview", *typed], cwd=place, text=True, check=False,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    )  # fmt: skip
    took = f"exit status {done.returncode}, {time.monotonic() - start_s:.1f} s"
    print(f"{command}: {took}", flush=True)
    return done.returncode, f"```\n$ {command}\n{done.stdout[-20_000:].rstrip()}\n```\n{took}\n"


if __name__ == "__main__":
    raise SystemExit(main())
