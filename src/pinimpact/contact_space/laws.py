"""The restitution laws: what each one counts during restitution, and the goal at which the impact ends.

All laws are cumulative over the whole impact, second compressions included. (theory.md, section 2)

To add a law, write it down here, as one more `Law` in `_LAWS`, and give its goal in
`_kernels.laws.restitution_goal`; nothing else knows one law from another. A law that counts something
other than the three quantities below needs that quantity in `_kernels.laws` and `_kernels.slip_events` as
well. `scipy_baseline`, which is kept independent on purpose, says that it does not know the law until it is
taught.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from ..checks import choice


@dataclass(frozen=True, slots=True)
class Law:
    """A restitution law: the impact ends when what is counted in restitution reaches the goal.

    Attributes:
        name: What users call it.
        counts: What grows towards the goal: the normal impulse P_r or the normal work W_r of all
            restitution so far, or the normal velocity v₃ itself.
        equation: The goal, with its number on the theory page.
        summary: One line on what it is, and what it can and cannot take.
        always_met: Whether every impact whose approach can be stopped meets it.
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
"""What each of `LAWS` counts."""

ALWAYS_MET = tuple(law.name for law in _LAWS if law.always_met)
"""Those that every impact meets, once its approach is stopped."""


def law_code(name: str) -> int:
    """Return the kernels' code of a law, or raise `UnknownNameError`."""
    return LAWS.index(choice("law", name, LAWS, "a restitution law"))
