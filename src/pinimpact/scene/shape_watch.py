"""Pairs of convex shapes in a run: when they touch, in which points, and when these become others.

A pair that is apart is followed by conservative advancement on the dense output of each step, unless it stays
apart along one direction. One that touches has contacts of single points, in places that the
scene keeps for it; they end where a point leaves its face or edge, and others join them where the plane that
holds the shapes apart meets another corner.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ..errors import InputError, IrregularMotionError
from ..geometry.convex_pair import Touch, corners_of, follow, gap, touches
from ..geometry.convex_shape import PlacedShape, cross
from ..geometry.touch_time import Advance, Front, PairState, advance, first_touch, normal_rate
from ..robot.contact import Contact, contact_constants
from ..robot.forest import forward_kinematics, joint_jacobian
from ..robot.shape_pair import PointContact, ShapePair, point_contact
from ._kernels.contact_forces import FREE
from ._kernels.events.gap import SAFETY
from .crossing import crossing
from .dense_step import DenseStep
from .dynamics import SceneDynamics
from .hybrid_state import HybridState, Touching
from .layout import SceneLayout
from .pairs_apart import PairsApart

Array = NDArray[np.float64]

Placed = tuple[PlacedShape, PlacedShape]

THIRDS = 8
"""Parts of a step from which the third rates of corners' heights are estimated."""

SAMPLES = (0.5, 1.0)
"""Parts of a step at which it is seen whether a point has left its face or edge."""

ROUNDING = 1e-12
"""Part of the shapes' size by which a point may be beyond its face or edge through rounding."""

AHEAD = 1e-6
"""Part of the shapes' size by which they move before it is seen what touches after a point has left."""

TURNED = 0.1
"""Part of the angle between two edges by which they turn before bounds are computed again."""

SUNK = 1e-6
"""Part of the shapes' size by which they never overlap, but for a fault."""

MEMBERS_PREFERRED = ("vertex-face", "face-vertex", "edge-edge", "vertex-edge", "edge-vertex", "vertex-vertex")


class Meeting(NamedTuple):
    """Where a pair of shapes ends a smooth motion.

    Attributes:
        time: When [s].
        pair: Its number.
        leaving: Whether a point leaves its face or edge; else something touches.
    """

    time: float
    pair: int
    leaving: bool


@dataclass(frozen=True, eq=False)
class _Watched:
    """A pair in a run.

    Attributes:
        number: Of the pair.
        pair: The shapes.
        places: Numbers of the contacts that are kept for it.
        blanks: What stands there where nothing touches.
        size: Of both shapes together [m].
        supports: (2, nv) True for velocities that move A, and those that move B.
        state: The state of the motion, with what touches.
    """

    number: int
    pair: ShapePair
    places: list[int]
    blanks: list[Contact]
    size: float
    supports: NDArray[np.bool_]
    state: HybridState

    @property
    def label(self) -> str:
        return self.pair.contact.label

    @property
    def now(self) -> Touching:
        """What touches."""
        return self.state.touching.get(self.number, _NOTHING)

    @property
    def points(self) -> dict[int, PointContact]:
        """The points that touch, by place."""
        return self.now.points

    @property
    def normals(self) -> dict[int, Array]:
        """(3,) normal of each, from B to A."""
        return self.now.normals

    def become(self, **changes: Any) -> None:
        """Let something else touch."""
        others = {number: one for number, one in self.state.touching.items() if number != self.number}
        now = self.now._replace(**changes)
        self.state.touching = others | {self.number: now} if now.points else others


_NOTHING, _NONE = Touching({}, {}), np.zeros(0, dtype=np.int64)


class ShapeWatch:
    """The pairs of shapes of one run.

    Args:
        model: The robot.
        layout: Of the scene.
        dynamics: Its contacts, whose places for pairs are filled here.
        state: The state of the motion, with what touches.
    """

    def __init__(
        self, model: pin.Model, layout: SceneLayout, dynamics: SceneDynamics, state: HybridState
    ) -> None:
        self._model, self._layout, self._state = model, layout, state
        self._dynamics, self._work = dynamics, dynamics.work
        self.tolerance = 0.0
        groups: dict[int, tuple[Contact, list[int]]] = {}  # places, by the contact that they are of
        for i, contact in enumerate(dynamics.contacts):
            if contact.pair is not None:
                groups.setdefault(id(contact.pair), (contact.pair, []))[1].append(i)
        pairs = tuple(pair for pair, _ in groups.values())
        if pairs:
            self._apart = PairsApart(model, layout, pairs)
            moves = layout.pair_tables(pairs).moves.reshape(len(pairs), 2, model.nv) != 0
        self._pairs = []
        for k, (contact, places) in enumerate(groups.values()):
            pair, blanks = layout.pairs[contact], [dynamics.contacts[i] for i in places]
            size = pair.a.shape.reach + pair.b.shape.reach
            self._pairs.append(_Watched(k, pair, places, blanks, size, moves[k], state))

    @cached_property
    def _data(self) -> Any:
        return self._layout.data_for(self, self._model)

    def __bool__(self) -> bool:
        return bool(self._pairs)

    @property
    def directions(self) -> Array | None:
        """(p, 3) along which pairs are apart, which steps change in place; None without pairs."""
        return self._apart.directions if self._pairs else None

    def continue_with(self, directions: Array | None) -> None:
        """Continue from another state, with its directions."""
        if directions is not None:
            self._apart.directions[:] = directions
        for watched in self._touching():
            for i, point in watched.points.items():
                self._dynamics.contacts[i] = point.instant

    def _touching(self) -> list[_Watched]:
        """Return the pairs that touch."""
        return [self._pairs[number] for number in sorted(self._state.touching)]

    # ---- states

    def _set(self, q: Array) -> None:
        forward_kinematics(self._model, self._data, q)

    def start(self, q: Array, rounding: float) -> None:
        """Let the pairs touch that do at the start.

        Args:
            q: (nq,) configuration.
            rounding: Overlap that is none [m].

        Raises:
            InputError: A pair that overlaps.
        """
        if not self._pairs:
            return
        self._set(q)
        near = self._apart.at(q) <= rounding
        for number in np.flatnonzero(near).tolist():
            watched = self._pairs[number]
            placed = watched.pair.placed(self._data)
            found = gap(*placed)
            if found.value < -rounding:
                a, b = watched.pair.a.name, watched.pair.b.name
                raise InputError(
                    f"q0: {a!r} starts {-found.value:.6g} m inside {b!r}; start with the shapes apart, or "
                    f"leave out the contact {watched.label!r}",
                    field="q0",
                    value=found.value,
                )
            if found.value <= rounding:
                self._fill(watched, touches(*placed, found.normal, rounding), placed, found.normal)

    def clear(self) -> None:
        """Let nothing touch."""
        for watched in self._pairs:
            for i, blank in zip(watched.places, watched.blanks, strict=True):
                self._put(i, blank)
                self._dynamics.contacts[i] = blank
                self._work.modes[i] = FREE
        self._state.touching = {}

    def restart(self, q: Array, within: float) -> list[int]:
        """Let the pairs touch that are near each other, after time stepping; return the places filled.

        Args:
            q: (nq,) configuration.
            within: Gap or overlap up to which shapes touch [m].

        Raises:
            IrregularMotionError: A pair that overlaps by more.
        """
        self.clear()
        if not self._pairs:
            return []
        self._set(q)
        filled: list[int] = []
        for number in np.flatnonzero(self._apart.at(q) <= within).tolist():
            watched = self._pairs[number]
            placed = watched.pair.placed(self._data)
            found = gap(*placed)
            if found.value < -within:
                raise IrregularMotionError(
                    f"contacts: {watched.label!r} overlaps by {-found.value:.3g} m",
                    field="contacts",
                    value=watched.label,
                )
            if found.value <= within:
                touching = touches(*placed, found.normal, max(within, abs(found.value)))
                filled += self._fill(watched, touching, placed, found.normal)
        return filled

    def refresh(self, q: Array) -> None:
        """Bring the contacts of what touches, as impacts take them, to a configuration."""
        touching = self._touching()
        if touching:
            self._set(q)
        for watched in touching:
            placed, points, normals = watched.pair.placed(self._data), {}, {}
            for i, point in watched.points.items():
                now = follow(point.touch, *placed, watched.normals[i])
                instant = self._made(watched, i, placed, now.touch, now.normal).instant
                points[i], normals[i] = point._replace(instant=instant), now.normal
                self._dynamics.contacts[i] = instant
            watched.become(points=points, normals=normals)

    def _made(self, watched: _Watched, i: int, placed: Placed, touch: Touch, normal: Array) -> PointContact:
        blank = watched.blanks[watched.places.index(i)]
        return point_contact(watched.pair, self._data, placed, normal, touch, blank)

    # ---- what touches

    def _fill(self, watched: _Watched, found: Sequence[Touch], placed: Placed, normal: Array) -> list[int]:
        """Give places to what touches and has none; return them."""
        present = [follow(point.touch, *placed, normal).touch.point for point in watched.points.values()]
        near = 1e-9 * watched.size
        fresh = [
            touch
            for touch in found
            if all(float(np.linalg.norm(touch.point - other)) > near for other in present)
        ]
        free = [i for i in watched.places if i not in watched.points]
        if len(fresh) > len(free):
            raise IrregularMotionError(
                f"contacts: {watched.label!r} touches in {len(present) + len(fresh)} points, more "
                f"than the {len(watched.places)} that two such faces can share; corners may "
                "differ by rounding",
                field="contacts",
                value=watched.label,
            )
        for i, touch in zip(free, fresh, strict=False):
            self._take(watched, i, self._made(watched, i, placed, touch, normal), normal)
        if fresh:
            watched.become(flush=_NOTHING.flush)
        return free[: len(fresh)]

    def _take(self, watched: _Watched, i: int, point: PointContact, normal: Array) -> None:
        watched.become(points={**watched.points, i: point}, normals={**watched.normals, i: normal})
        self._put(i, point.lasting or point.instant)
        self._dynamics.contacts[i] = point.instant

    def _put(self, i: int, contact: Contact) -> None:
        """Let a place of the workspace be that of a contact."""
        tip, base, constants = contact_constants(self._model, contact)
        self._work.contact_constants[i], self._work.contact_joints[i] = constants, (tip, base)

    def _leave(self, watched: _Watched, i: int) -> None:
        """Let nothing touch in a place any more."""
        blank = watched.blanks[watched.places.index(i)]
        points, normals = ({k: x for k, x in of.items() if k != i} for of in watched.now[:2])
        watched.become(points=points, normals=normals)
        self._put(i, blank)
        self._dynamics.contacts[i] = blank
        self._work.modes[i] = FREE

    def _lift(self, watched: _Watched) -> float:
        """Return the height over the plane of contact below which corners lie in it [m]."""
        return max(4.0 * self.tolerance, 1e-9 * watched.size)

    def review(self) -> None:
        """Leave the places of what has opened.

        Raises:
            IrregularMotionError: Corners of polytopes that stay on corners or edges: no plane is common.
        """
        modes = self._work.modes
        for watched in self._touching():
            for i in watched.points:
                if modes[i] == FREE:
                    self._leave(watched, i)
                elif watched.points[i].lasting is None:
                    kind = watched.points[i].touch.kind.replace("-", " on ")
                    raise IrregularMotionError(
                        f"contacts: {watched.label!r} rests {kind}, where its normal is not "
                        "determined; start slightly beside it, or give one of the shapes a radius",
                        field="contacts",
                        value=watched.label,
                    )

    def swapped(self) -> NDArray[np.int64]:
        """Return the contacts whose forces act on the second shape of their pair."""
        if not self._state.touching:
            return _NONE
        found = [
            i for w in self._touching() for i, point in w.points.items() if point.swapped and point.lasting
        ]
        return np.array(found, dtype=np.int64)

    # ---- within a step

    def within(self, step: DenseStep, end: float) -> Meeting | None:
        """Return where the first pair ends a step until a time, or None."""
        peak = SAFETY * self._work.rate_bounds[:2]
        best: Meeting | None = None
        near, touching = [], self._state.touching
        if len(touching) < len(self._pairs):
            near = np.flatnonzero(~self._apart.over(step, peak)).tolist()
        for number in sorted({*near, *touching}):
            watched = self._pairs[number]
            if number in touching:
                meeting = self._change(watched, step, end, peak)
            else:
                found = self._touch(watched, step, end)
                meeting = Meeting(found.time, number, False) if found.touches else None
            if meeting is not None and (best is None or meeting.time < best.time):
                best, end = meeting, meeting.time
        return best

    def _at(self, watched: _Watched, step: DenseStep) -> Callable[[float], PairState]:
        model, data, pair = self._model, self._data, watched.pair

        def at(t: float) -> PairState:
            forward_kinematics(model, data, *step.at(t), step.acceleration(t))
            moving = (
                data.oMi[joint].act(motions[joint]).vector
                for motions in (data.v, data.a)
                for joint in (pair.a.joint, pair.b.joint)
            )
            return PairState(*pair.placed(data), *moving)

        return at

    def _touch(self, watched: _Watched, step: DenseStep, end: float) -> Advance:
        """Return where a pair that is apart touches."""
        at = self._at(watched, step)

        def normal(t: float) -> Array:
            state = at(t)
            return gap(state.a, state.b).normal

        start = self._apart.until(watched.number, step, normal)
        if start >= end:
            return Advance(end, np.inf, False)
        bend, floor = float(self._apart.bends[watched.number]), 0.25 * self._work.touching_gap
        return self._settled(watched, first_touch(at, start, end, bend, floor), step)

    def _settled(self, watched: _Watched, found: Advance | None, step: DenseStep) -> Advance:
        if found is None:
            raise IrregularMotionError(
                f"contacts: the shapes of {watched.label!r} neither touch nor separate near t = "
                f"{step.start:.6g} s; their distance stays within rounding",
                field="contacts",
                value=watched.label,
            )
        return found

    def _turning(self, watched: _Watched, step: DenseStep, peak: Array) -> tuple[float, float]:
        """Return what the speeds of turning of both shapes do not exceed together [1/s], and second rates.

        The latter is for directions that one of them carries, as seen from the other [1/s²].
        """
        turn = np.linalg.norm(joint_jacobian(self._model, self._data, step.q)[3:], axis=0)
        spins = [float((turn * supports) @ peak[0]) for supports in watched.supports]
        faster = sum(float((turn * supports) @ peak[1]) for supports in watched.supports)
        return sum(spins), faster + sum(s * s for s in spins) + sum(spins) ** 2

    # ---- pairs that touch

    def _change(self, watched: _Watched, step: DenseStep, end: float, peak: Array) -> Meeting | None:
        """Return where what touches becomes something else."""
        at = self._at(watched, step)
        slack = max(ROUNDING * watched.size, self.tolerance)
        best: Meeting | None = None

        def beyond(t: float) -> float:
            state = at(t)
            return max(
                follow(point.touch, state.a, state.b, watched.normals[i]).beyond
                for i, point in watched.points.items()
            )

        before = step.start
        for part in SAMPLES:
            time = end if part == 1.0 else step.start + part * (end - step.start)
            if beyond(time) > slack:
                found = crossing(lambda t: slack - beyond(t), before, time, step.h)
                best, end = Meeting(found, watched.number, True), found
                break
            before = time
        # within no time at all nothing else can come near
        advanced = self._next_corner(watched, at, step, end, peak) if end > step.start else None
        if advanced is not None and advanced.touches:
            best = Meeting(advanced.time, watched.number, False)
        if best is None:
            last = at(end)
            depth = -gap(last.a, last.b).value
            if depth > SUNK * watched.size:
                raise IrregularMotionError(
                    f"contacts: {watched.label!r} penetrates by {depth:.3g} m at t = {end:.6g} s, "
                    "beyond its contact points: corners may have met corners or edges exactly; "
                    "start slightly beside it",
                    field="contacts",
                    value=watched.label,
                )
        return best

    def _guarding(self, watched: _Watched) -> int:
        """Return the place whose plane holds the shapes apart."""
        return min(watched.points, key=lambda i: MEMBERS_PREFERRED.index(watched.points[i].touch.kind))

    def _next_corner(
        self,
        watched: _Watched,
        at: Callable[[float], PairState],
        step: DenseStep,
        end: float,
        peak: Array,
    ) -> Advance | None:
        """Return where another corner comes to the plane of contact, or None if there is none."""
        i = self._guarding(watched)
        touch, normal = watched.points[i].touch, watched.normals[i]
        times = (step.start, 0.5 * (step.start + end), end)
        states = [at(t) for t in times]
        samples = [_heights(touch, normal, state) for state in states]
        masks = []
        lift = max(self._lift(watched), *(4.0 * self._slack(watched, (one.a, one.b)) for one in states))
        for k, side in enumerate(("vertex-face", "face-vertex")):
            heights = np.array([sample[k] for sample in samples])
            mask = np.abs(heights).max(axis=0) > lift  # others are held where they are
            mask[corners_of(touch, states[0].a, states[0].b)[k]] = False
            tips = [p.touch.features[k] for p in watched.points.values() if p.touch.kind == side]
            mask[tips] = False
            held = [m for m in watched.now.flush[k] if heights[0, m] <= lift]
            mask[held] = False
            if touch.kind in ("vertex-face", "face-vertex") and touch.kind != side:
                mask[:] = False  # the normal is that of its own face
            masks.append(mask)
        others_a, others_b = masks
        if not (others_a.any() or others_b.any()):
            return None
        floor = max(0.25 * self._work.touching_gap, 0.1 * self.tolerance)  # what is closed drifts by more
        spin, faster = self._turning(watched, step, peak)

        def heights_at(t: float) -> tuple[Array, Array, float, float]:
            here = at(t)
            there = follow(touch, here.a, here.b, normal)
            rate_of_normal = normal_rate(touch, there, here)
            heights, rates = [], []
            for vertices, origin, mask, velocity, sign in (
                (here.a.vertices, there.touch.point, others_a, here.velocity_a, 1.0),
                (here.b.vertices, there.touch.other, others_b, here.velocity_b, -1.0),
            ):
                arm = vertices[mask] - origin
                heights.append(sign * (arm @ there.normal))
                rates.append(sign * (arm @ (rate_of_normal + cross(there.normal, velocity[3:]))))
            bend, until = bend_of_heights(touch, here, spin, faster)
            return np.concatenate(heights), np.concatenate(rates), bend, until

        apart = (end - step.start) / THIRDS
        little = 1e-3 * apart
        third: float | None = None

        def front(t: float) -> list[Front]:
            nonlocal third
            height, rate, bend, until = heights_at(t)
            plane = np.zeros(1)
            now = Front(height, rate, plane, plane, 0.0, float(height.min()), bend, until)
            if t == step.start:  # second rates alone let most steps pass
                return [now]
            if third is None:
                sampled = [heights_at(step.start + k * apart)[1] for k in range(THIRDS + 1)]
                third = SAFETY * float(np.abs(np.diff(sampled, 2, axis=0)).max()) / apart**2
            second = (heights_at(t + little)[1] - rate) / little - third * little
            return [now._replace(closing_a=np.minimum(second, 0.0), closing_b=plane, third=third)]

        found = advance(front, step.start, end, floor)
        return self._settled(watched, found, step)

    def meet(self, meeting: Meeting, step: DenseStep) -> list[int]:
        """Let a pair touch, or touch elsewhere; return the places of what arrives."""
        watched = self._pairs[meeting.pair]
        q, v = step.at(meeting.time)
        self._set(q)
        placed = watched.pair.placed(self._data)
        if not watched.points:
            apart = gap(*placed)
            touching = touches(*placed, apart.normal, max(self.tolerance, abs(apart.value)))
            return self._fill(watched, touching, placed, apart.normal)
        if not meeting.leaving:
            i = self._guarding(watched)
            normal = follow(watched.points[i].touch, *placed, watched.normals[i]).normal
            now = self._at(watched, step)(meeting.time)
            low_a, low_b = _heights(watched.points[i].touch, normal, now)
            sunk = min(-min(low_a.min(), low_b.min(), 0.0), SUNK * watched.size)
            slack = max(self._slack(watched, placed), sunk)
            found = touches(*placed, normal, slack)
            arriving = self._fill(watched, found, placed, normal)
            if arriving:
                return arriving
            if watched.pair.a.shape.radius + watched.pair.b.shape.radius == 0.0:
                flush = (frozenset(np.flatnonzero(low <= slack).tolist()) for low in (low_a, low_b))
                watched.become(flush=tuple(flush))
                return []
        return self._change_features(watched, step, meeting.time, q, v)

    def _slack(self, watched: _Watched, placed: Placed) -> float:
        """Return by how much what touches may seem apart, for what is closed drifts within a step [m]."""
        radius = watched.pair.a.shape.radius + watched.pair.b.shape.radius
        worst = 0.0
        for i, point in watched.points.items():
            now = follow(point.touch, *placed, watched.normals[i])
            worst = max(worst, abs(float((now.touch.point - now.touch.other) @ now.normal) - radius))
        return max(self.tolerance, worst)

    def _change_features(self, watched: _Watched, step: DenseStep, t: float, q: Array, v: Array) -> list[int]:
        """Let go of points that leave their faces and edges; let touch what touches a little later."""
        speed = float(np.abs(v).max()) * (1.0 + watched.size)
        ahead = AHEAD * watched.size / speed if speed > 0.0 else 0.0
        later, _ = step.at(t + min(ahead, 0.1 * step.h))
        self._set(later)
        placed = watched.pair.placed(self._data)
        slack = self._slack(watched, placed)
        round_ = watched.pair.a.shape.radius + watched.pair.b.shape.radius > 0.0
        apart = gap(*placed)
        found = touches(*placed, apart.normal, slack) if round_ else []
        known = {(touch.kind, touch.features) for touch in found}
        for i, point in list(watched.points.items()):
            beyond = follow(point.touch, *placed, watched.normals[i]).beyond > max(
                ROUNDING * watched.size, self.tolerance
            )
            other = bool(known) and (point.touch.kind, point.touch.features) not in known
            if beyond or other:
                self._leave(watched, i)
        normal = apart.normal
        if not round_ and watched.points:
            i = self._guarding(watched)
            normal = follow(watched.points[i].touch, *placed, watched.normals[i]).normal
        if not round_:
            found = touches(*placed, normal, slack)
        arriving = self._fill(watched, found, placed, normal)
        self._set(q)
        return arriving


def _heights(touch: Touch, normal: Array, state: PairState) -> tuple[Array, Array]:
    """Return the heights of A's corners over the plane of a touch, and of B's below it [m]."""
    now = follow(touch, state.a, state.b, normal)
    return (state.a.vertices - now.touch.point) @ now.normal, (
        now.touch.other - state.b.vertices
    ) @ now.normal


def bend_of_heights(touch: Touch, state: PairState, spin: float, faster: float) -> tuple[float, float]:
    """Return what second rates of corners' heights over a plane of contact do not exceed [m/s²]. (15.9)

    That is for a corner on a face, or two edges, from now on and for a time [s] that is returned too; for
    round shapes it is a guess.

    Args:
        touch: What holds the shapes apart.
        state: The shapes now.
        spin: What both turn by together at the most [1/s].
        faster: What second rates of directions that they carry do not exceed [1/s²].
    """
    twice = 2.0 * (state.a.shape.reach + state.b.shape.reach)
    if touch.kind != "edge-edge":
        return twice * faster, math.inf
    u, w = (
        np.subtract(*placed.vertices[placed.shape.edges[k]])
        for placed, k in zip((state.a, state.b), touch.features, strict=True)
    )
    sine = float(np.linalg.norm(cross(u, w)) / (np.linalg.norm(u) * np.linalg.norm(w)))
    part = 1.0 - TURNED
    rate = spin / (part * sine)
    until = TURNED * sine / spin if spin > 0.0 else math.inf
    return twice * (faster / (part * sine) + 3.0 * rate * rate + 2.0 * rate * spin + faster), until
