"""Contact detection for pairs of convex shapes in event-driven steps. (theory.md, section 15)

Pairs without a fixed separating direction over a step are followed by conservative advancement on its dense
output. Points in contact are removed where they leave their face or edge, and added where another corner
reaches the plane of contact.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from .._numeric.tolerances import HALF_DIGITS
from ..arrays import Array
from ..errors import IrregularMotionError
from ..geometry.convex_pair import Touch, corners_of, follow, gap, touches
from ..geometry.convex_shape import cross
from ..geometry.tolerances import CLOSE, SAFETY
from ..geometry.touch_time import Advance, Front, PairState, advance, first_touch, normal_rate
from ..robot.forest import forward_kinematics, joint_jacobian
from .dense_step import DenseStep
from .event_watch import crossing
from .touching_points import Placed, TouchingPoints
from .watched_pair import Located, Watched, between_others

THIRDS = 8
"""Number of intervals of a step from which the third rates of corner heights are estimated."""

SAMPLES = (0.5, 1.0)
"""Fractions of a step at which points are checked for having left their face or edge."""

INSTANT = 1e-9
"""Part of a step to which the time is known at which other points lie between the rest: in it, the support
changes as little as points in one plane differ."""

TURNED = 0.1
"""Fraction of the sine of the angle between two edges by which they may turn before bounds are recomputed."""

LASTING = ("vertex-face", "face-vertex", "edge-edge")
"""Features that stay in contact while the shapes slide."""

MEMBERS_PREFERRED = (*LASTING, "vertex-edge", "edge-vertex", "vertex-vertex")


class Meeting(NamedTuple):
    """A change of contact of a pair of shapes, which ends a smooth motion.

    Attributes:
        time: Time of the change [s].
        pair: Number of the pair; −1 if only the points that lie between others change.
        leaving: Whether a point leaves its face or edge; else a point comes into contact.
    """

    time: float
    pair: int
    leaving: bool


class ShapeWatch(TouchingPoints):
    """Locates changes of contact of pairs of shapes in steps; see `TouchingPoints`."""

    def _lift(self, watched: Watched) -> float:
        """Return the height over the plane of contact below which corners are taken to lie in it [m]."""
        return max(4.0 * self.tolerance, watched.coincidence)

    def within(self, step: DenseStep, end: float) -> Meeting | None:
        """Return the first change of contact in a step up to a time [s], or None."""
        peak = SAFETY * self._work.rate_bounds[:2]
        best: Meeting | None = None
        near, touching = [], self._state.touching
        if len(touching) < len(self.places):
            near = np.flatnonzero(~self._apart.over(step, peak)).tolist()
        for number in sorted({*near, *touching}):
            watched = self._watched(number)
            if number in touching:
                meeting = self._change(watched, step, end, peak)
            else:
                found = self._touch(watched, step, end)
                meeting = Meeting(found.time, number, False) if found.touches else None
            if meeting is not None and (best is None or meeting.time < best.time):
                best, end = meeting, meeting.time
        regrouped = self._regrouped(step, end) if self._common and len(self._state.touching) > 1 else None
        return best if regrouped is None else Meeting(regrouped, -1, False)

    def _regrouped(self, step: DenseStep, end: float) -> float | None:
        """Return when other points of faces in one plane lie between the rest, up to a time [s], or None."""

        def changed(t: float) -> bool:
            self._set(step.at(t)[0])
            return any(watched.now.between != omitted for watched, omitted in self._lying_between())

        before = step.start
        for part in SAMPLES:
            time = step.start + part * (end - step.start)
            if changed(time):
                while time - before > max(INSTANT * step.h, 2.0 * math.ulp(time)):
                    middle = 0.5 * (before + time)
                    before, time = (before, middle) if changed(middle) else (middle, time)
                return time
            before = time
        return None

    def _at(self, watched: Watched, step: DenseStep) -> Callable[[float], PairState]:
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

    def _touch(self, watched: Watched, step: DenseStep, end: float) -> Advance:
        """Return where a separated pair touches in a step up to a time [s]."""
        bend, floor = float(self._apart.bends[watched.number]), 0.25 * self._work.touching_gap
        found = first_touch(self._at(watched, step), step.start, end, bend, floor)
        return self._checked(watched, found, step)

    def _checked(self, watched: Watched, found: Advance | None, step: DenseStep) -> Advance:
        if found is None:
            raise IrregularMotionError(
                f"contacts: the shapes of {watched.label!r} neither touch nor separate near t = "
                f"{step.start:.6g} s; their distance stays within rounding",
                value=watched.label,
            )
        return found

    def _turning(self, watched: Watched, step: DenseStep, peak: Array) -> tuple[float, float]:
        """Return bounds of the rotation of both shapes in a step.

        Args:
            watched: The pair.
            step: The step.
            peak: (2, nv) bounds of |v| and |v̇| in it.

        Returns:
            Bound of the sum of their angular speeds [1/s]; bound of the second rate of a direction carried by
            one shape, relative to the other [1/s²].
        """
        turn = np.linalg.norm(joint_jacobian(self._model, self._data, step.q)[3:], axis=0)
        spins = [float((turn * supports) @ peak[0]) for supports in watched.supports]
        faster = sum(float((turn * supports) @ peak[1]) for supports in watched.supports)
        return sum(spins), faster + sum(s * s for s in spins) + sum(spins) ** 2

    # ---- touching pairs

    def _change(self, watched: Watched, step: DenseStep, end: float, peak: Array) -> Meeting | None:
        """Return where the points of a touching pair change in a step up to a time [s], or None."""
        at = self._at(watched, step)
        slack = self.tolerance
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
        advanced = self._next_corner(watched, at, step, end, peak) if end > step.start else None
        if advanced is not None and advanced.touches:
            best = Meeting(advanced.time, watched.number, False)
        if best is None:
            last = at(end)
            depth = -gap(last.a, last.b).value - self._slack(watched, (last.a, last.b))
            if depth > CLOSE * watched.size:
                raise IrregularMotionError(
                    f"contacts: {watched.label!r} penetrates by {depth:.3g} m at t = {end:.6g} s, "
                    "beyond its contact points: corners may have met corners or edges exactly; "
                    "start slightly beside it",
                    value=watched.label,
                )
        return best

    def _guarding(self, watched: Watched) -> int:
        """Return the number of the contact whose plane separates the shapes."""
        return min(watched.points, key=lambda i: MEMBERS_PREFERRED.index(watched.points[i].touch.kind))

    def _next_corner(
        self, watched: Watched, at: Callable[[float], PairState], step: DenseStep, end: float, peak: Array
    ) -> Advance | None:
        """Return where another corner reaches the plane of contact; None if no corner can."""
        i = self._guarding(watched)
        touch, normal = watched.points[i].touch, watched.normals[i]
        times = (step.start, 0.5 * (step.start + end), end)
        states = [at(t) for t in times]
        samples = [_heights(touch, normal, state) for state in states]
        masks = []
        lift = max(self._lift(watched), *(4.0 * self._slack(watched, (one.a, one.b)) for one in states))
        for k, side in enumerate(("vertex-face", "face-vertex")):
            heights = np.array([sample[k] for sample in samples])
            mask = np.abs(heights).max(axis=0) > lift  # the others stay in the plane
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
        floor = max(0.25 * self._work.touching_gap, 0.1 * self.tolerance)  # constraint drift is larger
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
        little = HALF_DIGITS * apart
        third: float | None = None

        def front(t: float) -> list[Front]:
            nonlocal third
            height, rate, bend, until = heights_at(t)
            plane = np.zeros(1)
            now = Front(height, rate, plane, plane, 0.0, float(height.min()), bend, until)
            if t == step.start:  # the bound of second rates alone suffices in most steps
                return [now]
            if third is None:
                sampled = [heights_at(step.start + k * apart)[1] for k in range(THIRDS + 1)]
                third = SAFETY * float(np.abs(np.diff(sampled, 2, axis=0)).max()) / apart**2
            second = (heights_at(t + little)[1] - rate) / little - third * little
            return [now._replace(closing_a=np.minimum(second, 0.0), closing_b=plane, third=third)]

        found = advance(front, step.start, end, floor)
        return self._checked(watched, found, step)

    def meet(self, meeting: Meeting, step: DenseStep) -> list[int]:
        """Apply a change of contact; return the numbers of the contacts whose gap closes."""
        divided = self._divided(step, meeting) if self._common else []
        arriving = self._meet(meeting, step) if meeting.pair >= 0 else []
        for watched, _, touch, normal in divided:
            arriving += self._add(watched, [touch], watched.pair.placed(self._data), normal)
        return arriving + self._omit_between()

    def _divided(self, step: DenseStep, meeting: Meeting) -> list[Located]:
        """Return points of faces in one plane that coincide with others at a change, but not soon after.

        `_data` is that of its time afterwards.
        """
        found: list[Located] = []
        t = meeting.time
        q, v = step.at(t)
        for numbers, group in zip(self._common, self._in_common(), strict=True):
            if not group or not (meeting.pair < 0 or meeting.pair in numbers):
                continue
            later = self._later(group[0], step, t, q, v)
            near = np.flatnonzero(self._apart.at(later) <= self.tolerance).tolist()
            group += [self._watched(p) for p in numbers if p in near and p not in self._state.touching]
            if len(group) < 2:
                continue
            self._set(q)
            known = [one for watched in group for one in self._located(watched)]
            self._set(later)
            fresh: list[tuple[Watched, Touch, Array]] = []
            for watched in group:
                same = watched.pair.a.joint == known[0].watched.pair.a.joint
                normal = known[0].normal if same else -known[0].normal
                placed = watched.pair.placed(self._data)
                every = touches(*placed, normal, self._slack(watched, placed))
                lasting = [one for one in every if one.kind in LASTING]
                fresh += [(watched, one, normal) for one in self._fresh(watched, lasting, placed, normal)]
            self._set(q)
            further: list[Located] = []
            for watched, touch, normal in fresh:
                now = follow(touch, *watched.pair.placed(self._data), normal)
                if now.beyond <= self.tolerance:
                    further.append(Located(watched, -1, now.touch, now.normal))
            if further:
                found += [one for one in between_others(group, further + known) if one.number < 0]
        return found

    def _meet(self, meeting: Meeting, step: DenseStep) -> list[int]:
        watched = self._watched(meeting.pair)
        q, v = step.at(meeting.time)
        forward_kinematics(self._model, self._data, q, v)
        placed = watched.pair.placed(self._data)
        if not watched.points:
            apart = gap(*placed)
            slack = max(self.tolerance, abs(apart.value))
            points, normal, _ = self._touching_along(watched, placed, apart.normal, slack)
            return self._add(watched, points, placed, normal)
        if not meeting.leaving:
            i = self._guarding(watched)
            normal = follow(watched.points[i].touch, *placed, watched.normals[i]).normal
            now = self._at(watched, step)(meeting.time)
            low_a, low_b = _heights(watched.points[i].touch, normal, now)
            sunk = min(-min(low_a.min(), low_b.min(), 0.0), CLOSE * watched.size)
            slack = max(self._slack(watched, placed), sunk)
            found = touches(*placed, normal, slack)
            arriving = self._add(watched, found, placed, normal)
            if arriving:
                return arriving
            if watched.pair.radius == 0.0:
                flush = (frozenset(np.flatnonzero(low <= slack).tolist()) for low in (low_a, low_b))
                watched.update(flush=tuple(flush))
                return []
        return self._change_features(watched, step, meeting.time, q, v)

    def _slack(self, watched: Watched, placed: Placed) -> float:
        """Return the gap up to which corners count as touching [m]: the tolerance or the constraint drift."""
        radius = watched.pair.radius
        worst = 0.0
        for i, point in watched.points.items():
            now = follow(point.touch, *placed, watched.normals[i])
            worst = max(worst, abs(float((now.touch.point - now.touch.other) @ now.normal) - radius))
        return max(self.tolerance, worst)

    def _relative_speed(self, watched: Watched, q: Array, v: Array) -> float:
        """Return a bound of the speeds of the smaller shape's points relative to the other [m/s]."""
        pair, data = watched.pair, self._data
        forward_kinematics(self._model, data, q, v)
        one, other = (data.oMi[joint].act(data.v[joint]) for joint in (pair.a.joint, pair.b.joint))
        motion, i = one - other, self._guarding(watched)
        touch = follow(watched.points[i].touch, *pair.placed(data), watched.normals[i]).touch
        linear = motion.linear + np.cross(motion.angular, touch.point)
        return float(np.linalg.norm(linear) + 2.0 * watched.size * np.linalg.norm(motion.angular))

    def _later(self, watched: Watched, step: DenseStep, t: float, q: Array, v: Array) -> Array:
        """Return the configuration at which the shapes have moved on by `CLOSE` of the smaller one's size."""
        speed = self._relative_speed(watched, q, v)
        ahead = CLOSE * watched.size / speed if speed > 0.0 else 0.0
        return step.at(t + min(ahead, 0.1 * step.h))[0]

    def _change_features(self, watched: Watched, step: DenseStep, t: float, q: Array, v: Array) -> list[int]:
        """Remove points that leave their faces and edges, and add those in contact slightly later.

        Return the numbers of the contacts whose gap closes.
        """
        self._set(self._later(watched, step, t, q, v))
        placed = watched.pair.placed(self._data)
        slack = self._slack(watched, placed)
        round_ = watched.pair.radius > 0.0
        apart = gap(*placed)
        found = touches(*placed, apart.normal, slack) if round_ else []
        known = {(touch.kind, touch.features) for touch in found}
        for i, point in list(watched.points.items()):
            beyond = follow(point.touch, *placed, watched.normals[i]).beyond > self.tolerance
            other = bool(known) and (point.touch.kind, point.touch.features) not in known
            if beyond or other:
                self._remove(watched, i)
        normal = apart.normal
        if not round_ and watched.points:
            i = self._guarding(watched)
            normal = follow(watched.points[i].touch, *placed, watched.normals[i]).normal
        if not round_:
            found = touches(*placed, normal, slack)
        arriving = self._add(watched, found, placed, normal)
        self._set(q)
        return arriving


def _heights(touch: Touch, normal: Array, state: PairState) -> tuple[Array, Array]:
    """Return the heights of A's corners over the plane of a touch, and of B's below it [m]."""
    now = follow(touch, state.a, state.b, normal)
    return (state.a.vertices - now.touch.point) @ now.normal, (
        now.touch.other - state.b.vertices
    ) @ now.normal


def bend_of_heights(touch: Touch, state: PairState, spin: float, faster: float) -> tuple[float, float]:
    """Return a bound of the second rates of corner heights over a plane of contact. (15.9)

    It is rigorous for a corner on a face and for two edges, and an estimate for round shapes.

    Args:
        touch: The features in contact, which define the plane.
        state: The placed shapes and their motion.
        spin: Bound of the sum of their angular speeds [1/s].
        faster: Bound of the second rates of directions that they carry [1/s²].

    Returns:
        The bound [m/s²], and the time for which it holds [s].
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
