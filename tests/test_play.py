"""The page's server without a browser: what it shows, what it obeys, whom it refuses, and what it outlives."""

import http.client
import json
import os
import signal
import socket
import stat
import subprocess
import sys
import time
import zlib
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus

from manywake import api
from manywake.case.learning import Learning
from manywake.cli.playing import _opener
from manywake.flow import readings
from manywake.flow.batch import FlowBatch
from manywake.learn import evaluate, flows, tables
from manywake.learn.controllers import simple
from manywake.learn.runs import Run
from manywake.learn.settings import Collection
from manywake.play import messages, pair, record, server, session
from manywake.play.hub import Hub
from manywake.play.pair import Pair
from manywake.play.picture import Picture
from manywake.play.session import Offer, Session
from manywake.play.training import Training
from manywake.suite import load

from .playing import KEY, NAME, PATIENCE, decoded, frame, note, offers, page, send, served, whole

pytestmark = pytest.mark.alone

SHORT = {"interval": 0.005, "actions": 4}
SAVED, POWER, DRAG, BESIDE, AMPLITUDE = 2, 4, 5, 7, 9
"""Places among a frame's numbers."""


@pytest.fixture(scope="module")
def known():
    return offers(**SHORT)


@pytest.fixture(scope="module")
def simulation(known):
    return known[NAME].ready


@pytest.fixture(scope="module")
def live(known):
    with served(known) as made:
        yield made


@pytest.fixture
def client(live):
    """A socket whose page has been told of the flow; who drives is nobody."""
    with page(live) as made:
        send(made, "drive", by="none")
        send(made, "pause", on=False)
        note(made, "state", lambda said: said["by"] == "none" and not said["paused"])
        yield made


# ---- what is shown


def test_a_page_is_told_of_the_flow_and_then_sees_it_go_on(live):
    with page(live) as client:
        said = note(client, "layout")
        assert said["case"] == NAME and said["reynolds"] == 100
        assert said["drivers"] == ["hand", "none", "constant", "harmonic", "feedback", "policy"]
        assert said["actions"] == ["cylinder.top +, cylinder.bottom −"]
        assert [shown["name"] for shown in said["shown"]] == ["c_d", "c_l"]
        assert said["shown"][0]["free"] == pytest.approx(3.1959, rel=0.01)
        numbers, lanes = frame(client)
        assert lanes.shape[0] == 2 and len(numbers) == 5 + 2 + 2 + 2
        later, _ = frame(client, lambda found: found[0] > numbers[0] + 0.2)
        assert 2.0 < later[DRAG] < 4.0


def test_a_frame_has_the_field_in_eight_bits_and_no_hole_where_the_body_is(simulation):
    flow = simulation.flows[0]
    picture, start = Picture(flow), flow.baseline.start
    for which, shade in enumerate(picture.shades):
        numbers, lanes = decoded(picture.frame(1, 1, which, [start], [0.5, 2.0]))
        assert numbers.tolist() == [0.5, 2.0]
        truth = picture._values(shade.name, start)
        fluid = picture._raster.fluid
        inside = fluid & (truth > shade.low) & (truth < shade.high)
        step = (shade.high - shade.low) / 255
        assert inside.mean() > 0.8
        assert np.abs(shade.low + step * lanes[0][inside] - truth[inside]).max() < 0.51 * step + 1e-6
        # pixels of the body are like the fluid beside them
        row, column = np.argwhere(~fluid)[0]
        near = slice(max(row - 2, 0), row + 3), slice(max(column - 2, 0), column + 3)
        assert lanes[0][row, column] in lanes[0][near][fluid[near]]


def test_a_blown_up_field_is_drawn_too(simulation):
    flow = simulation.flows[0]
    picture, start = Picture(flow, 64), flow.baseline.start
    spoilt = replace(start, u=np.full_like(start.u, np.nan))
    with np.errstate(invalid="ignore"):
        assert picture.levels(picture.shades[0], spoilt).dtype == np.uint8


def test_what_is_saved_is_what_an_evaluation_says(simulation):
    flow, task = simulation.flows[0], simulation.task
    played = Pair(simulation)
    played.drive("constant")
    for _ in range(8):
        assert not played.act(2, lambda amplitudes: None)
    numbers = simulation.chosen.definition.controllers["constant"]
    whole = evaluate.play(flow, task, simple("constant", numbers, 1), [flow.baseline.start], 8)
    limits = np.array([actuator.limit for actuator in flow.case.actuators])
    late = evaluate.window(whole, 4 * played.steps, 8 * played.steps)
    found = evaluate.control(flow.baseline, limits, late, 0)
    saved, spent = played.saved(4 * played.interval)
    assert saved == pytest.approx(found.drag_reduction, abs=1e-12)
    assert spent == pytest.approx(found.power / found.cd_uncontrolled, abs=1e-12)


def test_whoever_drives_the_flow_beside_stays_uncontrolled_to_the_bit(simulation):
    flow = simulation.flows[0]
    played = Pair(simulation)
    for by in ("hand", "policy", "hand", "harmonic"):
        played.drive(by)
        played.hand[:] = 1.0
        played.act(1, lambda amplitudes: None)
    steps = round(played.time * played.unit / flow.case.dt)
    free = FlowBatch(flow.operators, flow.baseline.start, 1)
    free.advance(np.zeros((steps, 2, 1)))
    np.testing.assert_array_equal(played.states[0].u, free.velocity(0))
    assert np.abs(played.states[1].u - played.states[0].u).max() > 0.01


def test_the_hand_acts_more_often_than_a_policy():
    own = Pair(flows.open_flows(load.choose(NAME)))
    assert own.interval == pytest.approx(0.25)
    own.drive("hand")
    assert own.interval == pytest.approx(pair.TOUCH)


# ---- what is obeyed


def test_the_hand_drives_and_the_drag_answers(client):
    send(client, "drive", by="hand")
    send(client, "hand", actions=[1.0])
    numbers, _ = frame(client, lambda found: found[AMPLITUDE] > 0.5)
    assert numbers[AMPLITUDE + 1] == -numbers[AMPLITUDE]
    numbers, _ = frame(client, lambda found: abs(found[DRAG] - found[BESIDE]) > 0.01)
    assert numbers[POWER] > 0


def test_pause_step_reset_and_speed(client):
    send(client, "pause", on=True)
    note(client, "state", lambda said: said["paused"])
    send(client, "reset")
    numbers, _ = frame(client, lambda found: found[0] == 0)
    assert np.isnan(numbers[DRAG])
    send(client, "step")
    numbers, _ = frame(client, lambda found: found[0] > 0)
    assert numbers[0] == pytest.approx(SHORT["interval"] / 0.1)
    send(client, "speed", value=2.5)
    note(client, "state", lambda said: said["speed"] == 2.5 and said["paused"])
    send(client, "speed", value=20.0)


def test_another_field_is_drawn(client):
    before = frame(client)[1]
    send(client, "field", name="speed")
    note(client, "state", lambda said: said["field"] == "speed")
    after = frame(client, lambda numbers: True)[1]
    while np.abs(after.astype(int) - before).mean() < 20:
        after = frame(client)[1]
    send(client, "field", name="vorticity")


def test_two_pages_see_one_flow_and_both_can_drive_it(live, client):
    with page(live) as other:
        note(other, "layout")
        send(other, "drive", by="policy")
        note(client, "state", lambda said: said["by"] == "policy")
        send(client, "drive", by="constant")
        note(other, "state", lambda said: said["by"] == "constant")


def test_a_page_that_comes_later_is_told_what_was_read(live, client):
    numbers, _ = frame(client, lambda found: found[0] > 0.5)
    with page(live) as late:
        rows = note(late, "traces", lambda said: said["rows"] and said["rows"][-1][0] >= numbers[1] - 1e-3)["rows"]
    assert len(rows[0]) == 5 and (np.diff([row[0] for row in rows]) > 0).all()


def test_a_game_ends_with_the_drag_saved_less_the_power_spent(client, monkeypatch):
    monkeypatch.setattr(session, "SCORED", 0.5)
    send(client, "score")
    assert note(client, "state", lambda said: said["score"])["by"] == "hand"
    said = note(client, "state", lambda said: said["score"] and said["score"]["value"] is not None)
    assert said["score"]["left"] == 0 and abs(said["score"]["value"]) < 20
    send(client, "drive", by="none")  # what has come to its end stays
    assert note(client, "state", lambda said: said["by"] == "none")["score"]["value"] is not None


def test_a_game_is_over_when_another_drives(client):
    send(client, "score")
    note(client, "state", lambda said: said["score"])
    send(client, "drive", by="policy")
    assert note(client, "state", lambda said: said["by"] == "policy")["score"] is None


def test_making_a_flow_shows_how_far_it_is_and_can_be_stopped(client, monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    numbers, _ = frame(client)
    send(client, "open", case=NAME, reynolds=101.5)
    note(client, "state", lambda said: said["busy"] and not said["busy"]["what"].startswith("opening"))
    send(client, "cancel")
    said = note(client, "state", lambda said: said["busy"] is None)
    assert "the flow before goes on" in said["notice"]["text"]
    frame(client, lambda found: found[0] > numbers[0])
    assert not list((tmp_path / "manywake" / "baselines").glob("*.npz"))


def test_another_flow_is_opened_by_its_name(known):
    other = load.choose("free-cylinder-rotation", interval=0.04, actions=4)
    both = {**known, "free-cylinder-rotation": Offer(other)}
    with served(both) as made, page(made) as client:
        note(client, "layout", lambda said: said["case"] == NAME)
        send(client, "open", case="free-cylinder-rotation")
        said = note(client, "layout", lambda said: said["case"] != NAME)
        assert said["case"] == "free-cylinder-rotation" and len(said["cases"]) == 2
        numbers, _ = frame(client, lambda found: len(found) == 5 + 2 + 2 + 1 and found[0] > 0.1)
        assert 1.0 < numbers[DRAG] < 2.0


# ---- what is refused


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "wanted JSON"),
        ("{", "wanted JSON"),
        ("[" * 4000, "wanted JSON"),
        ("[]", "wanted an object with a type"),
        ('{"type": ["drive"]}', "wanted an object with a type"),
        ('{"type": "fly"}', "one of drive, hand, pause"),
        ('{"type": "drive"}', "drive wants"),
        ('{"type": "drive", "by": 3}', "by of drive is of another type"),
        ('{"type": "drive", "by": "me"}', "got 'me', wanted one of hand, none"),
        ('{"type": "drive", "by": "none", "also": 1}', "has no 'also'"),
        ('{"type": "hand", "actions": [0.1, 0.2]}', "got 2 actions, wanted 1"),
        ('{"type": "hand", "actions": [1.5]}', "in [-1, 1]"),
        ('{"type": "hand", "actions": [NaN]}', "NaN is no number"),
        ('{"type": "hand", "actions": [1e999]}', "not finite"),
        ('{"type": "hand", "actions": ["1"]}', "of another type"),
        ('{"type": "speed", "value": 1e9}', "wanted 0.25 to 20"),
        ('{"type": "speed", "value": 99999999999999999999}', "too long"),
        ('{"type": "field", "name": "smoke"}', "wanted one of vorticity"),
        ('{"type": "open", "case": "../../etc/passwd"}', "wanted one of cylinder-jets"),
        ('{"type": "open", "case": "cylinder-jets", "reynolds": 1e6}', "wanted 20 to 200"),
        ('{"type": "seen"}', "seen wants"),
        ("x" * 5000, "wanted at most 4096"),
        (b"\x00\x01", "got bytes, wanted text"),
    ],
)
def test_a_malformed_message_gets_an_error_and_harms_nothing(client, text, said):
    client.send(text)
    assert said in note(client, "error")["message"]
    numbers, _ = frame(client)
    frame(client, lambda found: found[0] > numbers[0])


def test_a_message_that_is_too_large_closes_the_socket_and_no_other(live, client):
    with page(live) as large:
        note(large, "layout")
        large.send("x" * (server.LARGEST + 1))
        assert _closed(large) == 1009
    frame(client)


def test_a_flood_closes_the_socket_and_no_other(live, client):
    with page(live) as flooding:
        note(flooding, "layout")
        with pytest.raises(ConnectionClosed):
            for _ in range(20000):
                send(flooding, "pause", on=False)
        assert _closed(flooding) == server.TOO_FAST
    numbers, _ = frame(client)
    frame(client, lambda found: found[0] > numbers[0])


@pytest.mark.parametrize("key", ["", "another", KEY + "x"])
def test_a_wrong_key_opens_nothing(live, key):
    with page(live, key) as client:
        assert _closed(client) == server.WRONG_KEY


@pytest.mark.parametrize("origin", [None, "null", "http://evil.example", "https://127.0.0.1", "http://127.0.0.1:1"])
def test_a_page_of_another_origin_opens_no_socket(live, origin):
    with pytest.raises(InvalidStatus) as refused, page(live, origin=origin):
        pass
    assert refused.value.response.status_code == 403


def test_another_host_gets_nothing(live):
    there = f"127.0.0.1:{live.port}"
    for host in ("evil.example", f"evil.example:{live.port}", "127.0.0.1"):
        assert got(live.port, "/", Host=host).status == 403
    assert got(live.port, "/", Origin="http://evil.example").status == 403
    with socket.create_connection(("127.0.0.1", live.port)) as raw:
        lines = (
            f"GET /live?key={KEY} HTTP/1.1", "Host: evil.example", f"Origin: http://{there}", "Connection: Upgrade",
            "Upgrade: websocket", "Sec-WebSocket-Version: 13", "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==", "", "",
        )  # fmt: skip
        raw.sendall("\r\n".join(lines).encode())
        assert b" 403 " in raw.recv(100)


def test_pages_have_a_policy_and_no_file_outside_is_served(live):
    answer = got(live.port, "/", Host=f"localhost:{live.port}")
    text, policy = answer.text, answer.headers["content-security-policy"]
    assert answer.status == 200 and "manywake" in text and KEY not in text
    assert "default-src 'none'" in policy and "script-src 'self';" in policy and "unsafe" not in policy
    assert "http:" not in policy and "https:" not in policy
    for path in ("/../server.py", "/..%2fserver.py", "/%2e%2e/server.py", "//etc/passwd", "/settings.json"):
        assert got(live.port, path).status == 404
    assert got(live.port, "/", "POST").status == 405


@dataclass
class Answer:
    status: int
    headers: Mapping[str, str]
    text: str


def got(port: int, path: str, method: str = "GET", **headers: str) -> Answer:
    with closing(http.client.HTTPConnection("127.0.0.1", port, timeout=PATIENCE)) as connection:
        connection.request(method, path, headers=headers)
        answer = connection.getresponse()
        return Answer(answer.status, answer.headers, answer.read().decode())


def test_nothing_is_fetched_from_elsewhere():
    for path in Path(server.__file__).with_name("static").iterdir():
        text = path.read_text().replace("http://www.w3.org/2000/svg", "")
        assert "http://" not in text.replace("http://${", "") and "https://" not in text, path


def test_only_the_loopback_interface_listens():
    with server.bound(None) as made, server.bound(None) as other:
        assert made.getsockname()[0] == other.getsockname()[0] == "127.0.0.1"
        assert made.getsockname()[1] != other.getsockname()[1]
        with pytest.raises(ValueError, match="port: got .* which cannot be had"):
            server.bound(made.getsockname()[1])


def test_too_many_pages_are_told_so(live, monkeypatch, client):
    monkeypatch.setattr(server, "PAGES", 1)
    with page(live) as more:
        assert _closed(more) == server.TOO_MANY


def _closed(client) -> int:
    """Return the code that a socket is closed with."""
    try:
        while True:
            client.recv(timeout=PATIENCE)
    except ConnectionClosed as closed:
        return closed.rcvd.code


# ---- what is outlived


def test_a_page_that_reads_nothing_gets_no_more_and_slows_no_other(live, client):
    with page(live) as still:
        first, _ = frame(client)
        frame(client, lambda found: found[0] > first[0] + 2.0)
        frames, end = 0, time.monotonic() + PATIENCE
        while time.monotonic() < end:
            try:
                frames += isinstance(still.recv(timeout=0.3 if frames else PATIENCE), bytes)
            except TimeoutError:
                break
            if frames > server.AHEAD:
                break
    assert frames == server.AHEAD


def test_a_socket_that_is_dropped_lets_the_flow_wait_for_the_next_page(live):
    with page(live) as client:
        numbers, _ = frame(client)
        client.socket.shutdown(socket.SHUT_RDWR)
    end = time.monotonic() + PATIENCE
    while live.session.hub.pages and time.monotonic() < end:
        time.sleep(0.01)
    assert live.session.hub.pages == 0
    with page(live) as client:
        frame(client, lambda found: found[0] > numbers[0])


def test_a_flow_that_blows_up_begins_anew(client, monkeypatch):
    frame(client, lambda found: found[0] > 0.5)
    monkeypatch.setattr(readings, "NO_FLOW", 0.0)
    said = note(client, "state", lambda said: said["notice"])
    assert "the flow blew up at" in said["notice"]["text"] and said["hand"] == [0.0]
    monkeypatch.undo()
    frame(client, lambda found: 0.2 < found[0] < 5)


def test_a_server_that_is_stopped_tells_its_pages_and_leaves_no_thread(known):
    with served(known) as made, page(made) as client:
        frame(client)
        made.stop()
        assert _closed(client) in (1001, 1012)


def test_a_thread_that_fails_ends_the_server(known):
    made = server.Server(Session({NAME: replace(known[NAME], ready=None, chosen=None)}, NAME, Hub()), server.bound(0))
    with pytest.raises(AttributeError):
        made.run()
    assert made.session.ended


def test_a_hub_keeps_the_newest_only():
    hub = Hub()
    woken = []
    key = hub.join(lambda: woken.append(1))
    for number in range(1, 1000):
        hub.show(number, bytes(10))
        hub.tell("state", {"number": number})
    hub.tell("layout", {})
    assert hub.frame(0) == (999, bytes(10)) and hub.frame(999) is None
    (_, state), (last, layout) = hub.notes(0)
    assert json.loads(state) == {"type": "state", "number": 999} and json.loads(layout) == {"type": "layout"}
    assert hub.notes(last) == [] and len(woken) == 2 * 999 + 1
    hub.leave(key)
    assert hub.pages == 0


def test_too_many_messages_at_once_are_refused(known):
    idle = Session(known, NAME, Hub())
    for _ in range(session.WAITING):
        idle.ask(messages.Speed(1.0))
    with pytest.raises(ValueError, match="64 wait already"):
        idle.ask(messages.Speed(1.0))


# ---- a training


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "run"
    learning = Learning(update_period=2, episodes=4, batch_size=2, hidden=(8,))
    return api.train(learning=learning, collection=Collection(engine="serial"), run=folder, **SHORT)


def test_a_training_is_told_as_it_grows(run):
    watching = Training(Run(run.folder), 3.2)
    policy, curve = watching.policy(), watching.curve()
    assert policy.version == 2 and watching.policy() is None
    assert curve["done"] == curve["total"] == 4 and len(curve["points"]) == 4
    table = tables.columns(run.folder / "episodes.csv")
    assert curve["points"][-1][1] == pytest.approx(100 * (1 - table["c_d_second_half"][-1] / 3.2), abs=1e-3)
    assert watching.curve() is None
    tables.append(run.folder / "episodes.csv", [{name: column[-1] for name, column in table.items()}])
    assert watching.curve()["done"] == 5


def test_the_page_of_a_run_has_its_policy_and_its_curve(run, monkeypatch):
    monkeypatch.setattr(server, "LOOK", 0.05)
    first = {"run mine": Offer(run.simulation.chosen, run.simulation)}
    assert Pair(run.simulation, shipped=False).controllers.keys() == {"none", "constant", "harmonic", "feedback"}
    with served(first, training=Training(Run(run.folder), 3.2), run="run mine") as made, page(made) as client:
        assert note(client, "layout", lambda said: "policy" in said["drivers"])["run"] == "run mine"
        send(client, "drive", by="policy")
        note(client, "state", lambda said: said["by"] == "policy")
        with page(made) as late:  # what was told before is told to who comes later
            assert note(late, "training", lambda said: said["curve"])["version"] == 2


# ---- recordings


def test_a_recording_gives_back_every_frame(simulation):
    written = record.recording(simulation, 0.3, width=64)
    length, rest = whole(written)
    about = json.loads(rest[:length])
    fields = np.frombuffer(zlib.decompress(rest[length:]), np.uint8)
    shape = len(about["drivers"]), about["frames"], about["height"], about["width"]
    frames = np.cumsum(fields.reshape(shape), axis=3, dtype=np.uint8)
    assert about["drivers"] == ["none", "constant", "policy"] and about["frames"] == 7
    picture, played = Picture(simulation.flows[0], 64), Pair(simulation)
    played.drive("policy")
    for t in range(6):
        np.testing.assert_array_equal(frames[2, t], picture.levels(picture.shades[0], played.states[1]) >> 1)
        played.act(1, lambda amplitudes: None)
        assert about["numbers"]["policy"][t + 1][DRAG] == pytest.approx(played.readings[-1].now[0], abs=1e-4)
    assert about["numbers"]["policy"][0][DRAG] is None


def test_the_recordings_of_the_docs_are_small():
    demo = Path(__file__).parents[1] / "docs" / "demo"
    names = [each["name"] for each in json.loads((demo / "cases.json").read_text())]
    assert names == list(record.CASES)
    assert all((demo / f"{name}.wake").stat().st_size <= record.LARGEST for name in names)


# ---- the command


def test_the_command_says_where_the_page_is_and_ends_when_it_is_told_to():
    words = [sys.executable, "-m", "manywake.cli", "play", "--no-browser", "--case", NAME]
    with subprocess.Popen(words, stderr=subprocess.PIPE, text=True) as process:
        address = process.stderr.readline().split()[-1]
        port, _, key = address.removeprefix("http://127.0.0.1:").partition("/#key=")
        assert len(key) >= 32
        while True:
            try:
                made = got(int(port), "/")
                break
            except ConnectionRefusedError:
                assert process.poll() is None
                time.sleep(0.05)
        assert made.status == 200
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE) == 0


def test_the_command_refuses_what_it_cannot_show(tmp_path):
    def refused(*words):
        done = subprocess.run([sys.executable, "-m", "manywake.cli", "play", *words], capture_output=True, text=True)
        assert done.returncode == 2
        return " ".join(done.stderr.split())

    assert "which has no settings.json" in refused(str(tmp_path))
    assert "wanted TASK = Task(...)" in refused("--case", "channel")


def test_the_browser_is_led_by_a_file_that_nobody_else_can_read(monkeypatch):
    opened = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    with _opener("http://127.0.0.1:1/#key=secret&x") as show:
        show()
        path = Path(opened[0].removeprefix("file://"))
        assert "secret" not in opened[0] and "#key=secret&amp;x" in path.read_text()
        assert stat.S_IMODE(os.stat(path).st_mode) == 0o600
    assert not path.exists()
