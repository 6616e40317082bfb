"""Data of a scene that do not change from run to run, computed on first use."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
import pinocchio as pin

from ..arrays import Array, Bools, Integers
from ..geometry._kernels.constants import ABSENT, CONSTANTS, KIND
from ..geometry.plane import Plane
from ..geometry.tolerances import COINCIDE
from ..robot.contact import Contact, contact_constants
from ..robot.forest import data_of, inverse_mass
from ..robot.joint_limits import JointLimit, joint_limits
from ..robot.names import ShapedRobot, frame_id, motion_signs
from ..robot.pinocchio_bridge import RobotDynamics, robot_dynamics
from ..robot.shape_pair import ShapePair, shape_pair
from ._kernels.tolerances import ROUNDING
from .joint_charts import joint_table
from .joint_metres import gyration, metres_per_unit
from .level_faces import law_of, within_hull
from .reach import chain_length, link_lengths, out_of_reach

K = TypeVar("K")
V = TypeVar("V")

LEAST = 4
"""Least number of contacts of a shape for which a common bounding sphere saves time."""


class SceneLayout:
    """Tables and bounds of a scene.

    Args:
        model: The model, which does not change.
        contacts: Unilateral contacts.
        held: Bilateral contacts.
        limited: Whether the joint limits act.
        geometry: Collision shapes, for contacts of two shapes.
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
        self._runs = runs((*self._contacts, *self._held))
        self._spare_dynamics: list[RobotDynamics] = []
        self._spare_data: list[Any] = []
        self._damping: _Last[bytes, float] = _Last()
        self._tables: _Last[tuple[Contact, ...], ContactTables] = _Last()
        self._pair_tables: _Last[tuple[Contact, ...], PairTables] = _Last()

    @cached_property
    def limits(self) -> tuple[JointLimit, ...]:
        """The finite limits of joints with scalar coordinates."""
        return joint_limits(self._model)

    @cached_property
    def extent(self) -> float:
        """The robot's size L [m]: its longest chain or link, else largest radius of gyration, else 1 m."""
        return self._longest or float(self._radii.max(initial=0.0)) or 1.0

    @cached_property
    def _longest(self) -> float:
        """Length of the longest chain to a contact, or of the longest link [m]; zero if there is none."""
        links = link_lengths(self._model)
        chains = [chain_length(self._model, links, contact) for contact in self._bounding.values()]
        return max(*chains, *links, 0.0)

    @cached_property
    def metres_per_unit(self) -> Array:
        """(nv,) κ of (10.6), the metres per unit of each velocity; not to be changed in place."""
        return metres_per_unit(self._model, self._radii, self.extent)

    @cached_property
    def _radii(self) -> Array:
        return gyration(self._model)

    @cached_property
    def unreachable(self) -> tuple[str, ...]:
        """Names of the contacts that cannot reach their surface at any configuration."""
        count = len(self._contacts)
        far = [run for run, c in self._bounding.items() if out_of_reach(self._model, c, self._limited)]
        return tuple(self._contacts[i].label for first, stop in far for i in range(first, min(stop, count)))

    @cached_property
    def watched(self) -> tuple[Contact, ...]:
        """The contacts that may reach their surface before others do."""
        omitted = {*self.unreachable, *self._inner}
        return tuple(contact for contact in self._contacts if contact.label not in omitted)

    @property
    def _inner(self) -> Iterator[str]:
        """The names of corners that lie between those of other shapes of one body, above one plane. (15.3)"""
        alike: dict[tuple[object, ...], list[tuple[Contact, Array]]] = {}
        for one in self._contacts:
            point = one.radius == one.rim == 0.0 and one.pair is None
            if one.shape is not None and point and isinstance(one.plane, Plane):
                frame = self._model.frames[frame_id(self._model, one.frame)]
                key = frame.parentJoint, one.plane, *law_of(one)
                alike.setdefault(key, []).append((one, frame.placement.act(np.array(one.offset))))
        for every in alike.values():
            if len({one.shape for one, _ in every}) > 1:
                inner = within_hull(np.array([point for _, point in every]))
                yield from (every[k][0].label for k in np.flatnonzero(inner).tolist())

    @cached_property
    def _bounding(self) -> dict[tuple[int, int], Contact]:
        """The bounding contact of each run: a sphere, its only contact, or the spheres of two shapes."""
        every, found = (*self._contacts, *self._held), {}
        for first, stop in self._runs:
            one = every[first]
            alone = one if one.pair is None else self.pairs[one.pair].bounding
            found[first, stop] = bounding_sphere(every[first:stop]) or alone
        return found

    @cached_property
    def pairs(self) -> dict[Contact, ShapePair]:
        """The two shapes of each contact between shapes."""
        wanted = dict.fromkeys(c.pair for c in self._contacts if c.pair is not None)
        if not wanted:
            return {}
        robot = ShapedRobot(self._model, self._geometry)
        return {contact: shape_pair(robot, contact) for contact in wanted}

    @cached_property
    def sources(self) -> tuple[str, ...]:
        """Names of the possible sources of impacts and modes: contacts, joint limits and joints."""
        contacts = (contact.label for contact in (*self._contacts, *self._held))
        limits = (limit.name for limit in self.limits)
        return tuple(dict.fromkeys((*contacts, *limits, *list(self._model.names)[1:])))

    @cached_property
    def joint_charts(self) -> Integers:
        """Table of the configuration space, see `joint_table`."""
        return joint_table(self._model)

    @cached_property
    def velocity_joint(self) -> Integers:
        """(nv,) Joint of each velocity."""
        return np.repeat(np.arange(self._model.njoints), np.array(self._model.nvs))

    @cached_property
    def gap_coordinates(self) -> Bools:
        """(nq,) Whether gaps of contacts or joint limits depend on each coordinate."""
        model, ends = self._model, set[int]()
        for contact in (*self._contacts, *self._held):
            if contact.pair is not None:
                ends |= {self.pairs[contact.pair].a.joint, self.pairs[contact.pair].b.joint}
                continue
            frames = [frame_id(model, key) for key in (contact.frame, contact.plane.body) if key is not None]
            ends |= {model.frames[frame].parentJoint for frame in frames}
        found = np.zeros(model.nq, dtype=np.bool_)
        for joint in {joint for end in ends for joint in list(model.supports[end])[1:]}:
            found[model.idx_qs[joint] : model.idx_qs[joint] + model.nqs[joint]] = True
        found[[limit.index_q for limit in self.limits]] = True
        return found

    @cached_property
    def chains(self) -> tuple[Integers, Integers]:
        """(nj,) Last velocity that moves each joint, or −1; (nv,) the one before each velocity, or −1."""
        model = self._model
        last, before = np.full(model.njoints, -1), np.arange(-1, model.nv - 1)
        for joint in range(1, model.njoints):
            start, count = model.idx_vs[joint], model.nvs[joint]
            last[joint] = above = last[model.parents[joint]]
            if count > 0:
                before[start], last[joint] = above, start + count - 1
        return last, before

    def rate_of_damping(self, damping: Array) -> float:
        """Return the largest decay rate of damped joints in the neutral configuration [1/s]."""
        if not damping.any():
            return 0.0
        return self._damping.of(damping.tobytes(), lambda _: self._rate_of_damping(damping))

    def _rate_of_damping(self, damping: Array) -> float:
        model = self._model
        minverse = inverse_mass(model, data_of(model), pin.neutral(model))
        root = np.sqrt(damping)
        return float(np.linalg.eigvalsh(root[:, None] * minverse * root)[-1])

    def tables(self, contacts: tuple[Contact, ...]) -> ContactTables:
        """Return the tables of contacts, those of the scene or others; not to be changed in place."""
        return self._tables.of(contacts, self._make_tables)

    def pair_tables(self, contacts: tuple[Contact, ...]) -> PairTables:
        """Return the tables of contacts between two shapes; not to be changed in place."""
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
            np.array([pair.radius for pair in pairs]),
            np.array([side.in_joint.act(side.shape.center) for side in sides]),
            reaches,
            np.array([motion_signs(self._model, side.joint, 0) != 0.0 for side in sides], dtype=np.int64),
            COINCIDE * reaches.sum(axis=1),
        )

    def places(self, contacts: Sequence[Contact]) -> list[tuple[Contact, list[int]]]:
        """Return each contact between two shapes, and the numbers of the contacts reserved for its points."""
        groups: dict[int, tuple[Contact, list[int]]] = {}
        for i, contact in enumerate(contacts):
            if contact.pair is not None:
                if id(contact.pair) not in groups:
                    groups[id(contact.pair)] = contact.pair, []
                groups[id(contact.pair)][1].append(i)
        return list(groups.values())

    def dynamics_for(self, owner: object, model: pin.Model) -> RobotDynamics:
        """Return the dynamics of a model; those of the scene's own model are reused by later owners."""
        if model is not self._model:
            return robot_dynamics(model)
        robot = self._spare_dynamics.pop() if self._spare_dynamics else robot_dynamics(model)
        weakref.finalize(owner, self._spare_dynamics.append, robot).atexit = False
        return robot

    def data_for(self, owner: object, model: pin.Model) -> Any:
        """Return the data of a model; those of the scene's own model are reused by later owners."""
        if model is not self._model:
            return data_of(model)
        data = self._spare_data.pop() if self._spare_data else data_of(model)
        weakref.finalize(owner, self._spare_data.append, data).atexit = False
        return data

    def _make_tables(self, contacts: tuple[Contact, ...]) -> ContactTables:
        model, count = self._model, len(contacts)
        nowhere = np.zeros(CONSTANTS)  # reserved for a pair of shapes that does not touch yet
        nowhere[KIND] = ABSENT
        parts = [
            contact_constants(model, contact) if contact.pair is None else (0, 0, nowhere)
            for contact in contacts
        ]
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
    """Cache of one value: runs mostly ask for the same key again, and comparing is cheaper than hashing."""

    def __init__(self) -> None:
        self._known: tuple[K, V] | None = None

    def of(self, key: K, make: Callable[[K], V]) -> V:
        """Return `make(key)`, computed again only if the key differs from the last one."""
        if self._known is None or self._known[0] != key:
            self._known = key, make(key)
        return self._known[1]


class PairTables(NamedTuple):
    """Tables of p pairs of convex shapes.

    Attributes:
        vertices: (m, 3) vertices of the cores, in the axes of their joints [m].
        ranges: (p, 3) indices of the first vertex of the first and second shape, and one past the last.
        joints: (p, 2) joints that carry the shapes.
        radii: (p,) sum of the radii that round both cores [m].
        centers: (2 p, 3) centers of the shapes, in the axes of their joints [m].
        reaches: (p, 2) largest distance of a point from the center [m].
        moves: (2 p, nv) 1 for the velocities that move the shape, else 0.
        least: (p,) gap above which a pair counts as apart [m].
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
    """Tables of n contacts.

    Attributes:
        constants: (n, `CONSTANTS`) see `geometry._kernels.constants`.
        joints: (n, 2) joints of the tip and of the surface.
        friction: (n,) coefficients of friction in sustained contact.
        blocks: (b, 3) runs of contacts: the first contact, one past the last, and the index of the bounding
            sphere or −1.
        spheres: (s, `CONSTANTS`) constants of the bounding spheres.
    """

    constants: Array
    joints: Integers
    friction: Array
    blocks: Integers
    spheres: Array


def runs(contacts: Sequence[Contact]) -> list[tuple[int, int]]:
    """Return the runs (first, last + 1) of consecutive contacts of one shape with one surface.

    A contact of no shape, or of a shape with fewer than `LEAST` contacts, is a run of its own.
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
    if one.rim > 0.0 or other.rim > 0.0 or one.of_rim != other.of_rim:
        return False
    same = (one.shape or one.of_rim) is not None and one.shape == other.shape and one.frame == other.frame
    return same and one.pair is None and one.plane == other.plane


def bounding_sphere(contacts: Sequence[Contact]) -> Contact | None:
    """Return a contact whose tip is a sphere that bounds the tips of a run; None for a single contact."""
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
