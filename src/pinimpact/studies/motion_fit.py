"""Coefficients of contacts from whole recorded motions, by simulations from their first flights. (I12)"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import sqrtm

from ..checks import in_short
from ..errors import InputError
from ..scene.scene import Scene
from .estimate import Identified, fit, group_numbers
from .flights import Body
from .found import free_body
from .rolling_out import Start, differences, starts_of

Array = NDArray[np.float64]

SAMPLES = 32
"""Frames of a motion that count, at equal distances: poses change little from one to the next."""

FIRST = 16
"""Flights at most by which the start of the fit is chosen."""

STEP = 1e-3
"""Of differences by a parameter, in parts of its range: motions that turn over elsewhere are averaged."""

CHUNKS = 32
"""Of the motions, for an executor: the scene is sent with each and has to be prepared there."""

TOLERANCE = 1e-4
"""Of the fit: where a motion comes to rest on another face, the sum of squares jumps by more."""


def fit_motions(
    motions: Any,
    scene: Scene,
    bounds: dict[str, tuple[float, float]],
    law: str | None,
    loss: str,
    setters: Mapping[str, Callable[[Scene, str, float], Scene]],
    executor: Executor | None,
) -> Identified:
    """Return the parameters whose simulations are closest to recorded motions of a free body.

    Simulations from each flight to the end of the next one come first: in whole motions, a small change turns
    later bounces over, and the sum of squares has many minima.
    """
    free_body(scene, "identify")
    if executor is not None and not isinstance(executor, Executor):
        raise InputError(
            f"executor: {in_short(executor)} given; None or a concurrent.futures.Executor expected",
            field="executor",
            value=executor,
        )
    root = np.real(sqrtm(Body.of(scene.model).inertia))
    about = {"names": tuple(bounds), "law": law, "setters": setters}
    low, high = np.array(list(bounds.values())).T

    def fitted(starts: list[Start], first: Array | None) -> Identified:
        known: dict[bytes, Array] = {}
        slopes: dict[bytes, Array] = {}

        def residual(x: Array, some: list[Start] = starts) -> Array:
            one = partial(_residual, Identified(about | {"x": x}).apply(scene), root)
            if executor is None:
                return np.array(list(map(one, some)))
            return np.array(list(executor.map(one, some, chunksize=-(-len(some) // CHUNKS))))

        def all_of(x: Array) -> Array:
            if x.tobytes() not in known:
                known.clear()
                known[x.tobytes()] = residual(x)
            return known[x.tobytes()]

        def jacobian(x: Array) -> Array:
            if x.tobytes() not in slopes:
                slopes.clear()
                here, steps = all_of(x), STEP * (high - low)
                steps[x + steps > high] *= -1.0
                moved = zip(x + np.diag(steps), steps, strict=True)
                slopes[x.tobytes()] = np.stack([(residual(y) - here) / h for y, h in moved], axis=2)
            return slopes[x.tobytes()]

        group = group_numbers([start.label for start in starts], len(starts))
        trial = partial(residual, some=starts[:: -(-len(starts) // FIRST)])
        return fit(
            *(all_of, jacobian, bounds, group, loss, lambda name, x: "", trial, TOLERANCE, first),
            law=law,
            setters=setters,
        )

    flights = starts_of(scene, motions, True, "trajectories")
    near = fitted(flights, None).x if len({start.label for start in flights}) > 1 else None
    return fitted(starts_of(scene, motions, False, "trajectories"), near)


def _residual(scene: Scene, root: Array, start: Start) -> Array:
    """Return the differences (6 SAMPLES,) of a motion, in metres; their squares add up to its mean. (I12)"""
    frames = np.linspace(0, len(start.t) - 1, SAMPLES).round().astype(np.int64)
    off, turn = differences(scene, start, frames)
    turn = start.rotation[frames].inv().apply(turn) @ root
    return np.hstack([off, turn]).ravel() / np.sqrt(SAMPLES)
