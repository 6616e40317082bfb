"""Whether the motion determines the mean forces of a time step."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin

from .._numeric.tolerances import RANK, ROUNDOFF
from ..arrays import Array
from ..robot.forest import data_of, inverse_mass, joint_jacobian
from ..robot.names import motion_signs
from ._kernels.tolerances import STEPS_STILL, STEPS_TOUCH
from ._kernels.workspace import SceneWorkspace
from .forces import StepForces


def step_tolerances(work: SceneWorkspace, extent: float) -> tuple[float, float]:
    """Return the largest gap of a closed contact [m] and speed of one at rest [m/s] in time steps.

    `extent` is the size of the scene [m].
    """
    touching = max(float(work.touching_gap), STEPS_TOUCH * extent)
    return touching, STEPS_STILL * float(work.resting_speed or 1.0)


class StepUniqueness:
    """Decides for time steps of a robot whether the motion determines their forces.

    This is the case where G M⁻¹H of (9.3) is regular for the rows that are closed in the step. Friction of a
    sliding contact is proportional to its normal force. Rows that no force moves are left out.

    Args:
        model: The robot.
        touching: Gap up to which a contact without a force is closed [m].
        still: Speed up to which contacts are at rest [m/s].
    """

    def __init__(self, model: pin.Model, touching: float, still: float) -> None:
        self._model, self._touching, self._still = model, touching, still

    @cached_property
    def _data(self) -> Any:
        return data_of(self._model)

    def __call__(self, forces: StepForces, q: Array, work: SceneWorkspace) -> bool:
        """Return whether the motion determines the forces of a step with the configuration q (nq,).

        `work` is a workspace of the scene, with the friction of its contacts and its joint limits.
        """
        model, data = self._model, self._data
        rows, columns = self._rows(forces, joint_jacobian(model, data, q), work)
        if len(rows) == 0:
            return True
        inverse = inverse_mass(model, data, q)
        sizes = np.einsum("ij,ij->i", rows @ inverse, rows)
        moved = sizes > ROUNDOFF * sizes.max()
        count = int(np.count_nonzero(moved))
        if count > model.nv:
            return False
        scale = 1.0 / np.sqrt(sizes[moved])  # masses can differ by any factor
        system = scale[:, None] * (rows[moved] @ inverse @ columns[moved].T) * scale
        return int(np.linalg.matrix_rank(system, tol=RANK)) == count

    def _rows(self, forces: StepForces, jacobian: Array, work: SceneWorkspace) -> tuple[Array, Array]:
        """Return G and H (m, nv) of the closed rows; `jacobian` (6, nv) is that of `joint_jacobian`."""
        model = self._model
        rows, columns = [np.zeros((0, model.nv))], [np.zeros((0, model.nv))]
        held = work.bilateral[forces.contacts] != 0
        touches = (forces.gaps <= self._touching) & (np.abs(forces.speeds[:, 2]) <= self._still)
        bears = forces.impulses.any(axis=1)
        for k in np.flatnonzero(held | touches | bears).tolist():
            at_point = jacobian[:3] + np.cross(jacobian[3:], forces.points[k], axis=0)
            signs = motion_signs(model, *forces.ends[k].tolist())
            own = forces.axes[k] @ (at_point * signs)
            slip, mu = forces.speeds[k, :2], work.friction[forces.contacts[k]]
            speed = float(np.linalg.norm(slip))
            slides = not held[k] and (mu == 0.0 or speed > self._still)
            drag = mu / speed * slip if slides and mu > 0.0 else np.zeros(2)
            rows.append(own[2:] if slides else own)
            columns.append((own[2] - drag @ own[:2])[None] if slides else own)
        holds = forces.modes[work.limits :] != 0
        holds[work.limit_v[forces.modes[: work.limits] != 0]] = True
        stops = np.eye(model.nv)[holds & (forces.joints != 0.0)]
        return np.vstack([*rows, stops]), np.vstack([*columns, stops])
