"""How small changes pass an impact at several contacts of a scene. (docs/derivatives.md, 11)"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ..contact_space.derivatives import Boundary
from ..contact_space.many_derivatives import Change, slopes_along
from ..contact_space.many_inputs import many_inputs
from ..contact_space.problem import ImpactProblem
from ..contact_space.simultaneous import find_policy
from ..errors import InputError
from ..robot.contact import Contact
from ..robot.derivatives import slope_of_restitution
from ..robot.many_derivatives import ManySlopes, coefficient_change
from ..robot.matrices import checked_matrices
from ..robot.names import free_velocities
from ..robot.placed_robot import PlacedRobot
from ._kernels.contact_forces import SLIP
from .dynamics import SceneDynamics
from .records import ImpactRecord

Array = NDArray[np.float64]

DEPENDENT = 1e-12
"""Part of the largest singular value below which changes are combinations of others."""

REPRODUCED = 1e-6
"""Part of the change of velocity to which an impact is computed again for its derivatives."""


class Parameter(NamedTuple):
    """A coefficient by which a motion is differentiated: "friction" or "restitution" of a contact."""

    kind: str
    contact: int


class GroupJump:
    """The velocity after an impact at several contacts and limits, by what is before it.

    Args:
        dynamics: Dynamics of the scene.
        model: Its model.
        data: Data of it.
        held: Contacts that hold.
        locked: Joints that are locked.
        record: One of the records of the impact.
        modes: Of contacts and, past those, limits before it; zero is open.

    Attributes:
        jacobian: (n, nv) of the gaps.
        rates: (n,) of the gaps before the impact.
        sources: (n,) numbers of the contacts and limits.
        closed: (n,) which of them were closed before it.

    Raises:
        InputError: A contact of two collision shapes is among them.
    """

    def __init__(
        self,
        dynamics: SceneDynamics,
        model: pin.Model,
        data: pin.Data,
        held: Sequence[Contact],
        locked: Sequence[str | int],
        record: ImpactRecord,
        modes: NDArray[np.int64],
    ) -> None:
        assert record.group is not None
        group, count = record.group[0], len(dynamics.contacts)
        self._group, self._record, self.sources = group, record, np.array(group.sources, dtype=np.int64)
        self._contacts = [dynamics.contacts[i] for i in group.sources if i < count]
        for contact in self._contacts:
            if contact.pair is not None:
                raise InputError(
                    f"sensitivities: {contact.label!r}, a contact of two collision shapes, takes part in an "
                    f"impact at several contacts at t = {record.time:.6g} s; they are not available there",
                    field="sensitivities",
                )
        limits = [dynamics.limits[i - count] for i in group.sources if i >= count]
        stops = np.zeros((len(limits), model.nv))
        for row, limit in zip(stops, limits, strict=True):
            row[limit.index_v] = limit.sign
        placed, free = PlacedRobot(model, data, record.q), free_velocities(model, locked)
        anchors = tuple(placed.geometry(anchor) for anchor in held)
        self._matrices = checked_matrices(placed, self._contacts, anchors, free.astype(np.float64), stops)
        self._slopes = ManySlopes(placed, self._contacts, self._matrices, held, free)
        self.jacobian = self._matrices.jacobian[2::3]
        velocity = self._matrices.velocity(record.v_before)
        self.rates, now = velocity[:, 2].copy(), modes[self.sources]
        self.closed = now > 0
        # what is closed has velocities only by the error of steps
        self._still = np.column_stack([now > SLIP, now > SLIP, now > 0])
        self._still[len(self._contacts) :, :2] = False
        velocity[self._still] = 0.0
        problem = group.problem
        self._inputs = many_inputs(
            ImpactProblem(
                *(self._matrices.delassus, velocity, problem.friction, problem.restitution, problem.law),
                problem.surface_velocity,
                stiffness=problem.stiffness,
            )
        )

    def changes_after(
        self, x: Array, parameters: Sequence[Parameter]
    ) -> tuple[Array, NDArray[np.bool_], Boundary] | None:
        """Return the velocities' changes (nv, m) after the impact, for changes x (2nv, m) before it.

        The last columns are those of parameters. Also returns of which of them the impact depends, and flags;
        None if the impact is not the recorded one, so that it has another outcome nearby.
        """
        nv, record, inputs = len(x) // 2, self._record, self._inputs
        solution = find_policy(self._group.policy).run(inputs, False)
        impulse, change = solution.impulse.ravel(), record.v_after - record.v_before
        response = self._matrices.response
        if not np.abs(response @ impulse - change).max() <= REPRODUCED * np.abs(change).max():
            return None
        velocity = self._slopes.velocity(record.v_before) @ x[:nv] + self._matrices.jacobian @ x[nv:]
        velocity[self._still.ravel()] = 0.0
        known = np.isfinite(x).all(axis=0)
        basis, weights = _basis(velocity[:, known], x[:nv, known], np.abs(inputs.velocity).max())
        changes = [self._change(*np.split(column, [len(velocity)])) for column in basis.T]
        changed, first = [], x.shape[1] - len(parameters)
        for column, parameter in enumerate(parameters, first):
            places = np.flatnonzero(self.sources == parameter.contact).tolist()
            if places and self._matters(parameter, places[0]):
                changes.append(coefficient_change(len(self.sources), **{parameter.kind: places[0]}))
                changed.append(column)
        found = slopes_along(inputs, self._group.policy, solution, changes)
        of_state = found.impulse[:, : len(basis.T)]
        after = np.full((nv, x.shape[1]), np.nan)
        after[:, known] = x[nv:, known] + self._slopes.change(impulse) @ x[:nv, known]
        after[:, known] += response @ of_state @ weights
        after[:, changed] += response @ found.impulse[:, len(basis.T) :]
        depends = np.zeros(len(parameters), dtype=bool)
        depends[np.array(changed, dtype=np.int64) - first] = True
        return after, depends, found.boundary

    def _matters(self, parameter: Parameter, place: int) -> bool:
        """Whether an impact depends on a coefficient of a contact; not on e where a bounce would rest."""
        used = self._inputs.restitution[place]
        return parameter.kind == "friction" or (
            not self.closed[place] and used == self._contacts[place].restitution
        )

    def _change(self, velocity: Array, of_q: Array) -> Change:
        """Return the change of the impact's data for a change of velocities (3n,) and of q (nv,)."""
        inputs, k = self._inputs, len(self._contacts)
        delassus = np.tensordot(of_q, self._slopes.delassus, 1)
        velocity = velocity.reshape(-1, 3).copy()
        velocity[self._still] = 0.0
        restitution, stiffness = np.zeros(len(velocity)), np.zeros(len(velocity))
        for i, contact in enumerate(self._contacts):
            if inputs.restitution[i] > 0.0:
                bend = slope_of_restitution(contact, max(-float(inputs.velocity[i, 2]), 0.0))
                restitution[i] = -bend * velocity[i, 2]
        if 0 < k < len(velocity):  # κ w of a limit is the mean of the contacts'
            w, dw = inputs.delassus.diagonal()[2::3], delassus.diagonal()[2::3]
            moved = float(np.mean(inputs.stiffness[:k] * dw[:k]))
            stiffness[k:] = (moved - inputs.stiffness[k:] * dw[k:]) / w[k:]
        return Change(velocity, delassus, np.zeros(len(velocity)), restitution, stiffness)


def _basis(velocity: Array, of_q: Array, speed: float) -> tuple[Array, Array]:
    """Return directions (3n + nv, r) that velocities (3n, m) and q's changes (nv, m) combine, and weights."""
    size = speed or 1.0
    left, values, right = np.linalg.svd(np.vstack([velocity / size, of_q]), full_matrices=False)
    kept = values > DEPENDENT * values.max(initial=0.0)
    basis = left[:, kept]
    basis[: len(velocity)] *= size
    return basis, values[kept, None] * right[kept]
