"""Where the flow's thread leaves what pages are to be told: the newest of each kind, so that no page can fall behind.

A page that is slow, or reads nothing, gets fewer frames. Nobody waits for it, and nothing is kept for it.
"""

import json
import threading
from collections.abc import Callable
from typing import Any


class Hub:
    """The newest frame and the newest notes by kind, and who is to be woken when there are newer ones."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._notes: dict[str, tuple[int, str]] = {}
        self._frame: tuple[int, bytes] | None = None
        self._count = 0
        self._wakers: dict[object, Callable[[], None]] = {}
        self.joined = threading.Event()
        """Set when a page comes; whoever has told it all clears it."""

    @property
    def pages(self) -> int:
        """How many pages look."""
        return len(self._wakers)

    def join(self, waker: Callable[[], None]) -> object:
        """Let waker() be called, from any thread, when there is something new; return what `leave` wants."""
        key = object()
        with self._lock:
            self._wakers[key] = waker
        self.joined.set()
        return key

    def leave(self, key: object) -> None:
        with self._lock:
            self._wakers.pop(key, None)

    def tell(self, kind: str, said: dict[str, Any]) -> None:
        """Leave a note, in the place of the last one of its kind; notes of another kind keep their order."""
        text = json.dumps({"type": kind, **said}, allow_nan=False)
        with self._lock:
            self._count += 1
            self._notes.pop(kind, None)
            self._notes[kind] = self._count, text
            wakers = list(self._wakers.values())
        for wake in wakers:
            wake()

    def show(self, number: int, frame: bytes) -> None:
        """Leave a frame, in the place of the last one."""
        with self._lock:
            self._frame = number, frame
            wakers = list(self._wakers.values())
        for wake in wakers:
            wake()

    def notes(self, after: int) -> list[tuple[int, str]]:
        """Return the notes that came after one, by their numbers."""
        with self._lock:
            return [note for note in self._notes.values() if note[0] > after]

    def frame(self, after: int) -> tuple[int, bytes] | None:
        """Return the newest frame if it came after one, by its number."""
        with self._lock:
            return self._frame if self._frame is not None and self._frame[0] > after else None
