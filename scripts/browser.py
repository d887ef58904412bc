# SPDX-License-Identifier: MIT
"""Headless Chromium without a network, for check_view.py and check_site.py.

Needs Python and Chromium only: Chromium is spoken to through a pipe.
"""

from __future__ import annotations

import base64
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

NAMES = ("chromium", "chromium-browser", "google-chrome")
SECONDS = 60.0
SIZE = (1100, 900)  # of the window
FLAGS = (
    "--headless=new", "--remote-debugging-pipe", "--no-sandbox", "--no-first-run",
    "--disable-background-networking", "--use-gl=angle", "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader", "--hide-scrollbars", "--host-resolver-rules=MAP * ~NOTFOUND",
    f"--window-size={SIZE[0]},{SIZE[1]}",
)  # fmt: skip


class Browser:
    """Chromium with one page; messages of its console, and all that it asked to load."""

    def __init__(self, program: str, folder: str):
        read, self.write = os.pipe()
        self.read, write = os.pipe()
        # Chromium reads its orders from 3 and answers to 4.
        command = f'exec "$0" "$@" 3<&{read} 4>&{write}'
        flags = [*FLAGS, f"--user-data-dir={folder}", "about:blank"]
        self.process = subprocess.Popen(
            ["bash", "-c", command, program, *flags],
            pass_fds=(read, write),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(read)
        os.close(write)
        self.rest, self.number, self.session = b"", 0, None
        self.messages: list[str] = []
        self.loaded: list[str] = []
        self.deadline = time.monotonic() + SECONDS

    def ask(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Have an order carried out; notes what else is told meanwhile."""
        self.number += 1
        order = {"id": self.number, "method": method, "params": parameters}
        if self.session:
            order["sessionId"] = self.session
        os.write(self.write, json.dumps(order).encode() + b"\0")
        while True:
            answer = self._next()
            if answer.get("id") == self.number:
                if "error" in answer:
                    sys.exit(f"{method}: {answer['error']['message']}")
                return answer["result"]
            self._note(answer)

    def _next(self) -> dict[str, Any]:
        while b"\0" not in self.rest:
            data = os.read(self.read, 1 << 16)
            if not data or time.monotonic() > self.deadline:
                sys.exit("Chromium does not answer")
            self.rest += data
        answer, _, self.rest = self.rest.partition(b"\0")
        return json.loads(answer)

    def _note(self, answer: dict[str, Any]) -> None:
        method, told = answer.get("method"), answer.get("params", {})
        if method == "Runtime.consoleAPICalled":
            self.messages.append(f"console: {told['args']}")
        elif method == "Runtime.exceptionThrown":
            self.messages.append(f"error: {told['exceptionDetails']}")
        elif method == "Log.entryAdded":
            self.messages.append(f"{told['entry']['level']}: {told['entry']['text']}")
        elif method == "Network.requestWillBeSent":
            self.loaded.append(told["request"]["url"][:80])

    def run(self, script: str) -> Any:
        """Evaluate JavaScript in the page and let it draw; returns the value."""
        drawn = "new Promise(d => requestAnimationFrame(() => requestAnimationFrame(d)))"
        script = f"(async () => {{ const value = {script}; await {drawn}; return value; }})()"
        answer = self.ask(
            "Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True
        )
        if "exceptionDetails" in answer:
            sys.exit(f"{script}: {answer['exceptionDetails']}")
        return answer["result"].get("value")

    def open(self, page: Path, query: str = "") -> None:
        """Go to a page on disk and wait until it is there; the first call opens the tab."""
        if self.session is None:
            target = self.ask("Target.createTarget", url="about:blank")["targetId"]
            answer = self.ask("Target.attachToTarget", targetId=target, flatten=True)
            self.session = answer["sessionId"]
            for domain in ("Runtime", "Log", "Network", "Page"):
                self.ask(f"{domain}.enable")
        self.ask("Page.navigate", url=page.resolve().as_uri() + query)
        while self.run("document.readyState") != "complete":
            time.sleep(0.05)

    def end_if_it_spoke(self) -> None:
        """End the program where the console has a message, or something came from elsewhere."""
        strange = [url for url in self.loaded if not url.startswith(("file:", "data:"))]
        if self.messages or strange:
            told = [message[:300] for message in self.messages]
            sys.exit("\n".join([*told, *(f"loads {url}" for url in strange)][:5]))

    def picture(self, selector: str) -> bytes:
        """PNG of a part of the page."""
        place = self.run(f"document.querySelector('{selector}').getBoundingClientRect().toJSON()")
        clip = {key: place[key] for key in ("x", "y", "width", "height")} | {"scale": 1}
        clip["y"] += self.run("scrollY")
        return base64.b64decode(self.ask("Page.captureScreenshot", clip=clip)["data"])

    def drag(self, by: tuple[int, int], modifiers: int = 0) -> None:
        """Press in the middle of the view, move the pointer, and let go."""
        place = self.run("document.querySelector('#view canvas').getBoundingClientRect().toJSON()")
        x, y = place["x"] + place["width"] / 2, place["y"] + place["height"] / 2
        how = {"button": "left", "buttons": 1, "modifiers": modifiers}
        for kind, dx, dy in (
            ("mousePressed", 0, 0), ("mouseMoved", *by), ("mouseReleased", *by),
        ):  # fmt: skip
            self.ask("Input.dispatchMouseEvent", type=kind, x=x + dx, y=y + dy, clickCount=1, **how)
        self.run("0")


@contextmanager
def chromium() -> Iterator[Browser]:
    """Have a browser; ends the program where there is none."""
    program = next(filter(None, map(shutil.which, NAMES)), None)
    if program is None:
        sys.exit(f"there is none of {', '.join(NAMES)} here")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        browser = Browser(program, folder)
        try:
            yield browser
        finally:
            browser.process.terminate()
            browser.process.wait()


def main(check: Callable[[Browser, Path, Path | None], None], usage: str | None) -> None:
    """Check what the command line names, and make a screenshot if it names a file for it."""
    arguments = sys.argv[1:]
    if not 1 <= len(arguments) <= 2:
        sys.exit(usage)
    with chromium() as browser:
        check(browser, Path(arguments[0]), Path(arguments[1]) if arguments[1:] else None)
