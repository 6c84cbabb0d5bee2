"""The folder of a process for what it shares with its workers: gone with the process, however that ends.

The process holds a lock in it, and removes the folder when it ends in order. After a kill the server that forks its
workers does, whose end comes with that of the process. Where both were killed, the next process that makes a folder
removes what they left.
"""

import atexit
import os
import shutil
import tempfile
import time
from functools import lru_cache
from multiprocessing import util
from pathlib import Path

from filelock import FileLock, Timeout

NAME = "MANYWAKE_ROOM"
"""Tells the server that forks workers which folder is its process's."""
_PREFIX, _LOCK = "manywake-room-", ".room"
_BEGUN = 60.0
"""Seconds within which a folder without a lock may still get one."""


def folder() -> Path:
    """Return the folder of this process; made, and locked, when it is first asked for."""
    return _made(os.getpid())[0]


@lru_cache(maxsize=1)
def _made(process: int) -> tuple[Path, FileLock]:
    for left in Path(tempfile.gettempdir()).glob(f"{_PREFIX}*"):
        sweep(left)
    while True:
        path = Path(tempfile.mkdtemp(prefix=_PREFIX))
        lock = FileLock(path / _LOCK)
        try:
            lock.acquire()  # freed by the system, whatever ends this process
        except FileNotFoundError:
            continue
        if (path / _LOCK).exists():  # else another process swept it before it was locked
            break
    os.environ[NAME] = str(path)
    # past what multiprocessing itself keeps in here, and not in processes that are forked from this one
    util.Finalize(None, shutil.rmtree, [path], {"ignore_errors": True}, exitpriority=-200)
    return path, lock


def sweep(path: Path) -> None:
    """Remove the folder of a process that is gone; leave that of one that lives, of another user, or just begun."""
    try:
        there, lock = path.stat(), path / _LOCK
        if there.st_uid != os.getuid() or not lock.exists() and time.time() - there.st_mtime < _BEGUN:
            return
        with FileLock(lock, timeout=0):
            shutil.rmtree(path, ignore_errors=True)
    except (Timeout, OSError):
        return


if NAME in os.environ:  # of the process that this one serves, or of one above
    atexit.register(sweep, Path(os.environ[NAME]))
