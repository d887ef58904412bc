#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Turn, colour and play the view in space of a report.html in headless Chromium.

    python3 scripts/check_view.py REPORT.html [SCREENSHOT.png]

Needs Python and Chromium only, and no network: Chromium is spoken to through a pipe. Ends with 1,
and a sentence, if a picture stays the same that should change, or if the console has a message.
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

    def picture(self, part: str = "canvas") -> bytes:
        """PNG of a part of the view, or of the whole window."""
        place = self.run(f"document.querySelector('#view {part}').getBoundingClientRect().toJSON()")
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


def check(browser: Browser, page: Path, screenshot: Path | None) -> None:
    """Do what a reader does; ends the program where nothing happens."""
    target = browser.ask("Target.createTarget", url="about:blank")["targetId"]
    answer = browser.ask("Target.attachToTarget", targetId=target, flatten=True)
    browser.session = answer["sessionId"]
    for domain in ("Runtime", "Log", "Network", "Page"):
        browser.ask(f"{domain}.enable")
    browser.ask("Page.navigate", url=page.resolve().as_uri())
    while browser.run("document.readyState") != "complete":
        time.sleep(0.05)
    if browser.run("document.querySelector('#view .shown').hidden"):
        sys.exit("\n".join(["the view is not shown", *browser.messages]))
    browser.run("document.querySelector('#view').scrollIntoView()")
    last = browser.picture()
    if screenshot is not None:
        screenshot.write_bytes(browser.picture(".shown"))

    def changes(what: str, do: Any) -> None:
        nonlocal last
        do()
        now = browser.picture()
        if now == last:
            sys.exit(f"{what}: the picture stays the same")
        last = now

    def choose(part: str, value: int, event: str) -> None:
        browser.run(
            f"(e => {{ e.value = {value}; e.dispatchEvent(new Event('{event}')); }})"
            f"(document.querySelector('#view .{part}'))"
        )

    changes("turn", lambda: browser.drag((120, 40)))
    changes("move", lambda: browser.drag((60, 60), modifiers=8))
    wheel = "document.querySelector('#view canvas').dispatchEvent(new WheelEvent('wheel', "
    changes("zoom", lambda: browser.run(wheel + "{deltaY: -300, cancelable: true}))"))
    changes("back", lambda: browser.run("document.querySelector('#view .back').click()"))
    fields = browser.run("document.querySelectorAll('#view .field option').length")
    for k in [*range(1, fields), 0]:
        changes(f"colour {k}", lambda k=k: choose("field", k, "change"))
    changes("step", lambda: choose("step", 1, "input"))
    changes("yarns", lambda: browser.run("document.querySelector('#view .yarns').click()"))
    tools = browser.run("document.querySelectorAll('#view .tools input').length")
    if tools:
        everything = "document.querySelectorAll('#view .tools input').forEach(b => b.click())"
        changes("tools", lambda: browser.run(everything))
    caption = "document.querySelector('#view .caption').textContent"
    before = browser.run(caption)
    browser.run("document.querySelector('#view .play').click()")
    for _ in range(40):
        time.sleep(0.05)
        if browser.run(caption) != before:
            break
    else:
        sys.exit("play: the step stays the same")
    browser.run("document.querySelector('#view .play').click()")
    strange = [url for url in browser.loaded if not url.startswith(("file:", "data:"))]
    if browser.messages or strange:
        sys.exit("\n".join([*browser.messages, *(f"loads {url}" for url in strange)]))
    print(f"{page}: {fields} fields and {tools} tools, turned, coloured and played")


def main(arguments: list[str]) -> None:
    """Check the page of the command line."""
    if not 1 <= len(arguments) <= 2:
        sys.exit(__doc__)
    program = next(filter(None, map(shutil.which, NAMES)), None)
    if program is None:
        sys.exit(f"there is none of {', '.join(NAMES)} here")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        browser = Browser(program, folder)
        try:
            check(browser, Path(arguments[0]), Path(arguments[1]) if arguments[1:] else None)
        finally:
            browser.process.terminate()
            browser.process.wait()


if __name__ == "__main__":
    main(sys.argv[1:])
