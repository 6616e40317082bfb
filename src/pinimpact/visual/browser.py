"""A headless browser, if there is one: it opens a page and returns its document."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import NamedTuple

BROWSERS = (
    *("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "microsoft-edge"),
    "/Applications/Google Chrome.app/Contents/MacOS/Google Chrome",
)
"""Browsers, in the order of the search."""

OPTIONS = (
    *(
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--use-angle=swiftshader",
        "--enable-unsafe-swiftshader",
    ),
    *("--no-first-run", "--disable-background-networking", "--disable-component-update", "--disable-sync"),
    *("--disable-quic", "--hide-scrollbars", "--enable-logging=stderr", "--v=0"),
    # a page that needs a network is none of ours
    *("--host-resolver-rules=MAP * ~NOTFOUND", "--proxy-server=http://127.0.0.1:9"),
)


class Opened(NamedTuple):
    """The result of opening a page."""

    dom: str  # the document as text, after its scripts have run
    console: list[str]  # the lines that it wrote to its console


def find_browser() -> str | None:
    """Return a browser of this machine that can run headless, or None."""
    return next((found for name in BROWSERS if (found := shutil.which(name))), None)


def open_page(
    browser: str,
    page: str | Path,
    fragment: str = "",
    *,
    size: tuple[int, int] = (960, 540),
    screenshot: str | Path | None = None,
    timeout: float = 600.0,
) -> Opened:
    """Open a page from a file, without any network, in a window of a size [px].

    `fragment` is the part of its address after #; a screenshot is written to a PNG file instead of returning
    the document. Errors as in `subprocess.run`, if it takes longer than the timeout [s].
    """
    address = Path(page).absolute().as_uri() + (f"#{fragment}" if fragment else "")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        wanted = "--dump-dom" if screenshot is None else f"--screenshot={screenshot}"
        options = (f"--user-data-dir={profile}", f"--window-size={size[0]},{size[1]}")
        command = [browser, *OPTIONS, *options, "--virtual-time-budget=3000", wanted, address]
        done = subprocess.run(command, check=True, capture_output=True, timeout=timeout)
    log = done.stderr.decode("utf-8", "replace").splitlines()
    return Opened(done.stdout.decode("utf-8", "replace"), [row for row in log if ":CONSOLE" in row])
