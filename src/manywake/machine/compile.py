"""Compilation of kernels by numba: without the interpreter lock, on first use, cached on disk."""

import hashlib
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


def kernel(function) -> Any:
    """Compile a plain function of arrays; in every process anew where no folder can be written to."""
    config: Any = numba.config
    before = config.CACHE_DIR
    config.CACHE_DIR = before or _cache_folder()
    try:
        return numba.njit(error_model="numpy", nogil=True, cache=True)(function)
    except RuntimeError:
        return numba.njit(error_model="numpy", nogil=True)(function)
    finally:
        config.CACHE_DIR = before
