"""The restitution laws: the quantity and the goal with which restitution ends.

All laws are cumulative over the whole impact, including second compressions. (theory.md, section 2)

To add a law, add a `Law` to `_LAWS` and its goal to `_kernels.laws.restitution_goal`. A law of another
quantity than the three below also needs that quantity in `_kernels.laws` and `_kernels.slip_events`.
`scipy_baseline`, which is independent on purpose, raises an error for a law that is not implemented there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from ..checks import choice


@dataclass(frozen=True, slots=True)
class Law:
    """A restitution law: the impact ends when a quantity reaches its goal.

    Attributes:
        name: Name for users.
        counts: The quantity: the normal impulse P_r or the normal work W_r of all restitution so far, or the
            normal velocity v₃.
        equation: The goal, with its number on the theory page.
        summary: One line of description.
        always_met: Whether every impact whose approach can be stopped satisfies the law.
    """

    name: str
    counts: Literal["velocity", "impulse", "work"]
    equation: str
    summary: str
    always_met: bool = False


_LAWS = (
    Law(
        "poisson",
        "impulse",
        "P_r = e P_c (2.4)",
        "the impulse of restitution is e times that of compression; with friction it can create "
        "energy; a locked mechanism receives the impulse, too",
        always_met=True,
    ),
    Law(
        "energetic",
        "work",
        "W_r = −e² W_c (2.5)",
        "Stronge's law: the normal work of restitution is e² times that of compression; never creates energy",
    ),
    Law(
        "newton",
        "velocity",
        "v₃ = −e v₃° (2.6)",
        "the normal velocity is −e times its initial value; with friction it can create energy, "
        "which is flagged",
    ),
)

LAWS = tuple(law.name for law in _LAWS)
"""Names of the restitution laws, by their codes in the kernels."""

COUNTED = tuple(law.counts for law in _LAWS)
"""The quantity of each of `LAWS`."""

ALWAYS_MET = tuple(law.name for law in _LAWS if law.always_met)
"""Laws that every impact satisfies, once its approach is stopped."""


def law_code(name: str) -> int:
    """Return the code of a law in kernels, or raise `UnknownNameError`."""
    return LAWS.index(choice("law", name, LAWS, "a restitution law"))
