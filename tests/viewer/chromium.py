"""A real browser under remote control, by its own protocol (Chrome DevTools Protocol) over a websocket."""

import base64
import json
import os
import shutil
import subprocess
import sys
import time
import urllib.request
from pathlib import Path
from typing import Any

from websockets.sync.client import ClientConnection, connect


def find_chromium() -> str | None:
    """The program, if it is installed."""
    names = ("chromium", "chromium-browser", "google-chrome")
    return next((path for name in names if (path := shutil.which(name))), None)


class Chromium:
    """One page in one headless browser."""

    def __init__(self, program: str, profile: Path, url: str, size: tuple[int, int] = (1280, 720)) -> None:
        """Start the browser and open an address."""
        self._process = subprocess.Popen(
            [
                program,
                "--headless",
                *(["--no-sandbox"] if sys.platform == "linux" and os.geteuid() == 0 else []),
                "--enable-unsafe-swiftshader",
                "--use-angle=swiftshader",
                "--ignore-gpu-blocklist",
                "--disable-dev-shm-usage",
                "--no-first-run",
                "--disable-background-networking",
                "--disable-component-update",
                "--remote-debugging-port=0",
                f"--window-size={size[0]},{size[1]}",
                f"--user-data-dir={profile}",
                "about:blank",
            ],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        self._socket = self._connect(profile)
        self._number = 0
        self.console: list[str] = []
        self.command("Page.enable")
        self.command("Runtime.enable")
        self.command("Page.navigate", url=url)

    def command(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Send one command and wait for its answer; console lines that come meanwhile are kept."""
        self._number += 1
        self._socket.send(json.dumps({"id": self._number, "method": method, "params": parameters}))
        while True:
            message = json.loads(self._socket.recv(timeout=60))
            if message.get("method") == "Runtime.exceptionThrown":
                self.console.append(json.dumps(message["params"]["exceptionDetails"]))
            if message.get("id") == self._number:
                assert "error" not in message, message
                return message["result"]

    def evaluate(self, script: str) -> Any:
        """The value of a JavaScript expression."""
        return self.command("Runtime.evaluate", expression=script, returnByValue=True)["result"].get("value")

    def wait_for(self, script: str, timeout_s: float = 40.0) -> None:
        """Wait until a JavaScript expression is true."""
        until = time.monotonic() + timeout_s
        while not self.evaluate(script):
            assert time.monotonic() < until, f"still not true after {timeout_s} s: {script}"
            time.sleep(0.1)

    def click(self, text: str) -> None:
        """Click the button or label that says exactly this."""
        script = (
            "[...document.querySelectorAll('button, label')]"
            f".find(e => e.textContent.trim() === {json.dumps(text)})"
        )
        self.wait_for(f"!!{script}")
        self.evaluate(f"{script}.click()")

    def screenshot(self, path: Path) -> Path:
        """A PNG of what a person would see."""
        path.write_bytes(base64.b64decode(self.command("Page.captureScreenshot", format="png")["data"]))
        return path

    def close(self) -> None:
        """End the browser."""
        self._socket.close()
        self._process.kill()
        self._process.wait()

    def _connect(self, profile: Path) -> ClientConnection:
        port_file, until = profile / "DevToolsActivePort", time.monotonic() + 40
        while True:
            assert time.monotonic() < until, "Chromium did not start"
            try:
                port = int(port_file.read_text().split()[0])
                with urllib.request.urlopen(f"http://127.0.0.1:{port}/json/list", timeout=5) as answer:
                    page = next(t for t in json.load(answer) if t["type"] == "page")
                return connect(page["webSocketDebuggerUrl"], max_size=None)
            except (OSError, IndexError, StopIteration):
                time.sleep(0.1)
