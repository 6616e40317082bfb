"""What a run needs of a scene that does not change from run to run, made when it is first asked for."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
import pinocchio as pin

from ..arrays import Array, Integers
from ..geometry._kernels.constants import CONSTANTS
from ..geometry.tolerances import COINCIDE
from ..robot.contact import Contact, contact_constants
from ..robot.forest import Forest, data_of, inverse_mass
from ..robot.joint_limits import JointLimit, joint_limits
from ..robot.names import ShapedRobot, frame_id, motion_signs
from ..robot.pinocchio_bridge import RobotDynamics, robot_dynamics
from ..robot.shape_pair import ShapePair, shape_pair
from ._kernels.tolerances import ROUNDING
from .joint_charts import joint_table
from .joint_metres import gyration, metres_per_unit
from .reach import chain_length, link_lengths, out_of_reach

K = TypeVar("K")
V = TypeVar("V")

LEAST = 4
"""Contacts of a shape that are worth a sphere in which a scene looks at them together."""


class SceneLayout:
    """What a run needs of a scene beyond its state, as long as the model stays as it is, see `holds_for`.

    The contacts may be open, those held are not; `limited` says whether the joint limits act.
    """

    def __init__(
        self,
        model: pin.Model,
        contacts: Sequence[Contact],
        held: Sequence[Contact],
        limited: bool,
        geometry: pin.GeometryModel | None,
    ) -> None:
        self._model = model
        self._contacts = tuple(contacts)
        self._held = tuple(held)
        self._limited = limited
        self._geometry = geometry
        self._sizes = _sizes(model)
        self._links = [pin.SE3(placement) for placement in model.jointPlacements]
        self._bounds = _bounds(model)
        every = (*self._contacts, *self._held)
        self._runs = runs(every)
        keys = dict.fromkeys(key for c in every for key in (c.frame, c.plane.body) if key is not None)
        ids = (frame_id(model, key) for key in keys)
        self._frames = [(i, pin.SE3(model.frames[i].placement)) for i in ids]
        self._spare_dynamics: list[RobotDynamics] = []
        self._spare_data: list[Any] = []
        self._damping: _Last[bytes, float] = _Last()
        self._gyration: _Last[bytes, Array] = _Last()
        self._metres: _Last[bytes, Array] = _Last()
        self._tables: _Last[tuple[Contact, ...], ContactTables] = _Last()
        self._pair_tables: _Last[tuple[Contact, ...], PairTables] = _Last()

    def holds_for(self, model: pin.Model) -> bool:
        """Return whether sizes, placements and joint limits of the model are what they were."""
        return bool(
            self._sizes == _sizes(model)
            and self._links == model.jointPlacements.tolist()
            and self._bounds == _bounds(model)
            and all(model.frames[i].placement == placement for i, placement in self._frames)
        )

    @cached_property
    def limits(self) -> tuple[JointLimit, ...]:
        """The finite bounds of the coordinates that are plain numbers."""
        return joint_limits(self._model)

    @property
    def extent(self) -> float:
        """The robot's size L [m]: the longest chain to a contact or link, else of its masses, else 1 m."""
        return self._longest or float(self._radii.max(initial=0.0)) or 1.0

    @cached_property
    def _longest(self) -> float:
        """The longest chain to a contact, or the longest link; zero where there is none [m]."""
        links = link_lengths(self._model)
        chains = [chain_length(self._model, links, contact) for contact in self._bounding.values()]
        return max(*chains, *links, 0.0)

    @property
    def metres_per_unit(self) -> Array:
        """(nv,) The speed that a unit of each velocity means, see `joint_metres`; not to be changed."""
        return self._metres.of(
            self._inertias(), lambda _: metres_per_unit(self._model, self._radii, self.extent)
        )

    @property
    def _radii(self) -> Array:
        return self._gyration.of(self._inertias(), lambda _: gyration(self._model))

    def _inertias(self) -> bytes:
        return np.concatenate([one.toDynamicParameters() for one in self._model.inertias]).tobytes()

    @cached_property
    def unreachable(self) -> tuple[str, ...]:
        """Names of the contacts that can never reach their surface, whatever the joints do."""
        count = len(self._contacts)
        far = [run for run, c in self._bounding.items() if out_of_reach(self._model, c, self._limited)]
        return tuple(self._contacts[i].label for first, stop in far for i in range(first, min(stop, count)))

    @cached_property
    def watched(self) -> tuple[Contact, ...]:
        """The contacts that may reach their surface."""
        unreachable = set(self.unreachable)
        return tuple(contact for contact in self._contacts if contact.label not in unreachable)

    @cached_property
    def _bounding(self) -> dict[tuple[int, int], Contact]:
        """The sphere that bounds each run, or its only contact, or spheres around the two shapes of that."""
        every, found = (*self._contacts, *self._held), {}
        for first, stop in self._runs:
            one = every[first]
            alone = one if one.pair is None else self.pairs[one.pair].bounding
            found[first, stop] = bounding_sphere(every[first:stop]) or alone
        return found

    @cached_property
    def pairs(self) -> dict[Contact, ShapePair]:
        """The two shapes of each contact of such."""
        wanted = dict.fromkeys(c.pair for c in self._contacts if c.pair is not None)
        if not wanted:
            return {}
        robot = ShapedRobot(self._model, self._geometry)
        return {contact: shape_pair(robot, contact) for contact in wanted}

    @cached_property
    def sources(self) -> tuple[str, ...]:
        """Names of what impacts and modes can be of: contacts, joint limits and joints."""
        contacts = (contact.label for contact in (*self._contacts, *self._held))
        limits = (limit.name for limit in self.limits)
        return tuple(dict.fromkeys((*contacts, *limits, *list(self._model.names)[1:])))

    @cached_property
    def joint_charts(self) -> Integers:
        """The table of the configuration space, see `joint_table`."""
        return joint_table(self._model)

    @cached_property
    def velocity_joint(self) -> Integers:
        """(nv,) the joint that each velocity belongs to."""
        return np.repeat(np.arange(self._model.njoints), np.array(self._model.nvs))

    @cached_property
    def chains(self) -> tuple[Integers, Integers]:
        """The last of the velocities that move each joint, −1 for none, and the one before each (nv,)."""
        model = self._model
        last, before = np.full(model.njoints, -1), np.arange(-1, model.nv - 1)
        for joint in range(1, model.njoints):
            start, count = model.idx_vs[joint], model.nvs[joint]
            last[joint] = above = last[model.parents[joint]]
            if count > 0:
                before[start], last[joint] = above, start + count - 1
        return last, before

    def rate_of_damping(self, damping: Array) -> float:
        """Return how fast damped joints (nv,) settle at the most, in the neutral configuration [1/s]."""
        if not damping.any():
            return 0.0
        return self._damping.of(damping.tobytes(), lambda _: self._rate_of_damping(damping))

    def _rate_of_damping(self, damping: Array) -> float:
        model = self._model
        minverse = inverse_mass(model, data_of(model), pin.neutral(model))
        minverse = np.triu(minverse) + np.triu(minverse, 1).T
        root = np.sqrt(damping)
        return float(np.linalg.eigvalsh(root[:, None] * minverse * root)[-1])

    def tables(self, contacts: tuple[Contact, ...]) -> ContactTables:
        """Return what runs need of contacts, those of the scene or others; not to be changed in place."""
        return self._tables.of(contacts, self._make_tables)

    def pair_tables(self, contacts: tuple[Contact, ...]) -> PairTables:
        """Return what runs need of contacts of two shapes; not to be changed in place."""
        return self._pair_tables.of(contacts, self._make_pair_tables)

    def _make_pair_tables(self, contacts: tuple[Contact, ...]) -> PairTables:
        pairs = [self.pairs[contact] for contact in contacts]
        sides = [side for pair in pairs for side in (pair.a, pair.b)]
        placed = [
            side.shape.vertices @ side.in_joint.rotation.T + side.in_joint.translation for side in sides
        ]
        last = np.cumsum([len(vertices) for vertices in placed])
        reaches = np.array([side.shape.reach for side in sides]).reshape(len(pairs), 2)
        return PairTables(
            np.concatenate(placed),
            np.column_stack([np.concatenate([[0], last[1:-1:2]]), last[::2], last[1::2]]),
            np.array([side.joint for side in sides], dtype=np.int64).reshape(len(pairs), 2),
            np.array([pair.a.shape.radius + pair.b.shape.radius for pair in pairs]),
            np.array([side.in_joint.act(side.shape.center) for side in sides]),
            reaches,
            np.array([motion_signs(self._model, side.joint, 0) != 0.0 for side in sides], dtype=np.int64),
            COINCIDE * reaches.sum(axis=1),
        )

    def places(self, contacts: Sequence[Contact]) -> list[tuple[Contact, list[int]]]:
        """Return each contact of two shapes among those kept for them, with the numbers of its places."""
        groups: dict[int, tuple[Contact, list[int]]] = {}
        for i, contact in enumerate(contacts):
            if contact.pair is not None:
                groups.setdefault(id(contact.pair), (contact.pair, []))[1].append(i)
        return list(groups.values())

    def dynamics_for(self, owner: object, model: pin.Model) -> RobotDynamics:
        """Return dynamics of the robot, for the scene's own model some that an earlier owner has left."""
        if model is not self._model:
            return robot_dynamics(model)
        robot = self._spare_dynamics.pop() if self._spare_dynamics else robot_dynamics(model)
        robot.refresh()
        weakref.finalize(owner, self._spare_dynamics.append, robot).atexit = False
        return robot

    def data_for(self, owner: object, model: pin.Model) -> Any:
        """Return what `data_of` does; for the scene's own model one that an earlier owner has left."""
        if model is not self._model:
            return data_of(model)
        data = self._spare_data.pop() if self._spare_data else data_of(model)
        if isinstance(data, Forest):
            data.refresh()
        weakref.finalize(owner, self._spare_data.append, data).atexit = False
        return data

    def _make_tables(self, contacts: tuple[Contact, ...]) -> ContactTables:
        model, count = self._model, len(contacts)
        parts, nowhere = [], None
        for contact in contacts:
            if contact.pair is None:
                parts.append(contact_constants(model, contact))
            else:  # a place, which is nowhere as yet
                nowhere = nowhere or contact_constants(model, contact)
                parts.append(nowhere)
        blocks: list[tuple[int, int, int]] = []
        spheres: list[Array] = []
        for first, stop in runs(contacts):
            sphere = bounding_sphere(contacts[first:stop])
            blocks.append((first, stop, -1 if sphere is None else len(spheres)))
            if sphere is not None:
                spheres.append(contact_constants(model, sphere)[2])
        return ContactTables(
            np.array([part[2] for part in parts]).reshape(count, CONSTANTS),
            np.array([part[:2] for part in parts], dtype=np.int64).reshape(count, 2),
            np.array([contact.sustained_friction for contact in contacts], dtype=float),
            np.array(blocks, dtype=np.int64).reshape(-1, 3),
            np.array(spheres).reshape(-1, CONSTANTS),
        )


class _Last(Generic[K, V]):
    """What was last made, and of what: runs ask for the same again, and comparing is cheaper than hashing."""

    def __init__(self) -> None:
        self._known: tuple[K, V] | None = None

    def of(self, key: K, make: Callable[[K], V]) -> V:
        """Return what `make` makes of a key, remade where it is not the last one."""
        if self._known is None or self._known[0] != key:
            self._known = key, make(key)
        return self._known[1]


class PairTables(NamedTuple):
    """What runs need of p pairs of shapes.

    Attributes:
        vertices: (m, 3) of the cores, in the axes of their joints.
        ranges: (p, 3) the first vertex of the first shape, of the second one, and the one after its last.
        joints: (p, 2) that carry them.
        radii: (p,) around both cores [m].
        centers: (2 p, 3) of the shapes, in the axes of their joints.
        reaches: (p, 2) largest distance of a point from them [m].
        moves: (2 p, nv) 1 for the velocities that move the shape, else 0.
        least: (p,) by what they have to stay apart [m].
    """

    vertices: Array
    ranges: Integers
    joints: Integers
    radii: Array
    centers: Array
    reaches: Array
    moves: Integers
    least: Array


class ContactTables(NamedTuple):
    """What runs need of contacts.

    Attributes:
        constants: (n, 28) see `robot._kernels.constants`.
        joints: (n, 2) of the tip and of the surface.
        friction: (n,) of sustained contact.
        blocks: (b, 3) runs of contacts looked at together: the first contact, the one after the last, and
            which sphere bounds them or −1.
        spheres: (s, 28) constants of the spheres.
    """

    constants: Array
    joints: Integers
    friction: Array
    blocks: Integers
    spheres: Array


def _sizes(model: pin.Model) -> tuple[int, int, int, int]:
    return model.nq, model.nv, model.njoints, model.nframes


def _bounds(model: pin.Model) -> tuple[bytes, bytes]:
    return model.lowerPositionLimit.tobytes(), model.upperPositionLimit.tobytes()


def runs(contacts: Sequence[Contact]) -> list[tuple[int, int]]:
    """Return first and last + 1 of the contacts, one after the other, that are of one shape and surface.

    A contact that is of no shape, or of a shape with less than `LEAST` of them, is a run alone.
    """
    found: list[tuple[int, int]] = []
    first = 0
    for i in range(1, len(contacts) + 1):
        if i < len(contacts) and _together(contacts[first], contacts[i]):
            continue
        found += [(first, i)] if i - first >= LEAST else [(k, k + 1) for k in range(first, i)]
        first = i
    return found


def _together(one: Contact, other: Contact) -> bool:
    same = one.shape is not None and one.shape == other.shape and one.frame == other.frame
    return same and one.pair is None and one.plane == other.plane


def bounding_sphere(contacts: Sequence[Contact]) -> Contact | None:
    """Return a sphere that bounds the tips of a run, as a contact of its own; None for one alone."""
    if len(contacts) == 1:
        return None
    centres = np.array([contact.offset for contact in contacts])
    centre = 0.5 * (centres.min(axis=0) + centres.max(axis=0))
    away = np.linalg.norm(centres - centre, axis=1)
    radius = float(max(d + c.radius + c.rim for d, c in zip(away.tolist(), contacts, strict=True)))
    x, y, z = centre.tolist()
    return replace(
        contacts[0],
        offset=(x, y, z),
        radius=radius * (1.0 + ROUNDING),
        rim=0.0,
        name=f"{contacts[0].shape} on {contacts[0].plane.label}",
    )
