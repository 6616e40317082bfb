"""Touching pairs of convex shapes in event-driven steps, each represented by contacts of single points."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin

from ..arrays import Array, Integers
from ..errors import InputError, IrregularMotionError
from ..geometry.convex_pair import Touch, between_faces, follow, gap, touches
from ..geometry.convex_shape import PlacedShape
from ..geometry.lines import FacingEdge
from ..geometry.tolerances import LOCAL
from ..robot.contact import contact_constants
from ..robot.forest import forward_kinematics
from ..robot.shape_pair import PointContact, ShapePair, point_contact
from ._kernels.contact_forces import FREE
from ._kernels.tolerances import START_ROUNDING
from .dynamics import SceneDynamics
from .hybrid_state import HybridState
from .layout import SceneLayout
from .level_faces import with_common_faces
from .pairs_apart import PairsApart
from .watched_pair import NOTHING, Located, Watched, between_others

Placed = tuple[PlacedShape, PlacedShape]


MOST_TOGETHER = 100.0
"""Largest ratio of the gap rates of points that touch together, as an edge turns about its end."""


Reserved: TypeAlias = list[tuple[ShapePair, list[int]]]
"""Pairs of shapes, and the numbers of the contacts reserved for the points of each."""

_NONE = np.zeros(0, dtype=np.int64)


class TouchingPoints:
    """The pairs of convex shapes of one run, and the contacts that represent their points in contact.

    The reserved contacts in `dynamics` and its workspace are set here.

    Attributes:
        tolerance: Gap up to which shapes touch [m].
        places: The pairs, and the contacts reserved for their points.
        reserved: Numbers of these contacts.
        blanks: (n, …) constants of all contacts while no shapes touch.
    """

    def __init__(
        self, model: pin.Model, layout: SceneLayout, dynamics: SceneDynamics, state: HybridState
    ) -> None:
        self._model, self._layout, self._state = model, layout, state
        self._dynamics, self._work = dynamics, dynamics.work
        self.tolerance = 0.0
        groups, work = layout.places(dynamics.contacts), self._work
        pairs = tuple(pair for pair, _ in groups)
        if pairs:
            self._apart = PairsApart(model, layout, pairs)
            self._moves = layout.pair_tables(pairs).moves.reshape(len(pairs), 2, model.nv) != 0
        self.places = [(layout.pairs[contact], numbers) for contact, numbers in groups]
        self.reserved = np.array([i for _, numbers in groups for i in numbers], dtype=np.int64)
        self.blanks = work.contact_constants.copy()
        self._open = tuple(dynamics.contacts)
        laws = (self._open[numbers[0]] for _, numbers in self.places)
        self._common = with_common_faces(zip((pair for pair, _ in self.places), laws, strict=True))

    @cached_property
    def _data(self) -> Any:
        return self._layout.data_for(self, self._model)

    def __bool__(self) -> bool:
        return bool(self.places)

    @property
    def directions(self) -> Array | None:
        """(p, 3) Separating directions, which steps change in place; None without pairs."""
        return self._apart.directions if self.places else None

    def continue_with(self, directions: Array | None) -> None:
        """Restore the separating directions (p, 3), and the contacts of the present state."""
        if directions is not None:
            self._apart.directions[:] = directions
        for watched in self._touching():
            for i, point in watched.acting.items():
                self._dynamics.contacts[i] = point.instant

    def _watched(self, number: int) -> Watched:
        return Watched(number, *self.places[number], self._moves[number], self._state)

    def _touching(self) -> list[Watched]:
        """Return the pairs that touch."""
        return [self._watched(number) for number in sorted(self._state.touching)]

    # ---- states

    def _set(self, q: Array) -> None:
        forward_kinematics(self._model, self._data, q)

    def start(self, q: Array, v: Array, rounding: float, left: Callable[[Any], Any]) -> None:
        """Set the contacts of the pairs that touch at the start of a motion.

        Args:
            q: (nq,) configuration.
            v: (nv,) velocity.
            rounding: Overlap that is taken as zero [m].
            left: Returns the largest overlap that time steps may leave [m] for a gap rate [m/s]; such an
                overlap is described in `state.overlap`.

        Raises:
            InputError: A pair overlaps by more.
        """
        forward_kinematics(self._model, self._data, q, v)
        near = self._apart.at(q) <= rounding
        for number in np.flatnonzero(near).tolist():
            watched = self._watched(number)
            placed = watched.pair.placed(self._data)
            found = gap(*placed)
            if found.value < -rounding:
                a, b = watched.pair.a.name, watched.pair.b.name
                overlap = f"q0: {a!r} starts {-found.value:.6g} m inside {b!r}"
                if -found.value > left(self._fastest(watched, placed, found.normal)):
                    raise InputError(
                        f"{overlap}; start with the shapes apart, or leave out the contact {watched.label!r}",
                        field="q0",
                        value=found.value,
                    )
                self._state.overlap = overlap
            if found.value <= rounding:
                points, normal, apart = self._touching_along(watched, placed, found.normal, rounding)
                if not apart:
                    self._add(watched, points, placed, normal)
        self._omit_between()

    def rest(self, q: Array, v: Array, acceleration: Array) -> list[int]:
        """Set the contacts of edges and corners at rest that carry a force; return their numbers.

        These are in contact if they approach each other by the acceleration (nv,) without their contact.
        """
        filled: list[int] = []
        noise = self._work.rtol * self._dynamics.fastest(acceleration)
        near = np.flatnonzero(self._apart.at(q) <= START_ROUNDING).tolist()
        for watched in (self._watched(number) for number in near if number not in self._state.touching):
            forward_kinematics(self._model, self._data, q, v)
            placed = watched.pair.placed(self._data)
            found = gap(*placed)
            touching = touches(*placed, found.normal, START_ROUNDING)
            points = np.array([touch.point for touch in touching]).reshape(-1, 3)
            speeds = np.abs(watched.pair.relative_velocity(self._data)(points))
            if not touching or found.value > START_ROUNDING or speeds.max() > self._work.resting_speed:
                continue
            forward_kinematics(self._model, self._data, q, acceleration)
            _, apart = watched.pair.normal_of_contact(self._data, found.normal, points, noise)
            if not apart:  # any normal that separates them lasts as long as they carry a force
                filled += self._add(watched, touching, placed, found.normal)
        if filled:
            self._omit_between()
        return self._filled(filled)

    def _fastest(self, watched: Watched, placed: Placed, normal: Array) -> float:
        """Return the least rate of a corner's height over the other shape along the normal [m/s]."""
        corners = np.concatenate([placed[0].vertices, placed[1].vertices])
        return float((watched.pair.relative_velocity(self._data)(corners) @ normal).min())

    def clear(self) -> None:
        """Remove the contacts of all pairs."""
        work, numbers = self._work, self.reserved
        self._dynamics.contacts[:] = self._open
        work.contact_constants[numbers], work.contact_joints[numbers] = self.blanks[numbers], 0
        work.modes[numbers] = FREE
        self._state.touching = {}

    def restart(self, q: Array, v: Array, within: float) -> list[int]:
        """Set the contacts of the pairs whose gap or overlap is within a distance [m]; return their numbers.

        Raises:
            IrregularMotionError: A pair overlaps by more.
        """
        self.clear()
        if not self.places:
            return []
        forward_kinematics(self._model, self._data, q, v)
        filled: list[int] = []
        for number in np.flatnonzero(self._apart.at(q) <= within).tolist():
            watched = self._watched(number)
            placed = watched.pair.placed(self._data)
            found = gap(*placed)
            if found.value < -within:
                raise IrregularMotionError(
                    f"contacts: {watched.label!r} overlaps by {-found.value:.3g} m", value=watched.label
                )
            if found.value <= within:
                near = max(within, abs(found.value))
                points, normal, apart = self._touching_along(watched, placed, found.normal, near)
                if not apart:
                    filled += self._add(watched, points, placed, normal)
        self._omit_between()
        return self._filled(filled)

    def _filled(self, numbers: list[int]) -> list[int]:
        """Return those of the contacts that represent a point."""
        return [i for i in numbers if self._dynamics.contacts[i] is not self._open[i]]

    def join(self, q: Array, v: Array, arriving: Integers) -> list[int]:
        """Set the contacts that collide together with those that arrive; return their numbers.

        Points that touch at the same instant collide together, as when a plank falls flat onto two blocks. On
        an edge that turns about its end, gaps are in proportion to rates: points touch together if they close
        within the time in which those that arrive cover the tolerance.

        Args:
            q: (nq,) configuration.
            v: (nv,) velocity.
            arriving: Numbers of the contacts or limits that arrive.
        """
        most = self.tolerance * MOST_TOGETHER
        near = np.flatnonzero(self._apart.at(q) <= most).tolist()
        if not near:
            return []
        approach = -self._dynamics.gaps_at(q, v)[arriving, 1]
        approach = approach[approach > self._work.resting_speed]
        soon = self.tolerance / float(approach.min()) if approach.size else 0.0
        forward_kinematics(self._model, self._data, q, v)
        filled: list[int] = []
        for watched in map(self._watched, near):
            placed, fresh = watched.pair.placed(self._data), not watched.points
            if fresh:
                found = gap(*placed)
                within = min(max(self.tolerance, soon * -self._fastest(watched, placed, found.normal)), most)
                if found.value > within:
                    continue
                within = max(within, -found.value)
                every, normal, apart = self._touching_along(watched, placed, found.normal, within)
                if apart or self._fastest(watched, placed, normal) >= 0.0:
                    continue
            else:
                normal = next(self._located(watched)).normal
                every = touches(*placed, normal, most)
            joining, velocity = [], watched.pair.relative_velocity(self._data)
            for touch in every:
                rate = float(velocity(touch.point) @ normal)
                height = float((touch.point - touch.other) @ normal) - watched.pair.radius
                if height <= min(max(self.tolerance, -soon * rate), most):
                    joining += [touch] if fresh or rate < -self._work.resting_speed else []
            filled += self._add(watched, joining, placed, normal)
        if filled:
            self._omit_between()
        return filled

    def _touching_along(
        self, watched: Watched, placed: Placed, normal: Array, within: float
    ) -> tuple[list[Touch], Array, bool]:
        """Return the points of contact of two shapes, and the results of `ShapePair.normal_of_contact`.

        The velocities are those of `_data`; other arguments as in `touches`.
        """
        found = touches(*placed, normal, within)
        if not found:
            return found, normal, False
        points = np.array([touch.point for touch in found])
        slow = self._work.resting_speed
        along, apart = watched.pair.normal_of_contact(self._data, normal, points, slow)
        return found if along is normal else touches(*placed, along, within) or found, along, apart

    def refresh(self, q: Array) -> None:
        """Update the contacts of touching pairs that impacts use to a configuration."""
        touching = self._touching()
        if touching:
            self._set(q)
        for watched in touching:
            placed, points, normals = watched.pair.placed(self._data), {}, {}
            for i, point in watched.points.items():
                now = follow(point.touch, *placed, watched.normals[i])
                instant = self._point(watched, i, placed, now.touch, now.normal).instant
                points[i], normals[i] = point._replace(instant=instant), now.normal
                if i not in watched.now.between:
                    self._dynamics.contacts[i] = instant
            watched.update(points=points, normals=normals)

    def _point(
        self, watched: Watched, i: int, placed: Placed, touch: Touch, normal: Array, facing: bool = False
    ) -> PointContact:
        return point_contact(watched.pair, self._data, placed, normal, touch, self._open[i], facing)

    # ---- points in contact

    def _add(self, watched: Watched, found: Sequence[Touch], placed: Placed, normal: Array) -> list[int]:
        """Assign contacts to the points in contact that have none; return the numbers of these contacts."""
        fresh = self._fresh(watched, found, placed, normal)
        free = [i for i in watched.places if i not in watched.points]
        if len(fresh) > len(free):
            raise IrregularMotionError(
                f"contacts: {watched.label!r} touches in {len(watched.points) + len(fresh)} points, more "
                f"than the {len(watched.places)} that two such faces can share; corners may "
                "differ by rounding",
                value=watched.label,
            )
        for i, touch in zip(free, fresh, strict=False):
            face = between_faces(touch, *placed, normal)
            along = normal if face is None else face
            point = self._point(watched, i, placed, touch, along, face is not None)
            self._assign(watched, i, point, along)
        if fresh:
            watched.update(flush=NOTHING.flush)
        return free[: len(fresh)]

    def _fresh(self, watched: Watched, found: Sequence[Touch], placed: Placed, normal: Array) -> list[Touch]:
        """Return the points that do not coincide with points that have a contact."""
        present = [follow(point.touch, *placed, normal).touch.point for point in watched.points.values()]
        near = watched.coincidence
        return [
            touch
            for touch in found
            if all(float(np.linalg.norm(touch.point - other)) > near for other in present)
        ]

    def _assign(self, watched: Watched, i: int, point: PointContact, normal: Array) -> None:
        watched.update(points={**watched.points, i: point}, normals={**watched.normals, i: normal})
        self._fill(i, point)

    def _fill(self, i: int, point: PointContact) -> None:
        """Let contact i represent a point."""
        tip, base, constants = contact_constants(self._model, point.lasting or point.instant)
        self._work.contact_constants[i], self._work.contact_joints[i] = constants, (tip, base)
        self._dynamics.contacts[i] = point.instant

    def _remove(self, watched: Watched, i: int) -> None:
        """Remove the point of contact i."""
        points, normals = ({k: x for k, x in of.items() if k != i} for of in watched.now[:2])
        watched.update(points=points, normals=normals, between=watched.now.between - {i})
        self._empty(i)

    def _empty(self, i: int) -> None:
        """Let contact i represent no point."""
        self._work.contact_constants[i], self._work.contact_joints[i] = self.blanks[i], 0
        self._dynamics.contacts[i] = self._open[i]
        self._work.modes[i] = FREE

    def between(self) -> list[int]:
        """Return the contacts of points between others, which are omitted."""
        return [i for now in self._state.touching.values() for i in now.between]

    def _omit_between(self) -> list[int]:
        """Omit the contacts of points that now lie between others; return the contacts that no longer do."""
        again: list[int] = []
        for watched, omitted in self._lying_between():
            before = watched.now.between
            watched.update(between=omitted)
            for i in omitted - before:
                self._empty(i)
            for i in before - omitted:
                self._fill(i, watched.points[i])
                again.append(i)
        return again

    def _lying_between(self) -> Iterator[tuple[Watched, frozenset[int]]]:
        """Return pairs with common faces, and which of their points lie between others, by number. (15.3)

        The configuration is that of `_data`.
        """
        for group in self._in_common():
            found = between_others(group, [one for watched in group for one in self._located(watched)])
            for watched in group:
                yield watched, frozenset(one.number for one in found if one.watched.number == watched.number)

    def _in_common(self) -> Iterator[list[Watched]]:
        """Return the sets of touching pairs with common faces."""
        for numbers in self._common:
            yield [self._watched(p) for p in numbers if p in self._state.touching]

    def _located(self, watched: Watched) -> Iterator[Located]:
        """Return the points of a touching pair in the configuration of `_data`."""
        placed = watched.pair.placed(self._data)
        for i, point in watched.points.items():
            now = follow(point.touch, *placed, watched.normals[i])
            yield Located(watched, i, now.touch, now.normal)

    def review(self) -> None:
        """Remove the points that have separated.

        Raises:
            IrregularMotionError: A corner stays on a corner or edge, where the normal is undetermined.
        """
        modes, opened = self._work.modes, False
        for watched in self._touching():
            for i in watched.acting:
                if modes[i] == FREE:
                    self._remove(watched, i)
                    opened = True
                elif watched.points[i].lasting is None:
                    kind = watched.points[i].touch.kind.replace("-", " on ")
                    raise IrregularMotionError(
                        f"contacts: {watched.label!r} rests {kind}, where its normal is not "
                        "determined; start slightly beside it, or give one of the shapes a radius",
                        value=watched.label,
                    )
        if opened and self._common:
            self._set(self._state.q)
            while opening := set(self._omit_between()):  # points between those that open do too
                for watched in self._touching():
                    for i in watched.points.keys() & opening:
                        self._remove(watched, i)
        self.let_tip()

    def let_tip(self) -> None:
        """Give crossings of edges their own normal if the points of their pair do not span a face. (15.3)"""
        for watched in self._touching():
            flat = [
                i for i, p in watched.acting.items() if p.lasting and isinstance(p.lasting.plane, FacingEdge)
            ]
            if not flat:
                continue
            forward_kinematics(self._model, self._data, self._state.q, self._state.v)
            placed = watched.pair.placed(self._data)
            now = {one.number: one for one in self._located(watched)}
            points = np.array([now[i].touch.point for i in watched.acting])
            rates = watched.pair.relative_velocity(self._data)(points) @ now[flat[0]].normal
            spans = np.linalg.matrix_rank(points - points[0], LOCAL * watched.size) > 1
            if spans and np.ptp(rates) <= self._work.resting_speed:
                continue
            for i in flat:
                touch, normal = now[i].touch, now[i].normal
                self._assign(watched, i, self._point(watched, i, placed, touch, normal), normal)

    def swapped(self) -> Integers:
        """Return the contacts whose forces act on the second shape of their pair."""
        if not self._state.touching:
            return _NONE
        found = [
            i for w in self._touching() for i, point in w.points.items() if point.swapped and point.lasting
        ]
        return np.array(found, dtype=np.int64)
