"""What figures were made with: commit and date."""

from __future__ import annotations

import subprocess
from datetime import UTC, datetime
from pathlib import Path

import planview


def provenance() -> dict[str, str]:
    """Commit of the sources ("unknown" outside of a git repository), marked where they differ from it, and date."""
    return {"commit": _commit(Path(planview.__path__[0])), "date": datetime.now(UTC).date().isoformat()}


def _commit(folder: Path) -> str:
    try:
        commit, changes = (_git(folder, *a) for a in (("rev-parse", "--short", "HEAD"), ("status", "-s", "-uno", ".")))
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return commit + (" with changes" if changes else "")


def _git(folder: Path, *arguments: str) -> str:
    done = subprocess.run(["git", "-C", str(folder), *arguments], capture_output=True, text=True, check=True)
    return done.stdout.strip()
