"""A server of the page for tests: one shipped flow with short actions, on a port of its own, in a thread."""

import json
import struct
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from websockets.sync.client import ClientConnection, connect

from manywake.learn import flows
from manywake.play.hub import Hub
from manywake.play.picture import HEADER
from manywake.play.server import Server, bound
from manywake.play.session import Offer, Session
from manywake.suite import load

KEY, NAME, PATIENCE = "a-key-for-tests", "cylinder-jets", 120.0


def offers(**settings: Any) -> dict[str, Offer]:
    chosen = load.choose(NAME, **settings)
    return {NAME: Offer(chosen, flows.open_flows(chosen))}


@contextmanager
def served(known: dict[str, Offer], port: int = 0, run: str | None = None, **others: Any) -> Iterator[Server]:
    """Serve until the end of the block, and see that all threads have ended then."""
    before, started = set(threading.enumerate()), threading.Event()
    server = Server(Session(known, next(iter(known)), Hub(), run), bound(port), token=KEY, **others)
    thread = threading.Thread(target=server.run, args=(started.set,))
    thread.start()
    try:
        assert started.wait(PATIENCE)
        yield server
    finally:
        server.stop()
        thread.join(PATIENCE)
        new = [one for one in threading.enumerate() if one not in before]
        new = [one for one in new if not one.name.endswith(("(recv_events)", "(keepalive)"))]  # of tests' own sockets
        for one in new:
            one.join(PATIENCE)
    assert not any(one.is_alive() for one in new), new


def page(server: Server, key: str = KEY, origin: str | None = "", **others: Any) -> ClientConnection:
    """Return a socket as a page opens it."""
    own = f"http://127.0.0.1:{server.port}" if origin == "" else origin
    return connect(f"ws://127.0.0.1:{server.port}/live?key={key}", origin=own, max_size=None, **others)


def send(socket: ClientConnection, kind: str, **what: Any) -> None:
    socket.send(json.dumps({"type": kind, **what}))


def told(socket: ClientConnection) -> Iterator[str | bytes]:
    """Yield what comes, for as long as a test may wait."""
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        said = socket.recv(timeout=PATIENCE)
        if isinstance(said, bytes):
            drawn(socket, said)
        yield said


def note(socket: ClientConnection, kind: str, when=lambda said: True) -> dict[str, Any]:
    """Return the next note of a kind that is as it should be; frames on the way are taken as drawn."""
    for said in told(socket):
        if isinstance(said, str) and (found := json.loads(said))["type"] == kind and when(found):
            return found
    raise AssertionError(f"no {kind} as it should be")


def frame(socket: ClientConnection, when=lambda numbers: True) -> tuple[np.ndarray, np.ndarray]:
    """Return numbers and lanes (lanes, h, w) of the next frame whose numbers are as they should be."""
    for said in told(socket):
        if isinstance(said, bytes):
            numbers, lanes = decoded(said)
            if when(numbers):
                return numbers, lanes
    raise AssertionError("no frame as it should be")


def drawn(socket: ClientConnection, said: bytes) -> None:
    send(socket, "seen", frame=HEADER.unpack_from(said)[1])


def decoded(said: bytes) -> tuple[np.ndarray, np.ndarray]:
    magic, _, _, _, lanes, width, height, count, _ = HEADER.unpack_from(said)
    assert magic == b"wake"
    numbers = np.frombuffer(said, "<f4", count, HEADER.size)
    return numbers, np.frombuffer(said, np.uint8, offset=HEADER.size + 4 * count).reshape(lanes, height, width)


def whole(text: bytes) -> tuple[int, bytes]:
    """Return the length that stands before a text, and the rest."""
    return struct.unpack_from("<I", text)[0], text[4:]
