"""Input and results of a time step: rows, matrices, velocities, forces. (theory.md, 16)"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..._compile.declared import Flags, FloatRows, Floats, FloatStack, IntegerRows, Integers
from ..._compile.jit import inlined


class StepRows(NamedTuple):
    """The rows of a step: three per contact, three per held contact, then one per limit and dry joint.

    Attributes:
        contacts: (nc,) numbers of the near contacts.
        held: (nh,) numbers of the held contacts.
        limits: (nl,) numbers of the near joint limits.
        dry: (nd,) indices in v of the joints with dry friction.
        values: (rows, …) nonzero entries of each row of the Jacobian.
        columns: (rows, …) their columns, in ascending order.
        counts: (rows,) their numbers.
        surface: (nc + nh, 3) velocities of the surfaces [m/s].
        gap: (nc + nh + nl,) gaps of contacts, held contacts and limits at the midpoint, γ of (16.2) [m].
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
        """Return the numbers of near contacts, then of near limits counted after all `contacts`."""
        return np.concatenate([self.contacts, self.limits + contacts])

    @property
    def normals(self) -> Integers:
        """(nc + nl,) Numbers of the normal rows of contacts and of the rows of limits."""
        nc, nh = len(self.contacts), len(self.held)
        return np.concatenate([3 * np.arange(nc) + 2, 3 * (nc + nh) + np.arange(len(self.limits))])

    def room(self, nv: int, iterations: int) -> StepResult:
        """Return an uninitialized `StepResult` for nv velocities and a number of iterations."""
        impulse, u_start, u_end = np.empty((3, len(self.counts)))
        (predicted, v_end, foreseen), struck = np.empty((3, nv)), np.zeros(nv, dtype=bool)
        items = len(self.contacts) + len(self.limits)
        (fast, arrives), gaps = np.empty((2, items), dtype=bool), np.empty(items)
        bent, (course, tried_course) = np.empty(1, dtype=bool), np.empty((2, 2, iterations, len(impulse)))
        own = struck, foreseen, np.empty(len(impulse)), tried_course, np.zeros(1)
        return StepResult(impulse, u_start, u_end, fast, arrives, predicted, v_end, gaps, bent, course, *own)

    @property
    def held_rows(self) -> Integers:
        """(3 nh,) Numbers of the rows of held contacts."""
        return 3 * len(self.contacts) + np.arange(3 * len(self.held))


def widest(before: Integers) -> int:
    """Return the largest number of velocities that move a contact, from the `velocity_parent` of each."""
    depth: list[int] = []
    for parent in before.tolist():
        depth.append(1 + (depth[parent] if parent >= 0 else 0))
    return min(2 * max(depth), len(depth))


class StepSystem(NamedTuple):
    """Data that depend on the step size and on the configuration at the midpoint only.

    Attributes:
        mass: (nv, nv) M with the terms of damping and drives.
        inverse: (nv, nv) its inverse.
        softened: (nv,) these terms, θhD + ¼h²K.
        damping: (nv,) hD.
        theta: (nv,) θ, ½ or 1. (theory.md, 16.1)
        tree: (nv,) number of the tree that each velocity belongs to.
        start: (nv,) the first velocity of that tree.
        rests: (nj,) joints at rest, including the world; their velocity stays zero.
        collides: (n + nl,) contacts and limits that close by an impact law, and not by (16.2).
        restitution: (n + nl,) Newton's coefficients of contacts and limits that close by (16.2) in this step.
        compliances: (n,) relative compliances of all contacts.
        gravity: Gravitational acceleration [m/s²].
    """

    mass: FloatRows
    inverse: FloatRows
    softened: Floats
    damping: Floats
    theta: Floats
    tree: Integers
    start: Integers
    rests: Flags
    collides: Flags
    restitution: Floats
    compliances: Floats
    gravity: float


class StepResult(NamedTuple):
    """The results of a step.

    Attributes:
        impulse: (rows,) impulses [N s].
        u_start: (rows,) row velocities at the start [m/s]; joints are scaled by `joint_metres`.
        u_end: (rows,) row velocities at the end.
        fast: (nc + nl,) contacts and limits that close so fast that they have been apart.
        arrives: (nc + nl,) those of them without impulse in this step.
        predicted: (nv,) predicted velocity at the end, from which forces were evaluated.
        v_end: (nv,) velocity at the end; both are in the axes of the midpoint.
        gap_end: (nc + nl,) gaps at the end [m].
        bent: (1,) whether the term ½h J̇ v of (16.2) is included, and slow overlap is closed.
        course: (2, …, rows) compliances r and impulses of the iterations (16.3), zeros after the last one.
        struck: (nv,) velocities of islands with impacts in this step, whose contact problem is solved twice.
        foreseen: (nv,) `predicted` of the first contact problem.
        tried, tried_course: Impulses and iterations of the first one, if any island is struck.
        stiffness: (1,) step size times the rate at which a control that is a function changes v̇ with v.
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
    struck: Flags
    foreseen: Floats
    tried: Floats
    tried_course: FloatStack
    stiffness: Floats

    def kept(self) -> StepResult:
        """Return a copy of the velocities, with the other fields, and only the iterations that were taken."""
        v_end, predicted, foreseen = self.v_end.copy(), self.predicted.copy(), self.foreseen.copy()
        course = self.course[:, self.course[0].any(axis=1)]
        first = self.tried_course[:, self.tried_course[0].any(axis=1)] if self.struck.any() else course
        result = self._replace(v_end=v_end, predicted=predicted, foreseen=foreseen)
        return result._replace(course=course, tried_course=first)

    def of_first_problem(self, jacobian: FloatRows) -> StepResult:
        """Return the result of the first contact problem; `jacobian` (rows, nv) is that of the rows."""
        v_end = np.where(self.struck, self.predicted, self.v_end)
        u_end = self.u_end + jacobian @ (v_end - self.v_end)
        result = self._replace(impulse=self.tried, u_end=u_end, v_end=v_end, course=self.tried_course)
        return result._replace(predicted=self.foreseen, struck=np.zeros_like(self.struck))

    def gaps_at(self, part: float, h: float, rows: StepRows) -> Floats:
        """Return the gaps (nc + nl,) after a fraction of a step of length h; rates are linear in time."""
        start, end = self.u_start[rows.normals], self.u_end[rows.normals]
        return self.gap_end + h * ((part - 1.0) * start + 0.5 * (part * part - 1.0) * (end - start))


class MeanForces(NamedTuple):
    """The mean forces of a step.

    Attributes:
        world: (nc + nh, 3) forces of contacts and held contacts in world axes [N].
        points: (nc + nh, 3) points of action [m].
        axes: (nc + nh, 3, 3) contact axes, as rows.
        joints: (nv,) forces of limits and dry friction [N or N m].
    """

    world: FloatRows
    points: FloatRows
    axes: FloatStack
    joints: Floats


@inlined
def closing_speed(gap, slow, h):
    """Return γ/h of (16.2) [m/s]; zero for overlap that would close faster than `slow` [m/s]."""
    return gap / h if gap > -slow * h else 0.0


@inlined
def first_row(nc, i):
    """Return the first row of item i: of contact i < nc, or else a row of a held contact, limit or joint."""
    return 3 * i if i < nc else 2 * nc + i


@inlined
def normal_row(nc, every, i):
    """Return the normal row of contact i < nc, or the row of limit i − nc, and the index of its gap.

    `every` is the number of contacts including held ones.
    """
    if i < nc:
        return 3 * i + 2, i
    return 3 * every + i - nc, every + i - nc
