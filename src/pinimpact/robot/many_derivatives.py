"""Derivatives of the impact of a robot at many contacts. (docs/derivatives.md, 11)"""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ..arrays import Array, Bools
from ..checks import finite_array
from ..contact_space.derivatives import Boundary
from ..contact_space.many_derivatives import Change, Slopes, coefficient_changes, slopes_along
from ..contact_space.many_inputs import many_inputs
from ..contact_space.simultaneous import compile_policy, find_policy
from ..geometry._kernels.constants import TIP_PLANE
from ._kernels import configuration_slopes as places
from ._kernels.row_slopes import Rows
from .contact import Contact
from .corner_motion import Corner
from .derivatives import Place, Tree, contact_place, responses, slope_of_restitution
from .held import check_at_rest
from .many_impact import check_many, many_problem
from .matrices import ManyMatrices, checked_matrices
from .names import free_velocities, model_of
from .placed_robot import PlacedRobot
from .touching import check_rims


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ManyImpactDerivatives:
    """Derivatives of q̇⁺ and of the impulses P of an impact at n contacts; by q in the tangent space.

    Columns without derivative are NaN, see `boundary`.

    Attributes:
        v: (nv,) q̇⁺.
        dv_dq, dv_dv: (nv, nv) ∂q̇⁺/∂q and ∂q̇⁺/∂q̇.
        dv_dfriction, dv_drestitution: (nv, n) ∂q̇⁺/∂μ and ∂q̇⁺/∂e of each contact.
        dP_dq, dP_dv: (n, 3, nv) ∂P/∂q and ∂P/∂q̇, of the impulses in world axes.
        dP_dfriction, dP_drestitution: (n, 3, n) ∂P/∂μ and ∂P/∂e.
        boundary: Flags of `Boundary`.
    """

    v: Array
    dv_dq: Array
    dv_dv: Array
    dv_dfriction: Array
    dv_drestitution: Array
    dP_dq: Array
    dP_dv: Array
    dP_dfriction: Array
    dP_drestitution: Array
    boundary: Boundary

    def __repr__(self) -> str:
        count = self.dv_dfriction.shape[1]
        return f"ManyImpactDerivatives(nv={len(self.v)}, contacts={count}, boundary={self.boundary!r})"


class ContactRow(NamedTuple):
    """The three rows of a contact Jacobian, and their derivatives by q."""

    tree: Tree
    place: Place

    @property
    def axes(self) -> Array:
        """(3, 3) t₁, t₂, n as rows."""
        return self.place.at[places.AXES : places.AXES + 9].reshape(3, 3)

    @property
    def turns(self) -> Array:
        """(3, nv) rotation of the axes per unit of each q_k, in world axes."""
        return self.place.shifts[:, places.TURN : places.TURN + 3].T

    def slopes(self, motions: Array, relative: bool = False) -> Array:
        """Return ∂(J x)/∂q (3, nv) for the motions (joints, 6) of x, see `velocity_slopes`. (D19)"""
        tip, base, at, shifts = self.place
        out = np.empty((3, len(self.tree.joint)))
        places.velocity_slopes(*self.tree, tip, base, at, shifts, motions, relative, out)
        return out

    def add_forces(self, force: Array, out: Array) -> None:
        """Add ∂(JᵀP)/∂q (nv, nv) for a force (3,) in world axes. (D20)"""
        f1, f2, f3 = force.tolist()
        places.force_slopes(*self.tree, self.place.at, self.place.shifts, f1, f2, f3, out)

    def turned(self, force: Array) -> Array:
        """Return the derivative by q (3, nv) of a vector (3,) that is fixed in the contact axes."""
        return np.asarray(-pin.skew(force) @ self.turns)


class RowSlopes:
    """Derivatives of the rows of contacts of a robot, and of its mass matrix, by the configuration.

    Args:
        placed: The robot at a configuration.
        contacts: The contacts.
        corners: Corners of patches of two shapes, by the index of their contact.
        spare: A Data of the model as scratch; None to create one.
        on_surface: See `contact_kinematics.jacobian`.
        idle: Contacts without force, for which the motion of corners over faces is not needed.

    Attributes:
        tree: The `Tree` of the robot.
        axes: (3, 3) axes of each contact.
        rows: `ContactRow` of each contact.
        carried: Contacts with points and faces fixed to the shapes; those of corners are of their features.
        fixed: `ContactRow` of each of `carried`.
        signs: (n,) −1 for contacts of `carried` whose tip is on the second shape, else 1.
        slides: (n, nv) changes of the gaps in addition to those by the Jacobian, see `Corner.follow`.
        features_meet: Whether a corner is a vertex of one shape on an edge of the other.

    Raises:
        InputError: The motion of a corner is not known.
    """

    def __init__(
        self,
        placed: PlacedRobot,
        contacts: Sequence[Contact],
        corners: Mapping[int, Corner] | None = None,
        spare: pin.Data | None = None,
        on_surface: bool = False,
        idle: Container[int] = (),
    ) -> None:
        model, corners = placed.model, corners or {}
        self._placed, self.tree = placed, Tree.of(placed)
        self._data = model.createData() if spare is None else spare
        self._still = pin.computeGeneralizedGravityDerivatives(model, self._data, placed.q).copy()
        self.carried, now = list(contacts), list(contacts)
        self.signs, self.features_meet = np.ones(len(now)), False
        for k, corner in corners.items():
            self.carried[k] = now[k] = corner.carried(placed.data, contacts[k])
            if corner.on_face:
                now[k] = corner.contact(placed.data, contacts[k])
            if corner.kind == TIP_PLANE:
                self.signs[k] = -1.0
        self.rows = rows_of(placed, self.tree, now, True)
        self.axes, self.fixed = [row.axes for row in self.rows], list(self.rows)
        self.slides = np.zeros((len(now), len(self._still)))
        for k, corner in corners.items():
            if corner.on_face and k not in idle:
                place = self.rows[k].place
                (self.fixed[k],) = rows_of(placed, self.tree, [self.carried[k]], True)
                self.slides[k], meet = corner.follow(placed.data, self.tree.J, place.shifts)
                self.features_meet |= meet
        if on_surface:
            for row, contact in zip(self.rows, now, strict=True):
                row.place.move_onto_surface(placed.geometry(contact))

    def of_mass(self, x: Array) -> Array:
        """Return D(x) = ∂(M x)/∂q (nv, nv)."""
        model, data, q = self._placed.model, self._data, self._placed.q
        return np.asarray(pin.computeRNEADerivatives(model, data, q, np.zeros(len(x)), x)[0] - self._still)

    def forces(self, impulses: Array) -> Array:
        """Return ∂(JᵀP)/∂q (nv, nv) for impulses (k, 3) that are fixed in the axes of the contacts."""
        out = np.zeros((len(self._still), len(self._still)))
        for row, axes, impulse in zip(self.rows, self.axes, impulses, strict=True):
            row.add_forces(axes.T @ impulse, out)
        return out


def stacked(tree: Tree, rows: Sequence[ContactRow]) -> Rows:
    """Return the places of contacts as arrays."""
    places_of = [row.place for row in rows]
    tips = np.array([one.tip for one in places_of], dtype=np.int64)
    bases = np.array([one.base for one in places_of], dtype=np.int64)
    at = np.array([one.at for one in places_of]).reshape(-1, places.PLACE)
    shifts = np.array([one.shifts for one in places_of]).reshape(-1, len(tree.joint), places.SHIFT)
    return Rows(*tree, tips, bases, at, shifts)


def rows_of(placed: PlacedRobot, tree: Tree, contacts: Sequence[Contact], turns: bool) -> list[ContactRow]:
    """Return the rows of contacts, in contact axes if `turns`, else in world axes."""
    return [ContactRow(tree, contact_place(placed, tree, one, turns, len(tree.joint))) for one in contacts]


class ManySlopes:
    """Derivatives by q of the data of an impact at n contacts and joint stops. (D17), (D21)

    Stops come last in the matrices; `free` (nv,) are velocities that are not locked; `corners` and
    `on_surface` as for `RowSlopes`. `delassus` (nv, 3n, 3n) is ∂W/∂q.
    """

    def __init__(
        self,
        placed: PlacedRobot,
        contacts: Sequence[Contact],
        matrices: ManyMatrices,
        held: Sequence[Contact],
        free: Bools,
        corners: Mapping[int, Corner] | None = None,
        on_surface: bool = False,
    ) -> None:
        self.matrices, self._free, self._placed = matrices, free, placed
        self._robot = robot = RowSlopes(placed, contacts, corners, None, on_surface)
        self._held = rows_of(placed, robot.tree, held, False)
        nv, m = matrices.response.shape
        moved, self._moved_held = np.zeros((m, m, nv)), np.zeros((m, 3 * len(held), nv))
        for i, y in enumerate(matrices.response.T):
            motions = robot.tree.motions(y)
            for k, row in enumerate(robot.rows):
                moved[i, 3 * k : 3 * k + 3] = row.slopes(motions)
            for k, row in enumerate(self._held):
                self._moved_held[i, 3 * k : 3 * k + 3] = row.slopes(motions)
        self._of_mass = np.array([robot.of_mass(y) for y in matrices.response.T])
        pushes = matrices.held_response.reshape(-1, m)
        moved += np.einsum("hj,ihk->ijk", pushes, self._moved_held)
        moved += moved.transpose(1, 0, 2)
        moved -= np.einsum("mi,jmk->ijk", matrices.response, self._of_mass)
        self.delassus = np.ascontiguousarray(moved.transpose(2, 0, 1))

    def velocity(self, v: Array) -> Array:
        """Return ∂v°/∂q (3n, nv) at q̇ = v."""
        out, motions = np.zeros((self.matrices.response.shape[1], len(v))), self._robot.tree.motions(v)
        for k, row in enumerate(self._robot.rows):
            out[3 * k : 3 * k + 3] = row.slopes(motions, True)
        return out

    def change(self, impulse: Array) -> Array:
        """Return ∂q̇⁺/∂q (nv, nv) for constant impulses (3n,) in contact axes."""
        matrices = self.matrices
        forces = self._robot.forces(impulse.reshape(-1, 3)[: len(self._robot.rows)])
        forces -= np.tensordot(impulse, self._of_mass, 1)
        for row, push in zip(self._held, matrices.held_response @ impulse, strict=True):
            row.add_forces(push, forces)
        sliding = np.tensordot(impulse, self._moved_held, 1)
        return responses(self._placed, matrices.held, self._free, forces, sliding)

    def turned(self, impulse: Array) -> Array:
        """Return the derivative by q (n, 3, nv), in world axes, of impulses (3n,) fixed in contact axes."""
        given = zip(self._robot.rows, self._robot.axes, impulse.reshape(-1, 3), strict=False)
        return np.array([row.turned(axes.T @ one) for row, axes, one in given])


def derivatives_at_many(
    robot: pin.Model,
    data: pin.Data,
    q: ArrayLike,
    v: ArrayLike,
    contacts: Sequence[Contact],
    held: Sequence[Contact],
    locked: Sequence[str | int],
    simultaneous: str,
    side: int | None,
) -> ManyImpactDerivatives:
    """Differentiate the impact of a robot at n contacts; see `impact_derivatives`."""
    held = check_many(contacts, held)
    placed, free = PlacedRobot(robot, data, q), free_velocities(model_of(robot), locked)
    check_rims(placed, (*contacts, *held))
    anchors, mobility = tuple(map(placed.geometry, held)), free.astype(np.float64)
    matrices = checked_matrices(placed, contacts, anchors, mobility, np.zeros((0, len(free))))
    v = finite_array("v", v, (len(free),))
    check_at_rest(matrices.held, held, v, matrices.velocity_scale(v))
    velocity = matrices.velocity(v)
    approach = np.maximum(-velocity[:, 2], 0.0).tolist()
    bends = np.array([slope_of_restitution(c, speed) for c, speed in zip(contacts, approach, strict=True)])
    compile_policy(simultaneous)
    inputs = many_inputs(many_problem(contacts, matrices, velocity))
    solution = find_policy(simultaneous).run(inputs, False)
    of_matrices = ManySlopes(placed, contacts, matrices, held, free)
    changes = state_changes(of_matrices.velocity(v), of_matrices.delassus, bends)
    nv, n = matrices.response.shape[0], len(contacts)
    changes += state_changes(matrices.jacobian, np.zeros((nv, 3 * n, 3 * n)), bends)
    changes += coefficient_changes(n)
    found = slopes_along(inputs, simultaneous, solution, changes, side)
    return _assembled(of_matrices, v, solution.impulse.ravel(), found)


def _assembled(of_matrices: ManySlopes, v: Array, impulse: Array, found: Slopes) -> ManyImpactDerivatives:
    """Return the derivatives by q, q̇, μ and e, from those in contact space. (D17)"""
    matrices, nv, n = of_matrices.matrices, len(v), len(impulse) // 3
    split = nv, 2 * nv, 2 * nv + n
    by_q, by_v, by_friction, by_restitution = np.split(matrices.response @ found.impulse, split, axis=1)
    slopes = np.where(found.shared, found.impulse, np.nan).reshape(n, 3, -1)
    of_q, *others = np.split(np.einsum("nij,nik->njk", matrices.axes, slopes), split, axis=2)
    by_q, by_v = by_q + of_matrices.change(impulse), by_v + np.eye(nv)
    of_q, of_v, of_friction, of_restitution = of_q + of_matrices.turned(impulse), *others
    return ManyImpactDerivatives(
        *(v + matrices.response @ impulse, by_q, by_v, by_friction, by_restitution),
        *(of_q, of_v, of_friction, of_restitution),
        found.boundary,
    )


def state_changes(velocity: Array, delassus: Array, bends: Array) -> list[Change]:
    """Return m changes of the data of an impact, from those of velocities (3n, m) and of W (m, 3n, 3n).

    `bends` (n,) are de/d(approach speed) of the contacts.
    """
    zero = np.zeros(len(bends))
    return [
        Change(column.reshape(-1, 3), matrix, zero, -bends * column[2::3], zero)
        for column, matrix in zip(velocity.T, delassus, strict=True)
    ]
