"""Statuses, flags and effects of impacts."""

from __future__ import annotations

import enum
from operator import index
from typing import Any


class Sentences(enum.IntFlag):
    """Flags with a sentence each."""

    sentence: str

    def __new__(cls, value: int, sentence: str = "") -> Any:
        """Create a member from its value and its sentence."""
        member = int.__new__(cls, value)
        member._value_ = value
        member.sentence = sentence
        return member

    @classmethod
    def _missing_(cls, value: object) -> Any:
        """Accept NumPy integers too, such as the rows of ``batch.flags``."""
        return super()._missing_(index(value))  # type: ignore[arg-type]

    def describe(self) -> tuple[str, ...]:
        """Return the sentences of the flags that are set, in the order of their values."""
        return tuple(flag.sentence for flag in type(self) if flag & self)


class Status(enum.IntEnum):
    """The reason why an impact ended. ``str(status)`` is a sentence; arrays have the integer values."""

    _sentence: str

    def __new__(cls, value: int, sentence: str = "") -> Any:
        """Create a member from its value and its sentence."""
        member = int.__new__(cls, value)
        member._value_, member._sentence = value, sentence
        return member

    SEPARATED = 0, "Solved: the restitution law is met and the contact separates."
    ENDED_AT_REST = 1, "Solved: the normal velocity is zero at the end, without restitution."
    NO_IMPACT = 2, "The contact does not approach, so there is no impact."
    LOCKED = 3, "Friction locks the mechanism, so the normal velocity cannot rise."
    INVALID_NUMBERS = 4, "A number of the problem is not finite or out of its range."
    INDEFINITE_DELASSUS = 5, "The Delassus matrix is not symmetric positive semidefinite."
    UNSTOPPABLE = 6, "The contact approaches and no normal impulse can stop it."
    LAW_UNREACHABLE = 7, "The mechanism cannot satisfy the restitution law."
    OUT_OF_RANGE = 8, "The result is outside the range of double precision."
    NOT_CONVERGED = 9, "The solver reached its largest number of steps."

    def __str__(self) -> str:
        return self._sentence

    @property
    def ok(self) -> bool:
        """Whether there is a solution. If not, rows of batches are NaN and `solve_impact` raises an error."""
        return self <= Status.LOCKED


class Flag(Sentences):
    """Special events of an impact; ``str(flags)`` and ``describe()`` return sentences."""

    NONE = 0
    JAM = 1, "The normal acceleration was negative during slip (jam)."
    IMPACT_WITHOUT_COLLISION = 2, "The contact did not approach; friction alone made the impact."
    SECOND_COMPRESSION = 4, "The normal velocity fell back to zero and a second compression followed."
    STICK = 8, "The contact came to stick."
    SLIP_RESUMED = 16, "The slip stopped and resumed along the diverging invariant direction."
    LOCKED = 32, "Stick locked the normal direction."
    ENERGY_CREATED = 64, "The law created kinetic energy."
    NEAR_JUMP = 128, "The impact map is discontinuous nearby: a small change of input may change the outcome."
    NEAR_STICK_THRESHOLD = 256, "The friction coefficient is close to the threshold between stick and slip."
    SINGULAR_DELASSUS = 512, "The Delassus matrix is singular."
    SLIP_TURNED = 1024, "The direction of slip turned along the path."
    BOUND_REACHED = 2048, "A bound on steps or events was reached, and the answer is approximate."

    def __str__(self) -> str:
        return " ".join(self.describe()) or "Nothing special."

    def __format__(self, format_spec: str) -> str:
        return format(str(self), format_spec)

    def names(self) -> str:
        """Return the names of the flags that are set, "STICK|JAM"; empty if none is."""
        return "|".join(flag.name or "" for flag in Flag if flag & self)


EFFECTS = (
    "friction",
    "restitution",
    "normal-tangential coupling",
    "spatial slip",
    "stick",
    "resumed slip",
    "jam",
    "second compression",
    "recorded path",
)
"""Possible entries of `Solution.effects`, in this order.

- friction: μ > 0 and the contact slips or may slip
- restitution: e > 0: a restitution phase was computed
- normal-tangential coupling: b ≠ 0: normal impulse changes the tangential velocity
- spatial slip: the direction of slip turns and had to be integrated
- stick: a phase of stick was computed
- resumed slip: slip resumed along the diverging invariant direction
- jam: dv₃/dP₃ < 0 during some slip
- second compression: a second compression phase was computed
- recorded path: the path was recorded
"""
