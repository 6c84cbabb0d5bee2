"""The flow in a thread of its own: it obeys what pages ask for, keeps the pace, and leaves frames at the hub.

Kernels run without the interpreter lock, so the server goes on beside it.
"""

import queue
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from manywake.learn import flows
from manywake.learn.flows import Flows
from manywake.learn.policy import Policy
from manywake.play import layout, messages
from manywake.play.hub import Hub
from manywake.play.messages import FASTEST, SLOWEST, Message
from manywake.play.pair import HAND, POLICY, Pair
from manywake.play.picture import Picture
from manywake.suite import load
from manywake.suite.load import Chosen

RATE = 32.0
"""Frames a second at most."""
LATE = 0.25
"""Seconds that the flow may be behind its pace before it is given up."""
WAITING = 64
"""Messages that wait, at most."""
SCORED = 20.0
"""Length of a game by hand, in L/U."""
REYNOLDS = 0.2, 2.0
"""Reynolds numbers that a page can ask for, by that of the case's file."""
SPEED = 5.0


class _Stopped(Exception):
    """The making of a flow was stopped, by a page or by the end."""


@dataclass(frozen=True)
class Offer:
    """A flow that pages can choose. ready: its flows where they are open already, as those of a run."""

    chosen: Chosen
    ready: Flows | None = None

    def open(self, reynolds: float | None, progress: Callable[[str, float], None]) -> Flows:
        """Return the flows at a Reynolds number, made now where they are not in the cache."""
        chosen = self.chosen
        if reynolds is None or reynolds == chosen.cases[0].reynolds:
            return self.ready or flows.open_flows(chosen, progress)
        overrides = {**chosen.overrides, "reynolds": reynolds}
        return flows.open_flows(load.override(chosen.definition, chosen.protocol, overrides), progress)


def shipped() -> dict[str, Offer]:
    """Return the flows that come with the package and have a task, the default's first."""
    names = sorted(load.names(), key=lambda name: name != load.DEFAULT)
    definitions = {name: load.load(name) for name in names}
    return {
        name: Offer(load.override(definition, "default", {}))
        for name, definition in definitions.items()
        if definition.task is not None
    }


class Session:
    """Plays one of the offers, the one named `first`, until `close`.

    run: name of the run that the first offer is of. problem: what the thread failed by, if it did; then it has ended.
    """

    def __init__(self, offers: Mapping[str, Offer], first: str, hub: Hub, run: str | None = None):
        self.offers, self.hub, self.first, self.run = offers, hub, first, run
        self.problem: BaseException | None = None
        self._wanted: queue.Queue[Message | Policy] = queue.Queue(WAITING)
        self._nudge, self._closing, self._cancel = threading.Event(), threading.Event(), threading.Event()
        self._pair: Pair | None = None
        self._picture: Picture | None = None
        self._case = first
        self._policy: Policy | None = None
        self._layout = self._number = 0
        self._shade, self._paused, self._owed, self._speed = 0, False, 0, SPEED
        self._amplitudes: list[float] = []
        self._busy: dict[str, Any] | None = None
        self._notice: dict[str, Any] | None = None
        self._score: dict[str, Any] | None = None
        self._told = self._framed = self._due = 0.0
        self._pace: tuple[float, float] | None = None
        self._reached: float | None = None
        self._thread = threading.Thread(target=self._run, name="play", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def close(self) -> None:
        """End the thread; a flow that is being made is given up."""
        self._closing.set()
        self._nudge.set()
        if self._thread.ident is not None:
            self._thread.join()

    @property
    def ended(self) -> bool:
        return self._thread.ident is not None and not self._thread.is_alive()

    @property
    def pair(self) -> Pair | None:
        """The flows that are played; None until the first are open."""
        return self._pair

    def ask(self, wanted: Message | Policy) -> None:
        """Let the thread do what a page wants; ValueError where that cannot be, or too much waits."""
        if isinstance(wanted, messages.Cancel):
            self._cancel.set()
            return
        if not isinstance(wanted, Policy):
            self._check(wanted)
        try:
            self._wanted.put_nowait(wanted)
        except queue.Full:
            raise ValueError(f"message: {WAITING} wait already; wanted fewer at a time") from None
        if not isinstance(wanted, messages.Hand):  # a hand that moves would hurry the flow
            self._nudge.set()

    def _check(self, wanted: Message) -> None:
        """Raise ValueError where a message asks for what there is not."""
        pair = self._pair
        if isinstance(wanted, messages.Open):
            if wanted.case not in self.offers:
                raise ValueError(f"case: got {wanted.case[:40]!r}, wanted one of {', '.join(self.offers)}")
            low, high = (share * self.offers[wanted.case].chosen.definition.case.reynolds for share in REYNOLDS)
            if wanted.reynolds is not None and not low <= wanted.reynolds <= high:
                raise ValueError(f"reynolds: got {wanted.reynolds:g}, wanted {low:g} to {high:g} for {wanted.case}")
        elif isinstance(wanted, messages.Speed):
            if not SLOWEST <= wanted.value <= FASTEST:
                raise ValueError(f"speed: got {wanted.value:g}, wanted {SLOWEST:g} to {FASTEST:g} L/U a second")
        elif pair is None:
            raise ValueError("message: no flow is open yet; wait for it")
        elif isinstance(wanted, messages.Drive) and wanted.by not in (HAND, *pair.controllers):
            raise ValueError(f"drive: got {wanted.by[:40]!r}, wanted one of {', '.join((HAND, *pair.controllers))}")
        elif isinstance(wanted, messages.Hand):
            if len(wanted.actions) != pair.actions or not all(-1 <= action <= 1 for action in wanted.actions):
                raise ValueError(f"hand: got {len(wanted.actions)} actions, wanted {pair.actions} in [-1, 1]")
        elif isinstance(wanted, messages.Field) and self._picture is not None:
            names = [shade.name for shade in self._picture.shades]
            if wanted.name not in names:
                raise ValueError(f"field: got {wanted.name[:40]!r}, wanted one of {', '.join(names)}")

    def _run(self) -> None:
        try:
            self._open(self.first, None)
            while not self._closing.is_set():
                self._obey()
                if self.hub.joined.is_set():
                    self.hub.joined.clear()
                    self._tell_traces()
                    self._show()
                if self.hub.pages and (not self._paused or self._owed):
                    self._act()
                else:
                    self._due = 0.0
                    self._nudge.wait(0.1)
        except _Stopped:
            if not self._closing.is_set():
                self.problem = RuntimeError("play: the first flow was given up, so there is none to show")
        except Exception as problem:
            self.problem = problem

    # ---- what is asked for

    def _obey(self) -> None:
        self._nudge.clear()
        while True:
            try:
                wanted = self._wanted.get_nowait()
            except queue.Empty:
                return
            try:
                if not isinstance(wanted, Policy):
                    self._check(wanted)  # the flow may be another by now
                self._do(wanted)
            except ValueError as error:
                self._say(str(error))
            if not isinstance(wanted, messages.Hand):
                self._tell_state()

    def _do(self, wanted: Message | Policy) -> None:
        assert self._pair is not None and self._picture is not None
        match wanted:
            case Policy():
                self._policy = wanted
                if self._case == self.first and self.run is not None:
                    fresh = POLICY not in self._pair.controllers
                    self._pair.learnt(wanted)
                    if fresh:
                        self._tell_layout()
            case messages.Drive(by):
                self._pair.drive(by)
                self._notice = None
                if self._score and self._score["left"] > 0:
                    self._score = None
            case messages.Hand(actions):
                self._pair.hand[:] = actions
            case messages.Pause(on):
                self._paused, self._owed = on, 0
            case messages.Step():
                self._paused, self._owed = True, 1
            case messages.Reset():
                self._score = None
                self._reset()
            case messages.Score():
                self._pair.drive(HAND)
                self._reset()
                self._paused = False
                self._score = {"left": SCORED, "value": None}
            case messages.Speed(value):
                self._speed, self._pace, self._due = value, None, 0.0
            case messages.Field(name):
                self._shade = [shade.name for shade in self._picture.shades].index(name)
                self._show()
            case messages.Open(case, reynolds):
                self._open(case, reynolds)

    def _open(self, case: str, reynolds: float | None) -> None:
        """Open a flow and play it; the one before goes on where that fails or is stopped."""
        self._cancel.clear()
        self._busy = {"what": f"opening {case}", "share": 0.0}
        self._tell_state()
        try:
            simulation = self.offers[case].open(reynolds, self._progress)
            own = case == self.first and self.run is not None
            pair = Pair(simulation, self._policy if own else None, shipped=not own)
            picture = Picture(simulation.flows[0])
        except (_Stopped, ValueError, RuntimeError, OSError) as error:
            self._busy = None
            if self._pair is None or self._closing.is_set():
                raise
            self._say("stopped; the flow before goes on" if isinstance(error, _Stopped) else str(error))
            return
        self._busy = self._notice = self._score = None
        self._case, self._pair, self._picture, self._amplitudes = case, pair, picture, [0.0] * len(pair.mixing)
        self._layout, self._pace, self._reached = (self._layout + 1) % 65536, None, None
        self._tell_layout()
        self._tell_traces()
        self._tell_state()
        self._show()

    def _progress(self, what: str, share: float) -> None:
        """Take how far a flow is that is made; leave where it is not wanted any more."""
        if self._closing.is_set() or self._cancel.is_set():
            raise _Stopped
        self._busy = {"what": what, "share": round(min(max(share, 0.0), 1.0), 3)}
        if time.monotonic() - self._told > 0.2:
            self._tell_state()

    # ---- the flow

    def _act(self) -> None:
        assert self._pair is not None
        pair, begun = self._pair, self._pair.time
        self._owed = max(self._owed - 1, 0)
        parts = max(1, min(pair.steps, round(RATE * pair.interval / self._speed)))
        now = time.monotonic()
        if self._due < now - LATE:
            self._due, self._pace = now, (now, begun)
        share = pair.interval / parts / self._speed

        def seen(amplitudes: np.ndarray) -> None:
            self._amplitudes = amplitudes.tolist()
            self._due += share
            if time.monotonic() - self._framed >= 0.9 / RATE:
                self._show()
            if (left := self._due - time.monotonic()) > 0:
                self._nudge.wait(left)

        if pair.act(parts, seen):
            self._say(f"the flow blew up at {pair.time:.1f} L/U; both began anew, the hand at rest")
            self._score = None
            self._reset()
            self._tell_state()
        if self._paused:
            self._show()
        self._count(pair)
        self._measure(pair)

    def _reset(self) -> None:
        assert self._pair is not None
        self._pair.reset()
        self._amplitudes, self._pace = [0.0] * len(self._amplitudes), None
        self._tell_traces()
        self._show()

    def _count(self, pair: Pair) -> None:
        """Go on with a game by hand: its score is the drag saved less the power spent, in percent."""
        if self._score and self._score["value"] is None:
            saved, spent = pair.saved(pair.time)
            left = max(SCORED - pair.time, 0.0)
            over = left < 1e-6
            self._score = {"left": 0.0 if over else round(left, 2), "value": 100 * (saved - spent) if over else None}
            if over or time.monotonic() - self._told > 0.1:
                self._tell_state()

    def _measure(self, pair: Pair) -> None:
        """Tell about once a second how fast the flow is."""
        now = time.monotonic()
        if self._pace is None:
            self._pace = now, pair.time
        elif now - self._pace[0] > 1.0:
            self._reached = round((pair.time - self._pace[1]) / (now - self._pace[0]), 2)
            self._pace = now, pair.time
            self._tell_state()

    # ---- what pages are told

    def _say(self, text: str) -> None:
        self._notice = {"text": text, "id": (self._notice or {"id": 0})["id"] + 1}

    def _show(self) -> None:
        """Leave a frame of now."""
        if self._pair is None or self._picture is None or not self.hub.pages:
            return
        self._framed, self._number = time.monotonic(), self._number + 1
        pair, numbers = self._pair, self._pair.numbers(self._amplitudes)
        frame = self._picture.frame(self._number, self._layout, self._shade, pair.states, numbers)
        self.hub.show(self._number, frame)

    def _tell_layout(self) -> None:
        assert self._pair is not None and self._picture is not None
        file = self.offers[self._case].chosen.definition.case.reynolds
        self.hub.tell(
            "layout",
            {
                "id": self._layout,
                "case": self._case,
                "cases": [{"name": n, "reynolds": o.chosen.cases[0].reynolds} for n, o in self.offers.items()],
                "reynolds_range": [share * file for share in REYNOLDS],
                "run": self.run if self._case == self.first else None,
                "drivers": [HAND, *self._pair.controllers],
                "speeds": [SLOWEST, FASTEST],
                "scored": SCORED if self._pair.shown[0] == "c_d" else None,
                **layout.described(self._pair, self._picture),
            },
        )

    def _tell_state(self) -> None:
        self._told = time.monotonic()
        pair = self._pair
        self.hub.tell(
            "state",
            {
                "by": pair.by if pair else None,
                "hand": pair.hand.tolist() if pair else [],
                "paused": self._paused,
                "speed": self._speed,
                "reached": self._reached,
                "field": self._picture.shades[self._shade].name if self._picture else None,
                "busy": self._busy,
                "notice": self._notice,
                "score": self._score,
            },
        )

    def _tell_traces(self) -> None:
        """Tell the readings so far, a row of time, now and beside each."""
        if self._pair is not None:
            rows = [[reading.time, *reading.now, *reading.beside] for reading in self._pair.readings]
            self.hub.tell("traces", {"id": self._layout, "rows": np.round(np.nan_to_num(rows), 5).tolist()})
