"""Derivatives of the impact of a robot. (docs/derivatives.md, 5)"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, overload

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from .._numeric.tolerances import RANK
from ..arrays import Array, Bools, Integers
from ..checks import above_zero, finite_array, float_array, real_number, returned
from ..contact_space.derivatives import Boundary
from ..contact_space.one_sided import check_side
from ..contact_space.problem import ImpactProblem
from ..contact_space.solve import solve_impact
from ..errors import InputError, ModelError
from ..status import Flag
from ._kernels import configuration_slopes as places
from ._kernels import impact_slopes as kernel
from ._kernels.responses import half_solve
from ._kernels.tree import solve
from .contact import Contact, Contacts, check_contact, is_pair
from .data_cache import data_cache
from .forest import composite_inertias, joint_jacobian
from .held import held_at_rest
from .matrices import ContactMatrices, contact_geometry, contact_matrices, independent
from .names import free_velocities, model_of
from .one_sided import fill_one_sided_of_robot
from .placed_robot import ContactGeometry, PlacedRobot
from .robot_impact import LOCKED, impact
from .shape_pair import closest_points, known, shape_pair
from .struck import strike
from .touching import check_rims, touching_tips

if TYPE_CHECKING:
    from .many_derivatives import ManyImpactDerivatives

_UPPER = np.triu_indices(3)


class _View:
    """Descriptor for columns of `ImpactDerivatives.block`, in the rows of q̇⁺ or of P."""

    def __init__(self, of_impulse: bool, columns: Callable[[int], slice | int]) -> None:
        self._of_impulse, self._columns = of_impulse, columns

    def __get__(self, found: ImpactDerivatives | None, kind: type) -> Any:
        if found is None:
            return self
        nv = len(found.block) - 3
        return found.block[slice(nv, None) if self._of_impulse else slice(nv), self._columns(nv)]


def _views(columns: Callable[[int], slice | int]) -> tuple[_View, _View]:
    """Return views in the rows of q̇⁺ and of P."""
    return _View(False, columns), _View(True, columns)


KINKED = RANK
"""Entries of `Found.kinks` up to which they are rounding errors."""


class Found(NamedTuple):
    """Derivatives of an impact that hold along some changes of q only.

    Attributes:
        block: (nv + 3, 2 nv + 9) as of `ImpactDerivatives`.
        boundary: Flags of `Boundary`.
        kinks: (4, nv) rows that vanish for the δq along which the derivatives hold, see `fill_kinks`.
    """

    block: Array
    boundary: Boundary
    kinks: Array


class ImpactDerivatives:
    """Derivatives of q̇⁺ and of the impulse P of an impact; those by q are in the tangent space of q.

    Columns without derivative are NaN, see `boundary`.

    Attributes:
        v: (nv,) q̇⁺.
        dv_dq, dv_dv: (nv, nv) ∂q̇⁺/∂q and ∂q̇⁺/∂q̇.
        dv_dfriction, dv_drestitution: (nv,) ∂q̇⁺/∂μ and ∂q̇⁺/∂e.
        dv_dsurface: (nv, 6) ∂q̇⁺ by the surface's velocity and angular velocity, in its own axes.
        dP_dq, dP_dv: (3, nv) ∂P/∂q and ∂P/∂q̇, of the impulse in world axes.
        dP_dfriction, dP_drestitution: (3,) ∂P/∂μ and ∂P/∂e.
        dP_dsurface: (3, 6) ∂P by the surface's velocity and angular velocity.
        boundary: Flags of `Boundary`.
        block: (nv + 3, 2 nv + 9), of which all these are views.
    """

    __slots__ = ("block", "boundary")

    def __init__(self, block: Array, boundary: Boundary) -> None:
        self.block, self.boundary = block, boundary

    @classmethod
    def of(cls, found: Found) -> ImpactDerivatives:
        """Return derivatives with NaN in the columns of q along which friction changes its sign."""
        block, boundary, kinks = found
        at_kink = np.flatnonzero((np.abs(kinks) > KINKED).any(axis=0))
        block[:, at_kink] = np.nan
        return cls(block, boundary | (Boundary.START_AT_REST if len(at_kink) else Boundary.NONE))

    dv_dq, dP_dq = _views(lambda nv: slice(nv))
    dv_dv, dP_dv = _views(lambda nv: slice(nv, 2 * nv))
    dv_dsurface, dP_dsurface = _views(lambda nv: slice(2 * nv + kernel.SURFACE, 2 * nv + kernel.FRICTION))
    dv_dfriction, dP_dfriction = _views(lambda nv: 2 * nv + kernel.FRICTION)
    dv_drestitution, dP_drestitution = _views(lambda nv: 2 * nv + kernel.RESTITUTION)
    v = _View(False, lambda nv: 2 * nv + kernel.VALUE)

    def __repr__(self) -> str:
        return f"ImpactDerivatives(nv={len(self.v)}, boundary={self.boundary!r})"


_WITHOUT_DERIVATIVES = ("Composite", "Universal", "SphericalZYX", "Ellipsoid", "Mimic", "mimic")


def check_joints(model: pin.Model) -> None:
    """Raise `ModelError` for joints whose motion subspace, in their own axes, depends on q, and mimics."""
    for name, joint in zip(model.names, model.joints, strict=True):
        kind = joint.shortname()
        if any(word in kind for word in _WITHOUT_DERIVATIVES):
            raise ModelError(
                f"model: joint {name!r} is a {kind}; derivatives are not available for joints of this kind",
                value=name,
            )


def _restitution(
    model: pin.Model, data: pin.Data, q: ArrayLike, v: ArrayLike, contact: Contact
) -> tuple[float, float]:
    """Return e, at the approach speed if it is a function, and de/d(approach speed)."""
    if not callable(contact.restitution):
        return float(contact.restitution), 0.0
    cache = data_cache(model, data)
    velocity = contact_geometry(model, data, q, contact).velocity(finite_array("v", v, cache.v_shape))
    speed = max(-float(velocity[2]), 0.0)
    return contact.restitution_at(speed), slope_of_restitution(contact, speed)


def slope_of_restitution(contact: Contact, speed: float) -> float:
    """Return de/d(approach speed) [s/m]; 0 if e is a number."""
    if not callable(contact.restitution):
        return 0.0
    slope = getattr(contact.restitution, "slope", None)
    if not callable(slope):
        raise InputError(
            "restitution: a function of the approach speed without derivative; give it an attribute `slope`, "
            "a function that returns de/dv for a speed",
            value=contact.restitution,
        )
    found = returned("restitution.slope", f"at an approach of {speed:.6g} m/s", slope, speed)
    return real_number("restitution.slope", found)


@overload
def impact_derivatives(
    model: pin.Model, data: pin.Data, q: ArrayLike, v: ArrayLike, contact: Contact, *rest: Any, **more: Any
) -> ImpactDerivatives: ...
@overload
def impact_derivatives(
    model: pin.Model, data: pin.Data, q: ArrayLike, v: ArrayLike, contact: Contacts, *rest: Any, **more: Any
) -> ManyImpactDerivatives: ...
def impact_derivatives(
    model: pin.Model,
    data: pin.Data,
    q: ArrayLike,
    v: ArrayLike,
    contact: Contact | Sequence[Contact],
    held: Sequence[Contact] = (),
    locked: Sequence[str | int] = (),
    simultaneous: str = "propagate",
    side: int | None = None,
) -> ImpactDerivatives | ManyImpactDerivatives:
    """Return the derivatives of the impact of a robot at a contact, or at several at one instant.

    Those of one contact are exact. Those of a list are exact but for differences in contact space, which have
    about ten digits. (docs/derivatives.md, 11)

    Args:
        model: Pinocchio model, or a RobotWrapper.
        data: Its data; `contact_matrices` lists the fields that change.
        q: (nq,) configuration.
        v: (nv,) velocity before the impact.
        contact: The contact that collides, or a list of those that are closed at this instant, as in
            `impact`. For a collision shape its lowest tips take part, for two shapes their one closest point;
            then `model` is the RobotWrapper. A `restitution` that is a function needs an attribute ``slope``,
            its derivative by the approach speed [s/m].
        held: Contacts that hold during the impact.
        locked: Joints, by name or id, whose velocity the impact does not change.
        simultaneous: Policy of `solve_impact`, for a list of contacts.
        side: 1 or −1: columns without derivative are those to this side where they exist,
            for a change of that sign. (docs/derivatives.md, 6)

    Returns:
        `ImpactDerivatives`; `ManyImpactDerivatives` for a list, also of one, and for several tips.

    Raises:
        InputError: As `impact`; a contact or a function e without derivatives.
        UnknownNameError: A frame or joint that the model does not have.
        ModelError: The mass matrix is not positive definite; joints whose axes turn within the joint; mimics.
        UnstoppableApproachError: No normal impulse can stop the approach.
        LawError: The restitution law cannot be met.
    """
    check_side(side)
    if not isinstance(contact, Contact) or contact.geometry is not None:
        if isinstance(contact, Contact) and not is_pair(model, contact):
            tips = touching_tips(model, data, q, contact)
            contact = tips[0] if len(tips) == 1 else tips
        if isinstance(contact, Sequence) and not isinstance(contact, str):
            from .many_derivatives import derivatives_at_many

            return derivatives_at_many(model, data, q, v, contact, held, locked, simultaneous, side)
    rest = held_at_rest(model, data, q, v, contact, held), locked, True
    found = ImpactDerivatives.of(_differentiated(model, data, q, v, contact, *rest))
    if side is not None and np.isnan(found.block).any():
        own, cache = model_of(model), data_cache(model_of(model), data)
        at = float_array("q", q, cache.q_shape), float_array("v", v, cache.v_shape)

        def evaluate(q: Array, v: Array, contact: Contact) -> Array:
            return ImpactDerivatives.of(_differentiated(model, data, q, v, contact, *rest)).block

        fill_one_sided_of_robot(found.block, side, own, *at, contact, evaluate)
    return found


def impact_rows(
    model: pin.Model,
    data: pin.Data,
    q: ArrayLike,
    v: ArrayLike,
    contact: Contact,
    dt: float,
    held: Sequence[Contact] = (),
    locked: Sequence[str | int] = (),
) -> tuple[Array, Array]:
    """Return the result of a possible impact as a linear function for a controller: (q̇⁺, P) = A v̇ + b.

    v̇ is the acceleration of this tick, so that the velocity before an impact at its end is v + v̇ dt, at the
    present configuration. (docs/derivatives.md, D28)

    Args:
        model: As in `impact_derivatives`, with its errors.
        data: Likewise.
        q: (nq,) configuration.
        v: (nv,) velocity.
        contact: The contact that may collide.
        dt: Length of the tick [s].
        held: Contacts that hold during the impact.
        locked: Joints whose velocity the impact does not change.

    Returns:
        A (nv + 3, nv) and b (nv + 3,) of the velocity after the impact and of the impulse on the robot in
        world axes [N s]; columns without derivative are NaN.
    """
    dt = above_zero("dt", dt)
    rest = held_at_rest(model, data, q, v, contact, held), locked, False
    block = _differentiated(model, data, q, v, contact, *rest).block
    nv = len(block) - 3
    return dt * block[:, nv : 2 * nv], block[:, -1].copy()


def _differentiated(
    model: pin.Model,
    data: pin.Data,
    q: ArrayLike,
    v: ArrayLike,
    contact: Contact,
    held: tuple[Contact, ...],
    locked: Sequence[str | int],
    by_q: bool,
) -> Found:
    """Return q̇⁺ and P and their derivatives, as `assemble` lays them out."""
    if not isinstance(contact, Contact) or contact.geometry is not None:
        return _of_shape(model, data, q, v, contact, held, locked, by_q)
    model = model_of(model)
    if held or contact.rim > 0.0:
        check_rims(PlacedRobot(model, data, q), (contact, *held))
    e, cache = _restitution(model, data, q, v, contact), data_cache(model, data)
    if not (held or locked):
        work = strike(cache, model, data, contact)[1]
        if work is not None:
            block, kinks = np.empty((cache.nv + 3, 2 * cache.nv + kernel.MORE)), np.zeros((4, cache.nv))
            q_now, v_now = float_array("q", q, cache.q_shape), float_array("v", v, cache.v_shape)
            status, boundary = kernel.robot_slopes(work, q_now, v_now, *e, by_q, block, kinks)
            if 0 <= status <= LOCKED:
                return Found(block, Boundary(boundary), kinks)
            impact(model, data, q, v, contact)  # raises the error
    return _by_matrices(model, data, q, v, contact, e, held, locked, by_q)


def _of_shape(robot: Any, data: pin.Data, q: ArrayLike, v: ArrayLike, contact: Contact, *rest: Any) -> Found:
    """Return the result of `_differentiated` for a collision shape, at its single contact point."""
    if not isinstance(contact, Contact):
        check_contact("contact", contact)
    if is_pair(robot, contact):
        pair = shape_pair(robot, contact)
        points = [known(place)[1:] for place in closest_points(robot, data, q, pair, v)]
    else:
        points = [(tip, tip, False, False) for tip in touching_tips(robot, data, q, contact)]
    if len(points) != 1:
        raise InputError(
            f"contact: {contact.label!r} touches at {len(points)} points at this q; derivatives are for "
            "contact at one point",
            value=contact,
        )
    return derivatives_at_point(robot, data, q, v, points[0], *rest)


def derivatives_at_point(
    model: pin.Model,
    data: pin.Data,
    q: ArrayLike,
    v: ArrayLike,
    point: tuple[Contact, Contact | None, bool, bool],
    held: tuple[Contact, ...],
    locked: Sequence[str | int],
    by_q: bool = True,
) -> Found:
    """Return `impact_derivatives` for `instant`, `lasting`, `swapped` and `met` of a `PointContact`.

    The motion of the contact point with q follows from `lasting`.
    """
    (instant, lasting, swapped, met), rest = point, (held, locked)
    block, boundary, kinks = _differentiated(model, data, q, v, instant, *rest, by_q and lasting is instant)
    of_q = block[:, : len(block) - 3]
    if met:
        block[:, len(of_q[0]) : 2 * len(of_q[0])] = np.nan
        boundary |= Boundary.FEATURES_MEET
    if by_q and lasting is None:
        of_q[:] = np.nan
        boundary |= Boundary.FEATURES_MEET
    elif by_q and swapped and lasting is not None:  # this shape is the surface of `lasting`
        e = _restitution(model, data, q, v, lasting)
        of_lasting = _by_matrices(model_of(model), data, q, v, lasting, e, *rest, True, on_surface=True)
        of_q[:], kinks = of_lasting.block[:, : len(of_q[0])], of_lasting.kinks
        of_q[-3:] *= -1.0  # that impulse is on the other shape
    elif by_q and lasting is not None and lasting is not instant:
        of_lasting = _differentiated(model, data, q, v, lasting, *rest, True)
        of_q[:], kinks = of_lasting.block[:, : len(of_q[0])], of_lasting.kinks
    return Found(block, boundary, kinks)


class Tree(NamedTuple):
    """Joint Jacobian J (6, nv), the joint (nv,) of each velocity, and the parent (joints,) of each joint."""

    J: Array
    joint: Integers
    parent: Integers

    @classmethod
    def of(cls, placed: PlacedRobot) -> Tree:
        """Return the `Tree` of a robot at a configuration."""
        model, cache = placed.model, placed.cache
        if cache.joints is None:
            check_joints(model)
            cache.joints = np.repeat(np.arange(model.njoints), model.nvs), np.array(model.parents)
        return cls(joint_jacobian(model, placed.data, placed.q), *cache.joints)

    def motions(self, x: Array) -> Array:
        """Return the motions (joints, 6) of velocities x (nv,)."""
        out = np.empty((len(self.parent), 6))
        places.fill_motions(*self, np.ascontiguousarray(x), out)
        return out


class Place(NamedTuple):
    """Joints of tip and surface, and `at` and `shifts` of `fill_place`."""

    tip: int
    base: int
    at: Array
    shifts: Array

    def move_onto_surface(self, at: ContactGeometry) -> None:
        """Replace the contact point by that of the surface below the tip; it moves with gap and normal."""
        n, turns = at.axes[2], self.shifts[:, places.TURN : places.TURN + 3]
        self.at[places.POINT : places.POINT + 3] -= at.gap * n
        self.shifts[:, :3] -= np.outer(at.h[: len(turns)], n) + at.gap * np.cross(turns, n)


_NO_TREE = Tree(np.empty((6, 0), order="F"), np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64))


def contact_place(placed: PlacedRobot, tree: Tree, contact: Contact, turns: bool, n: int) -> Place:
    """Return the `Place` of a contact; `turns` as for `fill_place`, `n` is nv, or 0 for no `shifts`."""
    joints = placed.cache.ends(contact.frame, contact.plane.body)
    at, shifts = np.empty(places.PLACE), np.empty((n, places.SHIFT))
    frame, carrier = placed.placements(contact)
    places.fill_place_at(frame, carrier, contact.constants.copy(), turns, *tree, *joints, at, shifts)
    return Place(*joints, at, shifts)


def _by_matrices(
    model: pin.Model,
    data: pin.Data,
    q: ArrayLike,
    v: ArrayLike,
    contact: Contact,
    restitution: tuple[float, float],
    held: tuple[Contact, ...],
    locked: Sequence[str | int],
    by_q: bool,
    on_surface: bool = False,
) -> Found:
    """Return the result of `_differentiated` by `contact_matrices`, where the kernel does not apply.

    With `on_surface` the contact point is that of the surface below the tip.
    """
    matrices, (e, slope) = contact_matrices(model, data, q, contact, held, locked), restitution
    nv = len(matrices.h)
    v = finite_array("v", v, (nv,))
    velocity, scale = matrices.velocity(v), matrices.velocity_scale(v)
    if np.hypot(*velocity[:2]) <= kernel.AT_REST * scale:
        velocity[:2] = 0.0
    problem = ImpactProblem(
        *(matrices.delassus, velocity, contact.friction, e, contact.law),
        velocity_scale=scale,
        factor=matrices.factor,
        factor_scale=matrices.factor_scale,
    )
    solution = solve_impact(problem, derivatives=True)
    impulse, d = solution.impulse, solution.derivatives
    assert d is not None
    slopes = np.column_stack([d.dP_dv, d.dP_ddelassus.reshape(3, 9), d.dP_dfriction, d.dP_drestitution])
    placed, n, y = PlacedRobot(model, data, q), nv if by_q else 0, np.ascontiguousarray(matrices.response.T)
    tree = Tree.of(placed) if by_q else _NO_TREE
    place = contact_place(placed, tree, contact, True, n)
    if on_surface:
        place.move_onto_surface(matrices)
    tip, base, at, shifts = place
    carrier = placed.placements(contact)[1][:3].T.ravel()
    of_data, forces, turned = np.empty((9, n)), np.empty((nv, n)), np.empty((3, n))
    if by_q:
        inertia = composite_inertias(model, data, placed.q)
        given = *tree, placed.cache.parents, inertia, tip, base, at, shifts, y, v, impulse
        kernel.impact_slopes(*given, of_data, forces, turned)
        sliding = np.empty((0, nv))
        if held:
            sliding = _add_held(placed, tree, held, matrices, y, impulse, of_data, forces)
        forces = responses(placed, matrices.held, free_velocities(model, locked), forces, sliding)
    block, kinks = np.empty((nv + 3, 2 * nv + kernel.MORE)), np.zeros((4, nv))
    rest = y, v, impulse, slopes, slope, by_q, of_data, forces, turned, block
    kernel.assemble(at, carrier, np.ascontiguousarray(matrices.jacobian), *rest)
    if by_q:
        stops, still = bool(solution.flags & (Flag.STICK | Flag.SLIP_RESUMED)), kernel.AT_REST * scale
        kernel.fill_kinks(matrices.delassus, velocity, still, contact.friction, stops, of_data, kinks)
    return Found(block, d.boundary, kinks)


def _add_held(
    placed: PlacedRobot,
    tree: Tree,
    held: tuple[Contact, ...],
    matrices: ContactMatrices,
    y: Array,
    impulse: Array,
    of_data: Array,
    forces: Array,
) -> Array:
    """Add the contributions of held contacts to ∂W/∂q and to the forces; return dΓ Δ (3k, nv). (D21)"""
    nv, pushes = len(forces), matrices.held_response  # [h, world axis, i]
    moved = np.empty((3, len(held), 3, nv))
    for h, anchor in enumerate(held):
        tip, base, at, shifts = contact_place(placed, tree, anchor, False, nv)
        for i, x in enumerate(y):
            places.velocity_slopes(*tree, tip, base, at, shifts, tree.motions(x), False, moved[i, h])
        f1, f2, f3 = pushes[h] @ impulse
        places.force_slopes(*tree, at, shifts, f1, f2, f3, forces)
    by_rows = moved.reshape(3, 3 * len(held), nv)
    of_rows = pushes.reshape(-1, 3).T @ by_rows  # [j, i, k]
    of_data[3:] += (of_rows + of_rows.transpose(1, 0, 2))[_UPPER]
    return np.tensordot(impulse, by_rows, 1)


def responses(
    placed: PlacedRobot,
    anchors: Sequence[ContactGeometry],
    free: Bools,
    forces: Array,
    sliding: Array,
) -> Array:
    """Return x with M x + Γᵀλ = f, Γ x = −dΓ Δ for columns f (nv, n), x = 0 where it is not free. (D21)"""
    mass, mobility = placed.mass_matrix(), free.astype(np.float64)
    lower, n = np.empty_like(mass), forces.shape[1]
    rows = np.vstack([forces.T, *(anchor.axes.T @ anchor.jacobian for anchor in anchors)])
    half_solve(mass, placed.cache.parents, mobility, lower, rows)
    x = rows[:n]
    if anchors:
        left, sizes, right = independent(rows[n:])
        x -= (x @ right.T + (sliding.T @ left) / sizes) @ right
    solve(lower, placed.cache.parents, x)
    return np.ascontiguousarray((x * mobility).T)
