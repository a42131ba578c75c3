"""A headless Chromium that is steered through its DevTools protocol: just enough to take pictures."""

import base64
import json
import shutil
import subprocess
import tempfile
import time
from contextlib import suppress
from pathlib import Path
from typing import Any, Self
from urllib.request import urlopen

from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

_NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
_START_S = 30.0
_WAIT_S = 30.0


class Browser:
    """One page of a headless Chromium.

    Args:
        width: width of the window in CSS pixels.
        height: height of the window in CSS pixels.
        scale: device pixels per CSS pixel.
    """

    def __init__(self, width: int, height: int, scale: float = 1.0) -> None:
        program = next((path for name in _NAMES if (path := shutil.which(name))), None)
        if program is None:
            raise SystemExit("no Chromium found; on Debian: apt-get install chromium")
        self._profile = tempfile.TemporaryDirectory(prefix="screenshots-", ignore_cleanup_errors=True)
        self._process = subprocess.Popen(
            [
                program,
                "--headless=new",
                "--no-sandbox",
                "--disable-gpu",
                "--hide-scrollbars",
                "--no-first-run",
                "--disable-background-networking",
                "--disable-component-update",
                "--disable-sync",
                "--remote-debugging-port=0",
                f"--user-data-dir={self._profile.name}",
                f"--window-size={width},{height}",
                "about:blank",
            ],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        self._count = 0
        self._socket = connect(self._page_address(), max_size=None)
        self.resize(width, height, scale)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(ConnectionClosed):
            self.call("Browser.close")
        self._socket.close()
        self._process.wait(_START_S)
        self._profile.cleanup()

    def _page_address(self) -> str:
        port_file = Path(self._profile.name) / "DevToolsActivePort"
        deadline = time.monotonic() + _START_S
        while not (port_file.is_file() and (lines := port_file.read_text().split())):
            if time.monotonic() > deadline or self._process.poll() is not None:
                raise SystemExit("Chromium did not start")
            time.sleep(0.1)
        with urlopen(f"http://127.0.0.1:{lines[0]}/json/list") as answer:
            pages = json.load(answer)
        url: str = next(page["webSocketDebuggerUrl"] for page in pages if page["type"] == "page")
        return url

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """Send one DevTools command and return its result."""
        self._count += 1
        self._socket.send(json.dumps({"id": self._count, "method": method, "params": params}))
        while True:
            message = json.loads(self._socket.recv(timeout=_WAIT_S))
            if message.get("id") == self._count:
                if "error" in message:
                    raise RuntimeError(f"{method}: {message['error']['message']}")
                result: dict[str, Any] = message["result"]
                return result

    def resize(self, width: int, height: int, scale: float = 1.0) -> None:
        """Give the page another size."""
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=scale,
            mobile=False,
        )

    def open(self, url: str) -> None:
        """Go to a page."""
        self.call("Page.navigate", url=url)

    def run(self, script: str) -> Any:
        """Return the value of a JavaScript expression."""
        result = self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in result:
            raise RuntimeError(f"{script}: {result['exceptionDetails']}")
        return result["result"].get("value")

    def wait_for(self, script: str, what: str = "") -> Any:
        """Wait until a JavaScript expression is true, and return its value."""
        deadline = time.monotonic() + _WAIT_S
        while True:
            value = self.run(script)
            if value:
                return value
            if time.monotonic() > deadline:
                raise TimeoutError(f"waited {_WAIT_S:.0f} s for {what or script}")
            time.sleep(0.2)

    def wait_for_text(self, *texts: str) -> None:
        """Wait until the page shows all of `texts`."""
        for text in texts:
            self.wait_for(f"document.body && document.body.innerText.includes({json.dumps(text)})", text)

    def click(self, script: str) -> None:
        """Click in the middle of the element that a JavaScript expression finds."""
        box = self.wait_for(
            f"(() => {{ const e = {script}; if (!e) return null; e.scrollIntoViewIfNeeded();"
            " const r = e.getBoundingClientRect(); return [r.x + r.width / 2, r.y + r.height / 2]; })()",
            script,
        )
        for kind in ("mouseMoved", "mousePressed", "mouseReleased"):
            self.call("Input.dispatchMouseEvent", type=kind, x=box[0], y=box[1], button="left", clickCount=1)

    def click_text(self, text: str, selector: str = "a, button, [role=button], [role=tab]") -> None:
        """Click the first element of `selector` whose text, or title without one, is `text`."""
        self.click(
            f"[...document.querySelectorAll({json.dumps(selector)})]"
            f".find(e => (e.innerText.trim() || e.title) === {json.dumps(text)})"
        )

    def box(self, script: str, margin: float = 0.0) -> dict[str, float]:
        """Return where on the page the element that a JavaScript expression finds is."""
        x, y, width, height = self.wait_for(
            f"(() => {{ const e = {script}; if (!e) return null; const r = e.getBoundingClientRect();"
            " return [r.x, r.y, r.width, r.height]; })()",
            script,
        )
        return {
            "x": max(0.0, x - margin),
            "y": max(0.0, y - margin),
            "width": width + 2 * margin,
            "height": height + 2 * margin,
        }

    def picture(self, file: Path, clip: dict[str, float] | None = None) -> None:
        """Write what the page shows, or the part `clip` of it, as PNG."""
        params: dict[str, Any] = {"format": "png"}
        if clip is not None:
            params["clip"] = {**clip, "scale": 1}
        file.write_bytes(base64.b64decode(self.call("Page.captureScreenshot", **params)["data"]))
