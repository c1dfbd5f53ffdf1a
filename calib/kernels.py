"""`kernel` compiles a function when it is called, and caches it for as long as the sources that it depends on stay as
they are.

Numba's own cache looks only at the file of the function, but constants and kernels of other files are compiled into it
as well.
"""

from __future__ import annotations

import inspect
import pickle
import re
import warnings
from collections.abc import Callable
from contextlib import suppress
from functools import cache, cached_property
from hashlib import sha256
from pathlib import Path
from typing import Any
from uuid import uuid4

DIGEST_BYTES = sha256().digest_size
ROOT = Path(__file__).parent.parent
IMPORT = re.compile(r"^(?:from|import) ((?:calib|stereo|planview)\b[\w.]*)(?: import (\([^)]*\)|.*))?", re.MULTILINE)
"""An import of ours at the top level of a file: neither inside a function nor only for type checkers."""


def kernel(function: Callable[..., Any]) -> Kernel:
    """Compile a function when it is called, once for each set of types; it needs no GIL and divides as numpy does."""
    return Kernel(function, nogil=True, error_model="numpy")


def helper(function: Callable[..., Any]) -> Kernel:
    """A function that kernels call, compiled and cached with each of them."""
    return Kernel(function, nogil=True, error_model="numpy", inline="never")


def inlined(function: Callable[..., Any]) -> Kernel:
    """The same, as if its lines stood in each of them."""
    return Kernel(function, inline="always")


class Kernel:
    """A function that numba compiles, which is imported for the first call: a third of a second, and the help needs
    none."""

    def __init__(self, function: Callable[..., Any], **options: Any) -> None:
        self._function = function
        self._options = options

    def __call__(self, *args: Any) -> Any:
        return self.dispatcher(*args)

    @cached_property
    def dispatcher(self) -> Any:
        """The function as numba takes it, as are the kernels that it calls."""
        from numba import njit

        names = self._function.__globals__
        for name in self._function.__code__.co_names:
            if isinstance(names.get(name), Kernel):
                names[name] = names[name].dispatcher
        compiled = njit(**self._options)(self._function)
        if "inline" not in self._options:
            try:
                compiled._cache = _cache_of(self._function)
            except (AttributeError, ImportError, RuntimeError, TypeError):  # other internals, or no place to write
                _warn_uncached()
        return compiled


def _warn_uncached() -> None:
    warnings.warn(
        "kernels cannot be cached, which costs a minute at each start: neither planview's folder nor the user's "
        "cache can be written (set NUMBA_CACHE_DIR to a folder that stays), or this version of numba is unknown",
        RuntimeWarning,
        stacklevel=1,  # one place, hence one warning
    )


def _cache_of(function: Callable[..., Any]) -> KernelCache:
    """Cache in the folder that numba chooses; the names of its files hold the digest of the sources."""
    from numba.core.caching import FunctionCache  # no public name

    numba_cache = FunctionCache(function)  # type: ignore[no-untyped-call]
    file = Path(inspect.getfile(function))
    digest = digest_of(file)
    _remove_old(Path(numba_cache.cache_path), file.stem, digest)
    return KernelCache(numba_cache, digest)


class KernelCache:
    """Compiled code on the disk, a file for each set of types, in place of numba's files and their index.

    A file may be cut short by a power cut, overwritten, or closed to this user. It begins with the digest of the rest:
    what cannot be read as it was written is compiled again and replaced.
    """

    def __init__(self, numba_cache: Any, digest: str) -> None:
        self.cache_path: str = numba_cache.cache_path
        self._impl = numba_cache._impl
        self._key = numba_cache._index_key
        self._name = f"{self._impl.filename_base}-{digest}"

    def load_overload(self, types: Any, target: Any) -> Any:
        """The code for a set of types; None where there is none that can be used."""
        from numba.core.runtime.nrt import rtsys  # no public name

        # All that compiled code asks of numba; a ``refresh`` of what compiles it takes a quarter of a second.
        rtsys.initialize(target)
        try:
            content = self._path(types, target.codegen()).read_bytes()
        except OSError:
            return None
        digest = content[:DIGEST_BYTES]
        data = content[DIGEST_BYTES:]
        if sha256(data).digest() != digest:
            return None
        return self._impl.rebuild(target, pickle.loads(data))

    def save_overload(self, types: Any, compiled: Any) -> None:
        """Write the code for a set of types; warn where that is not possible."""
        from numba.core.serialize import dumps  # no public name

        if not self._impl.check_cachable(compiled):
            return
        data: bytes = dumps(self._impl.reduce(compiled))  # type: ignore[no-untyped-call]
        path = self._path(types, compiled.codegen)
        part = path.with_name(f"{path.name}.{uuid4().hex}")  # another process may write the same
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            part.write_bytes(sha256(data).digest() + data)
            part.replace(path)
        except OSError:
            with suppress(OSError):
                part.unlink()
            _warn_uncached()

    def _path(self, types: Any, codegen: Any) -> Path:
        from numba import __version__

        key = repr((__version__, self._key(types, codegen)))
        return Path(self.cache_path, f"{self._name}.{sha256(key.encode()).hexdigest()[:16]}.nbc")


@cache
def _remove_old(folder: Path, module: str, digest: str) -> None:
    """Remove what was compiled from other sources."""
    for compiled in folder.glob(f"{module}.*.nb[ci]*"):
        if digest not in compiled.name:
            with suppress(OSError):  # another process was faster, or still uses it
                compiled.unlink()


@cache
def digest_of(file: Path) -> str:
    """Digest of the contents of all ``sources`` of a file."""
    return sha256(b"".join(_read(source)[0] for source in sorted(sources(file)))).hexdigest()[:16]


def sources(file: Path) -> set[Path]:
    """A file and the files of our packages that it imports, directly or not."""
    known = set[Path]()
    new = {file}
    while new:
        known |= new
        new = {imported for importing in new for imported in _read(importing)[1]} - known
    return known


@cache
def _read(file: Path) -> tuple[bytes, set[Path]]:
    """Digest of a file, and the files of our packages that it imports."""
    text = file.read_text(encoding="utf-8")
    names = set[str]()
    for module, members in IMPORT.findall(text):
        names |= {module, *(f"{module}.{member}" for member in re.findall(r"\w+", members))}
    return sha256(text.encode()).digest(), {source for name in names if (source := _file_of(name))}


@cache
def _file_of(module: str) -> Path | None:
    path = ROOT.joinpath(*module.split("."))
    return next((file for file in (path.with_suffix(".py"), path / "__init__.py") if file.is_file()), None)
