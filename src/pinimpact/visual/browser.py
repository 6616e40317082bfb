"""Opening of pages in a headless browser."""

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
    # no network: replays are self-contained
    *("--host-resolver-rules=MAP * ~NOTFOUND", "--proxy-server=http://127.0.0.1:9"),
)


class Opened(NamedTuple):
    """The result of opening a page."""

    dom: str  # the document as text, after its scripts have run
    console: list[str]  # the lines of its console


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
) -> Opened:
    """Open a page from a file, without network.

    Args:
        browser: The browser, from `find_browser`.
        page: Path of the page.
        fragment: The part of its address after #.
        size: Width and height of the window [px].
        screenshot: A PNG file to write; the document is then not returned.
    """
    address = Path(page).absolute().as_uri() + (f"#{fragment}" if fragment else "")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        wanted = "--dump-dom" if screenshot is None else f"--screenshot={screenshot}"
        options = (f"--user-data-dir={profile}", f"--window-size={size[0]},{size[1]}")
        command = [browser, *OPTIONS, *options, "--virtual-time-budget=3000", wanted, address]
        done = subprocess.run(command, check=True, capture_output=True, timeout=600.0)
    log = done.stderr.decode("utf-8", "replace").splitlines()
    return Opened(done.stdout.decode("utf-8", "replace"), [row for row in log if ":CONSOLE" in row])
