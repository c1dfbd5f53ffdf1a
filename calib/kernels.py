"""`kernel` compiles a function, and caches it for as long as the sources that it depends on stay as they are.

Numba's own cache looks only at the file of the function, but constants and kernels of other files are compiled into it
as well.
"""

from __future__ import annotations

import inspect
import re
import warnings
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any, TypeVar

from numba import njit
from numba.core.dispatcher import Dispatcher

Function = TypeVar("Function", bound=Callable[..., Any])

ROOT = Path(__file__).parent.parent
IMPORT = re.compile(r"^(?:from|import) ((?:calib|stereo|planview)\b[\w.]*)(?: import (\([^)]*\)|.*))?", re.MULTILINE)
"""An import of ours at the top level of a file: neither inside a function nor only for type checkers."""


def kernel(function: Function) -> Dispatcher[Function]:
    """Compile a function when it is called, once for each set of types; it needs no GIL and divides as numpy does."""
    compiled = njit(nogil=True, error_model="numpy")(function)
    try:
        compiled._cache = _cache_of(function)  # type: ignore[attr-defined]
    except (AttributeError, ImportError, RuntimeError, TypeError):  # other internals of numba, or no place to write
        warnings.warn(
            "kernels cannot be cached, which costs a minute at each start: neither planview's folder nor the user's "
            "cache can be written (set NUMBA_CACHE_DIR to a folder that stays), or this version of numba is unknown",
            RuntimeWarning,
            stacklevel=1,  # one place, hence one warning
        )
    return compiled


def _cache_of(function: Callable[..., Any]) -> Any:
    """Numba's cache, in the folder that numba chooses; the names of its files hold the digest of the sources."""
    from numba.core.caching import FunctionCache  # no public name

    kept, file = FunctionCache(function), Path(inspect.getfile(function))  # type: ignore[no-untyped-call]
    digest = digest_of(file)
    _remove_old(Path(kept.cache_path), file.stem, digest)
    kept._cache_file = type(kept._cache_file)(kept.cache_path, f"{kept._impl.filename_base}-{digest}", digest)
    return kept


@cache
def _remove_old(folder: Path, module: str, digest: str) -> None:
    """Remove what was compiled from other sources."""
    for compiled in folder.glob(f"{module}.*.nb[ci]"):
        if digest not in compiled.name:
            with suppress(OSError):  # another process was faster, or still uses it
                compiled.unlink()


@cache
def digest_of(file: Path) -> str:
    """Digest of the contents of all ``sources`` of a file."""
    return sha256(b"".join(_read(source)[0] for source in sorted(sources(file)))).hexdigest()[:16]


def sources(file: Path) -> set[Path]:
    """A file and the files of our packages that it imports, directly or not."""
    known, new = set[Path](), {file}
    while new:
        known |= new
        new = {imported for importing in new for imported in _read(importing)[1]} - known
    return known


@cache
def _read(file: Path) -> tuple[bytes, set[Path]]:
    """Digest of a file, and the files of our packages that it imports."""
    text, names = file.read_text(encoding="utf-8"), set[str]()
    for module, members in IMPORT.findall(text):
        names |= {module, *(f"{module}.{member}" for member in re.findall(r"\w+", members))}
    return sha256(text.encode()).digest(), {source for name in names if (source := _file_of(name))}


@cache
def _file_of(module: str) -> Path | None:
    path = ROOT.joinpath(*module.split("."))
    return next((file for file in (path.with_suffix(".py"), path / "__init__.py") if file.is_file()), None)
