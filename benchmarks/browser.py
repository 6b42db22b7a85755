"""Browser: a headless Chromium that opens a page, by the DevTools protocol (https://chromedevtools.github.io)."""

from __future__ import annotations

import base64
import io
import json
import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any

from PIL import Image
from websockets.sync.client import ClientConnection, connect

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
PATIENCE = 30.0  # s


def found() -> str:
    """The program, by BROWSER_PATH or its usual names; "" where there is none."""
    return os.environ.get("BROWSER_PATH", "") or next((path for name in NAMES if (path := shutil.which(name))), "")


class Chromium:
    """A headless Chromium, as a context. Its tabs know nothing of each other."""

    def __init__(self) -> None:
        self._opened = ExitStack()
        folder = tempfile.TemporaryDirectory(prefix="browser-", ignore_cleanup_errors=True)
        self._folder = Path(self._opened.enter_context(folder))
        self._process = subprocess.Popen(
            [
                found(),
                "--headless=new",
                "--no-sandbox",
                "--disable-gpu",
                "--disable-dev-shm-usage",
                "--disable-backgrounding-occluded-windows",
                "--no-first-run",
                "--hide-scrollbars",
                "--remote-debugging-port=0",
                f"--user-data-dir={self._folder}",
                "about:blank",
            ],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        self._opened.callback(self._end)
        self.port, path = self._address()
        self._socket = self._opened.enter_context(_connected(f"ws://127.0.0.1:{self.port}{path}"))
        self._number = 0

    def __enter__(self) -> Chromium:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._opened.close()

    @contextmanager
    def tab(self) -> Iterator[str]:
        """A new tab's address in the protocol."""
        context = self._call("Target.createBrowserContext")["browserContextId"]
        target = self._call("Target.createTarget", url="about:blank", browserContextId=context)["targetId"]
        try:
            yield f"ws://127.0.0.1:{self.port}/devtools/page/{target}"
        finally:
            self._call("Target.disposeBrowserContext", browserContextId=context)

    def _call(self, method: str, **parameters: str) -> dict[str, Any]:
        self._number += 1
        self._socket.send(json.dumps({"id": self._number, "method": method, "params": parameters}))
        while (message := json.loads(self._socket.recv(timeout=PATIENCE))).get("id") != self._number:
            pass  # events
        return dict(message["result"])

    def _end(self) -> None:
        self._process.terminate()
        try:
            self._process.wait(5.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _address(self) -> tuple[int, str]:
        """Port and path of the debugger, which it writes once it listens."""
        end, file = time.monotonic() + PATIENCE, self._folder / "DevToolsActivePort"
        while time.monotonic() < end:
            if file.exists() and len(lines := file.read_text().split()) == 2:
                return int(lines[0]), lines[1]
            time.sleep(0.02)
        raise TimeoutError(f"{found()} does not start")


def _connected(address: str) -> ClientConnection:
    return connect(address, max_size=1 << 26, open_timeout=PATIENCE)


class Browser:
    """One tab, as a context."""

    def __init__(
        self,
        url: str,
        *,
        width: int = 1366,
        height: int = 700,
        dark: bool = False,
        touch: bool = False,
        chromium: Chromium | None = None,
    ) -> None:
        """width, height: of what is seen of the page. dark: what the page is told that its user prefers. touch: by
        fingers, as on a phone or a tablet. chromium: of which this is a tab; its own by default.
        """
        self._opened = ExitStack()
        program = self._opened.enter_context(Chromium()) if chromium is None else chromium
        self._socket = self._opened.enter_context(_connected(self._opened.enter_context(program.tab())))
        self._number = 0
        self.complaints: list[str] = []
        """Of the page: errors in its scripts, and what it was not let do."""
        for domain in ("Page", "Runtime", "Log"):
            self.call(f"{domain}.enable")
        metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": touch}
        self.call("Emulation.setDeviceMetricsOverride", **metrics)
        self.call("Emulation.setTouchEmulationEnabled", enabled=touch)
        scheme = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
        self.call("Emulation.setEmulatedMedia", features=scheme)
        self.call("Page.navigate", url=url)
        self.until("document.readyState == 'complete' && location.href != 'about:blank'")

    def __enter__(self) -> Browser:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Leave nothing behind."""
        self._opened.close()

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """A method of the protocol; its result."""
        self._number += 1
        self._socket.send(json.dumps({"id": self._number, "method": method, "params": parameters}))
        while True:
            message = json.loads(self._socket.recv(timeout=PATIENCE))
            if message.get("id") == self._number:
                if "error" in message:
                    raise RuntimeError(f"{method}: {message['error']}")
                return dict(message["result"])
            if message.get("method") == "Runtime.exceptionThrown":
                self.complaints.append(json.dumps(message["params"]["exceptionDetails"])[:500])
            entry = message.get("params", {}).get("entry", {}) if message.get("method") == "Log.entryAdded" else {}
            if entry.get("level") == "error":
                self.complaints.append(f"{entry.get('text')} {entry.get('url', '')}")

    def evaluate(self, expression: str) -> Any:
        """Value of an expression in the page."""
        answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in answer:
            raise RuntimeError(json.dumps(answer["exceptionDetails"])[:500])
        return answer["result"].get("value")

    def until(self, expression: str, patience: float = PATIENCE) -> Any:
        """Wait until an expression in the page is true, and give its value."""
        end = time.monotonic() + patience
        while not (value := self.evaluate(expression)):
            if time.monotonic() > end:
                raise TimeoutError(f"{expression} stays {value!r}; {'; '.join(self.complaints)}")
            time.sleep(0.05)
        return value

    def picture(self) -> Image.Image:
        """What is to be seen, pixel by pixel."""
        data = self.call("Page.captureScreenshot", format="png")["data"]
        return Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB")

    def press(self, key: str) -> None:
        """Press a key, by the name that a page gets (Tab, Enter, Escape, ArrowRight)."""
        codes = {"Tab": 9, "Enter": 13, "Escape": 27, " ": 32, "ArrowLeft": 37, "ArrowRight": 39}
        code = {"key": key, "code": "Space" if key == " " else key, "windowsVirtualKeyCode": codes[key]}
        text = {"Enter": "\r", " ": " "}.get(key)
        self.call("Input.dispatchKeyEvent", type="keyDown", **code, **({"text": text} if text else {}))
        self.call("Input.dispatchKeyEvent", type="keyUp", **code)

    def drag(self, points: list[tuple[float, float]]) -> None:
        """Press the mouse at the first point, move it along the others, and let it go [pixels]."""
        for kind, (x, y) in [("mousePressed", points[0]), *(("mouseMoved", point) for point in points[1:])]:
            self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=1, clickCount=1)
        x, y = points[-1]
        self.call("Input.dispatchMouseEvent", type="mouseReleased", x=x, y=y, button="left", clickCount=1)

    def click(self, selector: str) -> None:
        """Press the first element that a selector names."""
        left, top, right, bottom = self.rectangle(selector)
        self.drag([((left + right) / 2, (top + bottom) / 2)])

    def rectangle(self, selector: str) -> tuple[float, float, float, float]:
        """Left, top, right and bottom of the first element that a selector names [pixels]."""
        found = f"document.querySelector({json.dumps(selector)}).getBoundingClientRect()"
        left, top, right, bottom = self.evaluate(f"(r => [r.left, r.top, r.right, r.bottom])({found})")
        return left, top, right, bottom
