"""Copy the measured figures of docs/figures into the pages.

A table is marked by the name of its file, ``<!-- speed.txt -->`` … ``<!-- end -->``. A figure in a sentence
is marked by its file and row, and is the time of that row with two digits:
``<!-- startup: first scene, cold cache -->10 s<!-- end -->``.

python -m tools.figures updates all pages.
"""

from __future__ import annotations

import json
import math
import re

from .pages import DOCS, pages

FIGURES = DOCS / "figures"
TABLE = re.compile(r"<!-- (\w+\.txt) -->\n.*?<!-- end -->", re.DOTALL)
FIGURE = re.compile(r"<!-- (\w+): ([^>]+?) -->([^<]*)<!-- end -->")
UNITS = ((1.0, "s"), (1e-3, "ms"), (1e-6, "µs"), (1e-9, "ns"))


def figure(file: str, row: str) -> str:
    """Return a figure of docs/figures formatted for a sentence.

    Args:
        file: Name of a JSON file with rows, without its suffix.
        row: Its entry "what", the name of the measurement.

    Raises:
        KeyError: There is no such row, or more than one.
    """
    rows = json.loads((FIGURES / f"{file}.json").read_text(encoding="utf-8"))["rows"]
    found = [entry for entry in rows if entry["what"] == row]
    if len(found) != 1:
        raise KeyError(f"{file}.json: {len(found)} rows are called {row!r}")
    return time_of(found[0]["seconds"])


def time_of(seconds: float) -> str:
    """Return a positive time with two digits and its unit."""
    size, unit = next((size, unit) for size, unit in UNITS if float(f"{seconds:.1e}") >= size)
    return f"{two_digits(seconds / size)} {unit}"


def two_digits(number: float) -> str:
    """Return a positive number with two digits, without an exponent."""
    rounded = float(f"{number:.1e}")
    return f"{rounded:.{max(0, 1 - math.floor(math.log10(rounded)))}f}"


def refreshed(text: str) -> str:
    """Return the text of a page with its tables and figures replaced by those of docs/figures."""

    def table(mark: re.Match[str]) -> str:
        rows = (FIGURES / mark[1]).read_text(encoding="utf-8").rstrip()
        return f"<!-- {mark[1]} -->\n```text\n{rows}\n```\n<!-- end -->"

    def number(mark: re.Match[str]) -> str:
        return f"<!-- {mark[1]}: {mark[2]} -->{figure(mark[1], mark[2])}<!-- end -->"

    return FIGURE.sub(number, TABLE.sub(table, text))


def refresh_all() -> None:
    """Write tables and figures into all pages."""
    for page in pages():
        page.write_text(refreshed(page.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    refresh_all()
