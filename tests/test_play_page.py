"""The page in a headless Chromium: what is pressed there is felt by the flow, and what the flow does is seen."""

import json
import os
from pathlib import Path

import pytest
from PIL import Image

from manywake.learn import flows
from manywake.play import record
from manywake.play.session import Offer
from manywake.suite import load

from . import chromium
from .playing import KEY, NAME, served

pytestmark = [
    pytest.mark.alone,
    pytest.mark.skipif(chromium.PROGRAM is None, reason="no chromium is installed; apt-get install chromium"),
]
PICTURES = os.environ.get("MANYWAKE_PICTURES")
"""Folder for pictures of the page, docs/play say."""
READY = "window.manywake && manywake() && manywake().numbers[0] > 0.5"


@pytest.fixture(scope="module")
def known():
    chosen = load.choose(NAME)
    return {NAME: Offer(chosen, flows.open_flows(chosen))}


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with chromium.browser(tmp_path_factory.mktemp("chromium")) as made:
        yield made


@pytest.fixture(scope="module")
def server(known):
    with served(known) as made:
        yield made


@pytest.fixture
def tab(browser, server):
    made = browser.tab()
    made.size(1280, 860)
    made.open(server.address)
    made.until(READY)
    press(made, "none")
    made.js("document.querySelector('#reset').click()")
    yield made
    assert made.errors == []
    made.open("about:blank")


def press(tab, value):
    """Press the button of who drives, or of a field, and wait until it is so."""
    tab.until(f"document.querySelector('[data-value={value}]').click() || true")
    tab.until(f"document.querySelector('[data-value={value}]').getAttribute('aria-checked') === 'true'")


def picture(tab, name):
    if PICTURES:
        path = Path(PICTURES) / f"{name}.png"
        tab.picture(path)
        with Image.open(path) as image:
            image.convert("RGB").quantize(192, dither=Image.Dither.NONE).save(path, optimize=True)


def test_the_slider_moves_and_the_drag_answers(tab):
    tab.until("manywake().numbers[0] > 2 && manywake().numbers[5] === manywake().numbers[7]")
    tab.js("(s => { s.value = 1; s.dispatchEvent(new Event('input')) })(document.querySelector('#hand input'))")
    tab.until("manywake().numbers[9] > 0.9 && Math.abs(manywake().numbers[5] - manywake().numbers[7]) > 0.01")
    assert tab.js("document.querySelector('[data-value=hand]').getAttribute('aria-checked')") == "true"


def test_a_policy_that_is_switched_on_saves_drag(tab):
    tab.js("(s => { s.value = 4.3; s.dispatchEvent(new Event('input')) })(document.querySelector('#speed'))")
    press(tab, "policy")
    tab.until("manywake().numbers[0] > 12 && manywake().numbers[2] > 0.04")
    assert float(tab.js("document.querySelector('#saved').textContent").split()[0]) > 4
    tab.js("(s => { s.value = 2.3; s.dispatchEvent(new Event('input')) })(document.querySelector('#speed'))")
    tab.until("manywake().numbers[0] > 22")
    picture(tab, "desktop")


def test_keys_drive_while_they_are_held(tab):
    tab.js("document.activeElement.blur()")
    tab.key("q", "KeyQ", True)
    tab.until("manywake().numbers[9] > 0.5")
    tab.key("q", "KeyQ", False)
    tab.until("Math.abs(manywake().numbers[9]) < 0.1")
    tab.key(" ", "Space", True)
    tab.until("document.querySelector('#pause').textContent === 'Go on'")
    tab.key(" ", "Space", False)
    tab.key(" ", "Space", True)
    tab.until("document.querySelector('#pause').textContent === 'Pause'")


def test_the_key_is_kept_from_the_address_and_from_links(tab):
    assert tab.js("location.href").endswith("/")
    tab.js("document.querySelector('#link').click()")
    said = tab.until("document.querySelector('#share-says').textContent")
    assert "case=cylinder-jets" in said and "by=none" in said and KEY not in said


def test_two_tabs_see_one_flow(tab, browser, server):
    other = browser.tab()
    other.size(1280, 860)
    other.open(server.address)
    other.until(READY)
    press(other, "constant")
    tab.until("document.querySelector('[data-value=constant]').getAttribute('aria-checked') === 'true'")
    numbers = [each.js("[...manywake().numbers.slice(0, 1)]")[0] for each in (tab, other)]
    assert abs(numbers[0] - numbers[1]) < 2
    other.open("about:blank")


def test_a_phone_has_no_room_beside(tab):
    tab.size(390, 844, phone=True)
    tab.until("document.documentElement.scrollWidth <= 390 && document.querySelector('#field').clientWidth > 350")
    small = "[...document.querySelectorAll('button')].filter((b) => b.offsetHeight && b.offsetHeight < 30).length"
    assert tab.js(small) == 0
    press(tab, "policy")
    tab.until("manywake().numbers[0] > 12")
    picture(tab, "phone")


def test_the_dark_page_and_the_other_fields(tab):
    tab.js("document.querySelector('#theme').click()")
    dark = tab.js("document.documentElement.dataset.theme")
    press(tab, "harmonic")
    for field in ("pressure", "speed", "vorticity"):
        press(tab, field)
        tab.until(f"document.querySelector('#shade').textContent.startsWith('{field}')")
    tab.until("manywake().numbers[0] > 12")
    picture(tab, dark)
    tab.js("document.querySelector('#theme').click()")


def test_everything_that_can_be_pressed_has_a_name(tab):
    nameless = """[...document.querySelectorAll('button, input, select, canvas')].filter((e) => e.offsetParent
        && !(e.textContent.trim() || e.getAttribute('aria-label') || e.closest('label'))).map((e) => e.outerHTML)"""
    assert [one for one in tab.js(nameless) if "scale" not in one] == []
    assert tab.js("document.querySelectorAll('[role=radio][tabindex=\"0\"]').length") == 2


def test_the_page_says_that_the_server_is_gone_and_comes_back(browser, known):
    tab = browser.tab()
    with served(known) as first:
        port = first.port
        tab.open(first.address)
        tab.until(READY)
    shown = "(b => !b.hidden && b.textContent)(document.querySelector('#banner'))"
    assert "server is gone" in tab.until(shown)
    with served(known, port):
        tab.until("document.querySelector('#banner').hidden && document.body.dataset.link === 'there'")
        last = tab.until("manywake().numbers[0]")
        tab.until(f"manywake().numbers[0] !== {last}")
    assert tab.errors == []


def test_recorded_episodes_play_without_a_server(browser, known, tmp_path, monkeypatch):
    from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
    from threading import Thread

    monkeypatch.setattr(record, "CASES", {NAME: 96})
    monkeypatch.setattr(record, "LENGTH", 3.0)
    record.main(tmp_path)

    class Quiet(SimpleHTTPRequestHandler):
        def __init__(self, *arguments):
            super().__init__(*arguments, directory=str(tmp_path))

        def log_message(self, *arguments):
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Quiet) as plain:
        thread = Thread(target=plain.serve_forever)
        thread.start()
        tab = browser.tab()
        tab.size(1280, 860)
        tab.open(f"http://127.0.0.1:{plain.server_port}/")
        tab.until(READY)
        press(tab, "policy")
        tab.until("Math.abs(manywake().numbers[9]) > 0.05")
        assert tab.js("document.querySelector('#hand').offsetParent") is None
        assert json.loads((tmp_path / "cases.json").read_text())[0]["name"] == NAME
        picture(tab, "demo")
        plain.shutdown()
        thread.join()
    assert tab.errors == []
