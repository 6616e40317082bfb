"""Batches of impacts of one robot."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from operator import index
from typing import Any, Literal, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from .._compile.threads import in_threads, thread_count
from ..arrays import Array, Bools, Integers
from ..checks import counted, float_array, in_short, real_numbers
from ..contact_space.batch import BatchSolution, solve_factored, status_counts
from ..contact_space.inputs import FACTOR
from ..contact_space.solution import CAUSES, Work
from ..errors import InputError
from ..status import Flag, Status
from ..tables import AXES, by_component, data_frame
from ._kernels import robot_impact as kernel
from .contact import Contact, check_contact, check_held
from .data_cache import DataCache, data_cache
from .held import HeldContactWarning, moves, pull
from .matrices import contact_matrices
from .names import Stiffening, coordinate_names, is_stiff, joint_keys, mobilities, model_of, singular_mass
from .placed_robot import PlacedRobot
from .robot_impact import LOCKED, Hit, impact, impact_by_pinocchio, restitution_of_approach
from .struck import strike
from .touching import check_rims

_INVALID = int(Status.INVALID_NUMBERS)


class _Rows(NamedTuple):
    """The input: (N, nq) q, (N, nv) v, (N,) μ and e, usable rows, held contacts, constrained joints."""

    model: pin.Model
    q: Array
    v: Array
    contact: Contact
    mu: Array
    e: Array
    usable: Bools
    held: tuple[Contact, ...]
    locked: Sequence[str | int]
    stiffening: Stiffening
    threads: int


@dataclass(eq=False, repr=False)
class Hits:
    """The impacts of one robot, row by row; ``hits[i]`` is the `Hit` of a row.

    Attributes:
        v: (N, nv) post-impact velocities; NaN in rows without a solution.
        impulse_world: (N, 3) impulses on the robot in world axes [N s]; NaN likewise.
        status: (N,) integer values of `Status`.
        flags: (N,) integer values of `Flag`.
    """

    v: Array
    impulse_world: Array
    status: Integers
    flags: Integers
    _rows: _Rows
    _data: pin.Data | None = None

    def __len__(self) -> int:
        return len(self.v)

    def __getitem__(self, row: int) -> Hit:
        """Return the `Hit` of a row, solved again; raise the error of `impact` if there is none."""
        try:
            i = range(len(self))[index(row)]
        except (TypeError, IndexError):
            what = f"row: {in_short(row)} given, a whole number from 0 to {len(self) - 1} expected"
            raise (IndexError if isinstance(row, (int, np.integer)) else TypeError)(what) from None
        asked = self._rows
        if self._data is None:
            self._data = asked.model.createData()
        contact = asked.contact
        if contact.friction != asked.mu[i] or contact.restitution != asked.e[i]:
            contact = replace(contact, friction=asked.mu[i], restitution=asked.e[i])
        state = asked.q[i], asked.v[i]
        also: Any = {"held": asked.held, "locked": asked.locked, "stiffening": asked.stiffening}
        return impact(asked.model, self._data, *state, contact, **also)

    @cached_property
    def impulse(self) -> Array:
        """(N, 3) impulses on the robot in contact axes [N s], NaN likewise; computed on first access."""
        return self._contact_space[0].impulse

    @cached_property
    def work(self) -> Work:
        """The `Work` of the rows, arrays (N,) [J], NaN in rows without solution; computed on first access."""
        batch, surfaces = self._contact_space
        work = batch.work
        return replace(work, surface=np.einsum("ij,ij->i", batch.impulse, surfaces))

    @cached_property
    def _contact_space(self) -> tuple[BatchSolution, Array]:
        """The rows solved in contact space, and the velocities (N, 3) of the surfaces."""
        asked, model = self._rows, self._rows.model
        data = model.createData()
        return _solve(asked, _solve_by_kernel(data_cache(model, data), data, asked, len(self))[3])

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return the results as arrays (N,), by name.

        The columns are the friction and restitution used, v after the impact by coordinate, the impulse in
        contact axes t₁, t₂, n [N s], the work [J], and the names of status and flags.
        """
        work, asked = self.work, self._rows
        names = {
            "status": np.array([Status(code).name for code in self.status.tolist()], dtype=object),
            "flags": np.array([Flag(code).names() for code in self.flags.tolist()], dtype=object),
        }
        return {
            "friction": asked.mu,
            "restitution": asked.e,
            **by_component("v", coordinate_names(asked.model)[1], self.v),
            **by_component("impulse", AXES, self.impulse),
            **{f"work.{cause}": getattr(work, cause) for cause in (*CAUSES, "total")},
            **names,
        }

    def to_dataframe(self) -> Any:
        """Return `columns` as a pandas DataFrame; raise `InputError` if pandas is not installed."""
        return data_frame(self.columns())

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_data": None}

    def __repr__(self) -> str:
        return f"Hits({counted(len(self), 'impact')}: {status_counts(self.status)})"


def impacts(
    model: pin.Model,
    data: pin.Data,
    q: ArrayLike,
    v: ArrayLike,
    contact: Contact,
    friction: ArrayLike | None = None,
    restitution: ArrayLike | None = None,
    held: Sequence[Contact] = (),
    locked: Sequence[str | int] = (),
    threads: int = 1,
    law: Literal["newton", "poisson", "energetic"] | None = None,
    stiffening: Stiffening = None,
) -> Hits:
    """Compute the impact of one contact for many states and coefficients.

    Args:
        model: Pinocchio model, or a RobotWrapper.
        data: Its data; `contact_matrices` lists the fields that change.
        q: (N, nq) configurations, or (nq,) for all rows.
        v: (N, nv) pre-impact velocities, or (nv,) for all rows.
        contact: The contact that collides.
        friction: Number or (N,); None: that of the contact.
        restitution: Number or (N,); None: that of the contact.
        held: Bilateral contacts, as in `impact`. A row in which one moves has the status INVALID_NUMBERS.
        locked: Joints, by name or id, whose velocity the impact does not change.
        threads: Number of threads; held contacts, locked or stiffened joints, and joints that only Pinocchio
            can evaluate, such as mimic joints, use one. The results do not depend on it.
        law: Restitution law; None: that of the contact.
        stiffening: Of joints by control, from 0 (free) to 1 (locked), as in `impact`.

    Returns:
        The results row by row. A row with invalid numbers has its status and NaN, and does not affect other
        rows. If held contacts pull on their surfaces, a `HeldContactWarning` has the number of rows.

    Raises:
        InputError: Wrong shapes, an unknown law, or an invalid stiffening.
        UnknownNameError: A frame or joint that the model does not have.
        ModelError: The mass matrix is not positive definite.

    Warns:
        JointLimitWarning: A q is outside the joint limits, perhaps in degrees; given once for each Data.
    """
    model = model_of(model)
    cache = data_cache(model, data)
    check_contact("contact", contact)
    held = check_held(held)
    if law is not None:
        contact = replace(contact, law=law)
    mu = contact.friction if friction is None else friction
    coefficient = contact.restitution if restitution is None else restitution
    e = None if callable(coefficient) else coefficient
    q, v, mu = real_numbers("q", q), real_numbers("v", v), real_numbers("friction", mu)
    e = None if e is None else real_numbers("restitution", e)
    given = ((q, 1), (v, 1), (mu, 0), (e, 0))
    count = next((len(value) for value, ndim in given if value is not None and value.ndim > ndim), 1)
    q = _per_row("q", q, count, cache.q_shape)
    v = _per_row("v", v, count, cache.v_shape)
    mu = _per_row("friction", mu, count)
    e = None if e is None else _per_row("restitution", e, count)
    locked = joint_keys(locked)
    in_steps = bool(held or locked) or is_stiff(stiffening)
    usable = np.ones(count, dtype=np.bool_)  # without other information the kernel checks q
    if cache.tree is None or e is None or in_steps or contact.rim > 0.0:
        usable[:] = [_is_usable(model, data, row, contact) for row in q]
    if e is None:
        e = np.zeros(count)
        for row in np.flatnonzero(usable):
            e[row] = restitution_of_approach(model, data, q[row], v[row], contact)
    below, above = q < cache.bounds[0], q > cache.bounds[1]
    if below.any() or above.any():  # which rows takes three times as long
        beyond = np.flatnonzero((below | above).any(axis=1) & usable)
        if len(beyond):
            cache.warn_of_limits(q[beyond[0]], f" (row {beyond[0]}; {counted(len(beyond), 'row')} in all)")
    mobilities(model, locked, stiffening)
    rows = _Rows(model, q, v, contact, mu, e, usable, held, locked, stiffening, thread_count(threads))
    if in_steps:
        return _in_steps(data, rows)
    codes, after, impulses, _ = _solve_by_kernel(cache, data, rows, 0)
    return Hits(after, impulses, codes[:, 0].copy(), codes[:, 1].copy(), rows)


def _is_usable(model: pin.Model, data: pin.Data, q: Array, contact: Contact) -> bool:
    """Return whether a configuration is finite and normalized, and no rim lies flat there."""
    try:
        check_rims(PlacedRobot(model, data, q), (contact,))
    except InputError:
        return False
    return True


def _solve_by_kernel(
    cache: DataCache, data: pin.Data, rows: _Rows, wanted: int
) -> tuple[Integers, Array, Array, Array]:
    """Return status and flags (N, 2), v⁺, impulses, and for `wanted` rows the other results of `resolve`."""
    model, contact, count = rows.model, rows.contact, len(rows.q)
    after, impulses = np.full((count, cache.nv), np.nan), np.full((count, 3), np.nan)
    numbers, codes = np.full((wanted, kernel.SIZE), np.nan), np.empty((count, 2), dtype=np.int64)
    codes[:] = _INVALID, 0
    work = strike(cache, model, data, contact)[1]
    given = rows.q, rows.v, rows.usable, rows.mu, rows.e
    results = after, impulses, codes, numbers
    if work is None:
        _solve_by_pinocchio(data, rows, *results)
        return codes, after, impulses, numbers

    def solve(part: slice) -> int:
        stopped: int = kernel.robot_impacts(work, *(x[part] for x in given), *(x[part] for x in results))
        return stopped

    each = in_threads(solve, count, rows.threads)
    stopped = next((one for one in each if one != kernel.ALL_DONE), kernel.ALL_DONE)
    if stopped >= 0:
        raise singular_mass(model, stopped)
    return codes, after, impulses, numbers


def _solve_by_pinocchio(
    data: pin.Data, rows: _Rows, after: Array, impulses: Array, codes: Integers, numbers: Array
) -> None:
    """Compute the rows by calls of Pinocchio, for joints that the kernels do not support."""
    model, contact, nv = rows.model, rows.contact, rows.model.nv
    for row in np.flatnonzero(rows.usable).tolist():
        placed, out = PlacedRobot(model, data, rows.q[row]), np.empty(nv + kernel.SIZE)
        ended = impact_by_pinocchio(placed, rows.v[row], contact, rows.mu[row], rows.e[row], out)
        if ended[0] == kernel.SINGULAR_MASS:
            raise singular_mass(model, ended[1])
        codes[row, 0] = ended[0]
        if ended[0] <= LOCKED:
            codes[row, 1], after[row] = ended[1], out[:nv]
            numbers[row : row + 1] = out[nv:]
            p, axes = out[nv + kernel.AFTER + 3 :][:3], out[nv + kernel.AXES :][:9]
            impulses[row] = p @ axes.reshape(3, 3)


def _solve(rows: _Rows, numbers: Array) -> tuple[BatchSolution, Array]:
    """Return the solutions for the results of `robot_impact`, with work, and surface velocities."""
    upper = numbers[:, kernel.DELASSUS : kernel.DELASSUS + 6]
    delassus = upper[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
    velocity = numbers[:, kernel.VELOCITY : kernel.VELOCITY + 3]
    surface = numbers[:, kernel.SURFACE : kernel.SURFACE + 3]
    scale = numbers[:, kernel.SCALE]
    factors = np.ascontiguousarray(numbers[:, kernel.SINGULAR : kernel.SINGULAR + FACTOR])
    problems = delassus, velocity, rows.mu, rows.e, rows.contact.law, scale, factors
    return solve_factored(*problems, threads=rows.threads, work=True), surface


def _in_steps(data: pin.Data, rows: _Rows) -> Hits:
    """Solve the rows by `contact_matrices`, once for consecutive rows of equal q, and `solve_factored`."""
    model, contact, count, nv = rows.model, rows.contact, len(rows.q), rows.model.nv
    delassus, velocity, scale = np.full((count, 3, 3), np.nan), np.full((count, 3), np.nan), np.zeros(count)
    response, surface, axes = np.zeros((count, nv, 3)), np.zeros((count, 3)), np.zeros((count, 3, 3))
    factors = np.zeros((count, FACTOR))
    pulls: list[tuple[int, Any]] = []
    found: Any = None
    last = -1
    finite = np.isfinite(rows.v).all(axis=1)
    also = rows.held, rows.locked, rows.stiffening
    for row in np.flatnonzero(rows.usable & finite).tolist():
        if last < 0 or not np.array_equal(rows.q[row], rows.q[last]):
            found, last = contact_matrices(model, data, rows.q[row], contact, *also), row
        v = rows.v[row]
        size = found.velocity_scale(v)
        if any(moves(anchor, v, size) for anchor in found.held):
            continue
        delassus[row], velocity[row] = found.delassus, found.velocity(v)
        scale[row] = size
        if found.factor is not None:
            factors[row] = *found.factor[np.tril_indices(3)], found.factor_scale
        response[row], surface[row], axes[row] = found.response, found.surface_velocity, found.axes
        pulls.append((row, found))
    batch = solve_factored(delassus, velocity, rows.mu, rows.e, contact.law, scale, factors)
    after = rows.v + np.einsum("ijk,ik->ij", response, batch.impulse)
    _warn_of_pull(rows, batch, pulls)
    world = np.einsum("ik,ikj->ij", batch.impulse, axes)
    hits = Hits(after, world, batch.status, batch.flags, rows)
    hits.__dict__["_contact_space"] = batch, surface
    return hits


def _warn_of_pull(rows: _Rows, batch: BatchSolution, pulls: list[tuple[int, Any]]) -> None:
    """Warn of held contacts that pull, with the number of rows."""
    counts = dict.fromkeys((anchor.label for anchor in rows.held), 0)
    for row, found in pulls:
        impulses = found.held_response @ batch.impulse[row]
        for anchor, geometry, impulse in zip(rows.held, found.held, impulses, strict=True):
            counts[anchor.label] += pull(geometry, impulse, batch.impulse[row]) > 0.0
    for label, count in counts.items():
        if count:
            warnings.warn(
                f"held: {label!r} pulls on its surface in {counted(count, 'row')} of "
                f"{len(rows.q)}; if it can lift off, remove it from held",
                HeldContactWarning,
                stacklevel=4,
            )


def _per_row(name: str, value: ArrayLike, count: int, shape: tuple[int, ...] = ()) -> Array:
    """Return (count, *shape) of values given for each row, or once for all."""
    if np.ndim(value) == len(shape):
        value = np.broadcast_to(float_array(name, value, shape) if shape else value, (count, *shape))
    return float_array(name, value, (count, *shape))
