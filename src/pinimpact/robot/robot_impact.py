"""Impacts of robots: from (q, v) and a contact to post-impact velocity and impulse."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from typing import Any, overload

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ..arrays import Array
from ..checks import finite_array, float_array, real_numbers
from ..contact_space.inputs import FACTOR, NO_FACTOR, triangle_of
from ..contact_space.methods import METHODS
from ..contact_space.one_contact import solve_inputs
from ..contact_space.problem import ImpactProblem, contact_inputs
from ..contact_space.solution import Inputs, Solution
from ..contact_space.solve import solve_impact
from ..display import html_table, in_a_line
from ..errors import UnknownNameError
from ..status import Status
from ._kernels import robot_impact as kernel
from .contact import Contact, Contacts, check_contact, check_held, is_pair
from .data_cache import DataCache, _caches, data_cache, not_normalized
from .held import held_at_rest, warn_of_pulls
from .joint_reactions import held_of_impact, joint_reactions
from .many_impact import ImpactOptions, ManyHit, impact_at_many
from .matrices import contact_geometry, contact_matrices
from .names import Stiffening, is_stiff, model_of, singular_mass
from .placed_robot import PlacedRobot
from .shape_pair import touching_points
from .struck import strike
from .touching import check_rims, touching_tips

LOCKED = int(Status.LOCKED)
"""The last status with a solution."""

_FLOAT = np.dtype(np.float64)
# bound once: an impact takes microseconds, so lookups of module attributes matter
_Model = pin.Model
_Array = np.ndarray
_empty = np.empty
_robot_impact = kernel.robot_impact
SIZE = kernel.SIZE
_NONE_HELD = np.zeros((0, 3))
_NONE_HELD.setflags(write=False)


def _factor(numbers: Array) -> tuple[Array | None, float | None]:
    """Return a factor of W and its scale for an `ImpactProblem`."""
    if not numbers.any():
        return None, None
    return triangle_of(numbers), float(numbers[-1])


@dataclass(slots=True, eq=False, repr=False)
class Hit:
    """The result of an impact of a robot.

    Attributes:
        held_impulses: (k, 3) impulse on the robot at each held contact, in world axes [N s].
    """

    _numbers: Array
    _ended: tuple[int, ...]
    _contact: Contact
    _restitution: float
    _solution: Solution | None = None
    held_impulses: Array = field(default_factory=lambda: _NONE_HELD)

    @property
    def v(self) -> Array:
        """(nv,) post-impact generalized velocity."""
        return self._numbers[:-SIZE]

    @property
    def impulse_world(self) -> Array:
        """(3,) impulse on the robot at the contact, in world axes [N s]."""
        return self._part(kernel.AFTER + 3, 3) @ self.axes

    @property
    def axes(self) -> Array:
        """(3, 3) contact axes t₁, t₂, n as rows, in world axes."""
        return self._part(kernel.AXES, 9).reshape(3, 3)

    @property
    def contact(self) -> Contact:
        """The contact that collided."""
        return self._contact

    @property
    def problem(self) -> ImpactProblem:
        """The contact-space problem that was solved."""
        w11, w12, w13, w22, w23, w33, *velocity = self._part(kernel.DELASSUS, 9).tolist()
        return ImpactProblem(
            np.array([[w11, w12, w13], [w12, w22, w23], [w13, w23, w33]]),
            np.array(velocity),
            self._contact.friction,
            self._restitution,
            self._contact.law,
            self._part(kernel.SURFACE, 3).copy(),
            float(self._part(kernel.SCALE, 1)[0]),
            None,
            *_factor(self._part(kernel.SINGULAR, FACTOR)),
        )

    @property
    def solution(self) -> Solution:
        """The solution in contact axes: velocity, impulse, segments, work, status, flags."""
        if self._solution is None:
            inputs = self._inputs()
            numbers = (*self._ended[:3], *self._part(kernel.AFTER, 7).tolist())
            surface = self._part(kernel.SURFACE, 3)
            self._solution = Solution(numbers, inputs, surface_velocity=surface)
        return self._solution

    def joint_reactions(
        self, model: pin.Model, data: pin.Data, q: ArrayLike, v: ArrayLike, held: Sequence[Contact] = ()
    ) -> Array:
        """Return the impulsive wrench through each joint, (joints, 6) force [N s] over moment [N m s].

        Row i is the wrench that the link before joint i exerts on the link after it, at the joint and in its
        axes. Row 0 is the wrench that the robot exerts on the world other than at contacts, at the origin
        and in world axes. About or along the axis of a joint the wrench is zero, except for the impulse that
        accelerates a rotor and the impulse −k Δq̇ of the control that stiffens the joint (1.6).

        Args:
            model: That of the impact.
            data: Its data.
            q: (nq,) the configuration.
            v: (nv,) the velocity before it.
            held: The held contacts of the impact.
        """
        placed = PlacedRobot(model, data, q)
        contacts = (self._contact, *held_of_impact(held, len(self.held_impulses)))
        change = self.v - finite_array("v", v, self.v.shape)
        pushes = np.vstack([self.impulse_world, self.held_impulses])
        return joint_reactions(placed, change, contacts, pushes)

    def _repr_html_(self) -> str:
        title = f"{self._contact.label}: impulse on the robot, world axes [N s]"
        table = html_table(title, ("x", "y", "z"), [self.impulse_world.tolist()])
        return table + self.solution._repr_html_()

    def __repr__(self) -> str:
        return (
            f"Hit(v={in_a_line(self.v)}, impulse_world={in_a_line(self.impulse_world)}, "
            f"status={self.solution.status.name})"
        )

    def _inputs(self) -> Inputs:
        w11, w12, w13, w22, w23, w33, v1, v2, v3 = self._part(kernel.DELASSUS, 9).tolist()
        contact = self._contact
        return (
            *(w11, w12, w13, w22, w23, w33, v1, v2, v3),
            contact.friction,
            self._restitution,
            contact.law_code,
            float(self._part(kernel.SCALE, 1)[0]),
            numbers if (numbers := self._part(kernel.SINGULAR, FACTOR)).any() else NO_FACTOR,
        )

    def _part(self, start: int, count: int) -> Array:
        start += len(self._numbers) - SIZE
        return self._numbers[start : start + count]


@overload
def impact(
    model: pin.Model, data: pin.Data, q: ArrayLike, v: ArrayLike, contact: Contact, *rest: Any, **more: Any
) -> Hit: ...
@overload
def impact(
    model: pin.Model, data: pin.Data, q: ArrayLike, v: ArrayLike, contact: Contacts, *rest: Any, **more: Any
) -> ManyHit: ...
def impact(
    model: pin.Model,
    data: pin.Data,
    q: ArrayLike,
    v: ArrayLike,
    contact: Contact | Sequence[Contact],
    held: Sequence[Contact] = (),
    locked: Sequence[str | int] = (),
    method: str = "exact",
    record: bool = False,
    simultaneous: str = "propagate",
    stiffening: Stiffening = None,
    **options: Any,
) -> Hit | ManyHit:
    """Compute the impact of a robot at a contact, or at several at one instant: M Δq̇ = Jᵀ P.

    The contacts are taken as closed, whatever their gaps. If none approaches, the velocity does not change
    and ``hit.solution.status`` is NO_IMPACT. Closed contacts at rest belong in the list: they take part.

    Args:
        model: Pinocchio model, or a RobotWrapper.
        data: Its data; `contact_matrices` lists the fields that may change.
        q: (nq,) configuration.
        v: (nv,) pre-impact velocity.
        contact: The contact that collides, or a list of those that are closed at this instant. For a
            collision shape the tips with the smallest gap take part, for two shapes their closest points;
            then `model` is the RobotWrapper.
        held: Contacts that are bilateral constraints during the impact; see `contact_matrices`. Each must be
            at rest on its surface. One that pulls gives a `HeldContactWarning`.
        locked: Joints, by name or id, whose velocity the impact does not change.
        method: Method of `solve_impact`, for one contact.
        record: Whether to record ``hit.solution.path``.
        simultaneous: Policy of `solve_impact`, for a list of contacts.
        stiffening: How much control stiffens joints during the impact, from 0 (free) to 1 (locked): a number
            for all joints with one velocity, or one for each joint by name. (1.6)
        **options: Options of the method or policy.

    Returns:
        A `Hit`; a `ManyHit` for a list of contacts, also of one, and if several tips of a shape touch.

    Raises:
        InputError: An invalid q, v or stiffening; a held contact that moves; a rim that lies flat.
        UnknownNameError: A frame or joint that the model does not have; an unknown method.
        ModelError: The mass matrix is not positive definite.
        UnstoppableApproachError: No normal impulse can stop the approach.
        LawError: The mechanism cannot satisfy the restitution law.

    Warns:
        JointLimitWarning: The q is outside the joint limits, perhaps in degrees; given once for each Data.
    """
    robot, model = model, model if type(model) is _Model else model_of(model)
    cache = _caches.get(id(data))
    if cache is None or cache.model() is not model:
        cache = data_cache(model, data)
    stiff = stiffening is not None and is_stiff(stiffening)
    general = stiff or method != "exact" or held or locked or record or options
    if type(contact) is not Contact or contact.geometry is not None or contact.rim > 0.0 or general:
        asked = ImpactOptions(held, locked, method, record, simultaneous, stiffening, options)
        return _general_impact(robot, model, data, q, v, contact, asked)
    # fast path for arguments that `float_array` would return unchanged
    usual = type(q) is _Array and q.dtype == _FLOAT and q.shape == cache.q_shape and q.flags.carray
    q_now: Array = q if usual else float_array("q", q, cache.q_shape)  # type: ignore[assignment]
    usual = type(v) is _Array and v.dtype == _FLOAT and v.shape == cache.v_shape and v.flags.carray
    v_now: Array = v if usual else float_array("v", v, cache.v_shape)  # type: ignore[assignment]
    restitution = contact.restitution
    if callable(restitution):
        restitution = restitution_of_approach(model, data, q_now, v_now, contact)
    numbers = _empty(cache.nv + SIZE)
    struck = cache.workspaces.get(id(contact))
    if struck is None or model.nframes != cache.frames_seen or model.njoints != cache.njoints:
        struck = strike(cache, model, data, contact)
    if struck[1] is not None:
        ended = _robot_impact(struck[1], q_now, v_now, restitution, numbers)
    else:
        placed = PlacedRobot(model, data, q_now)
        ended = impact_by_pinocchio(placed, v_now, contact, contact.friction, restitution, numbers)
    hit = Hit(numbers, ended, contact, restitution)
    if not 0 <= ended[0] <= LOCKED or ended[3]:
        _refuse_or_warn(ended, cache, q_now, v_now, hit)
    return hit


def _refuse_or_warn(ended: tuple[int, ...], cache: DataCache, q: Array, v: Array, hit: Hit) -> None:
    """Raise the error of an impact without solution, or warn of a q outside the joint limits."""
    if 0 <= ended[0] <= LOCKED:
        cache.warn_of_limits(q, stacklevel=5)
        return
    if ended[0] == kernel.SINGULAR_MASS:
        raise singular_mass(cache.model(), ended[1])
    finite_array("q", q, cache.q_shape)
    finite_array("v", v, cache.v_shape)
    if ended[0] == kernel.NOT_NORMALIZED:
        raise not_normalized(q)
    solve_inputs(hit._inputs())


ARGUMENTS = "held", "locked", "method", "record", "simultaneous", "stiffening"
"""Arguments of `impact` that misspelt options are compared with."""


def _check_options(asked: ImpactOptions) -> None:
    """Raise `UnknownNameError` for arguments of `Contact`, and for misspelt ones of `impact`."""
    method = METHODS.get(asked.method)
    for name, value in asked.more.items():
        if method is not None and name in method.options:
            continue
        if name in ("friction", "restitution", "law", "stiffness"):
            raise UnknownNameError(f"{name}: unknown option; it is an argument of Contact", value=value)
        if close := get_close_matches(name, ARGUMENTS, n=1, cutoff=0.7):
            raise UnknownNameError(f"{name}: unknown option; did you mean {close[0]!r}?", value=value)


def _general_impact(
    robot: Any,
    model: pin.Model,
    data: pin.Data,
    q: ArrayLike,
    v: ArrayLike,
    contact: Any,
    asked: ImpactOptions,
) -> Hit | ManyHit:
    """Compute the impact at several contacts, of a collision shape, or with options that the kernel lacks."""
    _check_options(asked)
    if isinstance(contact, Sequence) and not isinstance(contact, str):
        points = [point for one in contact for point in _points(robot, data, q, v, one)]
        return impact_at_many(model, data, q, v, points, asked)
    if not isinstance(contact, Contact):
        check_contact("contact", contact)
    if contact.geometry is None:
        if contact.rim > 0.0:
            check_rims(PlacedRobot(model, data, q), (contact,))
        held_at_rest(model, data, q, v, contact, asked.held)
        return impact_in_steps(model, data, q, v, contact, asked)
    tips = _points(robot, data, q, v, contact)
    data_cache(model, data).check_limits(real_numbers("q", q), stacklevel=5)
    one_or_many: Any = tips[0] if len(tips) == 1 else tips
    return impact(robot, data, q, v, one_or_many, *asked[:-1], **asked.more)


def _points(robot: Any, data: pin.Data, q: ArrayLike, v: ArrayLike, contact: Any) -> list[Contact]:
    """Return the contacts of single points of a collision shape; any other contact unchanged."""
    if not isinstance(contact, Contact) or contact.geometry is None:
        return [contact]
    if is_pair(robot, contact):
        return touching_points(robot, data, q, v, contact)
    return touching_tips(robot, data, q, contact)


def impact_by_pinocchio(
    placed: PlacedRobot, v: Array, contact: Contact, mu: float, e: float, numbers: Array
) -> tuple[int, ...]:
    """Compute the impact by calls of Pinocchio, for joints that the kernels do not support."""
    mass, cache, model = placed.mass_matrix(), placed.cache, placed.model
    frame, carrier = (matrix[:3].T.ravel() for matrix in placed.placements(contact))
    columns, signs = placed.columns(contact)
    room = _empty(kernel.room_to_resolve(model.nv))
    ended: tuple[int, ...] = kernel.resolve(
        *(mass, cache.parents, frame, carrier, columns, signs, contact.constants, cache.bounds),
        *(placed.q, v, mu, e, contact.law_code, room, numbers),
    )
    return ended


def restitution_of_approach(model: pin.Model, data: pin.Data, q: Array, v: Array, contact: Contact) -> float:
    """Return e for the approach speed of the contact; 0 if v is not finite."""
    speed = -float(contact_geometry(model, data, q, contact).velocity(v)[2])
    return contact.restitution_at(max(speed, 0.0)) if speed < math.inf else 0.0


def impact_in_steps(
    model: pin.Model,
    data: pin.Data,
    q: ArrayLike,
    v: ArrayLike,
    contact: Contact,
    asked: ImpactOptions,
) -> Hit:
    """Compute the impact by `contact_matrices` and `solve_impact`, where the kernel does not apply.

    The impact does not change a small velocity of held contacts, from constraint drift.
    """
    held = check_held(asked.held)
    matrices = contact_matrices(model, data, q, contact, held, asked.locked, asked.stiffening)
    nv = len(matrices.h)
    v = finite_array("v", v, (nv,))
    data_cache(model, data).check_limits(real_numbers("q", q), stacklevel=6)
    velocity = matrices.velocity(v)
    restitution = contact.restitution_at(max(-float(velocity[2]), 0.0))
    scale = matrices.velocity_scale(v)
    problem = ImpactProblem(
        *(matrices.delassus, velocity, contact.friction, restitution, contact.law, matrices.surface_velocity),
        velocity_scale=scale,
        factor=matrices.factor,
        factor_scale=matrices.factor_scale,
    )
    solution = solve_impact(problem, method=asked.method, record=asked.record, **asked.more)
    held_impulses = matrices.held_response @ solution.impulse
    warn_of_pulls(matrices.held, held, held_impulses, solution.impulse)
    factor = np.zeros(FACTOR)
    if matrices.factor is not None:
        known = contact_inputs(problem)[13]
        factor[: len(known)] = known  # empty for W = 0
    numbers = np.concatenate(
        [
            v + matrices.response @ solution.impulse,
            matrices.delassus[np.triu_indices(3)],
            velocity,
            matrices.surface_velocity,
            matrices.axes.ravel(),
            solution.velocity,
            solution.impulse,
            [solution.compression_impulse, scale],
            factor,
        ]
    )
    ended = (solution.status, solution.flags, solution.iterations)
    return Hit(numbers, ended, contact, restitution, solution, held_impulses)
