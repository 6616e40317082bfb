"""Predicted motions against recorded ones, and the difference of two models with intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import bootstrap

from ..checks import above_zero, in_short, truth_value
from ..errors import InputError
from ..robot.matrices import contact_geometry
from ..scene.scene import Scene
from ..scene.simulation import simulate
from .flights import Body, fit_flight
from .found import free_body
from .recordings import CLEARANCE, FRAMES, Motion, checked_motions, flights_of, generalized

Array = NDArray[np.float64]

RESAMPLES = 2000
"""Of a bootstrap; the ends of a 95 % interval then have errors of a twentieth of its length."""


@dataclass(frozen=True, eq=False, repr=False)
class RollOuts:
    """Errors of predicted motions, each from one recorded flight.

    Attributes:
        time: Times from the start of each roll-out [s], one array for each.
        position, rotation: Distances of predicted and recorded centres of mass [m] and rotations [rad], at
            these times.
        group: (n,) labels.
        start: (n,) numbers of the recording and of its frame at which each starts.
    """

    time: tuple[Array, ...]
    position: tuple[Array, ...]
    rotation: tuple[Array, ...]
    group: tuple[Any, ...]
    start: tuple[tuple[int, int], ...]

    def mean(self) -> Array:
        """Return the means (n, 2) over time of the errors of position [m] and rotation [rad]."""
        pairs = zip(self.position, self.rotation, strict=True)
        return np.array([[one.mean(), other.mean()] for one, other in pairs])

    def at_end(self) -> Array:
        """Return the errors (n, 2) at the ends."""
        return np.array(
            [[one[-1], other[-1]] for one, other in zip(self.position, self.rotation, strict=True)]
        )

    def __len__(self) -> int:
        return len(self.time)

    def __repr__(self) -> str:
        if not len(self):
            return "RollOuts(none)"
        (p, r), (p_end, r_end) = self.mean().mean(axis=0), self.at_end().mean(axis=0)
        return (
            f"RollOuts({len(self)}: {1e3 * p:.3g} mm and {np.degrees(r):.3g}° on average, "
            f"{1e3 * p_end:.3g} mm and {np.degrees(r_end):.3g}° at the end)"
        )


@dataclass(frozen=True, eq=False)
class Comparison:
    """The mean errors of one model minus those of another: position [m] and rotation [rad].

    Attributes:
        difference: (2,) means over groups.
        interval: (2, 2) from, to.
        groups: Number of groups.
    """

    difference: Array
    interval: Array
    groups: int


def rollouts(
    scene: Scene,
    held_out: Sequence[Motion],
    *,
    restart: bool = False,
    **options: Any,
) -> RollOuts:
    """Simulate recorded motions of a free body from their first flights, and measure the errors.

    Args:
        scene: The model: one free body with contacts.
        held_out: Recordings that were not used to fit it.
        restart: Whether to start again in each flight, up to the end of the next one.
        **options: Keywords of `simulate`.

    Raises:
        InputError: A robot that is not one free body, or recordings without flight.
        SimulationError: A motion that cannot be simulated.
    """
    free_body(scene, "rollouts")
    rows: list[tuple[Any, ...]] = []
    for start in starts_of(scene, held_out, truth_value("restart", restart), "held_out"):
        off, turn = differences(scene, start, **options)
        errors = np.linalg.norm(off, axis=1), np.linalg.norm(turn, axis=1)
        rows.append((start.t, *errors, start.label, start.place))
    return RollOuts(*(tuple(column) for column in zip(*rows, strict=True)))


class Start(NamedTuple):
    """The state of a recorded flight at its first frame, and what follows.

    Attributes:
        q, v: The state.
        t: (n,) times of the frames from there on [s].
        com: (n, 3) recorded centres of mass.
        rotation: (n,) recorded rotations.
        label: The group.
        place: Numbers of the recording and of the frame.
    """

    q: Array
    v: Array
    t: Array
    com: Array
    rotation: Rotation
    label: Any
    place: tuple[int, int]


def starts_of(scene: Scene, recorded: Any, restart: bool, field: str) -> list[Start]:
    """Return the start of each recording, or of each flight up to the end of the next one.

    Raises:
        InputError: Recordings that are none of one free body, or without flight.
    """
    motions, body = checked_motions(recorded), Body.of(scene.model)
    starts = []
    found = flights_of(scene, motions, body, CLEARANCE)
    for number, (motion, (label, poses, _, flights)) in enumerate(zip(motions, found, strict=True)):
        if not flights:
            raise InputError(
                f"{field}: motion {number} has no flight of {FRAMES} frames to start from",
                field=field,
                value=motion,
            )
        ends = [flight.stop for flight in flights[1:]] if restart else [len(motion.t)]
        for flight, stop in zip(flights, ends, strict=False):
            state = fit_flight(*poses.part(flight), float(motion.t[flight.start]), body)
            q = np.concatenate([state.com - state.rotation.apply(body.lever), state.rotation.as_quat()])
            q[:3] += _lift(scene, q)
            v = generalized(state, state.rotation, body)
            t, com, rotation = poses.part(slice(flight.start, stop))
            starts.append(Start(q, v, t - t[0], com, rotation, label, (number, flight.start)))
    return starts


def differences(
    scene: Scene, start: Start, frames: NDArray[np.int64] | slice = slice(None), **options: Any
) -> tuple[Array, Array]:
    """Return simulated less recorded centres of mass and rotations (n, 3), in the world, at some frames."""
    t, lever = start.t[frames], Body.of(scene.model).lever
    run = simulate(scene, start.q, start.v, float(start.t[-1]), **options)
    q = np.array([run.at(min(time, run.t[-1]))[0] for time in t.tolist()])
    rotation = Rotation.from_quat(q[:, 3:])
    off = q[:, :3] + rotation.apply(lever) - start.com[frames]
    return off, (rotation * start.rotation[frames].inv()).as_rotvec()


def _lift(scene: Scene, q: Array) -> Array:
    """Return the displacement (3,) that takes a body out of the surfaces that its recorded pose is in."""
    total, data = np.zeros(3), scene.model.createData()
    for contact in scene.contacts:
        place = contact_geometry(scene.model, data, q, contact)
        deeper = -place.gap - float(place.axes[2] @ total)
        if deeper > 0.0:
            total += deeper * place.axes[2]
    return total


def compare(
    test: RollOuts, other: RollOuts, paired: bool = True, *, level: float = 0.95, seed: int = 0
) -> Comparison:
    """Return the difference of the mean errors of two models, with intervals by a bootstrap over groups.

    Args:
        test: Roll-outs of one model.
        other: Those of the other.
        paired: Whether both are of the same recordings; the differences of each group are then resampled.
        level: Level of the intervals.
        seed: Seed of the bootstrap.

    Raises:
        InputError: Paired roll-outs of different recordings, or fewer than two groups.
    """
    for name, value in (("test", test), ("other", other)):
        if not isinstance(value, RollOuts) or len(set(value.group)) < 2:
            raise InputError(
                f"{name}: {in_short(value)} given, roll-outs of two or more groups expected",
                field=name,
                value=value,
            )
    level = above_zero("level", level)
    if not level < 1.0:
        raise InputError(f"level: {level} given, between 0 and 1 expected", field="level", value=level)
    if truth_value("paired", paired) and (test.group, test.start) != (other.group, other.start):
        raise InputError("other: its roll-outs are not of the recordings of test", field="other", value=other)
    options = {"confidence_level": level, "n_resamples": RESAMPLES, "rng": np.random.default_rng(seed)}
    one, two = _by_group(test), _by_group(other)
    difference = one.mean(axis=0) - two.mean(axis=0)
    if paired:
        found = bootstrap((one - two,), np.mean, axis=0, method="percentile", **options)
    else:

        def apart(a: Array, b: Array, axis: int) -> Array:
            return np.asarray(np.mean(a, axis=axis) - np.mean(b, axis=axis))

        found = bootstrap((one, two), apart, axis=0, method="percentile", **options)
    interval = np.column_stack([found.confidence_interval.low, found.confidence_interval.high])
    return Comparison(difference, interval, len(one))


def _by_group(runs: RollOuts) -> Array:
    """Return the mean errors (groups, 2)."""
    errors, groups = runs.mean(), list(dict.fromkeys(runs.group))
    which = np.array([groups.index(label) for label in runs.group])
    return np.array([errors[which == k].mean(axis=0) for k in range(len(groups))])
