"""Predictions of where a motion ends, from what was identified and how sure it is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from ..checks import as_tuple, at_least_zero, coefficient, finite_array
from ..errors import InputError, UnknownNameError
from ..scene.scene import Scene
from .ensemble_result import Ensemble, Estimate, shares
from .ensembles import ensemble
from .estimate import Identified

Array = NDArray[np.float64]

AXES = {
    "+x": (1.0, 0.0, 0.0),
    "-x": (-1.0, 0.0, 0.0),
    "+y": (0.0, 1.0, 0.0),
    "-y": (0.0, -1.0, 0.0),
    "+z": (0.0, 0.0, 1.0),
    "-z": (0.0, 0.0, -1.0),
}

DRAWS = 10_000
"""Draws outside the bounds of parameters after which a distribution has none inside."""


@dataclass(frozen=True)
class _Posterior:
    """A normal distribution of parameters between their bounds, as one of `scipy.stats`."""

    mean: Array
    root: Array
    bounds: Array

    def rvs(self, random_state: np.random.Generator) -> Array:
        """Return one draw."""
        for _ in range(DRAWS):
            drawn: Array = self.mean + self.root @ random_state.standard_normal(len(self.mean))
            if (drawn >= self.bounds[0]).all() and (drawn <= self.bounds[1]).all():
                return drawn
        raise InputError(
            f"fitted: no draws about {self.mean.tolist()} are within the bounds; fit it with wider ones",
            field="fitted",
            value=self.mean,
        )


@dataclass(frozen=True, eq=False, repr=False)
class Prediction:
    """What `predict` returns.

    Attributes:
        ensemble: All samples. Those that raised an error are not counted below.
        base: Name of the free joint whose pose is predicted.
    """

    ensemble: Ensemble
    base: str

    def _columns(self, names: Sequence[str]) -> Array:
        columns = self.ensemble.columns
        values = np.array([columns[f"q.{self.base}.{name}"] for name in names], dtype=float).T
        found: Array = values[np.isfinite(values).all(axis=1)]
        if not len(found):
            raise InputError("samples: none has an end; see ensemble.frequencies()", field="samples")
        return found

    def position(self, level: float = 0.9) -> tuple[Array, float]:
        """Return the median (3,) of the end positions and the radius [m] that holds a part of them."""
        points = self._columns(("x", "y", "z"))
        middle = np.median(points, axis=0)
        away = np.linalg.norm(points - middle, axis=1)
        return middle, float(np.quantile(away, coefficient("level", level)))

    def rotation(self, level: float = 0.9) -> tuple[Rotation, float]:
        """Return the mean of the end orientations and the angle [rad] from it that holds a part of them."""
        turns = Rotation.from_quat(self._columns(("qx", "qy", "qz", "qw")))
        middle = turns.mean()
        away = (middle.inv() * turns).magnitude()
        return middle, float(np.quantile(away, coefficient("level", level)))

    def faces(self, faces: Mapping[str, ArrayLike] = AXES, confidence: float = 0.95) -> dict[str, Estimate]:
        """Return how often each face of the body is on top at the end, with Wilson's intervals.

        Args:
            faces: Outward normals of the faces, in the body's axes, by name; the axes of the body by default.
            confidence: That of the intervals.
        """
        names = list(faces)
        normals = np.array([finite_array(f"faces[{name!r}]", faces[name], (3,)) for name in names])
        sizes = np.linalg.norm(normals, axis=1)
        if len(names) == 0 or (sizes == 0.0).any():
            raise InputError("faces: outward normals of any length but zero expected", field="faces")
        turns = Rotation.from_quat(self._columns(("qx", "qy", "qz", "qw")))
        up = turns.inv().apply([0.0, 0.0, 1.0])
        top = (up @ (normals / sizes[:, None]).T).argmax(axis=1)
        return shares(np.array(names, dtype=object)[top], confidence)

    def __repr__(self) -> str:
        middle, radius = self.position()
        return f"Prediction({self.base} ends at {middle.round(4).tolist()} m, 90 % within {radius:.3g} m)"


def predict(
    scene: Scene,
    fitted: Identified | Sequence[Identified],
    q0: ArrayLike,
    v0: ArrayLike,
    duration: float,
    *,
    scatter: Mapping[str, float] | None = None,
    start: Mapping[str, ArrayLike] | None = None,
    samples: int = 1000,
    seed: int = 0,
    executor: Executor | int | None = None,
    **options: Any,
) -> Prediction:
    """Predict where a free body ends up, from parameters that were identified. (studies.md)

    Samples draw the parameters from normal distributions with the covariance of the fit, within its bounds.

    Args:
        scene: The scene, with one free body or a robot with a free base.
        fitted: Results of `identify` and `identify_sliding` for coefficients of contacts.
        q0: (nq,) configuration.
        v0: (nv,) velocity.
        duration: Time to simulate [s].
        scatter: Standard deviations of parameters between groups, by name, added to those of the fit: what
            differs from toss to toss.
        start: Covariances (nv, nv) of the start, "q0" and "v0", in the tangent space.
        samples: Number of samples.
        seed: Seed of all draws.
        executor: As of `ensemble`.
        **options: Further arguments of `ensemble` and `simulate`.

    Raises:
        InputError: A scene without a free base, a covariance that is none; the errors of `ensemble`.
        UnknownNameError: A name in `scatter` or `start` that does not exist.
    """
    model = scene.model
    free = [name for name, joint in zip(model.names, model.joints, strict=True) if joint.nq == 7]
    if not free:
        raise InputError("scene: no body has a free joint, whose pose could be predicted", field="scene")
    over: dict[str | tuple[str, ...], Any] = {}
    scatter = dict(scatter or {})
    for one in as_tuple("fitted", fitted, Identified, "a result of identify"):
        if one.unidentified:
            raise InputError(f"fitted: {one.unidentified[0]}", field="fitted", value=one)
        spread = np.array([at_least_zero(f"scatter[{n!r}]", scatter.pop(n, 0.0)) for n in one.names])
        root = _root("fitted", one.covariance + np.diag(spread**2), len(spread))
        over[tuple(one.names)] = _Posterior(np.asarray(one.x), root, np.asarray(one.bounds))
    if scatter:
        name = next(iter(scatter))
        raise UnknownNameError(f"scatter: {name!r} was not fitted", field="scatter", value=name)
    for name, covariance in (start or {}).items():
        if name not in ("q0", "v0"):
            raise UnknownNameError(f'start: {name!r} given, "q0" or "v0" expected', field="start", value=name)
        unbounded = np.array([[-np.inf], [np.inf]]) * np.ones(model.nv)
        root = _root(f"start[{name!r}]", covariance, model.nv)
        over[name] = _Posterior(np.zeros(model.nv), root, unbounded)
    found = ensemble(
        scene, q0, v0, duration, over=over, samples=samples, seed=seed, executor=executor, **options
    )
    return Prediction(found, free[0])


def _root(field: str, covariance: ArrayLike, size: int) -> Array:
    """Return L with L Lᵀ = the covariance, which may be singular."""
    matrix = finite_array(field, covariance, (size, size))
    values, vectors = np.linalg.eigh(matrix)
    if not np.allclose(matrix, matrix.T) or values.min() < -1e-12 * max(values.max(), 0.0):
        raise InputError(
            f"{field}: not a covariance; a symmetric matrix without negative eigenvalues expected",
            field=field,
            value=covariance,
        )
    root: Array = vectors * np.sqrt(np.maximum(values, 0.0))
    return root
