"""Impacts of a free body, found in recorded motions."""

from __future__ import annotations

import itertools
from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from ..arrays import Array, Bools
from ..checks import above_zero, as_tuple, finite_array, in_short, real_numbers
from ..errors import InputError
from ..scene._kernels.tolerances import ATOL
from ..scene.scene import Scene
from .flights import Body, Flight, fit_flight
from .found import FoundImpacts, free_body

FRAMES = 5
"""Number of frames of the shortest flight; two would determine its state without any residual."""

CLEARANCE = 0.01
"""Gap [m] above which recorded bodies are clear of a surface: several times the errors of their shape."""

LIMIT = 5.0
"""Largest residual of a frame of a flight, in standard deviations: once in a million for normal noise."""


@dataclass(frozen=True, eq=False)
class Motion:
    """A recorded motion.

    Attributes:
        t: (n,) times, rising [s].
        q: (n, nq) configurations.
        group: Label; motions with common errors have the same one. None: the motion is its own group.
        sigma: Standard deviations of recorded position [m] and rotation [rad]; None: estimated.

    Raises:
        InputError: Times that are not rising, fewer than ten frames, wrong shapes, or numbers out of range.
    """

    t: Array
    q: Array
    group: Hashable = None
    sigma: tuple[float, float] | None = None

    def __init__(
        self, t: ArrayLike, q: ArrayLike, group: Hashable = None, sigma: Sequence[float] | None = None
    ) -> None:
        times = real_numbers("t", t)
        times = finite_array("t", times, (times.size,))
        if len(times) < 2 * FRAMES:
            raise InputError(f"t: {len(times)} frames given; two flights need {2 * FRAMES} at least", value=t)
        back = np.flatnonzero(np.diff(times) <= 0.0)
        if len(back):
            k = int(back[0])
            raise InputError(
                f"t: times do not rise at frame {k + 1}: {times[k + 1]:.9g} s after {times[k]:.9g} s", value=t
            )
        states = real_numbers("q", q)
        if states.ndim != 2 or len(states) != len(times):
            raise InputError(
                f"q: shape {states.shape} given, ({len(times)}, nq) expected: a row for each time", value=q
            )
        states = finite_array("q", states, states.shape)
        pair = None
        if sigma is not None:
            given = finite_array("sigma", real_numbers("sigma", sigma), (2,))
            pair = (above_zero("sigma", given[0]), above_zero("sigma", given[1]))
        for name, value in (("t", times), ("q", states), ("group", group), ("sigma", pair)):
            object.__setattr__(self, name, value)

    def label(self, number: int) -> Hashable:
        """Return the label of the group, or a label with the number of the motion if there is none."""
        return f"motion {number}" if self.group is None else self.group

    def __repr__(self) -> str:
        return f"Motion({len(self.t)} frames, {self.t[0]:.3g} to {self.t[-1]:.3g} s, group={self.group!r})"


class Poses(NamedTuple):
    """Times, centres of mass, rotations and gaps (n, contacts) of a recorded motion."""

    t: Array
    com: Array
    rotation: Rotation
    gaps: Array

    def part(self, frames: Any) -> tuple[Array, Array, Rotation]:
        """Return times and poses of some frames."""
        return self.t[frames], self.com[frames], self.rotation[frames]


def impacts(scene: Scene, motions: Sequence[Motion], *, clearance: float = CLEARANCE) -> FoundImpacts:
    """Find impacts of a free body at one contact in recorded motions.

    Flights are fitted to the frames on either side of an impact, a parabola and a torque-free rotation, and
    extrapolated to the instant at which they agree (I6)–(I8).

    Args:
        scene: One free body with its inertia, and contacts with surfaces.
        motions: The recordings.
        clearance: Least gap of all other contacts at the impact [m]; impacts at several contacts are dropped.

    Returns:
        The impacts. ``dropped`` has a sentence for each pair of flights without an impact that can be used.

    Raises:
        InputError: A robot that is not one free body, no contacts, or motions of other robots.
    """
    free_body(scene, "impacts")
    clearance = above_zero("clearance", clearance)
    motions = checked_motions(motions)
    if not scene.contacts:
        raise InputError("scene: it has no contacts", value=scene)
    body, rows, dropped = Body.of(scene), [], []
    for label, poses, sigma, flights in flights_of(scene, motions, body, clearance):
        for before, after in itertools.pairwise(flights):
            row = _impact(scene, poses, before, after, sigma, body, clearance)
            if isinstance(row, str):
                dropped.append(f"{label}, {poses.t[before.stop - 1]:.3f} s: {row}.")
            else:
                rows.append((*row, label))
    return _table(rows, dropped, scene)


def flights_of(
    scene: Scene, motions: Sequence[Motion], body: Body, clearance: float
) -> Iterator[tuple[Hashable, Poses, Array, list[slice]]]:
    """Yield label, poses, noise and the frames of the flights of each motion."""
    every = [_poses(scene, motion, body) for motion in motions]
    unknown = [poses for poses, motion in zip(every, motions, strict=True) if motion.sigma is None]
    noise = _noise(unknown, body, clearance) if unknown else np.zeros(2)
    for number, (motion, poses) in enumerate(zip(motions, every, strict=True)):
        sigma = noise if motion.sigma is None else np.array(motion.sigma)
        found = [
            one for one in _flights(poses, sigma, body) if _leaves(poses, one, sigma[0], body, clearance)
        ]
        yield motion.label(number), poses, sigma, found


def checked_motions(motions: Any) -> tuple[Motion, ...]:
    """Return motions of a free body, with quaternions of unit length, as a tuple, or raise `InputError`."""
    checked = []
    for motion in as_tuple("motions", motions, Motion, "a Motion"):
        if not isinstance(motion, Motion) or motion.q.shape[1] != 7:
            what = in_short(motion)
            raise InputError(f"motions: {what} given, Motions with q (n, 7) expected", value=motion)
        lengths = np.linalg.norm(motion.q[:, 3:], axis=1)
        if not lengths.all():
            frame = int(np.argmin(lengths))
            raise InputError(f"motions: the quaternion of frame {frame} of {motion} is zero", value=motion)
        q = np.hstack([motion.q[:, :3], motion.q[:, 3:] / lengths[:, None]])
        checked.append(replace(motion, q=q))
    return tuple(checked)


def _table(rows: list[Any], dropped: list[str], scene: Scene) -> FoundImpacts:
    columns = list(zip(*rows, strict=True)) if rows else [()] * 7
    q, before, after, covariance, time, contact = (np.array(column) for column in columns[:6])
    labels = np.empty(len(rows), dtype=object)
    labels[:] = columns[6]
    if len({type(label) for label in columns[6]}) == 1 and isinstance(columns[6][0], (int, str)):
        labels = np.array(columns[6])
    shapes = (q.reshape(-1, 7), before.reshape(-1, 6), after.reshape(-1, 6))
    return FoundImpacts(*shapes, contact, labels, time, covariance.reshape(-1, 12, 12), tuple(dropped), scene)


def _poses(scene: Scene, motion: Motion, body: Body) -> Poses:
    """Return the poses of a motion, with the gaps of the scene's contacts."""
    rotation = Rotation.from_quat(motion.q[:, 3:])
    com = motion.q[:, :3] + rotation.apply(body.lever)
    return Poses(motion.t, com, rotation, gaps(scene, motion.q))


def gaps(scene: Scene, q: Array) -> Array:
    """Return the gaps (n, contacts) at configurations."""
    data = scene.model.createData()
    return np.array([[one.gap(scene.model, data, row) for one in scene.contacts] for row in q])


def _noise(poses: list[Poses], body: Body, clearance: float) -> Array:
    """Return standard deviations of position [m] and rotation [rad] about free flight, common to all motions.

    They are estimated from the frames before the first approach to a surface, and include effects that free
    flight neglects, such as drag and errors of the calibration of cameras.
    """
    squares = []
    for one in poses:
        # a fast body hits the surface between two frames that are clear of it
        fall = np.diff(one.gaps, axis=0) - np.linalg.norm(body.gravity) * np.diff(one.t)[:, None] ** 2
        ahead = np.vstack([one.gaps[:1], one.gaps[:1], (one.gaps[1:] + fall)[:-1]])
        clear: Bools = np.all(np.minimum(one.gaps, ahead) > clearance, axis=1)
        stop = len(clear) if clear.all() else int(np.argmin(clear))
        if stop >= FRAMES:
            residuals = fit_flight(*one.part(slice(stop)), one.t[stop - 1], body).residuals
            squares.append((residuals**2).reshape(-1, 2, 3).sum(axis=(0, 2)) / (3.0 * (stop - 2)))
    if not squares:
        raise InputError(
            f"motions: none begins with {FRAMES} frames clear of the surfaces, from which the noise is "
            "estimated; give sigma=",
            value=len(poses),
        )
    # recorded poses may be exact, such as those of a body that does not turn; flights are computed to ATOL
    return np.maximum(np.sqrt(np.mean(squares, axis=0)), ATOL)


def _flights(poses: Poses, sigma: Array, body: Body) -> list[slice]:
    """Return the frames of the flights of a motion, in order; none shorter than `FRAMES`."""
    found, start, count = [], 0, len(poses.t)
    while start + FRAMES <= count:
        stop = start + FRAMES
        if not _is_parabola(poses, slice(start, stop), sigma[0], body):
            start += 1
            continue
        flight = fit_flight(*poses.part(slice(start, stop)), poses.t[stop - 1], body)
        if (np.abs(flight.residuals) / np.repeat(sigma, 3)).max() > LIMIT:
            start += 1
            continue
        while stop < count:
            beyond = _first_beyond(flight, poses, stop, sigma, body)
            if beyond == stop:
                break
            stop = beyond
            flight = fit_flight(*poses.part(slice(start, stop)), poses.t[stop - 1], body)
        found.append(slice(start, stop))
        start = stop
    return found


def _is_parabola(poses: Poses, frames: slice, sigma: float, body: Body) -> bool:
    """Return whether the centre of mass falls freely: a quick test before a fit."""
    dt = poses.t[frames] - poses.t[frames.start]
    path = poses.com[frames] - np.outer(0.5 * dt**2, body.gravity)
    line = np.column_stack([np.ones_like(dt), dt])
    return bool(np.abs(path - line @ (np.linalg.pinv(line) @ path)).max() <= LIMIT * sigma)


def _leaves(poses: Poses, frames: slice, sigma: float, body: Body, clearance: float) -> bool:
    """Return whether a body is clear of the surfaces in some frame, or its fall exceeds the noise.

    Otherwise the frames may be those of a body at rest, whose distance from a short parabola is in the noise.
    """
    g = float(np.linalg.norm(body.gravity))
    if g == 0.0 or (poses.gaps[frames].min(axis=1) > clearance).any():
        return True
    t = poses.t[frames] - poses.t[frames.start]
    weights = np.linalg.pinv(np.column_stack([np.ones_like(t), t, 0.5 * t**2]))[2]  # of the acceleration
    fall = float(weights @ (poses.com[frames] @ body.gravity)) / g
    return fall > LIMIT * sigma * float(np.linalg.norm(weights))


def _first_beyond(flight: Flight, poses: Poses, stop: int, sigma: Array, body: Body) -> int:
    """Return the first frame from `stop` on that a flight does not predict, or one past the last examined.

    As many frames are predicted as the flight has; the uncertainty is that of a line through equidistant
    frames.
    """
    frames = np.arange(stop, min(stop + flight.count, len(poses.t)))
    com, rotation, _, _ = flight.at(poses.t[frames], body)
    residuals = np.hstack([poses.com[frames] - com, (poses.rotation[frames] * rotation.inv()).as_rotvec()])
    n, ahead = flight.count, (frames - stop) + 0.5 * (flight.count + 1)
    spread = np.sqrt(1.0 + 1.0 / n + 12.0 * ahead**2 / (n * (n * n - 1.0)))
    beyond = (np.abs(residuals) > LIMIT * spread[:, None] * np.repeat(sigma, 3)).any(axis=1)
    return int(frames[np.argmax(beyond)]) if beyond.any() else int(frames[-1]) + 1


def _impact(
    scene: Scene, poses: Poses, before: slice, after: slice, sigma: Array, body: Body, clearance: float
) -> tuple[Any, ...] | str:
    """Return q, v⁻, v⁺, covariance, time and contact of the impact between two flights, or why it is none."""
    if after.start - before.stop > 1:
        missing = after.start - before.stop
        return f"{missing} frames lie between two flights, more than one impact takes"
    first, last = poses.t[before.stop - 1], poses.t[after.start]
    instant = 0.5 * (first + last)
    for _ in range(2):  # frames on the wrong side of the instant are left out, and the flights fitted again
        sides: list[Flight] = []
        for frames, inside in ((before, poses.t <= instant), (after, poses.t >= instant)):
            chosen = np.arange(frames.start, frames.stop)
            chosen = chosen[inside[chosen]]
            if len(chosen) < FRAMES:
                which = "before" if frames is before else "after"
                return f"the flight {which} the impact has {len(chosen)} frames; {FRAMES} are needed"
            sides.append(fit_flight(*poses.part(chosen), instant, body))
        apart, instant = _agreement(sides[0], sides[1], sigma)
        if not first - (last - first) <= instant <= last + (last - first):
            return "the flights do not agree near the frames between them"
    left, right = (_moved(flight, instant, body) for flight in sides)
    if apart > LIMIT:
        return f"the flights miss each other by {apart:.0f} standard deviations"
    com = 0.5 * (left.com + right.com)
    half = Rotation.from_rotvec(0.5 * (right.rotation * left.rotation.inv()).as_rotvec())
    rotation = half * left.rotation
    q = np.concatenate([com - rotation.apply(body.lever), rotation.as_quat()])
    near = gaps(scene, q[None])[0]
    order = np.argsort(near)
    if len(order) > 1 and near[order[1]] < clearance:
        return f"a second contact, {scene.contacts[order[1]].label}, is {1e3 * near[order[1]]:.1f} mm away"
    if abs(near[order[0]]) > 0.5 * clearance:  # more than errors of shape
        return f"no contact is closed; the nearest is {1e3 * near[order[0]]:.1f} mm away"
    covariance = np.zeros((12, 12))
    states = []
    for k, flight in enumerate((left, right)):
        states.append(generalized(flight, rotation, body))
        covariance[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] = _covariance(flight, rotation, sigma, body)
    return q, *states, covariance, instant, scene.contacts[order[0]].label


def _agreement(before: Flight, after: Flight, sigma: Array) -> tuple[float, float]:
    """Return the least distance of two flights, in standard deviations, and its time [s]. (I8)"""
    # standard deviation at the ends of fitted lines
    spread = np.repeat(sigma, 3) * np.sqrt(4.0 / before.count + 4.0 / after.count)
    gap = np.concatenate([after.com - before.com, (after.rotation * before.rotation.inv()).as_rotvec()])
    turn = after.rotation.apply(after.spin) - before.rotation.apply(before.spin)
    rate = np.concatenate([after.velocity - before.velocity, turn])
    gap, rate = gap / spread, rate / spread
    shift = -float(gap @ rate) / float(rate @ rate)
    return float(np.abs(gap + shift * rate).max()), before.time + shift


def _moved(flight: Flight, instant: float, body: Body) -> Flight:
    """Return a flight with its state at another instant."""
    com, rotation, velocity, spin = (one[0] for one in flight.at(np.array([instant]), body))
    return replace(flight, time=instant, com=com, velocity=velocity, rotation=rotation, spin=spin)


def generalized(flight: Flight, rotation: Rotation, body: Body) -> Array:
    """Return the velocity (6,) of the body, in its own axes, at its origin."""
    linear = rotation.inv().apply(flight.velocity) - np.cross(flight.spin, body.lever)
    return np.concatenate([linear, flight.spin])


def _covariance(flight: Flight, rotation: Rotation, sigma: Array, body: Body) -> Array:
    """Return the covariance (6, 6) of `generalized`."""
    scale = np.repeat(sigma, 3)
    own = flight.covariance * np.outer(scale, scale)
    turn = np.zeros((6, 6))
    x, y, z = body.lever
    turn[:3, :3], turn[3:, 3:] = rotation.inv().as_matrix(), np.eye(3)
    turn[:3, 3:] = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]  # lever × spin
    return turn @ own @ turn.T
