#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Turn, colour and play the view in space of a report.html in headless Chromium.

    python3 scripts/check_view.py REPORT.html [SCREENSHOT.png]

A page without a view is only opened. Ends with 1, and a sentence, if a picture stays the same that
should change, or if the console has a message.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

from browser import Browser, main


def check(browser: Browser, page: Path, screenshot: Path | None) -> None:
    """Do what a reader does; ends the program where nothing happens."""
    browser.open(page)
    if browser.run("document.querySelector('#view') === null"):
        browser.end_if_it_spoke()
        print(f"{page}: opened; it has no view in space")
        return
    if browser.run("document.querySelector('#view .shown').hidden"):
        sys.exit("\n".join(["the view is not shown", *browser.messages]))
    browser.run("document.querySelector('#view').scrollIntoView()")
    last = browser.picture("#view canvas")
    if screenshot is not None:
        screenshot.write_bytes(browser.picture("#view .shown"))

    def changes(what: str, do: Any) -> None:
        nonlocal last
        do()
        now = browser.picture("#view canvas")
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
    browser.end_if_it_spoke()
    print(f"{page}: {fields} fields and {tools} tools, turned, coloured and played")


if __name__ == "__main__":
    main(check, __doc__)
