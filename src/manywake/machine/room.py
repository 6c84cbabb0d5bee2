"""The folder of a process for what it shares with its workers: gone with the process, however that ends.

The process holds a lock in it. At an ordinary end it removes the folder itself; after a kill the server that forks its
workers does, whose end comes with that of the process; what that server cannot, because it was killed too, the next
process does that makes such a folder.
"""

import atexit
import os
import shutil
import tempfile
from functools import lru_cache
from multiprocessing import util
from pathlib import Path

from filelock import FileLock, Timeout

NAME = "MANYWAKE_ROOM"
"""Tells the server that forks workers which folder is its process's."""
_PREFIX = "manywake-"


def folder() -> Path:
    """Return the folder of this process; made, and locked, when it is first asked for."""
    return _made(os.getpid())[0]


@lru_cache(maxsize=1)
def _made(process: int) -> tuple[Path, FileLock]:
    for left in Path(tempfile.gettempdir()).glob(f"{_PREFIX}*"):
        sweep(left)
    path = Path(tempfile.mkdtemp(prefix=_PREFIX))
    lock = FileLock(path / ".lock")
    lock.acquire()  # freed by the system, whatever ends this process
    if not (path / ".lock").exists():  # swept by another process that begins, just before it was locked
        return _made.__wrapped__(process)
    os.environ[NAME] = str(path)
    # past what multiprocessing itself keeps in here, and not in processes that are forked from this one
    util.Finalize(None, shutil.rmtree, [path], {"ignore_errors": True}, exitpriority=-200)
    return path, lock


def sweep(path: Path) -> None:
    """Remove the folder of a process that is gone; leave that of one that lives, of another user, or just begun."""
    try:
        if path.stat().st_uid != os.getuid() or not (path / ".lock").exists():
            return
        with FileLock(path / ".lock", timeout=0):
            shutil.rmtree(path, ignore_errors=True)
    except (Timeout, OSError):
        return


if NAME in os.environ:  # of the process that this one serves, or of one above
    atexit.register(sweep, Path(os.environ[NAME]))
