"""Predictions of the end of a motion from identified parameters and their uncertainty."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from ..arrays import Array
from ..checks import as_tuple, at_least_zero, coefficient, finite_array, whole_number
from ..errors import InputError, UnknownNameError
from ..scene.scene import Scene
from .ensemble_result import Ensemble, Estimate, shares
from .ensembles import ensemble
from .estimate import Identified
from .posterior import Normal, covariance_root, posterior

if TYPE_CHECKING:
    from ..visual.html_replay import Replay


AXES = {s + "xyz"[k]: tuple(sign * np.eye(3)[k]) for k in range(3) for s, sign in (("+", 1.0), ("-", -1.0))}


@dataclass(frozen=True, eq=False, repr=False)
class Prediction:
    """The result of `predict`.

    Attributes:
        ensemble: All samples. Those that raised an error are excluded from the statistics.
        base: Name of the free joint whose pose is predicted.
        placement: Pose of the axes of its configuration, in the world.
    """

    ensemble: Ensemble
    base: str
    placement: pin.SE3

    def _poses(self) -> tuple[Array, Rotation]:
        """Return the final positions and rotations of all samples without an error, in the world."""
        columns = self.ensemble.columns
        ended = columns["status"] == "OK"
        if not ended.any():
            raise InputError("samples: no sample has a final pose; see ensemble.frequencies()")
        names = ("x", "y", "z", "qx", "qy", "qz", "qw")
        values = np.array([columns[f"q.{self.base}.{name}"][ended] for name in names], dtype=float).T
        axes, origin = np.array(self.placement.rotation), np.array(self.placement.translation)
        return origin + values[:, :3] @ axes.T, Rotation.from_matrix(axes) * Rotation.from_quat(values[:, 3:])

    def position(self, level: float = 0.9) -> tuple[Array, float]:
        """Return the median (3,) of the final positions, and the radius [m] that contains a part of them."""
        points, _ = self._poses()
        middle = np.median(points, axis=0)
        away = np.linalg.norm(points - middle, axis=1)
        return middle, float(np.quantile(away, coefficient("level", level)))

    def rotation(self, level: float = 0.9) -> tuple[Rotation, float]:
        """Return the mean final orientation, and the angle [rad] from it that contains a part of all."""
        _, turns = self._poses()
        middle = turns.mean()
        away = (middle.inv() * turns).magnitude()
        return middle, float(np.quantile(away, coefficient("level", level)))

    def faces(self, faces: Mapping[str, ArrayLike] = AXES, confidence: float = 0.95) -> dict[str, Estimate]:
        """Return the frequency with which each face of the body ends on top, with Wilson's intervals.

        Args:
            faces: Outward normals of the faces, in the body's axes, by name; the axes of the body by default.
            confidence: Confidence of the intervals.
        """
        names = list(faces)
        normals = np.array([finite_array(f"faces[{name!r}]", faces[name], (3,)) for name in names])
        sizes = np.linalg.norm(normals, axis=1)
        if len(names) == 0 or (sizes == 0.0).any():
            raise InputError("faces: outward normals of any length but zero expected")
        _, turns = self._poses()
        up = turns.inv().apply([0.0, 0.0, 1.0])
        top = (up @ (normals / sizes[:, None]).T).argmax(axis=1)
        return shares(np.array(names, dtype=object)[top], confidence)

    def replay(self, robot: Any, path: str | Path | None = "replay.html", samples: int = 30) -> Replay:
        """Write the motion of the sample nearest to the median among others, translucent, to an HTML file.

        Args:
            robot: The robot with its visual geometry, as of `pinimpact.replay`.
            path: The file to write, in a folder that exists; None for none.
            samples: Number of other samples; they are simulated again.
        """
        from ..visual.html_replay import cloud_replay

        count = whole_number("samples", samples, 1)
        middle = self._nearest()
        ended = np.flatnonzero(self.ensemble.columns["status"] == "OK")
        others = [i for i in ended.tolist() if i != middle][:count]
        run = self.ensemble.trajectory
        return cloud_replay(robot, run(middle), [run(i) for i in others], path)

    def _nearest(self) -> int:
        """Return the sample whose final pose is nearest to the median, relative to the 50 % regions."""
        (place, radius), (turn, angle) = self.position(0.5), self.rotation(0.5)
        points, turns = self._poses()
        away = np.linalg.norm(points - place, axis=1) / (radius or 1.0)
        turned = (turn.inv() * turns).magnitude() / (angle or 1.0)
        ended = np.flatnonzero(self.ensemble.columns["status"] == "OK")
        return int(ended[np.argmin(away**2 + turned**2)])

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

    Samples draw the parameters from normal distributions with the covariance of the fit, within its bounds,
    and have the restitution law of the fit. Parameters of single contacts override those of all contacts.

    Args:
        scene: The scene, with one free body or a robot with a free base.
        fitted: Results of `identify`, `identify_body` and `identify_sliding`.
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
        InputError: A scene without a free base, a covariance that is none, fits with different laws; the
            errors of `ensemble`.
        UnknownNameError: A name in `scatter` or `start` that does not exist.
    """
    model = scene.model
    free = [
        j
        for j in range(1, model.njoints)
        if model.parents[j] == 0 and model.joints[j].shortname() == "JointModelFreeFlyer"
    ]
    if not free:
        raise InputError("scene: no body has a free joint, so there is no pose to predict")
    if "reduce" in options:
        raise InputError("reduce: given, but predict sets it to the final pose; remove it")
    over: dict[str | tuple[str, ...], Any] = {}
    scatter = dict(scatter or {})
    for one in as_tuple("fitted", fitted, Identified, "a result of identify"):
        if one.unidentified:
            raise InputError(f"fitted: {one.unidentified[0]}", value=one)
        spread = np.array([at_least_zero(f"scatter[{n!r}]", scatter.pop(n, 0.0)) for n in one.names])
        over[tuple(one.names)] = posterior(one, spread)
    if scatter:
        name = next(iter(scatter))
        raise UnknownNameError(f"scatter: {name!r} was not fitted", value=name)
    for name, covariance in (start or {}).items():
        if name not in ("q0", "v0"):
            raise UnknownNameError(f'start: {name!r} given, "q0" or "v0" expected', value=name)
        over[name] = Normal(np.zeros(model.nv), covariance_root(f"start[{name!r}]", covariance, model.nv))
    found = ensemble(
        scene, q0, v0, duration, over=over, samples=samples, seed=seed, executor=executor, **options
    )
    return Prediction(found, model.names[free[0]], pin.SE3(model.jointPlacements[free[0]]))
