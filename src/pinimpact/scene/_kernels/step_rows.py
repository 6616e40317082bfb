"""What a time step starts from and leads to: rows, matrices, velocities, forces. (theory.md, 16)"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..._compile.declared import Flags, FloatRows, Floats, FloatStack, IntegerRows, Integers
from ..._compile.jit import inlined


class StepRows(NamedTuple):
    """The rows of a step: three of each contact, three of each held one, then those of scalar rows.

    Attributes:
        contacts: (nc,) numbers of the contacts that are near.
        held: (nh,) numbers of the held ones.
        limits: (nl,) numbers of the joint limits that are near.
        dry: (nd,) velocities of the joints with dry friction.
        values: (rows, …) nonzero entries of each row of the Jacobian.
        columns: (rows, …) their columns, in ascending order.
        counts: (rows,) their numbers.
        surface: (nc + nh, 3) velocities of the surfaces [m/s].
        gap: (nc + nh + nl,) of contacts, held contacts and limits at the midpoint, halfway between those at
            the ends [m].
    """

    contacts: Integers
    held: Integers
    limits: Integers
    dry: Integers
    values: FloatRows
    columns: IntegerRows
    counts: Integers
    surface: FloatRows
    gap: Floats

    def near(self, contacts: int) -> Integers:
        """Return the numbers of contacts, and of limits past those, which are so many."""
        return np.concatenate([self.contacts, self.limits + contacts])

    @property
    def normals(self) -> Integers:
        """(nc + nl,) The rows along the normals of contacts, and those of limits."""
        nc, nh = len(self.contacts), len(self.held)
        return np.concatenate([3 * np.arange(nc) + 2, 3 * (nc + nh) + np.arange(len(self.limits))])

    def room(self, nv: int, iterations: int) -> StepResult:
        """Return room for what a step leads to, with nv velocities, and for so many iterations."""
        impulse, u_start, u_end = np.empty((3, len(self.counts)))
        predicted, v_end = np.empty((2, nv))
        items = len(self.contacts) + len(self.limits)
        (fast, arrives), gaps = np.empty((2, items), dtype=bool), np.empty(items)
        bent, course = np.empty(1, dtype=bool), np.empty((2, iterations, len(self.counts)))
        return StepResult(impulse, u_start, u_end, fast, arrives, predicted, v_end, gaps, bent, course)

    @property
    def held_rows(self) -> Integers:
        """(3 nh,) The rows of held contacts."""
        return 3 * len(self.contacts) + np.arange(3 * len(self.held))


def widest(before: Integers) -> int:
    """Return how many velocities move the ends of a contact at the most, from the one before each."""
    depth: list[int] = []
    for parent in before.tolist():
        depth.append(1 + (depth[parent] if parent >= 0 else 0))
    return min(2 * max(depth), len(depth))


class StepSystem(NamedTuple):
    """What is the same in all steps of a length, or follows from the configuration at the midpoint.

    Attributes:
        mass: (nv, nv) M with what damping and drives add.
        inverse: (nv, nv) its inverse.
        softened: (nv,) what they add.
        tree: (nv,) number of the tree that each velocity belongs to.
        start: (nv,) the first velocity of that tree.
        rests: (nj,) joints that are at rest, the world among them; their velocity is zero and stays so.
        collides: (n + nl,) which contacts and limits do not close by the laws of a step, but by an impact.
        compliances: (n,) of all contacts.
        gravity: Its acceleration [m/s²].
    """

    mass: FloatRows
    inverse: FloatRows
    softened: Floats
    tree: Integers
    start: Integers
    rests: Flags
    collides: Flags
    compliances: Floats
    gravity: float


class StepResult(NamedTuple):
    """What a step leads to.

    Attributes:
        impulse: (rows,) the impulses [N s].
        u_start: (rows,) velocities of the rows at the start [m/s], of joints see `joint_metres`.
        u_end: (rows,) those at the end.
        fast: (nc + nl,) what closes so fast that it has been apart.
        arrives: (nc + nl,) which of it has no impulse here.
        predicted: (nv,) the velocity with which forces were evaluated at the end.
        v_end: (nv,) the velocity at the end; both are in the axes of the midpoint.
        gap_end: (nc + nl,) the gaps at the end [m].
        bent: (1,) whether the rows of contacts bend along the velocity, and slow overlap is closed.
        course: (2, …, rows) compliances r and impulses of the iterations, zeros from the last one on. (16.3)
    """

    impulse: Floats
    u_start: Floats
    u_end: Floats
    fast: Flags
    arrives: Flags
    predicted: Floats
    v_end: Floats
    gap_end: Floats
    bent: Flags
    course: FloatStack

    def kept(self) -> StepResult:
        """Return this with its own velocities, and the iterations that were taken."""
        used, predicted = self.course[0].any(axis=1), self.predicted.copy()
        return self._replace(v_end=self.v_end.copy(), predicted=predicted, course=self.course[:, used])

    def gaps_at(self, part: float, h: float, rows: StepRows) -> Floats:
        """Return the gaps (nc + nl,) after a part of a step of length h, whose rates are linear in time."""
        start, end = self.u_start[rows.normals], self.u_end[rows.normals]
        return self.gap_end + h * ((part - 1.0) * start + 0.5 * (part * part - 1.0) * (end - start))


class MeanForces(NamedTuple):
    """The mean forces of a step.

    Attributes:
        world: (nc + nh, 3) forces of contacts and held ones in world axes [N].
        points: (nc + nh, 3) where they act [m].
        axes: (nc + nh, 3, 3) contact axes there, as rows.
        joints: (nv,) forces of limits and dry friction [N or N m].
    """

    world: FloatRows
    points: FloatRows
    axes: FloatStack
    joints: Floats


@inlined
def closing_speed(gap, slow, h):
    """Return the speed [m/s] at which a gap is to close; overlap that closes faster is removed instead."""
    return gap / h if gap > -slow * h else 0.0


@inlined
def normal_row(nc, every, i):
    """Return the row along the normal of contact i < nc, or of limit i − nc, and the place of its gap.

    `every` is the number of all contacts, held ones among them.
    """
    if i < nc:
        return 3 * i + 2, i
    return 3 * every + i - nc, every + i - nc
