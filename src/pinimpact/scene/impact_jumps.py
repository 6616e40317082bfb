"""Derivatives of the velocity after an impact by the state before it. (docs/derivatives.md, 9 and 11)

"Changes" (2nv, m) are as in `saltation`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from ..arrays import Array, Bools, Integers
from ..contact_space._kernels.tolerances import MISSED
from ..contact_space.derivatives import Boundary
from ..contact_space.many_derivatives import Change, coefficient_change, slopes_along
from ..contact_space.many_inputs import many_inputs
from ..contact_space.problem import ImpactProblem
from ..contact_space.simultaneous import find_policy
from ..errors import InputError
from ..robot._kernels.impact_slopes import FRICTION
from ..robot.corner_motion import Corner, closest_corners
from ..robot.derivatives import KINKED, derivatives_at_point, slope_of_restitution
from ..robot.many_derivatives import ManySlopes
from ..robot.matrices import ContactMatrices, contact_matrices
from ..robot.names import free_velocities
from ..robot.placed_robot import PlacedRobot
from ..robot.shape_pair import contact_now
from ._kernels.contact_forces import SLIP
from ._kernels.tolerances import ROUNDING
from .dynamics import SceneDynamics
from .islands import islands, tree_roots
from .records import ImpactGroup, ImpactRecord
from .scene import Scene
from .scene_impacts import matrices_of_all
from .switched_off import held_contacts, limit_restitution, locked_joints


class Parameter(NamedTuple):
    """A coefficient by which a motion is differentiated: "friction" or "restitution" of a contact."""

    kind: str
    contact: int


class Passed(NamedTuple):
    """Changes after an impact.

    Attributes:
        after: (nv, m) changes of the velocity after it.
        depends: The parameters on which the impact depends.
        boundary: Flags of `Boundary`.
    """

    after: Array
    depends: tuple[Parameter, ...]
    boundary: Boundary


class ImpactJumps:
    """Differentiates the impacts of a scene."""

    def __init__(self, scene: Scene, dynamics: SceneDynamics, model: pin.Model) -> None:
        self.dynamics, self.model, self.data = dynamics, model, model.createData()
        self.held, self.locked = tuple(held_contacts(scene)), locked_joints(scene)
        self.free = free_velocities(model, self.locked)
        self.pairs = scene.layout().pairs
        self._limit_restitution = limit_restitution(scene)
        labels = [contact.label for contact in dynamics.contacts]
        self._source = {name: i for i, name in enumerate([*labels, *(x.name for x in dynamics.limits)])}
        self._roots = tree_roots(model)

    def sources(self, record: ImpactRecord) -> tuple[int, ...]:
        """Return the numbers of the contacts and limits that take part in an impact."""
        return (self._source[record.source],) if record.group is None else record.group[0].sources

    def islands(self, active: Bools) -> Integers:
        """Return the island (nv,) of each velocity; active contacts connect kinematic trees to islands."""
        work = self.dynamics.work
        return np.asarray(islands(self._roots, work.contact_joints[active])[work.velocity_joint])

    def of(
        self,
        record: ImpactRecord,
        modes: Integers,
        corners: Mapping[int, Corner] | None = None,
        error: float = math.inf,
    ) -> SingleJump | GroupJump:
        """Return the derivatives of an impact.

        Args:
            record: The impact.
            modes: (n + nl,) modes of contacts and limits before it.
            corners: Corners that contacts of two shapes represent, by number of the contact; None: unknown.
            error: Velocities of active contacts up to this fraction of the largest one are taken as zero. It
                is finite within time steps only.
        """
        group = None if record.group is None else record.group[0]
        within_step = error < math.inf  # there the gap of the colliding contact need not vanish
        if group is not None and (within_step or len(group.sources) > 1 or group.policy != "propagate"):
            corners = self._corners(record, group) if corners is None else corners
            return GroupJump(self, record, modes, corners, error)
        (number,), resting, law = self.sources(record), record.resting, None
        if group is not None:  # the other active contacts are lifted
            resting, law = float(group.problem.restitution[0]) == 0.0, "energetic"
        if number >= len(self.dynamics.contacts):
            return self._of_limit(number - len(self.dynamics.contacts), record, resting)
        return self._of_contact(number, record, resting, law)

    def _corners(self, record: ImpactRecord, group: ImpactGroup) -> dict[int, Corner]:
        """Return the corners that contacts of two shapes represent in an impact, by number, where known.

        The record does not store them. They are identified by their velocities.
        """
        found: dict[int, Corner] = {}
        candidates: dict[int, list[tuple[Corner, Array]]] = {}
        for place, i in enumerate(group.sources):
            basis = self.dynamics.contacts[i].pair if i < len(self.dynamics.contacts) else None
            if basis is None:
                continue
            if id(basis) not in candidates:
                pair, given = self.pairs[basis], (self.model, self.data, record.q)
                candidates[id(basis)] = [
                    (corner, contact_matrices(*given, contact).velocity(record.v_before))
                    for corner, contact in closest_corners(*given, pair)
                ]
            velocity = np.asarray(group.problem.velocity)[place]
            residuals = [float(np.abs(own - velocity).max()) for _, own in candidates[id(basis)]]
            if residuals:
                found[i] = candidates[id(basis)].pop(int(np.argmin(residuals)))[0]
        return found

    def _of_contact(self, number: int, record: ImpactRecord, resting: bool, law: str | None) -> SingleJump:
        """Return the derivatives of the impact of a single contact.

        Args:
            number: Number of the contact.
            record: The impact.
            resting: Whether restitution was set to zero.
            law: Law that replaces that of the contact, or None.
        """
        contact, nv = self.dynamics.contacts[number], len(record.v_before)
        pair = None if contact.pair is None else self.pairs[contact.pair]
        now = self.model, self.data, record.q, record.v_before
        contact, lasting, swapped, met = contact_now(*now, contact, pair)
        rests = resting and contact.restitution != 0.0
        other: dict[str, Any] = {"restitution": 0.0} if resting else {}
        other |= {"law": law} if law is not None else {}
        if other:
            contact = replace(contact, **other)
            lasting = lasting and replace(lasting, **other)
        point, rest = (contact, lasting, swapped, met), (self.held, self.locked)
        d = derivatives_at_point(*now, point, *rest)
        matrices = contact_matrices(self.model, self.data, record.q, contact)
        by_state, guard = d.block[:nv, : 2 * nv].copy(), matrices.jacobian[2]
        (by_friction, by_restitution), after = d.block[:nv, 2 * nv + FRICTION :][:, :2].T, d.block[:nv, -1]
        by_restitution = np.zeros(nv) if rests else by_restitution
        flags = d.boundary | (Boundary.LAST_BOUNCE if rests else Boundary.NONE)
        if contact.friction > 0.0 and self._begins_to_slip(record, matrices):
            flags |= Boundary.START_AT_REST
            by_state[:] = np.nan
        by = {"friction": by_friction, "restitution": by_restitution}
        return SingleJump(record, number, by_state, by, guard, flags, after, d.kinks)

    def _begins_to_slip(self, record: ImpactRecord, matrices: ContactMatrices) -> bool:
        """Whether a contact slips throughout an impact, but its slip before is within the error of a step."""
        rows = matrices.jacobian[:2] / self.dynamics.work.joint_metres
        error = self.dynamics.error(record.v_before)
        slow = np.hypot(*matrices.velocity(record.v_before)[:2]) <= error * np.abs(rows).sum(axis=1).max()
        return bool(slow) and all(segment.mode == "slip" for segment in record.solution.segments)

    def _of_limit(self, k: int, record: ImpactRecord, resting: bool) -> SingleJump:
        """Return the derivatives of the impact P = −(1 + e) u/w of a limit that approaches at u, w = W₃₃."""
        limit, nv = self.dynamics.limits[k], len(record.v_before)
        e = 0.0 if resting else self._limit_restitution
        guard = np.zeros(nv)
        guard[limit.index_v] = limit.sign
        placed = PlacedRobot(self.model, self.data, record.q)
        matrices = matrices_of_all(placed, (), (limit,), self.held, self.free.astype(np.float64))
        slopes, y = ManySlopes(placed, (), matrices, self.held, self.free), matrices.response[:, 2]
        w, rate = float(matrices.delassus[2, 2]), float(guard @ record.v_before)
        impulse = -(1.0 + e) * rate / w
        of_q = slopes.change(np.array([0.0, 0.0, impulse]))
        of_q -= np.outer(y, impulse / w * slopes.delassus[:, 2, 2])
        of_v = np.eye(nv) - (1.0 + e) / w * np.outer(y, guard)
        after, number = record.v_before + impulse * y, len(self.dynamics.contacts) + k
        guard *= self.dynamics.work.joint_metres
        by_state = np.hstack([of_q, of_v])
        return SingleJump(record, number, by_state, {}, guard, Boundary.NONE, after, np.zeros((0, nv)))


class SingleJump(NamedTuple):
    """Derivatives of the velocity after an impact at one contact or limit.

    Attributes:
        record: The impact.
        number: Number of the contact or limit.
        by_state: (nv, 2nv) derivatives by the state, in the tangent space.
        by: (nv,) derivatives by "friction" and "restitution".
        approach: (nv,) ∂(gap)/∂q [m per unit].
        boundary: Flags of `Boundary`.
        v: (nv,) the velocity after the impact.
        kinks: (…, nv) rows that vanish for the δq along which the derivatives hold.
    """

    record: ImpactRecord
    number: int
    by_state: Array
    by: dict[str, Array]
    approach: Array
    boundary: Boundary
    v: Array
    kinks: Array

    @property
    def numbers(self) -> tuple[int, ...]:
        """The contacts and limits that take part."""
        return (self.number,)

    def guard(self, least: float) -> Array | None:
        """Return ∂(gap)/∂q (nv,) of the contact or limit that closes."""
        return self.approach

    def after(self, x: Array, parameters: Sequence[Parameter]) -> Passed | None:
        """Return changes x (2nv, m) after the impact; see `GroupJump.after`."""
        after, on = self.by_state @ x, [one for one in parameters if one.contact == self.number]
        by_q, flags = x[: self.kinks.shape[1]], self.boundary
        at_kink = np.abs(self.kinks @ by_q) > KINKED * (
            np.abs(self.kinks) @ np.abs(by_q) + np.abs(x).max(axis=0)
        )
        if at_kink.any():
            flags |= Boundary.START_AT_REST
            after[:, at_kink.any(axis=0)] = np.nan
        change = np.abs(self.record.v_after - self.record.v_before).max()
        if not np.abs(self.v - self.record.v_after).max() <= MISSED * change:
            return None
        for column, parameter in enumerate(parameters, x.shape[1] - len(parameters)):
            if parameter in on:
                after[:, column] += self.by[parameter.kind]
        return Passed(after, tuple(on), flags)


class GroupJump:
    """Derivatives of the velocity after an impact at several contacts and limits; see `ImpactJumps.of`.

    Raises:
        InputError: A contact of two collision shapes takes part whose corner is not known.
    """

    def __init__(
        self,
        scene: ImpactJumps,
        record: ImpactRecord,
        modes: Integers,
        corners: Mapping[int, Corner],
        error: float,
    ) -> None:
        assert record.group is not None
        group, dynamics = record.group[0], scene.dynamics
        self.record, self.numbers = record, group.sources
        self._group, self._sources = group, np.array(group.sources, dtype=np.int64)
        count = len(dynamics.contacts)
        placed = PlacedRobot(scene.model, scene.data, record.q)
        self._contacts, known = [], {}
        for place, i in enumerate(one for one in group.sources if one < count):
            contact = dynamics.contacts[i]
            if i in corners:
                known[place] = corners[i]
                contact = corners[i].contact(scene.data, contact)
            elif contact.pair is not None:
                raise InputError(
                    f"sensitivities: {contact.label!r}, a contact of two collision shapes, takes part in an "
                    f"impact at several contacts at t = {record.time:.6g} s; they are not available there"
                )
            self._contacts.append(contact)
        limits = [dynamics.limits[i - count] for i in group.sources if i >= count]
        mobility = scene.free.astype(np.float64)
        self._matrices = matrices_of_all(placed, self._contacts, limits, scene.held, mobility)
        given = placed, self._contacts, self._matrices, scene.held, scene.free, known
        self._slopes = ManySlopes(*given, on_surface=True)
        velocity, now = self._matrices.velocity(record.v_before), modes[self._sources]
        self._rates, self._closed = velocity[:, 2].copy(), now > 0
        self._still = np.column_stack([now > SLIP, now > SLIP, now > 0])
        self._still &= np.abs(velocity) <= error * np.abs(velocity).max()
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

    def guard(self, least: float) -> Array | None:
        """Return ∂(gap)/∂q (nv,) of the contact or limit that closes; None if several do, or none.

        Args:
            least: Contacts that were open are taken to close if their gap rate is at most this [m/s].
        """
        strikes = np.flatnonzero(~self._closed & (self._rates <= least))
        return self._matrices.jacobian[3 * strikes[0] + 2] if len(strikes) == 1 else None

    def after(self, x: Array, parameters: Sequence[Parameter]) -> Passed | None:
        """Return changes x (2nv, m) after the impact; the last columns are those of the parameters.

        None if solving the impact again does not give the recorded outcome: it is not unique nearby.
        """
        nv, record, inputs = len(x) // 2, self.record, self._inputs
        solution = find_policy(self._group.policy).run(inputs, False, **self._group.options)
        impulse, change = solution.impulse.ravel(), record.v_after - record.v_before
        response = self._matrices.response
        if not np.abs(response @ impulse - change).max() <= MISSED * np.abs(change).max():
            return None
        velocity = self._slopes.velocity(record.v_before) @ x[:nv] + self._matrices.jacobian @ x[nv:]
        velocity[self._still.ravel()] = 0.0
        known = np.isfinite(x).all(axis=0)
        basis, weights = _basis(velocity[:, known], x[:nv, known], np.abs(inputs.velocity).max())
        changes = [self._change(*np.split(column, [len(velocity)])) for column in basis.T]
        columns, first = [], x.shape[1] - len(parameters)
        for column, parameter in enumerate(parameters, first):
            places = np.flatnonzero(self._sources == parameter.contact).tolist()
            if places and (
                parameter.kind == "friction"  # not e that was set to zero
                or self._inputs.restitution[places[0]] == self._contacts[places[0]].restitution
            ):
                changes.append(coefficient_change(len(self._sources), **{parameter.kind: places[0]}))
                columns.append(column)
        found = slopes_along(inputs, self._group.policy, solution, changes, options=self._group.options)
        after = np.full((nv, x.shape[1]), np.nan)
        after[:, known] = x[nv:, known] + self._slopes.change(impulse) @ x[:nv, known]
        after[:, known] += response @ found.impulse[:, : len(weights)] @ weights
        after[:, columns] += response @ found.impulse[:, len(weights) :]
        return Passed(after, tuple(parameters[k - first] for k in columns), found.boundary)

    def _change(self, velocity: Array, of_q: Array) -> Change:
        """Return the change of the impact's data for changes of the velocities (3n,) and of q (nv,)."""
        inputs, k = self._inputs, len(self._contacts)
        delassus = np.tensordot(of_q, self._slopes.delassus, 1)
        velocity = velocity.reshape(-1, 3).copy()
        velocity[self._still] = 0.0
        restitution, stiffness = np.zeros(len(velocity)), np.zeros(len(velocity))
        for i, contact in enumerate(self._contacts):
            if inputs.restitution[i] > 0.0:
                bend = slope_of_restitution(contact, max(-float(inputs.velocity[i, 2]), 0.0))
                restitution[i] = -bend * velocity[i, 2]
        if k < len(velocity):  # κ w of a limit is the mean of that of the contacts, or constant without any
            w, dw = inputs.delassus.diagonal()[2::3], delassus.diagonal()[2::3]
            moved = float(np.mean(inputs.stiffness[:k] * dw[:k])) if k > 0 else 0.0
            stiffness[k:] = (moved - inputs.stiffness[k:] * dw[k:]) / w[k:]
        return Change(velocity, delassus, np.zeros(len(velocity)), restitution, stiffness)


def _basis(velocity: Array, of_q: Array, speed: float) -> tuple[Array, Array]:
    """Return a basis (3n + nv, r) of the changes of velocities (3n, m) and q (nv, m), and weights (r, m)."""
    size = speed or 1.0
    left, values, right = np.linalg.svd(np.vstack([velocity / size, of_q]), full_matrices=False)
    kept = values > ROUNDING * values.max(initial=0.0)
    basis = left[:, kept]
    basis[: len(velocity)] *= size
    return basis, values[kept, None] * right[kept]
