"""The summary of an ensemble as one HTML page that opens offline."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; color: #111 }
body { margin: 2rem auto; padding: 0 1rem; max-width: 62rem }
table { border-collapse: collapse; margin: 0.5rem 0 1.5rem }
th, td { text-align: left; padding: 0.2rem 1.1rem 0.2rem 0; border-bottom: 1px solid #d5d9de }
td { font-variant-numeric: tabular-nums; white-space: nowrap }
td small { color: #5a6270 }
img { max-width: 100% }
"""


def ensemble_page(facts: Mapping[str, Any], figure: Figure) -> str:
    """Return the page of an ensemble, from `Ensemble.facts` and a figure of its distributions."""
    picture = io.BytesIO()
    figure.savefig(picture, format="png", dpi=110)
    numbers = {name: row for name, row in facts["results"].items() if "50 %" in row}
    texts = {name: row for name, row in facts["results"].items() if name not in numbers}
    count, parameters = facts["samples"], ", ".join(facts["parameters"])
    levels = list(next(iter(numbers.values()), {}))
    shares = [
        (name, value or "none", {level: 100.0 * x for level, x in share.items()})
        for name, row in texts.items()
        for value, share in row.items()
    ]
    parts = [
        f"<h1>{count} samples over {html.escape(parameters)}</h1>",
        "<p>In brackets: 95 % confidence intervals.</p>",
        *_table("Frequencies", ("result", "value", "%"), shares),
        *_table(
            "Quantiles [SI units]",
            ("result", *levels),
            [(name, *row.values()) for name, row in numbers.items()],
        ),
    ]
    indices = [
        (name, parameter, row["first order"], row["total"])
        for name, by_parameter in facts.get("sobol_indices", {}).items()
        for parameter, row in by_parameter.items()
    ]
    parts += _table("Sobol' indices", ("result", "parameter", "first order", "total"), indices)
    data = base64.b64encode(picture.getvalue()).decode("ascii")
    parts += ["<h2>Distributions</h2>", f'<img alt="Distributions" src="data:image/png;base64,{data}">']
    parts += ["<p>Solid line: median; dotted lines: 5 and 95 %.</p>"]
    head = f'<meta charset="utf-8"><title>Ensemble of {count} samples</title><style>{STYLE}</style>'
    body = "\n".join(parts)
    return f'<!DOCTYPE html>\n<html lang="en">\n<head>{head}</head>\n<body>\n{body}\n</body>\n</html>\n'


def _table(title: str, head: Iterable[str], rows: Sequence[Sequence[Any]]) -> list[str]:
    """Return a table of texts and estimates with a heading, or nothing without rows."""
    if not rows:
        return []
    names = "".join(f"<th>{name}</th>" for name in head)
    lines = ["<tr>" + "".join(f"<td>{_cell(x)}</td>" for x in row) + "</tr>" for row in rows]
    return [f"<h2>{title}</h2>", f"<table><tr>{names}</tr>", *lines, "</table>"]


def _cell(content: str | Mapping[str, float | None]) -> str:
    """Return the HTML of a text, or of an estimate with its interval."""
    if isinstance(content, str):
        return html.escape(content)
    number, low, high = ("–" if x is None else f"{x:.4g}" for x in content.values())
    return f"{number} <small>({low} to {high})</small>"
