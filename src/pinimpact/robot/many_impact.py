"""Impacts of robots at many contacts at one instant."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ..arrays import Array
from ..checks import finite_array
from ..contact_space.many_solution import ManySolution
from ..contact_space.problem import ImpactProblem
from ..contact_space.simultaneous import compile_policy
from ..contact_space.solve import solve_impact
from ..display import html_table, in_a_line
from ..errors import InputError
from ._kernels import contact_kinematics
from ._kernels.responses import half_solve, respond
from .contact import Contact, Contacts, check_contact, check_held
from .held import check_at_rest, warn_of_pulls
from .joint_reactions import held_of_impact, joint_reactions
from .matrices import ManyMatrices, many_matrices
from .names import Stiffening
from .placed_robot import PlacedRobot
from .touching import check_rims


class ImpactOptions(NamedTuple):
    """The options of `impact`; `more` are those of the method or policy."""

    held: Sequence[Contact]
    locked: Sequence[str | int]
    method: str
    record: bool
    simultaneous: str
    stiffening: Stiffening
    more: dict[str, Any]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ManyHit:
    """The result of an impact of a robot at n contacts.

    Attributes:
        v: (nv,) post-impact generalized velocity.
        impulses_world: (n, 3) impulses on the robot at the contacts, in world axes [N s].
        contacts: The n contacts.
        points: (n, 3) contact points, in world axes [m].
        axes: (n, 3, 3) contact axes t₁, t₂, n as rows, in world axes.
        problem: The contact-space problem that was solved.
        solution: Its solution, in contact axes.
        held_impulses: (k, 3) impulse on the robot at each held contact, in world axes [N s].
    """

    v: Array
    impulses_world: Array
    contacts: tuple[Contact, ...]
    points: Array
    axes: Array
    problem: ImpactProblem
    solution: ManySolution
    held_impulses: Array

    def joint_reactions(
        self, model: pin.Model, data: pin.Data, q: ArrayLike, v: ArrayLike, held: Sequence[Contact] = ()
    ) -> Array:
        """Return the impulsive wrench through each joint, (joints, 6); see `Hit.joint_reactions`."""
        placed = PlacedRobot(model, data, q)
        contacts = (*self.contacts, *held_of_impact(held, len(self.held_impulses)))
        change = self.v - finite_array("v", v, self.v.shape)
        pushes = np.vstack([self.impulses_world, self.held_impulses])
        return joint_reactions(placed, change, contacts, pushes)

    def _repr_html_(self) -> str:
        names = [contact.label for contact in self.contacts]
        rows = [(name, *row) for name, row in zip(names, self.impulses_world.tolist(), strict=True)]
        title = "Impulses on the robot, world axes [N s]"
        return html_table(title, ("", "x", "y", "z"), rows) + self.solution.as_html(names)

    def __repr__(self) -> str:
        return (
            f"ManyHit(v={in_a_line(self.v)}, impulses_world={in_a_line(self.impulses_world)}, "
            f"status={self.solution.status.name})"
        )


def impact_at_many(
    model: pin.Model, data: pin.Data, q: ArrayLike, v: ArrayLike, contacts: Contacts, asked: ImpactOptions
) -> ManyHit:
    """Compute the impact of a robot at n contacts; see `impact`."""
    held = check_many(contacts, asked.held)
    placed = PlacedRobot(model, data, q)
    check_rims(placed, contacts)
    policy = asked.simultaneous
    compile_policy(policy, contact_kinematics.jacobian, contact_kinematics.locate, half_solve, respond)
    matrices = many_matrices(model, data, q, contacts, held, asked.locked, asked.stiffening)
    v = finite_array("v", v, (matrices.jacobian.shape[1],))
    placed.cache.check_limits(placed.q, stacklevel=6)
    check_at_rest(matrices.held, held, v, matrices.velocity_scale(v))
    velocity = matrices.velocity(v)
    problem = many_problem(contacts, matrices, velocity)
    solution = solve_impact(problem, record=asked.record, simultaneous=policy, **asked.more)
    impulse = solution.impulse.ravel()
    held_impulses = matrices.held_response @ impulse
    warn_of_pulls(matrices.held, held, held_impulses, impulse)
    return ManyHit(
        v + matrices.response @ impulse,
        np.einsum("ni,nij->nj", solution.impulse, matrices.axes),
        tuple(contacts),
        np.array([placed.locate(contact)[2] for contact in contacts]),
        matrices.axes,
        problem,
        solution,
        held_impulses,
    )


def check_many(contacts: Sequence[Contact], held: Sequence[Contact]) -> tuple[Contact, ...]:
    """Raise `InputError` unless `contacts` are contacts of single points; return the held contacts."""
    if not contacts:
        raise InputError("contact: no contact given, at least one expected", value=contacts)
    for contact in contacts:
        check_contact("contact", contact)
    return check_held(held)


def many_problem(contacts: Sequence[Contact], matrices: ManyMatrices, velocity: Array) -> ImpactProblem:
    """Return the problem of n contacts that approach with a velocity (n, 3)."""
    laws = {contact.law for contact in contacts}
    approach = np.maximum(-velocity[:, 2], 0.0).tolist()
    return ImpactProblem(
        matrices.delassus,
        velocity,
        np.array([contact.friction for contact in contacts]),
        np.array([c.restitution_at(speed) for c, speed in zip(contacts, approach, strict=True)]),
        laws.pop() if len(laws) == 1 else "energetic",
        matrices.surface_velocity,
        stiffness=np.array([contact.stiffness for contact in contacts]),
    )
