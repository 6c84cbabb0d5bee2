"""A headless Chromium, driven by the DevTools protocol: as much of it as the tests of pages need."""

import base64
import itertools
import json
import shutil
import subprocess
import time
import urllib.request
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from websockets.sync.client import connect

PROGRAM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
PATIENCE = 120.0
FLAGS = (
    *("--headless=new", "--no-sandbox", "--no-first-run", "--remote-debugging-port=0", "--mute-audio"),
    *("--disable-background-timer-throttling", "--disable-renderer-backgrounding", "--disable-dev-shm-usage"),
    *("--disable-backgrounding-occluded-windows", "--disable-component-update", "--disable-background-networking"),
)


class Tab:
    """One page. errors: what its scripts threw, and what its security policy refused."""

    def __init__(self, address: str):
        self._closing, self._count = ExitStack(), itertools.count(1)
        self._socket = self._closing.enter_context(connect(address, max_size=None))
        self.errors: list[str] = []
        for domain in ("Page", "Runtime", "Log"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        number = next(self._count)
        self._socket.send(json.dumps({"id": number, "method": method, "params": params}))
        while True:
            said = json.loads(self._socket.recv(timeout=PATIENCE))
            if said.get("id") == number:
                assert "error" not in said, said
                return said["result"]
            if said.get("method") == "Runtime.exceptionThrown":
                self.errors.append(json.dumps(said["params"]["exceptionDetails"])[:500])
            if said.get("method") == "Log.entryAdded" and "Content Security" in said["params"]["entry"]["text"]:
                self.errors.append(said["params"]["entry"]["text"])

    def open(self, address: str) -> None:
        self.call("Page.navigate", url=address)

    def js(self, code: str) -> Any:
        """Return what an expression gives, or what the promise that it gives comes to."""
        said = self.call("Runtime.evaluate", expression=code, awaitPromise=True, returnByValue=True)
        assert "exceptionDetails" not in said, said
        return said["result"].get("value")

    def until(self, code: str, seconds: float = PATIENCE) -> Any:
        """Wait until an expression is true; return what it is."""
        end = time.monotonic() + seconds
        while not (found := self.js(f"(() => {{ try {{ return {code} }} catch {{ return null }} }})()")):
            assert time.monotonic() < end, f"not in {seconds} s: {code}; {self.errors}"
            time.sleep(0.02)
        return found

    def size(self, width: int, height: int, phone: bool = False) -> None:
        scale = 2 if phone else 1
        metrics = {"width": width, "height": height, "deviceScaleFactor": scale, "mobile": phone}
        self.call("Emulation.setDeviceMetricsOverride", **metrics)

    def picture(self, path: Path) -> None:
        path.write_bytes(base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"]))

    def key(self, key: str, code: str, down: bool) -> None:
        text = {"text": key} if down else {}
        self.call("Input.dispatchKeyEvent", type="keyDown" if down else "keyUp", key=key, code=code, **text)

    def close(self) -> None:
        self._closing.close()


class Browser:
    def __init__(self, port: int):
        self._port = port
        self._tabs: list[Tab] = []

    def tab(self) -> Tab:
        """Open another page."""
        request = urllib.request.Request(f"http://127.0.0.1:{self._port}/json/new?about:blank", method="PUT")
        with urllib.request.urlopen(request, timeout=PATIENCE) as answer:
            self._tabs.append(Tab(json.load(answer)["webSocketDebuggerUrl"]))
        return self._tabs[-1]

    def close(self) -> None:
        for tab in self._tabs:
            tab.close()


@contextmanager
def browser(folder: Path) -> Iterator[Browser]:
    """Start a browser whose profile is in a folder, and end it."""
    assert PROGRAM is not None
    command = [PROGRAM, *FLAGS, f"--user-data-dir={folder}", "about:blank"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        port, end = folder / "DevToolsActivePort", time.monotonic() + PATIENCE
        while not port.exists() or len(port.read_text().split()) < 2:
            assert process.poll() is None and time.monotonic() < end, "chromium does not start"
            time.sleep(0.05)
        made = Browser(int(port.read_text().split()[0]))
        try:
            yield made
        finally:
            made.close()
    finally:
        process.terminate()
        process.wait(PATIENCE)
