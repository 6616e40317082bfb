"""Colours for colour-blind readers (Okabe and Ito), axes and legends of plots."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COMPRESSION, RESTITUTION, STICK, RESUMED = "#d55e00", "#0072b2", "#e69f00", "#cc79a7"
GREEN, SKY, BLACK, FLOW = "#009e73", "#56b4e9", "black", "#a3abb3"
CYCLE = (RESTITUTION, COMPRESSION, GREEN, RESUMED, STICK, SKY, BLACK)
"""Colours of items that have no fixed colour."""


def axes_for(ax: Any, size: tuple[float, float] = (6.4, 4.4), **options: Any) -> Any:
    """Return the given axes, or those of a new pyplot figure of this size [in]."""
    if ax is not None:
        return ax
    from matplotlib import pyplot

    figure = pyplot.figure(figsize=size, layout="constrained")
    return figure.add_subplot(**options)


def plain(text: str) -> str:
    """Return text of users, such as names, so that matplotlib draws it as it is.

    Text between $ would be formulas, and labels that begin with _ would be left out of legends.
    """
    return (" " if text.startswith("_") else "") + text.replace("$", r"\$")


def legend(ax: Axes, below: bool = False, columns: int = 3, handles: Sequence[Any] | None = None) -> None:
    """Put a legend to the right of axes or below them; with `handles` only if given.

    Items with the same name and colour are one entry: a contact may have the name of something else.
    """
    once: dict[tuple[str, str], Any] = {}
    found: Sequence[Any] = ax.get_legend_handles_labels()[0] if handles is None else handles
    for handle in found:
        color = handle.get_color() if hasattr(handle, "get_color") else ""
        once.setdefault((str(handle.get_label()), str(color)), handle)
    if not once:
        return
    place: dict[str, Any] = {"loc": "upper left", "bbox_to_anchor": (1.01, 1.0), "borderaxespad": 0.0}
    if below:
        # below tick and axis labels; the distance is relative to the font size
        place = {"loc": "upper center", "bbox_to_anchor": (0.5, 0.0), "borderaxespad": 5.0, "ncols": columns}
    if ax.name == "3d":  # these axes fill the figure, with free space at the top
        place |= {"bbox_to_anchor": (0.5, 1.0), "borderaxespad": 0.0}
    ax.legend(handles=once.values(), fontsize="small", frameon=False, **place)
