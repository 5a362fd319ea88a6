"""A real browser for tests, driven over its DevTools pipe: no driver program, no package.

`with browser(1280) as tab:` starts headless Chromium; `tab.open(path)` loads a file, `tab.js("...")` evaluates,
`tab.mouse(...)` moves and presses a real pointer. Where no Chromium is found, `CHROMIUM` is None and tests skip.
"""

import base64
import json
import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
CHROMIUM = next((found for name in NAMES if (found := shutil.which(name))), None)
FLAGS = (
    "--headless",
    "--no-sandbox",  # containers of CI run as root
    "--disable-gpu",
    "--hide-scrollbars",
    "--remote-debugging-pipe",
    "--no-first-run",
    "--disable-background-networking",
)
PATIENCE_S = 30.0


class Tab:
    """One page of the browser."""

    def __init__(self, to: int, back: int) -> None:
        self._to, self._back = to, os.fdopen(back, "rb", buffering=0)
        self._rest, self._number, self._session = b"", 0, ""
        self.console: list[str] = []  # errors that the page reported

    def attach(self) -> None:
        """Open an empty page."""
        target = self.send("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.send("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log"):
            self.send(f"{domain}.enable")

    def look(
        self, width: int, height: int = 900, media: str = "", dark: bool = False, script: bool = True
    ) -> None:
        """Set the window's size [px], "print" or the screen, the colour scheme, and whether scripts run."""
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self.send("Emulation.setDeviceMetricsOverride", **size)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.send("Emulation.setEmulatedMedia", media=media, features=[scheme])
        self.send("Emulation.setScriptExecutionDisabled", value=not script)

    def open(self, path: Path) -> None:
        """Load a file."""
        self.send("Page.navigate", url=path.as_uri())
        self._until("Page.loadEventFired")

    def js(self, expression: str) -> Any:
        """Return the value of an expression, which goes past the page's own security policy."""
        result = self.send("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in result, result["exceptionDetails"]
        return result["result"].get("value")

    def mouse(self, kind: str, x: float, y: float, **more: Any) -> None:
        """Send mouseMoved, mousePressed or mouseReleased at a place of the window."""
        self.send("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)

    def drag(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        held: dict[str, Any] = {"button": "left", "buttons": 1, "clickCount": 1}
        self.mouse("mouseMoved", *start)
        self.mouse("mousePressed", *start, **held)
        self.mouse("mouseMoved", *end, button="left", buttons=1)
        self.mouse("mouseReleased", *end, **held)

    def double_click(self, x: float, y: float) -> None:
        for count in (1, 2):
            for kind in ("mousePressed", "mouseReleased"):
                self.mouse(kind, x, y, button="left", clickCount=count)

    def picture(self, path: Path, whole: bool = True) -> None:
        """Write what is seen as PNG: all of the page, or the window."""
        shot = self.send("Page.captureScreenshot", captureBeyondViewport=whole)
        path.write_bytes(base64.b64decode(shot["data"]))

    def send(self, method: str, **params: Any) -> dict[str, Any]:
        """Send a command of the DevTools protocol and return its result."""
        self._number += 1
        message: dict[str, Any] = {"id": self._number, "method": method, "params": params}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._to, json.dumps(message).encode() + b"\0")
        answer = self._until(self._number)
        assert "error" not in answer, (method, answer["error"])
        result: dict[str, Any] = answer["result"]
        return result

    def close(self) -> None:
        """Close both ends of ours."""
        os.close(self._to)
        self._back.close()

    def _until(self, awaited: int | str) -> dict[str, Any]:
        """Read messages up to the answer, or the event, that is awaited."""
        until = time.monotonic() + PATIENCE_S
        while time.monotonic() < until:
            message = self._read()
            if message.get("method") in {"Runtime.exceptionThrown", "Log.entryAdded"}:
                self.console.append(json.dumps(message["params"]))
            if awaited in {message.get("id"), message.get("method")}:
                return message
        raise TimeoutError(f"Chromium did not answer: {awaited}")

    def _read(self) -> dict[str, Any]:
        while b"\0" not in self._rest:
            block = self._back.read(1 << 16)
            if not block:
                raise EOFError("Chromium is gone")
            self._rest += block
        line, _, self._rest = self._rest.partition(b"\0")
        found: dict[str, Any] = json.loads(line)
        return found


@contextmanager
def browser(width: int = 1280, height: int = 900) -> Iterator[Tab]:
    """Yield an empty page of headless Chromium, which ends with the block."""
    assert CHROMIUM is not None
    theirs_in, to = os.pipe()
    back, theirs_out = os.pipe()
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        # the pipe is read from descriptor 3 and written to 4, which the shell arranges
        words = [CHROMIUM, *FLAGS, f"--user-data-dir={profile}"]
        wiring = f'exec "$@" 3<&{theirs_in} 4>&{theirs_out}'
        process = subprocess.Popen(
            ["bash", "-c", wiring, "bash", *words],
            pass_fds=(theirs_in, theirs_out),
            stderr=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
        )
        os.close(theirs_in)
        os.close(theirs_out)
        tab = Tab(to, back)
        try:
            tab.attach()
            tab.look(width, height)
            yield tab
        finally:
            tab.close()
            process.kill()
            process.wait()
