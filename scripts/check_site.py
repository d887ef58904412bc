#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Read the site of docs/ in headless Chromium, from the disk as scripts/docs leaves it.

    python3 scripts/check_site.py FOLDER [SCREENSHOT.png]

Opens every page, makes it dark and light, and searches for "picture frame" as a reader does. Ends
with 1, and a sentence, if nothing happens, or if the console has a message.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

from browser import Browser, main

SEARCHED, FOUND = "picture frame", "Cases, flat tests, commands"
SHOWN = "getComputedStyle(document.body).backgroundColor"
# the button that is seen: narrow windows have another one
BUTTON = "[...document.querySelectorAll('.theme-toggle')].find(b => b.offsetParent)"


def check(browser: Browser, site: Path, screenshot: Path | None) -> None:
    """Do what a reader does; ends the program where nothing happens."""
    pages = sorted(site.glob("*.html"))
    for page in pages:
        browser.open(page)
    browser.open(site / "index.html")
    colours = []
    for _ in range(3):  # as the system has it, light, dark
        browser.run(f"{BUTTON}.click()")
        colours.append(browser.run(SHOWN))
    if len(set(colours)) != 2:
        sys.exit(f"the switch of light and dark does nothing: {colours}")
    if screenshot is not None:
        screenshot.write_bytes(browser.picture("body"))
    # What the form asks for; waiting for it to be sent would end with the page.
    form = "document.querySelector('.sidebar-search-container')"
    action, name = browser.run(f"[{form}.getAttribute('action'), {form}.elements[0].name]")
    browser.open(site / action, f"?{name}={SEARCHED.replace(' ', '+')}")
    for _ in range(100):
        time.sleep(0.1)
        found = browser.run("document.querySelector('#search-results')?.innerText ?? ''")
        if FOUND in found:
            break
    else:
        sys.exit(f"a search for {SEARCHED!r} does not find {FOUND!r} but {found!r}")
    browser.end_if_it_spoke()
    print(f"{site}: {len(pages)} pages opened, dark and light, searched")


if __name__ == "__main__":
    main(check, __doc__)
