"""The errors and warnings of pinimpact."""

from __future__ import annotations

from typing import Any


class PinimpactError(Exception):
    """Base class of all errors of pinimpact.

    Args:
        message: What is wrong, with the value, and what is expected.
        field: Name of the argument or file key. Default: the text before the first colon of the message.
        value: The value, as given.
    """

    def __init__(self, message: str, *, field: str | None = None, value: Any = None) -> None:
        super().__init__(message)
        self.message = message
        self.field = field or (message.partition(": ")[0] if ": " in message else None)
        self.value = value

    def __str__(self) -> str:
        return self.message


class InertiaWarning(UserWarning):
    """Physically impossible principal moments of inertia: the largest exceeds the sum of the others."""


class JointLimitWarning(UserWarning):
    """A configuration is outside the joint limits, perhaps because it is in degrees."""


class BoundReachedWarning(UserWarning):
    """An impact at many contacts reached a bound on steps or events; its result is approximate."""


class SteppedWarning(UserWarning):
    """An interval was simulated by time steps, because its events could not be located one by one."""


class InputError(PinimpactError, ValueError):
    """An invalid value: wrong shape, not finite, out of range."""


class UnknownNameError(PinimpactError, KeyError):
    """A name that does not exist, or is not unique: frame, joint, robot, law, method, key."""


class ModelError(PinimpactError, ValueError):
    """A robot description that cannot be used: missing, invalid, without inertia."""


class UnstoppableApproachError(PinimpactError, ValueError):
    """The contact approaches, and no normal impulse can stop it (c = 0, or a blocked mechanism)."""


class LawError(PinimpactError, ValueError):
    """The mechanism cannot satisfy the restitution law."""


class SimulationError(PinimpactError, RuntimeError):
    """A simulation that cannot continue.

    Args:
        message: Why it stopped, and what may help.
        partial: The trajectory until then, or None.
        field: As in `PinimpactError`.
        value: As in `PinimpactError`.
    """

    def __init__(
        self, message: str, *, partial: Any = None, field: str | None = None, value: Any = None
    ) -> None:
        super().__init__(message, field=field, value=value)
        self.partial = partial


class IrregularMotionError(SimulationError):
    """Events that cannot be located one by one; ``scheme="auto"`` then takes time steps."""
