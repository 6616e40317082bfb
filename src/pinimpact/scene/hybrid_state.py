"""The complete state of a motion, which determines how it continues, as one value."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from ..arrays import Array, Integers
from ..robot.shape_pair import PointContact
from .dense_step import WORKS
from .forces import ClosedSet, StepForces
from .records import SteppedInterval


class Touching(NamedTuple):
    """The contact of two convex shapes A and B.

    Attributes:
        points: By number of the contact: the features in contact.
        normals: By number of the contact: the normal (3,), from B to A.
        flush: Corners of A and of B that lie in the plane of contact without being in contact.
        between: Numbers of the contacts whose points lie between others, which have no forces. (15.3)
    """

    points: dict[int, PointContact]
    normals: dict[int, Array]
    flush: tuple[frozenset[int], frozenset[int]] = (frozenset(), frozenset())
    between: frozenset[int] = frozenset()


@dataclass(eq=False, repr=False)
class HybridState:
    """State of a motion. Together with the scene and the options it determines how the motion continues.

    Field values are replaced, never changed in place, so copies share them. Data that kernels change in place
    (modes, active contacts, directions of slip, forces, stages of the last step) are in the workspace; copied
    and pickled states store them in `memory`, see `Integrator.value`.

    Attributes:
        t: Time [s].
        q, v: (nq,) configuration and (nv,) velocity.
        works: (4,) integrated work, see `dense_step.WORKS` [J].
        impact_energy: Change of kinetic energy in impacts so far [J].
        overlap: Message that describes an overlap at the start of more than rounding, or None.
        ended_by: Name of the event that has ended the motion, or None.
        closed: The active contacts, or None.
        forces_unique: Whether forces were unique where the smooth motion began.
        forces_beyond: Whether forces have exceeded their bounds.
        touching: Contacts of the pairs of convex shapes that touch, by number of the pair.
        flat: Numbers of the rims that lie flat.
        signs, counts: For each user event, the sign of its guard and the number of times it has happened.
        instant, happened: Time of the last user event [s], and the events that have happened at that time.
        length: Step size to try next [s].
        bounce: Predicted duration of a bounce that has just begun [s].
        cut_short: Whether the last step ended at a given time.
        low_orders_from: Numbers of steps from which orders 5, 3 and 2 may be tried.
        steps, rejected: Numbers of accepted and of rejected steps.
        marked: `steps`, `t` and `v` at the last time at which there was progress.
        pressed: Largest sum of the weight and the forces of the control at a check of friction so far [N].
        struck: Number of instants with impacts since the motion was resumed.
        islands: (trees,) island of each kinematic tree at rest in time steps, −1 for moving trees.
        resting_forces: Forces on the bodies at rest in time steps.
        warm_start: (nv,) initial iterate of the next time step, see `step_impulses`.
        pushed: (nv,) mean acceleration by the impulses of the last time step.
        step_before: Length of that step [s].
        unsolved: Largest residual of a contact problem in time steps so far.
        crossing, entering: Whether time steps are taken now; whether the next one is the first of them.
        until, interval: End of the present interval of time steps, and its length [s].
        coarse: Step size in it [s].
        handed_back, events_since: End of the last such interval [s], and the number of steps at that time.
        stepped: All such intervals.
        memory: Values of the dynamics, and the directions (p, 3) along which pairs of shapes are apart; None
            while the motion is being integrated.
    """

    t: float
    q: Array
    v: Array
    works: Array = field(default_factory=lambda: np.zeros(WORKS))
    impact_energy: float = 0.0
    overlap: str | None = None
    ended_by: str | None = None

    closed: ClosedSet | None = None
    forces_unique: bool = True
    forces_beyond: bool = False
    touching: dict[int, Touching] = field(default_factory=dict)
    flat: frozenset[int] = frozenset()

    signs: tuple[float, ...] = ()
    counts: tuple[int, ...] = ()
    instant: float = -math.inf
    happened: frozenset[int] = frozenset()

    length: float = 0.0
    bounce: float = math.inf
    cut_short: bool = False
    low_orders_from: tuple[int, ...] = (0, 0, 0)
    steps: int = 0
    rejected: int = 0
    marked: tuple[int, float, Array] = (0, 0.0, np.zeros(0))
    pressed: float = 0.0
    struck: int = 0

    islands: Integers | None = None
    resting_forces: StepForces | None = None
    warm_start: Array | None = None
    pushed: Array | None = None
    step_before: float = 0.0
    unsolved: float = 0.0
    crossing: bool = False
    entering: bool = False
    until: float = 0.0
    interval: float = 0.0
    coarse: float = 0.0
    handed_back: float = -math.inf
    events_since: int = 0
    stepped: tuple[SteppedInterval, ...] = ()

    memory: tuple[Any, ...] | None = None

    def copy(self, **changes: Any) -> HybridState:
        """Return a copy, with some fields changed."""
        state = object.__new__(HybridState)
        state.__dict__ = self.__dict__ | changes
        return state

    def assign(self, other: HybridState) -> None:
        """Copy all fields from another state."""
        self.__dict__.update(other.__dict__)

    def __repr__(self) -> str:
        return f"HybridState(t = {self.t:.6g} s)"
