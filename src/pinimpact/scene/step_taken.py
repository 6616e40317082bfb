"""What a time step was computed from, kept for its derivative."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..robot.contact import Contact
from ..robot.corner_motion import Corner
from ._kernels.step_rows import StepResult, StepRows

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]


class Removal(NamedTuple):
    """How overlap is taken away at the end of a step.

    Attributes:
        displacement: (nv,) ξ.
        pushes: z, along `StepRows.normals` of what has taken part, then of held contacts [kg m or kg m²].
        took_part: (nc + nl,) which of `StepRows.normals` have.
        before: (nq,) the configuration before.
    """

    displacement: Array
    pushes: Array
    took_part: Bools
    before: Array


@dataclass(slots=True, eq=False)
class StepTaken:
    """What a time step was computed from.

    Attributes:
        h: Its length, were it not cut [s].
        middle: (nq,) configuration at the midpoint.
        softened: (nv,) what damping and drives add to M.
        pushed: (nv,) mean acceleration by the impulses of the step before.
        follows: (nv,) which drives follow their laws.
        stopped: (nv,) velocities that are none: of what is at rest, or comes to rest at the end.
        contacts: The near contacts, then held ones.
        corners: By place among these: what contacts of two shapes stand for.
        axes: (k, 3, 3) contact axes of these at the midpoint, as rows.
        rows, found: Rows and result of the step.
        arriving: Numbers of the near contacts, and limits past those, that touch where it is cut.
        struck: Of contacts of two shapes that touch where it is cut, by number.
        touching: Gap up to which contacts touch [m].
        removal: Of overlap at the end, if there was any.
    """

    h: float
    middle: Array
    softened: Array
    pushed: Array
    follows: Bools
    stopped: Bools
    contacts: tuple[Contact, ...]
    corners: Mapping[int, Corner]
    axes: Array
    rows: StepRows
    found: StepResult
    touching: float
    arriving: tuple[int, ...] = ()
    struck: Mapping[int, Corner] = field(default_factory=dict)
    removal: Removal | None = None
