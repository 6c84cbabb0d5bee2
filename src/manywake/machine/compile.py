"""Compilation of kernels by numba: without the interpreter lock, on first use, cached on disk."""

import hashlib
import shutil
import warnings
from functools import cache
from pathlib import Path
from typing import Any

import numba
from platformdirs import user_cache_path


@cache
def _cache_folder() -> str:
    """Return a folder of the user's cache that is keyed by the code that kernels are made of.

    numba's own cache notices a change in the file of a kernel, but none in the files of what the kernel calls.
    """
    package = Path(__file__).parents[1]
    sources = sorted(source for room in ("machine", "flow") for source in (package / room).glob("*.py"))
    key = hashlib.sha256(b"".join(source.read_bytes() for source in sources)).hexdigest()[:16]
    return str(user_cache_path("manywake") / "kernels" / key)


ROOM, LITTLE = 100e6, 10e6
"""Bytes that must be free where kernels are kept: for the first, and where some are. All of them take a fifth of it."""


@cache
def _kept(folder: str) -> bool:
    """Return whether kernels can be kept in a folder; a warning says why not where its disk is full."""
    try:
        there = next(path for path in (Path(folder), *Path(folder).absolute().parents) if path.exists())
        free, filled = shutil.disk_usage(there).free, any(Path(folder).rglob("*.nbi"))
    except OSError:
        return True  # numba will tell whether it can be written to
    kept = free >= (LITTLE if filled else ROOM)
    if not kept:
        warnings.warn(
            f"cache: {there} has {free / 1e6:.0f} MB of free space, wanted {ROOM / 1e6:.0f} MB, so kernels are "
            "compiled anew in every process; make room, or set XDG_CACHE_HOME to another folder",
            stacklevel=2,
        )
    return kept


def kernel(function) -> Any:
    """Compile a plain function of arrays; in every process anew where no folder can be written to."""
    config: Any = numba.config
    before = config.CACHE_DIR
    config.CACHE_DIR = before or _cache_folder()
    try:
        return numba.njit(error_model="numpy", nogil=True, cache=_kept(config.CACHE_DIR))(function)
    except RuntimeError:  # it cannot be written to
        return numba.njit(error_model="numpy", nogil=True)(function)
    finally:
        config.CACHE_DIR = before
