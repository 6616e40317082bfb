"""Contacts of pairs of convex shapes in time steps: the corners of their contact patches. (theory.md, 16)"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from ..arrays import Array, Bools, Integers
from ..geometry._kernels.box_patch import MOST
from ..geometry._kernels.constants import KIND, PLANE, POINT, RADIUS, SIZE, SPHERE, TIP
from ..geometry.convex_pair import Touch, ties
from ..geometry.patch import Patch, patch, patch_along
from ..geometry.tolerances import FACING
from ..robot.contact import Contact
from ..robot.corner_motion import Corner
from ..robot.forest import forward_kinematics
from ..robot.shape_pair import CarriedShape, ShapePair, point_contact
from ._kernels import passing
from ._kernels.facing_boxes import BOX, HALF, REACH, FacingBoxes, face_boxes, fill_contact
from .dynamics import SceneDynamics
from .layout import SceneLayout
from .level_faces import points_between, with_common_faces
from .touching_points import Reserved, TouchingPoints


@dataclass(eq=False)
class _Places:
    """The contacts reserved for a pair of shapes.

    Attributes:
        pair: The shapes.
        numbers: Numbers of the contacts.
        used: How many of them represent corners of the present patch.
        corners: These corners, by number of the contact.
    """

    pair: ShapePair
    numbers: list[int]
    used: int = 0
    corners: dict[int, Corner] = field(default_factory=dict)


class _Spheres(NamedTuple):
    """Spheres that enclose the shapes of some pairs.

    Attributes:
        sides: (p, 2) numbers of the spheres of each pair.
        joints: (k,) joints that carry them.
        centres: (k, 3) their centres in the axes of the joints [m].
        reach: (k,) their radii [m].
    """

    sides: Integers
    joints: Integers
    centres: Array
    reach: Array


class FacingShapes:
    """Assigns the corners of the patches of pairs of shapes to the contacts reserved for these pairs.

    Args:
        model: The model.
        dynamics: The dynamics, whose contacts and workspace are modified.
        layout: The layout of the scene.
        shapes: The pairs, the contacts reserved for their points, and the constants of these while open.
        rests: (nj,) whether each joint is at rest; patches between joints at rest are not recomputed.
        near: Gap below which patches are computed at any speed [m].

    Attributes:
        boxes: Whether there are pairs of boxes, so that `place` evaluates the kinematics of the workspace.
        ties: (contacts,) whether another direction than its normal may come to separate its shapes, so that
            the normal is known at the instant of contact only.
    """

    def __init__(
        self,
        model: pin.Model,
        dynamics: SceneDynamics,
        layout: SceneLayout,
        shapes: TouchingPoints,
        rests: Bools,
        near: float,
    ) -> None:
        self._model, self._layout, self._rests = model, layout, rests
        self._dynamics, self._work = dynamics, dynamics.work
        self._near, self._gravity = near, float(np.linalg.norm(model.gravity.linear))
        self._struck: dict[int, Contact] = {}
        work, every = self._work, shapes.places
        self._blanks, self._kept = shapes.blanks, shapes.reserved
        self.ties = np.zeros(work.contacts, dtype=bool)
        for pair, numbers in every:
            work.contact_joints[numbers] = pair.a.joint, pair.b.joint
        self._ends = work.contact_joints[self._kept]
        boxes = np.array([_is_box(pair.a) and _is_box(pair.b) for pair, _ in every], dtype=bool)
        self._pairs = [_Places(*every[p]) for p in np.flatnonzero(~boxes).tolist()]
        joints, table, pairs = self._solids = _solids([pair for pair, _ in every], dynamics)
        used, sides = np.unique(pairs[: len(every)][~boxes], return_inverse=True)
        centres, reach = table[used, : passing.REACH], table[used, passing.REACH]
        self._spheres = _Spheres(sides.reshape(-1, 2), joints[used], centres, reach)
        self._set_boxes([every[p] for p in np.flatnonzero(boxes).tolist()])
        given = [(one.pair, dynamics.contacts[one.numbers[0]]) for one in (*self._box_places, *self._pairs)]
        self._common = np.full(len(given), -1)  # number of the set of pairs with common faces, boxes first
        for k, group in enumerate(with_common_faces(given)):
            self._common[group] = k

    @cached_property
    def _data(self) -> Any:
        return self._layout.data_for(self, self._model)

    def _set_boxes(self, pairs: Reserved) -> None:
        """Set the tables of pairs of boxes, see `facing_boxes.face_boxes`."""
        boxes = {_key(side): side for pair, _ in pairs for side in (pair.a, pair.b)}
        number = {key: k for k, key in enumerate(boxes)}
        self._box_places = [_Places(*one) for one in pairs]
        self._decided_boxes: dict[int, _Places] = {}  # whose corners are not those of the kernel
        self._joints = np.array([box.joint for box in boxes.values()], dtype=np.int64)
        self._boxes = np.zeros((len(boxes), BOX))
        for row, box in zip(self._boxes, boxes.values(), strict=True):
            row[:9], row[9:HALF] = box.in_joint.rotation.T.ravel(), box.in_joint.translation
            row[HALF:REACH], row[REACH] = box.shape.collision.halfSide, box.shape.reach
        self._ranges = np.array(
            [
                (number[_key(pair.a)], number[_key(pair.b)], numbers[0], len(numbers))
                for pair, numbers in pairs
            ],
            dtype=np.int64,
        ).reshape(-1, 4)
        count = len(pairs)
        self.boxes = count > 0
        points, others = np.zeros((2, count, MOST, 3))
        used, kinds = np.zeros(count, dtype=np.int64), np.zeros((count, MOST), dtype=np.int64)
        self._facing = FacingBoxes(
            used, np.zeros((count, 3)), points, others, kinds, np.zeros((count, 2, 3)), np.zeros(count)
        )

    def clear(self) -> None:
        """Remove the corners from all reserved contacts."""
        self._end_impact()
        self._work.contact_constants[self._kept] = self._blanks[self._kept]
        self._work.contact_joints[self._kept] = self._ends
        self._facing.used[:] = 0
        for places in self._pairs:
            places.used = 0

    def _end_impact(self) -> None:
        """Undo the changes of `dynamics.contacts` by `_strike`."""
        for i, blank in self._struck.items():
            self._dynamics.contacts[i] = blank
        self._struck.clear()

    def place(self, q: Array, v: Array, h: float, touching: float = -1.0) -> None:
        """Compute the patches of pairs that may touch within a time, and assign their corners to contacts.

        Args:
            q: (nq,) configuration.
            v: (nv,) velocity.
            h: The time [s].
            touching: For impacts: the largest gap of shapes in contact [m]; `dynamics.contacts` is set too.
                Negative: not for impacts.
        """
        self._end_impact()
        self._decided_boxes.clear()
        self._place(q, v, h, touching)
        if self._common.max(initial=-1) >= 0:
            self._omit_between(touching >= 0.0)

    def _place(self, q: Array, v: Array, h: float, touching: float) -> None:
        near = self._near + 8.0 * self._gravity * h * h
        if self.boxes:
            face_boxes(
                *(self._work, q, v, h, near, touching, self._joints, self._boxes, self._ranges),
                *(self._blanks, self._rests, self.ties, self._facing),
            )
            self._dynamics.check()
        facing = np.flatnonzero(self._facing.used)
        if touching < 0.0:
            facing = facing[self.ties[self._ranges[facing, 2]]]
        if facing.size or self._pairs:
            forward_kinematics(self._model, self._data, q, v)
        for p in facing.tolist():
            self._decide_boxes(p, touching)
        if not self._pairs:
            return
        joints = self._spheres.joints[self._spheres.sides]
        rests: Bools = self._rests[joints[:, 0]] & self._rests[joints[:, 1]]
        close = self._may_touch(h, near, touching) & ~rests
        used = np.array([places.used > 0 for places in self._pairs])
        for p in np.flatnonzero(close | (used & ((touching >= 0.0) | ~rests))).tolist():
            places = self._pairs[p]
            if rests[p]:
                for i in places.numbers[: places.used]:
                    corner = places.corners[i]
                    self._strike(places.pair, i, corner.normal, (corner.point, corner.other))
                continue
            within = touching if touching >= 0.0 else self._within[p]
            placed = places.pair.placed(self._data)
            faces = patch(*placed, within) if close[p] else None
            if faces is not None and places.pair.radius == 0.0:
                # in steps, the distance from the start to the midpoint
                depth = within if touching >= 0.0 else 0.5 * within
                others = np.array([one.normal for one in ties(*placed, faces.normal, depth)])
                self.ties[places.numbers] = tie = bool((others @ faces.normal < FACING).any())
                if tie:
                    faces = self._decided(places.pair, faces, within, touching)
            self._fill(places, faces, touching >= 0.0)

    def _may_touch(self, h: float, near: float, touching: float) -> Bools:
        """Return which pairs (p,) that are not both boxes may touch, by the spheres that enclose the shapes.

        Arguments as in `place`, with `near` [m] added to the path in the time; sets the distance `_within`
        of each pair at which its shapes may touch within it.
        """
        sides, joints, centres, reach = self._spheres
        turns, shifts = np.empty((len(joints), 3, 3)), np.empty((len(joints), 3))
        motions = np.empty((len(joints), 6))
        for k, joint in enumerate(joints.tolist()):
            pose = self._data.oMi[joint]
            turns[k], shifts[k], motions[k] = pose.rotation, pose.translation, self._data.v[joint].vector
        arm = np.linalg.norm(centres, axis=1) + reach
        speeds = np.linalg.norm(motions[:, :3], axis=1) + arm * np.linalg.norm(motions[:, 3:], axis=1)
        centres = np.einsum("kij,kj->ki", turns, centres) + shifts
        self._within = h * speeds[sides].sum(axis=1) + near
        apart = np.linalg.norm(centres[sides[:, 0]] - centres[sides[:, 1]], axis=1)
        within = touching if touching >= 0.0 else self._within
        return np.asarray(apart <= reach[sides].sum(axis=1) + within, dtype=bool)

    def may_pass(self, q: Array, v: Array, h: float) -> bool:
        """Return whether solids may pass through each other in a step (h) with midpoint q and velocity v."""
        return len(self._solids[0]) > 0 and passing.may_pass(self._work, q, v, h, *self._solids)

    def corners(self) -> dict[int, Corner]:
        """Return the corners that the last `place` assigned, by number of the contact."""
        found: dict[int, Corner] = {}
        for p in np.flatnonzero(self._used).tolist():
            found |= self._corners_of(p)
        return found

    @property
    def _used(self) -> Integers:
        """(p,) Number of the corners of each pair, boxes first."""
        others = np.array([places.used for places in self._pairs], dtype=np.int64)
        return np.concatenate([self._facing.used, others])

    def _corners_of(self, p: int) -> dict[int, Corner]:
        """Return the corners of a pair, boxes first, by number of the contact."""
        boxes = len(self._box_places)
        places = self._decided_boxes.get(p) if p < boxes else self._pairs[p - boxes]
        if places is not None:
            return {i: places.corners[i] for i in places.numbers[: places.used]}
        used, *faces, _ = self._facing
        normal, points, others, kinds, edges = (one[p].copy() for one in faces)
        pair, first = self._box_places[p].pair, int(self._ranges[p, 2])
        return {
            first + k: Corner(pair, normal, points[k], others[k], int(kinds[k]), edges)
            for k in range(int(used[p]))
        }

    def _omit_between(self, contacts: bool) -> None:
        """Omit the corners that lie between those of other shapes of the same two bodies. (15.3)

        Args:
            contacts: Whether `dynamics.contacts` is set too.
        """
        common = np.where(self._used > 0, self._common, -1)
        for group in np.flatnonzero(np.bincount(common + 1)[1:] > 1).tolist():
            found: dict[int, Corner] = {}
            for p in np.flatnonzero(common == group).tolist():
                found |= self._corners_of(p)
            every = list(found.values())
            pair = every[0].pair
            if not contacts and self._rests[[pair.a.joint, pair.b.joint]].all():
                continue  # as when they came to rest
            normals = np.array([one.normal for one in every])
            points, others = np.array([(one.point, one.other) for one in every]).transpose(1, 0, 2)
            gaps = np.einsum("ki,ki->k", normals, points - others)
            swapped = [one.pair.a.joint != pair.a.joint for one in every]
            normals[swapped] *= -1.0
            points[swapped] = others[swapped]  # of the same body
            between = points_between(normals, points, gaps)
            for i in (i for i, lies in zip(found, between.tolist(), strict=True) if lies):
                self._work.contact_constants[i] = self._blanks[i]
                if contacts:
                    self._dynamics.contacts[i] = self._struck.pop(i)

    def _decide_boxes(self, p: int, touching: float) -> None:
        """Replace the patch of a pair of boxes by that of `_decided`; set its contacts for impacts.

        `touching` as in `place`.
        """
        first, places = int(self._ranges[p, 2]), self._box_places[p]
        used, normals, points, others, kinds, edges, within = self._facing
        count, normal = int(used[p]), normals[p].copy()
        if not self.ties[first]:
            for k in range(count):
                self._strike(places.pair, first + k, normal, (points[p, k], others[p, k]))
            return
        ends = points[p, :count].copy(), others[p, :count].copy()
        gaps = (ends[0] - ends[1]) @ normal
        found = Patch(normal, *ends, gaps, kinds[p, :count].copy(), edges[p].copy())
        decided = self._decided(places.pair, found, float(within[p]), touching)
        if decided is found and touching < 0.0:  # as the kernel has filled it
            return
        places.used = count
        self._fill(places, decided, touching >= 0.0)
        used[p] = places.used
        self._decided_boxes[p] = places

    def _fill(self, places: _Places, found: Patch | None, contacts: bool) -> None:
        """Assign the corners of a patch to the contacts of a pair, as the kernel does for boxes."""
        work, pair, count = self._work, places.pair, 0
        if found is not None:
            count = min(len(found.gaps), len(places.numbers))
            chosen = np.argsort(found.gaps, kind="stable")[:count]
            for i, k in zip(places.numbers, np.sort(chosen).tolist(), strict=False):
                ends = found.points[k], found.others[k]
                given = found.normal, *ends, int(found.kinds[k]), found.edges
                self._write(pair, i, given)
                places.corners[i] = Corner(pair, *given)
                if contacts:
                    self._strike(pair, i, found.normal, ends)
        for i in places.numbers[count : places.used]:
            work.contact_constants[i] = self._blanks[i]
        places.used = count

    def _write(self, pair: ShapePair, i: int, given: tuple[Array, Array, Array, int, Array]) -> None:
        """Fill the constants of contact i from its normal, points, kind and edges, see `fill_contact`."""
        tip, base = (
            np.concatenate([pose.rotation.T.ravel(), pose.translation])
            for pose in (self._data.oMi[pair.a.joint], self._data.oMi[pair.b.joint])
        )
        radii = pair.a.shape.radius, pair.b.shape.radius
        fill_contact(self._work.contact_constants[i], tip, base, *given, *radii)

    def _decided(self, pair: ShapePair, found: Patch, within: float, touching: float) -> Patch | None:
        """Return the patch of two shapes that several directions may separate, by their motion.

        Args:
            pair: The shapes.
            found: Their patch along the direction of the least overlap.
            within: Largest gap of points in the patch [m].
            touching: See `place`.

        Returns:
            None if they touch, but stay apart along a direction, or if they do not touch yet at an impact:
            other impacts of this instant may decide. For shapes that touch, the patch with their
            `normal_of_contact`; for shapes that overlap, that along the direction of `overlap`.
        """
        least = float(found.gaps.min())
        if least > self._near:
            return None if touching >= 0.0 else found
        if touching < 0.0 and least < -self._near:
            overlap = pair.overlap(self._data, found.normal, 0.5 * within)
            return patch_along(*pair.placed(self._data), overlap, within)
        given = self._data, found.normal, found.points, self._work.resting_speed
        normal, apart = pair.normal_of_contact(*given, self._near, touching)
        if apart:
            return None
        if normal is found.normal:
            return found
        return found._replace(normal=normal, kinds=np.full_like(found.kinds, PLANE))

    def _strike(self, pair: ShapePair, i: int, normal: Array, ends: tuple[Array, Array]) -> None:
        """Replace a contact of `dynamics.contacts` by that of two points, for an impact."""
        core = Touch(
            "vertex-face",
            ends[0] + pair.a.shape.radius * normal,
            ends[1] - pair.b.shape.radius * normal,
            (0, 0),
        )
        blank = self._struck.setdefault(i, self._dynamics.contacts[i])
        self._dynamics.contacts[i] = point_contact(pair, self._data, (), normal, core, blank).instant


def _solids(every: list[ShapePair], dynamics: SceneDynamics) -> tuple[Integers, Array, Integers]:
    """Return the tables of `may_pass`: joints (k,) and dimensions (k, …) of solids, their pairs (p, 2)."""
    numbers: dict[Any, int] = {}
    joints: list[int] = []
    measures: list[list[float]] = []
    pairs: list[tuple[int, int]] = []

    def number(key: Any, joint: int, centre: list[float], reach: float, arm: float, thickness: float) -> int:
        numbers[key] = len(joints)
        joints.append(joint)
        measures.append([*centre, reach, arm, thickness])
        return numbers[key]

    def of_shape(one: CarriedShape) -> int:
        key, shape = _key(one), one.shape
        if key in numbers:
            return numbers[key]
        arm = shape.reach if len(shape.vertices) > 1 else 0.0
        centre = one.in_joint.act(shape.center).tolist()
        return number(key, one.joint, centre, shape.reach, arm, shape.half_thickness)

    pairs += [(of_shape(pair.a), of_shape(pair.b)) for pair in every]
    work, contacts = dynamics.work, dynamics.contacts
    for i in np.flatnonzero(work.contact_constants[:, KIND] == SPHERE).tolist():
        if contacts[i].pair is None:
            (tip, base), row = work.contact_joints[i].tolist(), work.contact_constants[i].tolist()
            ball = number(None, tip, row[TIP : TIP + 3], row[RADIUS], 0.0, row[RADIUS])
            pairs.append((ball, number(None, base, row[POINT : POINT + 3], row[SIZE], 0.0, row[SIZE])))
    table = np.array(measures).reshape(-1, passing.SOLID_NUMBERS)
    return np.array(joints, dtype=np.int64), table, np.array(pairs, dtype=np.int64).reshape(-1, 2)


def _is_box(one: CarriedShape) -> bool:
    return type(one.shape.collision).__name__ == "Box"


def _key(box: CarriedShape) -> tuple[int, bytes, int]:
    return box.joint, box.in_joint.homogeneous.tobytes(), id(box.shape)
