"""Data of a time step from which its derivatives are computed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ..arrays import Array, Bools
from ..robot.contact import Contact
from ..robot.corner_motion import Corner
from ._kernels.step_rows import StepResult, StepRows


class Near(NamedTuple):
    """The contacts of the rows of a time step.

    Attributes:
        contacts: The near contacts, then the held ones.
        corners: Corners that contacts of two shapes represent, by index in `contacts`.
    """

    contacts: tuple[Contact, ...]
    corners: Mapping[int, Corner]


class Removal(NamedTuple):
    """A displacement that removes overlap at the end of a step. (theory.md, 16)

    Attributes:
        displacement: (nv,) ξ.
        pushes: Multipliers z, along `StepRows.normals`, then `StepRows.held_rows` [kg m or kg m²].
        before: (nq,) configuration before it.
        v: (nv,) velocity before it.
        rows: The rows there.
        near: Their contacts.
    """

    displacement: Array
    pushes: Array
    before: Array
    v: Array
    rows: StepRows
    near: Near


@dataclass(slots=True, eq=False)
class StepTaken:
    """Data of a time step.

    Attributes:
        h: Step size, before an impact cut the step [s].
        middle: (nq,) configuration at the midpoint.
        v: (nv,) velocity at the start, in the axes of the midpoint.
        softened: (nv,) what damping and drives add to the diagonal of M.
        pushed: (nv,) mean acceleration by the impulses of the step before.
        follows: (nv,) whether drives follow their laws, below the effort limits.
        near: Contacts of its rows.
        axes: (k, 3, 3) axes of these contacts at the midpoint, as rows.
        rows, found: Rows and result of the step.
        collides: Near contacts and limits that close by an impact law, and not by (16.2).
        touching: Largest gap of a contact that touches [m].
        overlap: Largest overlap that velocities close [m].
        arriving: Indices in (near contacts, near limits) of those that close where the step is cut.
        struck: Corners of contacts of two shapes that touch where the step is cut, by number of the contact.
        removals: Successive removals of overlap at its end.
    """

    h: float
    middle: Array
    v: Array
    softened: Array
    pushed: Array
    follows: Bools
    near: Near
    axes: Array
    rows: StepRows
    found: StepResult
    collides: Bools
    touching: float
    overlap: float
    arriving: tuple[int, ...] = ()
    struck: Mapping[int, Corner] = field(default_factory=dict)
    removals: list[Removal] = field(default_factory=list)

    def idle(self) -> frozenset[int]:
        """Return the indices of near contacts that stay open and have no impulse, in no iteration either."""
        found, rows = self.found, self.rows.normals[: len(self.rows.contacts)]
        end = found.gap_end[: len(rows)]
        middle = end - 0.5 * self.h * found.u_end[rows]
        least = np.minimum(np.minimum(end, middle), middle - 0.5 * self.h * found.u_start[rows])
        acted = (found.impulse[rows] != 0.0) | (found.course[1][:, rows] != 0.0).any(axis=0)
        open_ones = ~acted & (least > self.touching)
        return frozenset(np.flatnonzero(open_ones).tolist())

    def open_at_start(self, bends: Array) -> Bools:
        """Return which contacts and held ones are open at the start, given (J̇ v)_n (k,). (16.2)"""
        rates = self.found.u_start[2 : 3 * len(bends) : 3] + 0.5 * self.h * bends
        opened = (bends > 0.0) & (self.rows.gap[: len(bends)] >= 0.5 * self.h * rates)
        return np.asarray(opened & (np.arange(len(bends)) < len(self.rows.contacts)))
