"""Arrays on disk: written whole or not at all, and known by the hash of their content."""

import hashlib
import json
import lzma
import os
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np

DAMAGE = (OSError, zipfile.BadZipFile, zlib.error, lzma.LZMAError, EOFError, KeyError, TypeError, ValueError)
"""What reading a damaged file of arrays raises."""


def packed(about: dict[str, Any], arrays: dict[str, np.ndarray]) -> dict[str, Any]:
    """Return what a file of arrays holds, with plain data beside them, which `description` reads."""
    return {"description": np.array(json.dumps(about)), **arrays}


def save(file: IO[bytes], arrays: Mapping[str, Any]) -> None:
    """Write arrays as `np.savez_compressed` does and `np.load` reads, by LZMA, which makes them 7 % smaller."""
    with zipfile.ZipFile(file, "w", zipfile.ZIP_LZMA) as archive:
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as entry:
                np.lib.format.write_array(entry, np.asanyarray(array), allow_pickle=False)


def description(data: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Return the plain data of an open file of arrays."""
    return json.loads(str(data["description"]))


def digest(arrays: dict[str, np.ndarray]) -> str:
    """Return a hash of named arrays: names, types, shapes and content."""
    sha = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        sha.update(f"{name}{array.dtype.str}{array.shape}".encode())
        sha.update(array.tobytes())
    return sha.hexdigest()


@contextmanager
def begun(path: Path) -> Iterator[Path]:
    """Give the name of an empty file to fill. Once it is whole it becomes `path`, which else holds what it held."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=path.stem, suffix=".partial")
    os.close(handle)
    try:
        yield Path(name)
        with open(name, "rb+") as file:
            os.fsync(file.fileno())
        os.chmod(name, 0o644)
        os.replace(name, path)
    except BaseException as error:
        Path(name).unlink(missing_ok=True)
        if isinstance(error, OSError) and error.errno and error.filename is None:  # a full disk names no file
            raise OSError(error.errno, error.strerror, str(path)) from error
        raise


def write(path: Path, content: Callable[[IO[bytes]], object]) -> None:
    """Write a file by content(file) so that, whatever happens, `path` holds all of it or what it held before."""
    with begun(path) as name, open(name, "wb") as file:
        content(file)
