"""The state of a motion: all on which what comes next depends, as one value."""

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
    """What touches of two shapes.

    Attributes:
        points: By contact: the features in contact.
        normals: (3,) normal of each, from B to A.
        flush: Corners in the plane of contact where nothing is to touch, of A and of B.
    """

    points: dict[int, PointContact]
    normals: dict[int, Array]
    flush: tuple[frozenset[int], frozenset[int]] = (frozenset(), frozenset())


@dataclass(eq=False, repr=False)
class HybridState:
    """What a motion has reached. With the scene and the options it determines how the motion continues.

    Values of fields are replaced, never changed in place, so `kept` states share them. What kernels change in
    place (modes, active contacts, directions of slip, forces, stages of the step before) is in the workspace;
    a value that is copied or pickled has it in `memory`, see `Integrator.value`.

    Attributes:
        t: Time [s].
        q, v: (nq,) configuration and (nv,) velocity.
        works: (4,) integrated works, see `dense_step.WORKS` [J].
        impact_energy: Change of kinetic energy in impacts so far [J].
        overlap: What overlaps at the start by more than rounding, as a sentence, or None.
        ended_by: Name of the event that has ended the motion, or None.
        closed: What is closed, or None.
        forces_found: Whether forces were found to the usual accuracy where modes were set last.
        forces_unique: Whether forces were unique where the smooth motion began.
        forces_beyond: Whether forces have exceeded their bounds.
        touching: Of pairs of shapes that touch, by number of the pair: in what.
        signs, counts: Of each user event: the sign of its guard, and how often it has happened.
        instant, happened: The time of the last user event, and which events have happened at that time.
        length: The length of step to try next [s].
        bounce: Up to how much longer than a bounce just begun steps may be [s].
        cut_short: Whether the last step ended at a given time.
        low_orders_from: The steps from which orders 5 and 3 may be tried.
        steps, rejected: Numbers of steps.
        marked: `steps`, `t` and `v` where there was progress last.
        rubbed: Least works of friction so far, in joints and in contacts [J].
        struck: Instants with impacts since the motion was resumed.
        islands: (trees,) Of each tree of joints that rests in time steps: its island, else −1.
        resting_forces: On what rests.
        warm_start, pushed: (nv,) where the iteration of a time step begins, see `step_impulses`; the mean
            acceleration by the impulses of the step before.
        step_before: The length of that step [s].
        unsolved: The largest error of a contact problem in time steps so far.
        crossing, entering: Whether time steps are taken now; whether the next is the first of them.
        until, interval: The time until which they are taken, and the length of that interval [s].
        coarse: Their length [s].
        handed_back, events_since: When the last such interval ended [s]; the number of steps at that time.
        stepped: All such intervals.
        memory: Values of the workspace, and the directions (p, 3) along which pairs of shapes are apart; None
            in a motion under way.
    """

    t: float
    q: Array
    v: Array
    works: Array = field(default_factory=lambda: np.zeros(WORKS))
    impact_energy: float = 0.0
    overlap: str | None = None
    ended_by: str | None = None

    closed: ClosedSet | None = None
    forces_found: bool = True
    forces_unique: bool = True
    forces_beyond: bool = False
    touching: dict[int, Touching] = field(default_factory=dict)

    signs: tuple[float, ...] = ()
    counts: tuple[int, ...] = ()
    instant: float = -math.inf
    happened: frozenset[int] = frozenset()

    length: float = 0.0
    bounce: float = math.inf
    cut_short: bool = False
    low_orders_from: tuple[int, ...] = (0, 0)
    steps: int = 0
    rejected: int = 0
    marked: tuple[int, float, Array] = (0, 0.0, np.zeros(0))
    rubbed: tuple[float, float] = (0.0, 0.0)
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

    def kept(self, **changes: Any) -> HybridState:
        """Return the present values, with changes."""
        state = object.__new__(HybridState)
        state.__dict__.update(self.__dict__, **changes)
        return state

    def become(self, other: HybridState) -> None:
        """Take the values of another state."""
        self.__dict__.update(other.__dict__)

    def __repr__(self) -> str:
        return f"HybridState(t = {self.t:.6g} s)"
