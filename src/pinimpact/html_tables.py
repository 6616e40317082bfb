"""Small tables in HTML, for notebooks."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from typing import Any


def html_table(title: str, head: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Return a table; numbers have six digits and stand to the right."""
    lines = [f"<table><caption style='text-align:left'><b>{escape(title)}</b></caption>"]
    if any(head):
        lines.append("<tr>" + "".join(f"<th>{escape(name)}</th>" for name in head) + "</tr>")
    lines += ["<tr>" + "".join(_cell(cell) for cell in row) + "</tr>" for row in rows]
    return "".join([*lines, "</table>"])


def html_lines(sentences: Iterable[str]) -> str:
    """Return sentences, one below the other."""
    return "".join(f"<div>{escape(sentence)}</div>" for sentence in sentences)


def _cell(cell: Any) -> str:
    if isinstance(cell, str):
        return f"<td style='text-align:left'>{escape(cell)}</td>"
    return f"<td style='text-align:right'>{cell:.6g}</td>"
