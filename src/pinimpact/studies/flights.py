"""Free flight of a rigid body: a parabola and a torque-free rotation, fitted to recorded poses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from .._numeric.tolerances import LITTLE
from ..arrays import Array
from ..scene._kernels.tolerances import ATOL, RTOL
from ..scene.scene import Scene
from ..scene.switched_off import altered_model

ITERATIONS = 20
"""Largest number of Gauss–Newton iterations; slow spins with little noise need two."""

DIFFERENCE = LITTLE
"""Increment of finite differences by angular velocity [rad/s]; their relative error is 10⁻⁶."""

_SKEW = np.array(
    [[0, 0, 0, 0, 0, -1, 0, 1, 0], [0, 0, 1, 0, 0, 0, -1, 0, 0], [0, -1, 0, 1, 0, 0, 0, 0, 0]], float
)
"""w @ _SKEW are the entries of the cross-product matrix [w]×."""


class Body(NamedTuple):
    """Properties of a body that determine its flight."""

    lever: Array  # (3,) centre of mass, body axes
    inertia: Array  # (3, 3) about it, over mass, body axes
    gravity: Array  # (3,) in the world

    @classmethod
    def of(cls, scene: Scene) -> Body:
        """Return the properties of the one free body of a scene, without effects that are switched off."""
        model = altered_model(scene.model, scene.without)
        inertia = model.inertias[1]
        return cls(
            np.array(inertia.lever), np.array(inertia.inertia) / inertia.mass, np.array(model.gravity.linear)
        )


@dataclass(frozen=True, slots=True, eq=False)
class Flight:
    """The motion of a body in flight, from poses at several times."""

    time: float  # the instant of the state
    com: Array  # (3,) centre of mass
    velocity: Array  # (3,) of it
    rotation: Rotation  # body to world
    spin: Array  # (3,) angular velocity, body axes
    count: int  # number of frames
    residuals: Array  # (count, 6) of position and rotation, world axes
    covariance: Array  # (6, 6) of velocity (world axes) and spin (body axes), over the variance of a residual

    def at(self, times: Array, body: Body) -> tuple[Array, Rotation, Array, Array]:
        """Return centres of mass, rotations, velocities and spins at times (n,)."""
        dt = np.asarray(times) - self.time
        com = self.com + np.outer(dt, self.velocity) + np.outer(0.5 * dt**2, body.gravity)
        matrices, spins = torque_free(self.rotation.as_matrix()[None], self.spin[None], body.inertia, dt)
        velocity = self.velocity + np.outer(dt, body.gravity)
        return com, Rotation.from_matrix(matrices[:, 0]), velocity, spins[:, 0]


def torque_free(R: Array, w: Array, inertia: Array, times: Array) -> tuple[Array, Array]:
    """Return rotations (t, k, 3, 3) and spins (t, k, 3) of k free bodies at times (t,) from now. (I6)

    R (k, 3, 3) are body to world, w (k, 3) angular velocities, inertia (3, 3) about the centre of mass, in
    body axes.
    """
    momentum, inverse = np.einsum("kij,jl,kl->ki", R, inertia, w)[:, None], np.linalg.inv(inertia)

    def rate(_: float, y: Array) -> Array:
        matrices = y.reshape(-1, 3, 3)
        spins = momentum @ matrices @ inverse
        return (matrices @ (spins @ _SKEW).reshape(-1, 3, 3)).ravel()

    found = np.tile(R, (len(times), 1, 1, 1))
    for sign in (1.0, -1.0):
        asked, which = np.unique(sign * times, return_inverse=True)
        asked, later = asked[asked > 0.0], sign * times > 0.0
        if len(asked):
            span = 0.0, sign * asked[-1]
            steps = solve_ivp(rate, span, R.ravel(), "DOP853", sign * asked, rtol=RTOL, atol=ATOL)
            found[later] = steps.y.T.reshape(-1, *R.shape)[(which - which.max() - 1)[later]]
    return found, (momentum @ found @ inverse)[:, :, 0]


def fit_flight(times: Array, com: Array, rotations: Rotation, instant: float, body: Body) -> Flight:
    """Fit a flight to recorded poses by least squares. (I7)

    Args:
        times: (n,) ascending times [s], at least three.
        com: (n, 3) centres of mass [m].
        rotations: n rotations, body to world.
        instant: Time of the state of the flight [s].
        body: The body.
    """
    dt = times - instant
    line = np.column_stack([np.ones_like(dt), dt])
    inverse = np.linalg.pinv(line)
    parabola = com - np.outer(0.5 * dt**2, body.gravity)
    p, v = inverse @ parabola
    first = int(np.argmin(np.abs(dt)))
    others = rotations.as_matrix()
    # start: a constant rate over neighbours, integrated along the window
    steps = (rotations[:-1].inv() * rotations[1:]).as_rotvec() / np.diff(times)[:, None]
    w = steps[min(first, len(steps) - 1)]
    R = torque_free(others[first][None], w[None], body.inertia, np.array([-dt[first]]))
    matrix, w = R[0][0, 0], R[1][0, 0]
    slopes = np.empty((len(dt), 3, 6))
    for _ in range(ITERATIONS):
        starts = np.vstack([w, w + DIFFERENCE * np.eye(3)])
        found, _ = torque_free(np.tile(matrix, (4, 1, 1)), starts, body.inertia, dt)
        off = Rotation.from_matrix(others @ np.swapaxes(found[:, 0], 1, 2)).as_rotvec()
        turned = found[:, 1:] @ np.swapaxes(found[:, :1], 2, 3)
        slopes[:, :, :3] = np.eye(3)
        slopes[:, :, 3:] = np.swapaxes(
            Rotation.from_matrix(turned.reshape(-1, 3, 3)).as_rotvec().reshape(-1, 3, 3), 1, 2
        )
        slopes[:, :, 3:] /= DIFFERENCE
        step = np.linalg.lstsq(slopes.reshape(-1, 6), off.ravel(), rcond=None)[0]
        matrix = Rotation.from_rotvec(step[:3]).as_matrix() @ matrix
        w = w + step[3:]
        if float(np.abs(slopes @ step).max()) ** 2 <= ATOL:  # an iteration squares the error
            break
    found, _ = torque_free(matrix[None], w[None], body.inertia, dt)
    off = Rotation.from_matrix(others @ np.swapaxes(found[:, 0], 1, 2)).as_rotvec()
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = (inverse[1] @ inverse[1]) * np.eye(3)
    rows = slopes.reshape(-1, 6)
    covariance[3:, 3:] = np.linalg.inv(rows.T @ rows)[3:, 3:]
    residuals = np.hstack([parabola - line @ np.array([p, v]), off])
    return Flight(instant, p, v, Rotation.from_matrix(matrix), w, len(dt), residuals, covariance)
