"""Short text of objects, and small HTML tables for notebooks."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import MISSING, fields
from html import escape
from inspect import isfunction
from typing import Any

import numpy as np
from numpy.typing import ArrayLike


def html_table(title: str, head: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Return an HTML table; numbers have six digits and are aligned to the right."""
    lines = [f"<table><caption style='text-align:left'><b>{escape(title)}</b></caption>"]
    if any(head):
        lines.append("<tr>" + "".join(f"<th>{escape(name)}</th>" for name in head) + "</tr>")
    lines += ["<tr>" + "".join(_cell(cell) for cell in row) + "</tr>" for row in rows]
    return "".join([*lines, "</table>"])


def html_lines(sentences: Iterable[str]) -> str:
    """Return sentences as HTML, each on its own line."""
    return "".join(f"<div>{escape(sentence)}</div>" for sentence in sentences)


def changed_fields(instance: Any, but: Sequence[str] = (), width: int = 60) -> list[str]:
    """Return "name=value" for each field of a dataclass that differs from its default.

    Args:
        instance: The dataclass.
        but: Names of fields to omit.
        width: Maximum length of a value; longer ones are cut.
    """
    found = []
    for field in fields(instance):
        value = getattr(instance, field.name)
        is_default = field.default is not MISSING and _same(value, field.default)
        if is_default or field.name in but or not field.repr:
            continue
        text = value.__name__ if isfunction(value) else " ".join(repr(value).split())
        found.append(f"{field.name}={text if len(text) <= width else text[: width - 1] + '…'}")
    return found


def short_repr(instance: Any) -> str:
    """Return the ``__repr__`` of a dataclass, without the fields that have their default value."""
    return f"{type(instance).__name__}({', '.join(changed_fields(instance))})"


def in_a_line(values: ArrayLike) -> str:
    """Return an array as text with six digits, of at most 70 characters."""
    digits = {"float_kind": lambda x: f"{x:.6g}"}
    text = np.array2string(np.asarray(values), separator=", ", threshold=12, formatter=digits)  # type: ignore[arg-type]
    text = " ".join(text.split())
    return text if len(text) <= 70 else f"{text[:69]}…"


def _same(value: Any, default: Any) -> bool:
    return value is default or (type(value) is type(default) and bool(value == default))


def _cell(cell: Any) -> str:
    if isinstance(cell, str):
        return f"<td style='text-align:left'>{escape(cell)}</td>"
    return f"<td style='text-align:right'>{cell:.6g}</td>"
