"""Robots of many kinematic trees, such as many free bodies: one Pinocchio Data for a few trees each.

A Data has tables of nv³ numbers: one of 60 free bodies takes 3 GB. Trees are coupled by contacts only, so
each Data of a `Forest` has a few of them, and the fields of a Data are assembled from theirs.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from .._numeric.tolerances import NOISE
from ..arrays import Array, Integers
from .articulated_bodies import inverse_of, is_accurate

LARGE = 60
"""Velocities up to which a robot has one Data, and a part several trees."""


class Part(NamedTuple):
    """Some trees of a robot, as a separate robot."""

    model: pin.Model
    data: pin.Data
    q: slice  # its coordinates in those of the whole
    v: slice  # its velocities
    first: int  # number of its first joint in the whole, if its joints are consecutive

    @property
    def joints(self) -> slice:
        """Indices of its joints in the whole."""
        return slice(self.first, self.first + self.model.njoints - 1)


class _OfJoints:
    """A field of all Data with an element for each joint, the world first."""

    def __init__(self, parts: list[Part], field: str) -> None:
        self._parts, self._field = parts, field

    def __getitem__(self, joint: int) -> Any:
        part = next((part for part in reversed(self._parts) if part.first <= joint), self._parts[0])
        return getattr(part.data, self._field)[joint - part.first + 1 if joint > 0 else 0]


class Forest:
    """Replaces the Data of a robot of many trees; the joints of its model are in depth-first order.

    `parts` are its trees, in groups of at most `most` velocities unless a single tree has more, and oMi, v, a
    placements and motions of the joints, as in a Data.
    """

    def __init__(self, model: pin.Model, most: int = LARGE) -> None:
        self.model = model
        self.parts = [_part(model, first, stop) for first, stop in _ranges(model, most)]
        self.oMi, self.v, self.a = (_OfJoints(self.parts, field) for field in ("oMi", "v", "a"))

    def parents(self) -> Integers:
        """Return (nv,) the next velocity towards the root, or −1."""
        found = [np.array(part.data.parents_fromRow, dtype=np.int64) for part in self.parts]
        return np.concatenate(
            [np.where(one >= 0, one + part.v.start, -1) for one, part in zip(found, self.parts, strict=True)]
        )


def data_of(model: pin.Model) -> Any:
    """Return a Data of a model, or a `Forest` if the Data would be large."""
    return Forest(model) if model.nv > LARGE and len(_ranges(model, 0)) > 1 else model.createData()


_ALL = slice(None)


def parts_of(model: pin.Model, data: Any) -> list[Part]:
    """Return the parts of a `Forest`; a Data is one part, the whole."""
    return data.parts if isinstance(data, Forest) else [Part(model, data, _ALL, _ALL, 1)]


def forward_kinematics(model: pin.Model, data: Any, q: Array, *motion: Array) -> None:
    """Compute placements for q (nq,), and motions for v and v̇ (nv,) if given; for a Data or a `Forest`."""
    for part in parts_of(model, data):
        pin.forwardKinematics(part.model, part.data, q[part.q], *(one[part.v] for one in motion))


def joint_jacobian(model: pin.Model, data: Any, q: Array) -> Array:
    """Return the joint Jacobian (6, nv) at q (nq,), and compute placements; for a Data or a `Forest`."""
    found = np.empty((6, model.nv), order="F")
    for part in parts_of(model, data):
        found[:, part.v] = pin.computeJointJacobians(part.model, part.data, q[part.q]).reshape(6, -1)
    return found


def mass_matrix(model: pin.Model, data: Any, q: Array) -> Array:
    """Return M (nv, nv) at q (nq,); for a Data or a `Forest`."""
    return _by_blocks(crba, model, data, q)


def crba(model: pin.Model, data: pin.Data, q: Array) -> Array:
    """Return `pin.crba` at q (nq,).

    With joints that mimic others, Pinocchio adds forces to those that `data.Fcrb` has from the call before.
    """
    if len(model.mimicking_joints) > 0:
        for forces in data.Fcrb:
            forces[:] = 0.0
    return np.asarray(pin.crba(model, data, q))


def has_constant_mass(model: pin.Model, data: Any) -> bool:
    """Return whether M is that of free bodies, the same everywhere: it is compared in two configurations."""
    q = pin.neutral(model)
    first = mass_matrix(model, data, q)
    second = mass_matrix(model, data, pin.integrate(model, q, np.linspace(0.3, 1.1, model.nv)))
    return bool(np.abs(second - first).max(initial=0.0) <= NOISE * np.abs(first).max(initial=0.0))


def composite_inertias(model: pin.Model, data: Any, q: Array) -> Array:
    """Return the inertias (joints, 10) of all that joints carry, in world axes; for a Data or a `Forest`."""
    found = np.zeros((model.njoints, 10))
    for part in parts_of(model, data):
        pin.crba(part.model, part.data, q[part.q], pin.Convention.WORLD)  # the other leaves oYcrb out
        found[part.joints] = [inertia.toDynamicParameters() for inertia in list(part.data.oYcrb)[1:]]
    return found


def inverse_mass(model: pin.Model, data: Any, q: Array) -> Array:
    """Return M⁻¹ (nv, nv) at q (nq,); for a Data or a `Forest`."""
    return _by_blocks(_inverse_mass, model, data, q)


def _inverse_mass(model: pin.Model, data: pin.Data, q: Array) -> Array:
    if is_accurate(model):
        upper = np.triu(pin.computeMinverse(model, data, q))
        return np.asarray(upper + np.triu(upper, 1).T)
    return inverse_of(crba(model, data, q))


def _by_blocks(function: Callable[..., Array], model: pin.Model, data: Any, q: Array) -> Array:
    found = np.zeros((model.nv, model.nv))
    for part in parts_of(model, data):
        size = part.model.nv
        found[part.v, part.v] = function(part.model, part.data, q[part.q]).reshape(size, size)
    return found


def potential_energy(model: pin.Model, data: Any, q: Array) -> float:
    """Return the potential energy of gravity [J]; for a Data or a `Forest`."""
    parts = parts_of(model, data)
    return sum(float(pin.computePotentialEnergy(part.model, part.data, q[part.q])) for part in parts)


def frame_placement(model: pin.Model, data: Any, frame: int) -> pin.SE3:
    """Return the placement of a frame, for up-to-date placements of joints; for a Data or a `Forest`."""
    if isinstance(data, Forest):
        return data.oMi[model.frames[frame].parentJoint] * model.frames[frame].placement
    return pin.updateFramePlacement(model, data, frame)


def _ranges(model: pin.Model, most: int) -> list[tuple[int, int]]:
    """Return the first joint of each part and the one after its last; none if trees are interleaved.

    Trees of a single joint are separate from others.
    """
    found: list[tuple[int, int]] = []
    parents, widths, size, alone = list(model.parents), list(model.nvs), 0, False
    roots = [j for j in range(1, model.njoints) if parents[j] == 0]
    for root, stop in zip(roots, [*roots[1:], model.njoints], strict=True):
        if min(parents[root + 1 : stop], default=root) < root:
            return []
        width, single = sum(widths[root:stop]), stop == root + 1
        if found and size + width <= most and single == alone:
            found[-1], size = (found[-1][0], stop), size + width
        else:
            found.append((root, stop))
            size, alone = width, single
    return found


def _part(model: pin.Model, first: int, stop: int) -> Part:
    own = pin.Model()
    for j in range(first, stop):
        parent = max(model.parents[j] - first + 1, 0)
        own.addJoint(parent, model.joints[j], model.jointPlacements[j], model.names[j])
    q, v = (
        slice(starts[first], starts[first] + size)
        for starts, size in ((model.idx_qs, own.nq), (model.idx_vs, own.nv))
    )
    own.gravity, own.armature = model.gravity, np.array(model.armature[v])
    for j in range(1, own.njoints):
        own.inertias[j] = model.inertias[j + first - 1]
    return Part(own, own.createData(), q, v, first)
