"""A headless Chromium for the tests of the page, which can connect to this machine only."""

import contextlib
import io
import os

import graph
import matplotlib.image
import numpy as np
import requirements
from playwright.sync_api import sync_playwright

WIDE, NARROW = (1440, 900), (390, 844)
_KEEP_MESSAGES = """
globalThis.messages = [];
new MutationObserver((changes) => {
  for (const { addedNodes } of changes) messages.push(...[...addedNodes].map((node) => node.textContent));
}).observe(document.getElementById("alarm"), { childList: true });
"""
"""Keeps the messages of the page, which shows each message only for some seconds."""


class Page:
    """A tab, with the errors in its console and its requests."""

    def __init__(self, tab):
        self.tab = tab
        self.errors = []
        self.requests = []
        tab.on("console", lambda line: self.errors.append(line.text) if line.type in ("error", "warning") else None)
        tab.on("pageerror", lambda error: self.errors.append(str(error)))
        tab.on("request", lambda request: self.requests.append(request.url))
        tab.on("websocket", lambda socket: self.requests.append(socket.url))

    def open(self, url):
        """Open an address and wait until the page has drawn."""
        self.tab.goto(url)
        self.wait("globalThis.diffbotPage?.frames > 0", "the first frame")
        self.get(_KEEP_MESSAGES)
        return self

    def get(self, expression):
        return self.tab.evaluate(expression)

    def wait(self, expression, what):
        """Wait until an expression is true and return its value. The page's policy forbids wait_for_function."""
        return self.wait_for(lambda: self.get(expression), what)

    def wait_for(self, condition, what):
        """Handle the browser's events until ``condition()`` is true, and return its value."""

        def value():
            self.tab.wait_for_timeout(20)
            return condition()

        return graph.wait_for(value, what=what)

    def wait_for_message(self, text):
        """Wait until the page has shown a message with this text, and delete it and all earlier messages."""
        found = f"messages.findIndex((one) => one.includes({text!r}))"
        self.wait(f"{found} >= 0", f"the message {text!r}")
        self.get(f"void messages.splice(0, {found} + 1)")

    def next_frame(self):
        self.get("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => done())))")

    def drag(self, start, end):
        """Press, drag and release on the map, between two pixels of the map."""
        box = self.tab.locator("#map").bounding_box()
        (x0, y0), (x1, y1) = ((box["x"] + x, box["y"] + y) for x, y in (start, end))
        self.tab.mouse.move(x0, y0)
        self.tab.mouse.down()
        self.tab.mouse.move(x1, y1, steps=4)
        self.tab.mouse.up()

    def text(self, selector):
        return self.tab.locator(selector).inner_text()

    def count(self, colour, selector="#map", apart=60):
        """Return the number of pixels of about this colour, since thin lines are blended with the background."""
        return int(np.count_nonzero(np.abs(self.pixels(selector) - np.array(colour)).sum(axis=1) <= apart))

    def pixels(self, selector="#map"):
        """Return the pixels (n, 3) of a part of the page as r, g, b from 0 to 255."""
        image = matplotlib.image.imread(io.BytesIO(self.tab.locator(selector).screenshot()))
        return np.round(255 * image[:, :, :3]).astype(int).reshape(-1, 3)


@contextlib.contextmanager
def chromium():
    """Yield a function that opens a tab of a size, light or dark, as a Page."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=requirements.browser(),
            args=["--disable-gpu", "--host-resolver-rules=MAP * ~NOTFOUND , EXCLUDE 127.0.0.1"]
            + (["--no-sandbox"] if os.geteuid() == 0 else []),
        )

        def new_page(size=WIDE, scheme="light"):
            width, height = size
            return Page(browser.new_page(viewport={"width": width, "height": height}, color_scheme=scheme))

        try:
            yield new_page
        finally:
            browser.close()
