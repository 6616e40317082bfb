"""What a time step was computed from, kept for its derivative."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from ..arrays import Array, Bools
from ..robot.contact import Contact
from ..robot.corner_motion import Corner
from ._kernels.step_rows import StepResult, StepRows


class Near(NamedTuple):
    """What the rows of a time step belong to.

    Attributes:
        contacts: The near contacts, then held ones.
        corners: By place among these: what contacts of two shapes stand for.
    """

    contacts: tuple[Contact, ...]
    corners: Mapping[int, Corner]


class Removal(NamedTuple):
    """A displacement that takes away overlap at the end of a step.

    Attributes:
        displacement: (nv,) ξ.
        pushes: z, along `StepRows.normals`, then `StepRows.held_rows` [kg m or kg m²].
        before: (nq,) the configuration before.
        v: (nv,) the velocity before.
        rows: The rows there.
        near: What they belong to.
    """

    displacement: Array
    pushes: Array
    before: Array
    v: Array
    rows: StepRows
    near: Near


@dataclass(slots=True, eq=False)
class StepTaken:
    """What a time step was computed from.

    Attributes:
        h: Its length, were it not cut [s].
        middle: (nq,) configuration at the midpoint.
        v: (nv,) velocity at the start, in the axes there.
        softened: (nv,) what damping and drives add to M.
        pushed: (nv,) mean acceleration by the impulses of the step before.
        follows: (nv,) which drives follow their laws.
        near: What its rows belong to.
        axes: (k, 3, 3) axes of these contacts at the midpoint, as rows.
        rows, found: Rows and result of the step.
        arriving: Numbers of the near contacts, and limits past those, that touch where it is cut.
        struck: Of contacts of two shapes that touch where it is cut, by number.
        touching: Gap up to which contacts touch [m].
        overlap: Up to which gaps are closed though they are below zero [m].
        removals: Of overlap at the end, one after another.
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
    touching: float
    overlap: float
    arriving: tuple[int, ...] = ()
    struck: Mapping[int, Corner] = field(default_factory=dict)
    removals: list[Removal] = field(default_factory=list)
