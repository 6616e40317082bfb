"""The varying parameters of an ensemble, and the drawing of its samples."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from scipy.stats import qmc

from ..arrays import Array
from ..checks import choice, counted, finite_array, in_short, near_matches, whole_number
from ..errors import InputError, PinimpactError, UnknownNameError
from ..robot.names import coordinate_names
from ..scene.scene import Scene
from .estimate import Identified, set_coefficient
from .posterior import Posterior

COEFFICIENTS = ("friction", "restitution", "sliding_friction", "stiffness")
"""Fields of `Contact` that can vary, of all contacts or of one, "friction:foot"."""

DESIGNS = ("random", "sobol", "halton", "saltelli")


class Sampling:
    """The parameters of an ensemble and their distributions; arguments as in `ensemble`.

    Attributes:
        names: (d,) names of the varying numbers.
        samples: Number of samples; for "saltelli" it is rounded up to d + 2 times a power of two, at least
            2 (d + 2), because a variance needs two base samples.
    """

    def __init__(
        self,
        scene: Scene,
        q0: ArrayLike,
        v0: ArrayLike,
        over: Mapping[str | tuple[str, ...], Any],
        samples: int,
        seed: int,
        design: str,
    ) -> None:
        model = scene.model
        self.scene = scene
        self.q0, self.v0 = finite_array("q0", q0, (model.nq,)), finite_array("v0", v0, (model.nv,))
        self.samples = whole_number("samples", samples, 1)
        self.seed = whole_number("seed", seed, 0)
        self.design = choice("design", design, DESIGNS, "a design")
        if not isinstance(over, Mapping) or not over:
            raise InputError(
                f"over: {in_short(over)} given, distributions by parameter expected, such as "
                '{"friction": scipy.stats.uniform(0.3, 0.2)}',
                value=over,
            )
        self._velocities = coordinate_names(model)[1]
        self._parts: list[tuple[tuple[str, ...], Any]] = []
        for key, distribution in over.items():
            fitted = isinstance(distribution, Posterior)
            names = tuple(distribution.fitted.names) if fitted else self._expanded(key)
            self._parts.append((names, self._checked(key, distribution, len(names))))
        self.names = tuple(name for names, _ in self._parts for name in names)
        twice = sorted({name for name in self.names if self.names.count(name) > 1})
        if twice:
            raise InputError(f"over: {twice[0]!r} is given twice", value=twice[0])
        fits = [distribution.fitted for _, distribution in self._parts if isinstance(distribution, Posterior)]
        laws = sorted({fit.law for fit in fits if fit.law is not None})
        if len(laws) > 1:
            raise InputError(
                f"fitted: fits with the laws {' and '.join(laws)} given, fits with one law expected",
                value=laws,
            )
        self._law = laws[0] if laws else None
        self._setters = dict.fromkeys(COEFFICIENTS, set_coefficient)
        for fit in fits:
            self._setters |= fit.setters
        if self.design == "saltelli":
            block = len(self.names) + 2
            self.base = 2 ** math.ceil(math.log2(max(-(-self.samples // block), 2)))
            self.samples = block * self.base

    def _expanded(self, key: Any) -> tuple[str, ...]:
        """Return the names of the numbers of a key of `over`."""
        names: list[str] = []
        for part in key if isinstance(key, tuple) else (key,):
            kind, _, of = str(part).partition(":")
            if kind in ("q0", "v0"):
                known: Sequence[str] = self._velocities
                names += [f"{kind}:{name}" for name in ([of] if of else known)]
            elif kind in COEFFICIENTS:
                known = [contact.label for contact in self.scene.contacts]
                names.append(str(part))
            else:
                choices = near_matches(kind, (*COEFFICIENTS, "q0", "v0"))
                raise UnknownNameError(f"over: {in_short(part)} is not a parameter; {choices}", value=part)
            if of and of not in known:
                raise UnknownNameError(
                    f"over: {part!r} given, but the scene has no {of!r}; {near_matches(of, known)}",
                    value=part,
                )
        return tuple(names)

    def _checked(self, key: Any, distribution: Any, length: int) -> Any:
        """Return a distribution, checked for the number of values of its key, or raise `InputError`."""
        needs = "rvs" if self.design == "random" else "ppf"

        def refused(what: str) -> InputError:
            return InputError(f"over[{key!r}]: {what} expected", field="over", value=distribution)

        # those of SciPy that are not frozen are called with their parameters
        if callable(distribution) or not callable(getattr(distribution, needs, None)):
            by = "" if needs == "rvs" else f", for the design {self.design!r},"
            raise refused(
                f"{in_short(distribution)} given, a frozen distribution of scipy.stats with {needs}{by}"
            )
        try:
            if needs == "rvs":
                draw = np.squeeze(distribution.rvs(random_state=np.random.default_rng(0)))
            else:
                draw = np.asarray(distribution.ppf(0.5))
            drawn = np.shape(draw)
            if not np.isfinite(draw).all():
                raise ValueError(f"a draw is {draw}")
        except PinimpactError:
            raise
        except Exception as error:
            drawn_from = f"nothing can be drawn from {in_short(distribution)} ({error})"
            raise refused(f"{drawn_from}; one frozen with valid parameters") from error
        if drawn not in ((), (length,)) or (drawn == () and length > 1):
            raise refused(f"draws of shape {drawn} given, {counted(length, 'number')}")
        return distribution

    def draw(self, first: int, count: int) -> Array:
        """Return the numbers (count, d) of samples, which depend only on the seed and on their indices."""
        if self.design == "random":
            rows = []
            for i in range(first, first + count):
                rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(i,)))
                drawn = (np.ravel(distribution.rvs(random_state=rng)) for _, distribution in self._parts)
                rows.append(np.concatenate(list(drawn)))
            return np.array(rows, dtype=float)
        ends = np.cumsum([len(names) for names, _ in self._parts])[:-1]
        parts = np.split(self._unit(first, count), ends, axis=1)
        columns = [distribution.ppf(part) for part, (_, distribution) in zip(parts, self._parts, strict=True)]
        return np.hstack(columns).astype(float)

    def _unit(self, first: int, count: int) -> Array:
        """Return points (count, d) of the unit cube."""
        d = len(self.names)
        if self.design == "halton":
            return _points(qmc.Halton(d, seed=self.seed), first, count)
        if self.design == "sobol":
            return _points(qmc.Sobol(d, seed=self.seed), first, count)
        # A, B, then A with each column of B
        both = _points(qmc.Sobol(2 * d, seed=self.seed), 0, self.base)
        a, b = both[:, :d], both[:, d:]
        rows = []
        for i in range(first, first + count):
            block, k = divmod(i, self.base)
            row = (b if block == 1 else a)[k].copy()
            if block > 1:
                row[block - 2] = b[k, block - 2]
            rows.append(row)
        return np.array(rows)

    def apply(self, numbers: Array) -> tuple[Scene, Array, Array]:
        """Return the scene, q0 and v0 of a sample."""
        of_scene = [j for j, name in enumerate(self.names) if name.partition(":")[0] not in ("q0", "v0")]
        names = [self.names[j] for j in of_scene]
        # all in one, so that parameters of single contacts override general ones of other distributions
        drawn = Identified(names=names, x=numbers[of_scene], law=self._law, setters=self._setters)
        scene = drawn.apply(self.scene) if names else self.scene
        q, v = self.states(numbers[None])
        return scene, q[0], v[0]

    def states(self, numbers: Array) -> tuple[Array, Array]:
        """Return q0 (n, nq) and v0 (n, nv) of samples (n, d)."""
        count, nv = len(numbers), len(self.v0)
        changes = {"q0": np.zeros((count, nv)), "v0": np.zeros((count, nv))}
        for name, column in zip(self.names, numbers.T, strict=True):
            kind, _, of = name.partition(":")
            if kind in changes:
                changes[kind][:, self._velocities.index(of)] = column
        q = np.tile(self.q0, (count, 1))
        for i in np.flatnonzero(changes["q0"].any(axis=1)).tolist():
            q[i] = pin.integrate(self.scene.model, self.q0, changes["q0"][i])
        return q, self.v0 + changes["v0"]

    def coefficient(self, numbers: Array, kind: str) -> Array | None:
        """Return a coefficient (n,) of the scene's only contact, or None if it does not vary."""
        contact = self.scene.contacts[0]
        for name in (f"{kind}:{contact.label}", kind):
            if name in self.names:
                return np.ascontiguousarray(numbers[:, self.names.index(name)])
        return None


def _points(engine: Any, first: int, count: int) -> Array:
    if first:
        engine.fast_forward(first)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of Sobol' points whose number is no power of 2: a chunk's is not
        points: Array = engine.random(count)
    return points
