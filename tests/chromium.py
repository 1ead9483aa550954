"""Chromium without a window, driven through its DevTools protocol, with WebGL computed by the processor."""

import asyncio
import base64
import json
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from tornado.httpclient import AsyncHTTPClient
from tornado.websocket import WebSocketClientConnection, websocket_connect

from programs import CHROMIUM_VARIABLE, find_chromium

SKIP_REASON = f"needs Chromium: install it, for instance the Debian package chromium, or set {CHROMIUM_VARIABLE} to its program"
FLAGS = (
    *("--headless=new", "--no-sandbox", "--remote-debugging-port=0", "--no-first-run", "--disable-extensions", "--disable-sync"),
    *("--disable-background-networking", "--disable-component-update", "--disable-default-apps", "--no-default-browser-check"),
    *("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--hide-scrollbars", "--force-color-profile=srgb", "--mute-audio"),
    *("--disable-dev-shm-usage", "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1"),
)
START_SECONDS, REPLY_SECONDS, STOP_SECONDS = 60.0, 120.0, 10.0
MAX_MESSAGE_BYTES = 2**28


class Page:
    """A tab. Messages of its console and failures of its requests are kept in `messages`, URLs of its requests in `requests`."""

    def __init__(self, loop: asyncio.AbstractEventLoop, connection: WebSocketClientConnection) -> None:
        self._loop, self._connection, self._next_id = loop, connection, 0
        self.messages: list[str] = []
        self.requests: list[str] = []

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Call a method of the protocol and return its result."""
        return self._loop.run_until_complete(asyncio.wait_for(self._call(method, parameters), REPLY_SECONDS))

    def evaluate(self, expression: str) -> Any:
        """Return the value of a JavaScript expression, or of its promise."""
        result = self.call("Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True)
        assert "exceptionDetails" not in result, result["exceptionDetails"]
        return result["result"].get("value")

    def open(
        self, url: str, width: int = 640, height: int = 480, is_dark: bool = False, keeps_storage: bool = False, scale: float = 1.0
    ) -> None:
        """Go to a page and return when the navigation has begun, with a new list of messages.

        keeps_storage: whether the page finds what it has stored before. scale: device pixels per pixel of the page.
        """
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.call(f"{domain}.enable")
        self.messages.clear()
        self.requests.clear()
        self.call("Network.setCacheDisabled", cacheDisabled=True)
        if not keeps_storage:
            self.call("Storage.clearDataForOrigin", origin=url, storageTypes="cache_storage")
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=scale, mobile=False)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if is_dark else "light"}
        self.call("Emulation.setEmulatedMedia", features=[scheme])
        self.call("Page.navigate", url=url)

    def wait_for(self, expression: str, seconds: float = 60.0) -> None:
        """Wait until a JavaScript expression, or the value of its promise, is true."""
        end = time.monotonic() + seconds
        while not self.evaluate(f"Promise.resolve({expression}).then(Boolean)"):
            assert time.monotonic() < end, (expression, self.messages)
            self._loop.run_until_complete(asyncio.sleep(0.02))

    def screenshot(self) -> bytes:
        """Return a PNG file of what the tab shows."""
        return base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])

    async def _call(self, method: str, parameters: dict[str, Any]) -> dict[str, Any]:
        self._next_id += 1
        await self._connection.write_message(json.dumps({"id": self._next_id, "method": method, "params": parameters}))
        while True:
            content = await self._connection.read_message()
            assert content is not None, f"Chromium ended while {method} was called"
            message = json.loads(content)
            if message.get("id") == self._next_id:
                assert "error" not in message, (method, message["error"])
                return message["result"]
            self._keep(message)

    def _keep(self, message: dict[str, Any]) -> None:
        parameters = message.get("params", {})
        match message.get("method"):
            case "Network.requestWillBeSent":
                self.requests.append(parameters["request"]["url"])
            case "Runtime.exceptionThrown":
                details = parameters["exceptionDetails"]
                self.messages.append(details.get("exception", {}).get("description", details["text"]))
            case "Runtime.consoleAPICalled":
                self.messages.append(" ".join(str(item.get("value", item.get("description"))) for item in parameters["args"]))
            case "Log.entryAdded":
                self.messages.append(f"{parameters['entry']['text']} {parameters['entry'].get('url', '')}")


@contextmanager
def run_chromium(folder: Path) -> Iterator[Page]:
    """Run Chromium with a new profile in `folder`, within the context."""
    program = find_chromium()
    assert program is not None, SKIP_REASON
    command = [program, *FLAGS, f"--user-data-dir={folder}", "about:blank"]
    with (folder / "chromium.log").open("wb") as log:
        process = subprocess.Popen(command, stdout=log, stderr=log)
    loop = asyncio.new_event_loop()
    try:
        connection = loop.run_until_complete(_connect(process, folder))
        yield Page(loop, connection)
        connection.close()
    finally:
        process.terminate()
        with suppress(subprocess.TimeoutExpired):
            process.wait(STOP_SECONDS)
        process.kill()
        process.wait()
        loop.run_until_complete(asyncio.sleep(0.05))
        loop.close()


async def _connect(process: subprocess.Popen, folder: Path) -> WebSocketClientConnection:
    port_file, end = folder / "DevToolsActivePort", time.monotonic() + START_SECONDS
    while not port_file.is_file() or "\n" not in port_file.read_text():
        assert process.poll() is None and time.monotonic() < end, (folder / "chromium.log").read_text(errors="replace")[-2000:]
        await asyncio.sleep(0.05)
    port = port_file.read_text().split()[0]
    while True:
        response = await AsyncHTTPClient().fetch(f"http://127.0.0.1:{port}/json/list")
        tabs = [tab for tab in json.loads(response.body) if tab["type"] == "page"]
        if tabs:
            return await websocket_connect(tabs[0]["webSocketDebuggerUrl"], max_message_size=MAX_MESSAGE_BYTES)
        assert time.monotonic() < end, "Chromium opens no tab"
        await asyncio.sleep(0.05)
