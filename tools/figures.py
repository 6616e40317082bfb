"""Put measured figures into the pages, so that each stands in one place: docs/figures.

Tables are marked by the file that has them, ``<!-- speed.txt -->`` … ``<!-- end -->``; a figure in a sentence
by its file and row, ``<!-- startup: first scene, cold cache -->10 s<!-- end -->``. A figure is the time of its
row, in two digits; ``| ratio`` after the row takes its ratio to the reference.

python -m tools.figures writes them all.
"""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

from .pages import DOCS, pages

FIGURES = DOCS / "figures"
TABLE = re.compile(r"<!-- (\w+\.txt) -->\n.*?<!-- end -->", re.DOTALL)
FIGURE = re.compile(r"<!-- (\w+): ([^|>]+?)(?: \| (\w+))? -->([^<]*)<!-- end -->")
UNITS = ((1.0, "s"), (1e-3, "ms"), (1e-6, "µs"), (1e-9, "ns"))


def figure(file: str, row: str, kind: str | None = None) -> str:
    """Return a figure of docs/figures as it stands in a sentence.

    Args:
        file: Name of a JSON file with rows, without its ending.
        row: What its row measures.
        kind: None for the time, "ratio" for the ratio to the reference.

    Raises:
        KeyError: There is no such row, or more than one.
    """
    rows = json.loads((FIGURES / f"{file}.json").read_text(encoding="utf-8"))["rows"]
    found = [entry for entry in rows if entry["what"] == row]
    if len(found) != 1:
        raise KeyError(f"{file}.json: {len(found)} rows are called {row!r}")
    if kind is not None:
        return digits(found[0][kind])
    size, unit = next((size, unit) for size, unit in UNITS if found[0]["seconds"] >= 0.9995 * size)
    return f"{digits(found[0]['seconds'] / size)} {unit}"


def digits(number: float) -> str:
    """Return a positive number in two digits, without an exponent."""
    return f"{number:.{max(0, 1 - math.floor(math.log10(number)))}f}"


def refreshed(text: str) -> str:
    """Return the text of a page with its tables and figures as docs/figures has them."""

    def table(mark: re.Match[str]) -> str:
        rows = (FIGURES / mark[1]).read_text(encoding="utf-8").rstrip()
        return f"<!-- {mark[1]} -->\n```text\n{rows}\n```\n<!-- end -->"

    def number(mark: re.Match[str]) -> str:
        return mark[0].replace(f"-->{mark[4]}<!--", f"-->{figure(mark[1], mark[2], mark[3])}<!--")

    return FIGURE.sub(number, TABLE.sub(table, text))


def refresh_all() -> None:
    """Write tables and figures into all pages."""
    for page in pages():
        page.write_text(refreshed(page.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    refresh_all()
