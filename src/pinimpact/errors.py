"""The errors that pinimpact raises on purpose: one root and its few children."""

from __future__ import annotations

from typing import Any


class PinimpactError(Exception):
    """Root of every error raised on purpose.

    Args:
        message: What is wrong, with the offending value, and what would be right.
        field: Name of the offending argument or file key, where there is one.
        value: The offending value, as given.
    """

    def __init__(self, message: str, *, field: str | None = None, value: Any = None) -> None:
        super().__init__(message)
        self.message = message
        self.field = field
        self.value = value

    def __str__(self) -> str:
        return self.message


class JointLimitWarning(UserWarning):
    """A configuration lies beyond the limits of a joint, as one in degrees does."""


class BoundReachedWarning(UserWarning):
    """An impact at many contacts reached a bound on steps or events, and its answer is approximate."""


class SteppedWarning(UserWarning):
    """A part of a motion was crossed by time stepping, since its events could not be located one by one."""


class InputError(PinimpactError, ValueError):
    """A value that cannot be used: wrong shape, not finite, out of range."""


class UnknownNameError(PinimpactError, KeyError):
    """A name that nothing bears (or several things do): frame, joint, robot, law, method, key."""


class ModelError(PinimpactError, ValueError):
    """A robot description that cannot be used: missing, broken, without inertia."""


class UnstoppableApproachError(PinimpactError, ValueError):
    """The contact approaches, and no normal impulse can stop it (c = 0, or a blocked mechanism)."""


class LawError(PinimpactError, ValueError):
    """The restitution law's end cannot be reached by this mechanism."""


class SimulationError(PinimpactError, RuntimeError):
    """A simulation that cannot continue; ``partial`` holds the trajectory computed until then.

    Args:
        message: Why it stopped and what would help.
        partial: The consistent trajectory up to the stop, or None where nothing was computed.
        field: As in `PinimpactError`.
        value: As in `PinimpactError`.
    """

    def __init__(
        self, message: str, *, partial: Any = None, field: str | None = None, value: Any = None
    ) -> None:
        super().__init__(message, field=field, value=value)
        self.partial = partial


class IrregularMotionError(SimulationError):
    """Events that cannot be located one after another; time stepping crosses them."""


class LockedPostureError(SimulationError):
    """Friction locks a contact in a direction in which nothing moves it, though it is carried on.

    Rigid bodies have neither forces nor impulses there. (theory.md, 13)
    """
