"""The server of the page: static files, and a socket that frames go down and messages come up, on loopback alone."""

import asyncio
import secrets
import socket
import threading
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from importlib.resources import files
from pathlib import Path

import uvicorn
from starlette.applications import Starlette
from starlette.routing import Mount, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocket, WebSocketDisconnect, WebSocketState

from manywake.play import messages
from manywake.play.guard import NAMES, Bucket, Guard, key
from manywake.play.hub import Hub
from manywake.play.session import Session
from manywake.play.training import Training

PORT = 8420
"""Tried first."""
PAGES = 8
"""That may look at once."""
AHEAD = 3
"""Frames that may be on their way to a page: it says which it has drawn."""
RATE, BURST = 150.0, 300.0
"""Messages a second of a page, and at once."""
LARGEST = 16384
"""Bytes of a message; what is longer closes the socket."""
PATIENCE = 30.0
"""Seconds that a page may take nothing until its socket is closed."""
LOOK = 2.0
"""Seconds from one look at a run's folder to the next."""
WRONG_KEY, TOO_MANY, TOO_FAST, ENDED = 4401, 4429, 4408, 1011
"""Why sockets are closed."""


class _Page:
    """What goes to one page: what is newest, and of errors the last."""

    def __init__(self, hub: Hub, loop: asyncio.AbstractEventLoop):
        self._hub, self._loop, self._news = hub, loop, asyncio.Event()
        self._note = self._frame = self._drawn = 0
        self._sent: list[int] = []
        self.error: str | None = None
        self._pending = False
        self._key = hub.join(self._wake)

    def _wake(self) -> None:
        """Let the page look for news; called from any thread, so one call at a time is on its way to the loop."""
        if not self._pending:
            self._pending = True
            try:
                self._loop.call_soon_threadsafe(self._woken)
            except RuntimeError:  # the loop has ended
                pass

    def _woken(self) -> None:
        self._pending = False
        self._news.set()

    def leave(self) -> None:
        self._hub.leave(self._key)

    def seen(self, frame: int) -> None:
        """Count a frame, and those before it, as drawn."""
        self._sent = [number for number in self._sent if number > frame]
        self._news.set()

    def refuse(self, text: str) -> None:
        self.error = text
        self._news.set()

    async def next(self) -> str | bytes:
        """Return what is to be sent next; wait until there is something."""
        while True:
            self._news.clear()
            if self.error is not None:
                text, self.error = self.error, None
                return messages.error(text)
            for number, text in self._hub.notes(self._note):
                self._note = number
                return text
            newest = self._hub.frame(self._frame) if len(self._sent) < AHEAD else None
            if newest is not None:
                self._frame, frame = newest
                self._sent.append(self._frame)
                return frame
            await self._news.wait()


def app(session: Session, token: str, port: int, training: Training | None = None) -> Starlette:
    """Return the application. token: the key that sockets must have. port: which the server is called by."""
    hub = session.hub

    async def live(socket: WebSocket) -> None:
        if not secrets.compare_digest(key(socket.scope).encode(), token.encode()):
            await _refused(socket, WRONG_KEY, "wrong key")
        elif hub.pages >= PAGES:
            await _refused(socket, TOO_MANY, f"{PAGES} pages look already")
        else:
            await socket.accept()
            page = _Page(hub, asyncio.get_running_loop())
            try:
                await _first(_read(socket, page, session), _write(socket, page), _over(session))
            finally:
                page.leave()
            if socket.application_state == WebSocketState.CONNECTED == socket.client_state:
                await socket.close(ENDED, "the flow's thread has ended" if session.ended else "")

    @asynccontextmanager
    async def lifespan(_: Starlette) -> AsyncIterator[None]:
        watching = asyncio.create_task(_watch(training, session)) if training is not None else None
        try:
            yield
        finally:
            if watching is not None:
                watching.cancel()
                await asyncio.wait([watching])

    static = StaticFiles(directory=Path(str(files("manywake.play") / "static")), html=True)
    made = Starlette(routes=[WebSocketRoute("/live", live), Mount("/", static)], lifespan=lifespan)
    made.add_middleware(Guard, port=port)
    return made


async def _refused(socket: WebSocket, code: int, reason: str) -> None:
    await socket.accept()  # a browser tells a page the reason of an open socket alone
    await socket.close(code, reason)


async def _first(*works) -> None:
    """Do some things at once until one of them is done, then leave the others."""
    tasks = [asyncio.create_task(work) for work in works]
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in tasks:
            task.cancel()
        ended = await asyncio.gather(*tasks, return_exceptions=True)
    for error in ended:
        if isinstance(error, Exception) and not isinstance(error, WebSocketDisconnect | OSError):
            raise error


async def _read(socket: WebSocket, page: _Page, session: Session) -> None:
    bucket = Bucket(RATE, BURST)
    while True:
        event = await socket.receive()
        if event["type"] == "websocket.disconnect":
            return
        if not bucket.take():
            await socket.close(TOO_FAST, f"more than {RATE:g} messages a second")
            return
        text = event.get("text")
        try:
            if text is None:
                raise ValueError("message: got bytes, wanted text")
            wanted = messages.parse(text)
            if isinstance(wanted, messages.Seen):
                page.seen(wanted.frame)
            else:
                session.ask(wanted)
        except ValueError as error:
            page.refuse(str(error))


async def _write(socket: WebSocket, page: _Page) -> None:
    while True:
        said = await page.next()
        sending = socket.send_text(said) if isinstance(said, str) else socket.send_bytes(said)
        try:
            await asyncio.wait_for(sending, PATIENCE)
        except (TimeoutError, RuntimeError):  # it takes nothing, or it was closed meanwhile
            return


async def _over(session: Session) -> None:
    """Wait until the flow's thread has ended, which it does by itself only where it failed."""
    while not session.ended:
        await asyncio.sleep(0.5)


async def _watch(training: Training, session: Session) -> None:
    """Look at a run's folder again and again; a table that is being written is read the next time."""
    while True:
        try:
            policy = await asyncio.to_thread(training.policy)
            if policy is not None:
                while session.pair is None:
                    await asyncio.sleep(0.1)
                session.ask(policy)
            curve = await asyncio.to_thread(training.curve)
            if curve is not None or policy is not None:
                session.hub.tell("training", training.told(curve))
        except ValueError as error:
            session.hub.tell("training", {"problem": str(error)})
        await asyncio.sleep(LOOK)


def bound(port: int | None) -> socket.socket:
    """Return a socket that listens on the loopback interface, at this port; at `PORT` or any without one."""
    for wanted in (PORT, 0) if port is None else (port,):
        made = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            made.bind((NAMES[0], wanted))
            made.listen()
            return made
        except OSError as error:
            made.close()
            if port is not None:
                raise ValueError(f"port: got {port}, which cannot be had ({error}); wanted a free one") from error
    raise ValueError(f"port: {NAMES[0]} has none that is free")


class Server:
    """Serves a session on a socket that is bound, until `stop`. token: drawn when not given."""

    def __init__(
        self, session: Session, where: socket.socket, training: Training | None = None, token: str | None = None
    ):
        self.session, self._where = session, where
        self.token = token or secrets.token_urlsafe(24)
        self.port = where.getsockname()[1]
        config = uvicorn.Config(
            app(session, self.token, self.port, training),
            log_level="error",
            access_log=False,  # addresses of sockets have the key
            ws="websockets-sansio",
            ws_max_size=LARGEST,
            ws_per_message_deflate=False,
            proxy_headers=False,
            server_header=False,
            timeout_graceful_shutdown=2,
        )
        self._uvicorn = uvicorn.Server(config)

    @property
    def address(self) -> str:
        """The page's address; what follows the # stays in the browser."""
        return f"http://{NAMES[0]}:{self.port}/#key={self.token}"

    def run(self, started: Callable[[], None] | None = None) -> None:
        """Serve until the process is told to end, or the session's thread has ended by a failure, which is raised."""
        self.session.start()
        ended = threading.Event()
        watching = threading.Thread(target=self._follow, args=(ended, started), name="play-follow", daemon=True)
        watching.start()
        try:
            self._uvicorn.run(sockets=[self._where])
        finally:
            ended.set()
            watching.join()
            self.session.close()
            self._where.close()
        if self.session.problem is not None:
            raise self.session.problem

    def _follow(self, ended: threading.Event, started: Callable[[], None] | None) -> None:
        """Say once that the server has started, and stop it when the session has ended."""
        while not ended.wait(0.05):
            if started is not None and self._uvicorn.started:
                started()
                started = None
            if self.session.ended:
                self.stop()
                return

    def stop(self) -> None:
        """Let `run` return."""
        self._uvicorn.should_exit = True
