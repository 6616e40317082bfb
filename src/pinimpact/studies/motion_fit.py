"""Coefficients of contacts from whole recorded motions, by simulations from their first flights. (I12)"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from functools import lru_cache, partial
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import sqrtm
from scipy.optimize import Bounds, minimize

from .._numeric.tolerances import LITTLE
from ..arrays import Array, Integers
from ..checks import choice, in_short, truth_value
from ..errors import InputError
from ..scene.scene import Scene
from .estimate import LOSSES, Identified, best_start, fit, group_numbers, robust_scale, with_covariance
from .flights import Body
from .found import free_body
from .measured import digests
from .rolling_out import Start, differences, starts_of

SAMPLES = 32
"""Number of equidistant frames of a motion that are compared; neighbouring poses differ little."""

FIRST, NEXT = 16, 256
"""Largest number of simulations that choose the start of a fit, and the start of a fit to whole motions."""

STEP = LITTLE
"""Increment of finite differences by a parameter, relative to its range."""

CHUNKS = 32
"""Number of chunks of motions for an executor: the scene is sent, and prepared, with each."""

TOLERANCE = 1e-4
"""Relative tolerance of the cost of fits to flights: a sixth of a standard error with 300 groups."""

RADII = 0.1, 3e-3
"""Initial and final trust-region radius of fits to whole motions, relative to the ranges of parameters."""

CURVED = 0.5
"""Largest ratio of the difference to the sum of a motion's forward and backward differences; 1 at a jump."""

JUMPS = 0.1
"""Largest part of the information on a parameter from motions that exceed `CURVED`."""


def fit_motions(
    motions: Any,
    scene: Scene,
    bounds: dict[str, tuple[float, float]],
    limits: dict[str, tuple[float, float]],
    law: str | None,
    loss: str,
    setters: Mapping[str, Callable[[Scene, str, float], Scene]],
    executor: Executor | None,
    restart: bool,
) -> Identified:
    """Return the parameters whose simulations are closest to recorded motions of a free body.

    Simulations from each flight to the end of the next one depend smoothly on the parameters. Whole motions
    are discontinuous where a later bounce changes side: they are fitted without derivatives, from the fit to
    flights.
    """
    free_body(scene, "identify")
    restart = truth_value("restart", restart)
    if executor is not None and not isinstance(executor, Executor):
        raise InputError(
            f"executor: {in_short(executor)} given; None or a concurrent.futures.Executor expected",
            value=executor,
        )
    choice("loss", loss, LOSSES, "a loss")
    root = np.real(sqrtm(Body.of(scene).inertia))
    fits = _Fits(scene, bounds, limits, law, loss, setters, executor, root)
    flights = starts_of(scene, motions, True, "trajectories")
    if restart:
        return fits.to_flights(flights)
    whole = starts_of(scene, motions, False, "trajectories")
    if len({start.label for start in flights}) > 1:
        near = fits._replace(loss="linear").to_flights(_some(flights, NEXT)).x
    else:
        near = best_start(bounds, partial(fits.residual, _some(whole, FIRST)))
    return fits.to_whole_motions(whole, near)


class _Fits(NamedTuple):
    """Fits to motions; the arguments are those of `identify`."""

    scene: Scene
    bounds: dict[str, tuple[float, float]]
    limits: dict[str, tuple[float, float]]
    law: str | None
    loss: str
    setters: Mapping[str, Callable[[Scene, str, float], Scene]]
    executor: Executor | None
    root: Array  # (3, 3) square root of the inertia of the body over its mass

    def residual(self, starts: list[Start], x: Array) -> Array:
        """Return the residuals (n, m) for parameters (p,)."""
        known = Identified(names=tuple(self.bounds), law=self.law, setters=self.setters, x=x)
        one = partial(_residual, known.apply(self.scene), self.root)
        if self.executor is None:
            return np.array(list(map(one, starts)))
        return np.array(list(self.executor.map(one, starts, chunksize=-(-len(starts) // CHUNKS))))

    def data(self, starts: list[Start]) -> tuple[Integers, dict[str, Any]]:
        """Return the groups of motions, and what identifies their residuals."""
        rows = digests(*zip(*((start.t, start.recorded, self.root) for start in starts), strict=True))
        return group_numbers([start.label for start in starts], rows), {"measure": "motions", "rows": rows}

    def to_flights(self, starts: list[Start]) -> Identified:
        """Fit flights by least squares, with finite differences."""
        low, high = np.array(list(self.bounds.values())).T
        group, known = self.data(starts)
        at = lru_cache(1)(lambda x: self.residual(starts, np.array(x)))

        @lru_cache(1)
        def slopes_at(given: tuple[float, ...]) -> Array:
            x, steps = np.array(given), STEP * (high - low)
            steps[x + steps > high] *= -1.0
            moved = zip(x + np.diag(steps), steps, strict=True)
            return np.stack([(self.residual(starts, y) - at(given)) / h for y, h in moved], axis=2)

        return fit(
            lambda x: at(tuple(x.tolist())),
            lambda x: slopes_at(tuple(x.tolist())),
            *(self.bounds, group, self.loss),
            trial=partial(self.residual, _some(starts, FIRST)),
            tolerance=TOLERANCE,
            limits=self.limits,
            law=self.law,
            setters=self.setters,
            **known,
        )

    def to_whole_motions(self, starts: list[Start], near: Array) -> Identified:
        """Fit whole motions by a derivative-free trust-region method (COBYQA), from x = `near` (p,)."""
        group, known = self.data(starts)
        low, high = np.array(list(self.bounds.values())).T
        at = lru_cache(None)(lambda x: self.residual(starts, np.array(x)))  # few points, some of them twice

        def place(z: Array) -> Array:
            return np.clip(low + z * (high - low), low, high)

        first = (near - low) / (high - low)
        scale = 1.0 if self.loss == "linear" else robust_scale(at(tuple(place(first).tolist()))) or 1.0

        def cost(z: Array) -> float:
            squares = (at(tuple(place(z).tolist())) / scale) ** 2
            return 0.5 * float(LOSSES[self.loss](squares)[0].mean())

        found = minimize(
            cost,
            first,
            method="COBYQA",
            bounds=Bounds(0.0, 1.0),
            options=dict(zip(("initial_tr_radius", "final_tr_radius"), RADII, strict=True)),
        )
        found.x = place(found.x)
        steps = STEP * (high - low)
        centre = np.clip(found.x, low + steps, high - steps)
        here = at(tuple(centre.tolist()))
        ahead = np.stack([self.residual(starts, centre + h) - here for h in np.diag(steps)], axis=2)
        behind = np.stack([here - self.residual(starts, centre - h) for h in np.diag(steps)], axis=2)
        slopes = (ahead + behind) / (2.0 * steps)
        found |= {"fun": here.ravel(), "jac": slopes.reshape(-1, len(low))}
        found.cost = float(LOSSES[self.loss]((here / scale) ** 2)[0].sum()) * 0.5 * scale**2
        given = found, self.bounds, here, slopes, group, self.loss, scale
        result = with_covariance(*given, limits=self.limits, law=self.law, setters=self.setters, **known)
        _without_jumps(result, ahead, behind)
        return result


def _some(starts: list[Start], most: int) -> list[Start]:
    """Return at most `most` of the starts, evenly spaced."""
    return starts[:: -(-len(starts) // most)]


def _without_jumps(result: Identified, ahead: Array, behind: Array) -> None:
    """Remove the intervals of parameters that are determined by motions with discontinuous residuals. (I12)

    `ahead` and `behind` (n, m, p) are forward and backward differences of the residuals of n motions by each
    parameter. The covariance and sentences of the result are changed in place.
    """
    slope = np.linalg.norm(ahead + behind, axis=1)
    jumps = np.linalg.norm(ahead - behind, axis=1) > CURVED * slope
    for j, name in enumerate(result.names):
        whole = float((slope[:, j] ** 2).sum())
        share = float((slope[jumps[:, j], j] ** 2).sum()) / whole if whole > 0.0 else 0.0
        if share > JUMPS and np.isfinite(result.covariance[j, j]):
            result.covariance[j] = result.covariance[:, j] = 0.0
            result.covariance[j, j] = np.inf
            sentence = (
                f"{name} has no interval: {share:.0%} of what determines it comes from "
                f"{jumps[:, j].sum()} motions that jump as it changes; restart=True fits single flights."
            )
            result.unidentified = (*result.unidentified, sentence)


def _residual(scene: Scene, root: Array, start: Start) -> Array:
    """Return the residuals (6 SAMPLES,) of a motion [m]; their sum of squares is a mean over frames. (I12)"""
    frames = np.linspace(0, len(start.t) - 1, SAMPLES).round().astype(np.int64)
    position, turn = differences(scene, start, frames)
    turn = start.rotation[frames].inv().apply(turn) @ root
    return np.hstack([position, turn]).ravel() / np.sqrt(SAMPLES)
