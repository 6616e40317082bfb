"""Predicted motions against recorded ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from ..arrays import Array, Integers
from ..checks import truth_value
from ..errors import InputError
from ..robot.matrices import contact_geometry
from ..scene.scene import Scene
from ..scene.simulation import simulate
from .flights import Body, fit_flight
from .found import free_body
from .recordings import CLEARANCE, FRAMES, Motion, checked_motions, flights_of, generalized


@dataclass(frozen=True, eq=False, repr=False)
class RollOuts:
    """Errors of predicted motions, each from one recorded flight.

    Attributes:
        time: Times from the start of each roll-out [s], one array for each.
        position, rotation: Distances of predicted and recorded centres of mass [m] and rotations [rad], at
            these times.
        group: (n,) labels.
        start: (n,) numbers of the recording and of its frame at which each starts.
        recorded: Recorded configurations (k, 7) at these times, one array for each.
    """

    time: tuple[Array, ...]
    position: tuple[Array, ...]
    rotation: tuple[Array, ...]
    group: tuple[Any, ...]
    start: tuple[tuple[int, int], ...]
    recorded: tuple[Array, ...]

    def mean(self) -> Array:
        """Return the means (n, 2) over time of the errors of position [m] and rotation [rad]."""
        return np.array([[one.mean() for one in self.position], [one.mean() for one in self.rotation]]).T

    def at_end(self) -> Array:
        """Return the errors (n, 2) at the ends."""
        return np.array([[one[-1] for one in self.position], [one[-1] for one in self.rotation]]).T

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


def rollouts(scene: Scene, held_out: Sequence[Motion], *, restart: bool = False, **options: Any) -> RollOuts:
    """Simulate recorded motions of a free body from their first flights, and measure the errors.

    Args:
        scene: The model: one free body with contacts.
        held_out: Recordings that were not used to fit it.
        restart: Whether to start again in each flight, up to the end of the next one.
        **options: Keywords of `simulate`.

    Raises:
        InputError: A robot that is not one free body, no recordings, or recordings without flight.
        SimulationError: A motion that cannot be simulated.
    """
    free_body(scene, "rollouts")
    rows: list[tuple[Any, ...]] = []
    for start in starts_of(scene, held_out, truth_value("restart", restart), "held_out"):
        position, turn = differences(scene, start, **options)
        errors = np.linalg.norm(position, axis=1), np.linalg.norm(turn, axis=1)
        rows.append((start.t, *errors, start.label, start.place, start.recorded))
    return RollOuts(*(tuple(column) for column in zip(*rows, strict=True)))


class Start(NamedTuple):
    """The state of a recorded flight at its first frame, and the recorded poses from there on."""

    q: Array  # state at the first frame, with v
    v: Array
    t: Array  # (n,) times of the frames from there on [s]
    com: Array  # (n, 3) recorded centres of mass
    rotation: Rotation  # (n,) recorded rotations
    label: Any
    place: tuple[int, int]  # numbers of the recording and of the frame
    recorded: Array  # (n, 7) recorded configurations


def starts_of(scene: Scene, recorded: Any, restart: bool, field: str) -> list[Start]:
    """Return the start of each recording, or of each flight up to the end of the next one."""
    motions, body = checked_motions(recorded), Body.of(scene)
    if not motions:
        raise InputError(f"{field}: no recordings given, at least one expected", value=recorded)
    starts = []
    found = flights_of(scene, motions, body, CLEARANCE)
    for number, (motion, (label, poses, _, flights)) in enumerate(zip(motions, found, strict=True)):
        if not flights:
            raise InputError(
                f"{field}: motion {number} has no flight of {FRAMES} frames to start from", value=motion
            )
        ends = [flight.stop for flight in flights[1:]] if restart else [len(motion.t)]
        for flight, stop in zip(flights, ends, strict=False):
            state = fit_flight(*poses.part(flight), float(motion.t[flight.start]), body)
            q = np.concatenate([state.com - state.rotation.apply(body.lever), state.rotation.as_quat()])
            q[:3] += _lift(scene, q)
            v = generalized(state, state.rotation, body)
            t, com, rotation = poses.part(slice(flight.start, stop))
            place = number, flight.start
            starts.append(Start(q, v, t - t[0], com, rotation, label, place, motion.q[flight.start : stop]))
    return starts


def differences(
    scene: Scene, start: Start, frames: Integers | slice = slice(None), **options: Any
) -> tuple[Array, Array]:
    """Return simulated minus recorded centres of mass [m] and rotations [rad] (n, 3), in world axes."""
    t, lever = start.t[frames], Body.of(scene).lever
    run = simulate(scene, start.q, start.v, float(start.t[-1]), **options)
    q = np.array([run.at(min(time, run.t[-1]))[0] for time in t.tolist()])
    rotation = Rotation.from_quat(q[:, 3:])
    position = q[:, :3] + rotation.apply(lever) - start.com[frames]
    return position, (rotation * start.rotation[frames].inv()).as_rotvec()


def _lift(scene: Scene, q: Array) -> Array:
    """Return the displacement (3,) [m] that moves a body out of the surfaces that it penetrates."""
    total, data = np.zeros(3), scene.model.createData()
    for contact in scene.contacts:
        place = contact_geometry(scene.model, data, q, contact)
        deeper = -place.gap - float(place.axes[2] @ total)
        if deeper > 0.0:
            total += deeper * place.axes[2]
    return total
