"""Least-squares fits to grouped measurements, with confidence intervals that are robust to groups.

The estimators are in docs/identification.md.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import OptimizeResult, least_squares
from scipy.stats import chi, qmc, t

from .. import checks
from .._numeric.tolerances import HALF_DIGITS, LITTLE
from ..arrays import Array, Integers
from ..checks import as_tuple, choice, counted, finite_array, in_short, real_numbers
from ..errors import InputError
from ..scene._kernels.tolerances import RTOL
from .measured import numbered

STARTS = 16
"""Number of points of a Halton sequence in the bounds; the one with the least cost is the start of a fit."""

ROBUST_SCALE = 3.0
"""Residual above which a loss reduces weights, in standard deviations; 99 % of the information of normally
distributed residuals is retained."""


def _soft_l1(z: Array) -> Array:
    root = np.sqrt(1.0 + z)
    return np.array([2.0 * (root - 1.0), 1.0 / root, -0.5 / root**3])


LOSSES: dict[str, Callable[[Array], Array]] = {
    "linear": lambda z: np.array([z, np.ones_like(z), np.zeros_like(z)]),
    "soft_l1": _soft_l1,
}
"""ρ, ρ′ and ρ″ of the squared ratio of a residual to its scale, as in `scipy.optimize.least_squares`."""


class Identified(OptimizeResult):
    """Fitted parameters: an `OptimizeResult` of SciPy with covariance and intervals. (docs/identification.md)

    Attributes:
        x: (p,) the parameters.
        names: Their names.
        bounds: (2, p) their bounds.
        covariance: (p, p) their covariance by leaving out groups (I4); infinite where there is none.
        groups: Number of groups; if each is given k times, its copies are one.
        group: (n,) number of the group of each row of residuals.
        measure: What the residuals are; those of other fits are comparable if theirs are the same.
        rows: (n,) digests of the measurements of each row, and of their weights.
        degrees: (p,) degrees of freedom of the intervals (I5), fewer if groups have unequal weight.
        unidentified: One sentence for each parameter that the data do not determine, within its bounds.
        fun: (n m,) whitened residuals, row by row; `jac` and `cost` are as in `scipy.optimize.least_squares`.
        scale: Residual above which the loss reduces weights.
        law: Restitution law of the fit; None if no law was used.
    """

    @property
    def standard_errors(self) -> Array:
        """(p,) square roots of the variances."""
        return np.sqrt(np.diag(self.covariance))

    def interval(self, level: float = 0.95) -> Array:
        """Return the (p, 2) confidence intervals at a level, by Student's t, within the bounds. (I5)"""
        half = t.ppf(0.5 + 0.5 * checks.level(level), self.degrees) * self.standard_errors
        low, high = self.bounds
        return np.clip(np.column_stack([self.x - half, self.x + half]), low[:, None], high[:, None])

    def apply(self, scene: Any) -> Any:
        """Return the scene with the fitted parameters.

        Raises:
            UnknownNameError: The scene has no contact of a fitted name.
        """
        for j in general_first(self.names):
            name = self.names[j]
            scene = self.setters[name.partition(":")[0]](scene, name, float(self.x[j]))
        if self.law is not None:
            scene = replace(scene, contacts=[replace(contact, law=self.law) for contact in scene.contacts])
        return scene

    def plot(self) -> Any:
        """Return a matplotlib Figure: parameters with intervals, and the residuals against normal ones."""
        from ..visual.plots.fits import fit_figure

        return fit_figure(self)

    def __repr__(self) -> str:
        rows = [
            f"  {name} = {value:.6g} ± {error:.2g}"
            for name, value, error in zip(self.names, self.x, self.standard_errors, strict=True)
        ]
        head = f"Identified({len(self.fun)} residuals in {self.groups} groups"
        return "\n".join([head, *rows, *(f"  {sentence}" for sentence in self.unidentified)]) + ")"


def set_coefficient(scene: Any, name: str, value: float) -> Any:
    """Return a scene with one coefficient of one or all contacts."""
    kind, _, label = name.partition(":")
    labels = [contact.label for contact in scene.contacts]
    if label and label not in labels:
        choice("scene", label, labels, "a contact of the scene")
    changed: dict[str, Any] = {kind: value}
    contacts = [
        replace(contact, **changed) if label in ("", contact.label) else contact for contact in scene.contacts
    ]
    return replace(scene, contacts=contacts)


def general_first(names: Sequence[str]) -> list[int]:
    """Return the indices of parameters, with those of single contacts or joints last, since they override."""
    return sorted(range(len(names)), key=lambda j: ":" in names[j])


def fit(
    residual: Callable[[Array], Array],
    jacobian: Callable[[Array], Array],
    free: Mapping[str, tuple[float, float]],
    group: Integers,
    loss: str,
    *,
    reason: Callable[[str, Array], str] = lambda name, x: "",
    trial: Callable[[Array], Array] | None = None,
    tolerance: float = RTOL,
    **known: Any,
) -> Identified:
    """Fit parameters, and return them with their covariance by groups. (I2)–(I5)

    Args:
        residual: Returns whitened residuals (n, m) of parameters (p,).
        jacobian: Returns their derivatives (n, m, p).
        free: Bounds of the parameters by name.
        group: (n,) index of the group of each row.
        loss: One of `LOSSES`.
        reason: See `with_covariance`.
        trial: Returns fewer residuals, or cheaper ones, to choose the start.
        tolerance: Relative tolerance of `least_squares` for cost and parameters.
        **known: See `with_covariance`.
    """
    rho = LOSSES[choice("loss", loss, LOSSES, "a loss")]
    low, high = np.array(list(free.values())).T

    def run(x: Array, loss: Any, scale: float) -> OptimizeResult:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Setting `gtol`")
            return least_squares(
                lambda x: residual(x).ravel(),
                x,
                lambda x: jacobian(x).reshape(-1, len(x)),
                bounds=(low, high),
                x_scale=high - low,
                loss=loss,
                f_scale=scale,
                ftol=tolerance,
                xtol=tolerance,
                gtol=np.finfo(float).tiny,  # it has a unit, so that only a gradient of zero ends a fit
            )

    errors, scale = trial or residual, 1.0
    result = run(best_start(free, errors), "linear", 1.0)
    while (start := better_along_a_parameter(result.x, free, errors)) is not None:
        other = run(start, "linear", 1.0)
        if other.cost >= result.cost:
            break
        result = other
    if loss != "linear":
        scale = robust_scale(residual(result.x))
        if scale > 0.0:
            result = run(result.x, rho, scale)
        else:  # more than half of the rows are zero, so there is no scale
            loss = "linear"
    slopes, residuals = jacobian(result.x), residual(result.x)
    return with_covariance(result, free, residuals, slopes, group, loss, scale, reason, **known)


def best_start(free: Mapping[str, tuple[float, float]], residual: Callable[[Array], Array]) -> Array:
    """Return that of `STARTS` points within the bounds with the least sum of absolute residuals."""
    low, high = np.array(list(free.values())).T
    starts = qmc.scale(qmc.Halton(len(free), scramble=False).random(STARTS + 1)[1:], low, high)
    return min(starts, key=lambda x: float(np.abs(residual(x)).sum()))


def better_along_a_parameter(
    x: Array, free: Mapping[str, tuple[float, float]], residual: Callable[[Array], Array]
) -> Array | None:
    """Return the best of some points that differ from x in one parameter; None if it is hardly better than x.

    A fit stays at its start if a parameter has no effect there, such as friction if all impacts stick.
    """
    others = np.repeat(x[None], STARTS * len(x), axis=0)
    parts = (np.arange(STARTS) + 0.5) / STARTS
    for j, (low, high) in enumerate(free.values()):
        others[j * STARTS : (j + 1) * STARTS, j] = low + parts * (high - low)
    costs = [float((residual(other) ** 2).sum()) for other in (x, *others)]
    best = int(np.argmin(costs))
    return others[best - 1] if costs[best] < (1.0 - LITTLE) * costs[0] else None


def robust_scale(residuals: Array) -> float:
    """Return the scale above which a loss reduces the weights of residuals (n, m).

    It follows from the norms of rows, so that components without errors, such as the tangential ones of a
    body that falls straight down, do not make it zero.
    """
    lengths = np.linalg.norm(residuals, axis=1)
    return ROBUST_SCALE * float(np.median(lengths) / chi.median(residuals.shape[1]))


def with_covariance(
    solution: OptimizeResult,
    free: Mapping[str, tuple[float, float]],
    residuals: Array,
    slopes: Array,
    group: Integers,
    loss: str,
    scale: float,
    reason: Callable[[str, Array], str] = lambda name, x: "",
    limits: Mapping[str, tuple[float, float]] | None = None,
    **known: Any,
) -> Identified:
    """Return a solution with its covariance by groups. (I3)–(I5)

    Args:
        solution: The solution, with parameters x (p,).
        free: Bounds of the parameters by name.
        residuals: (n, m) whitened residuals.
        slopes: (n, m, p) their derivatives.
        group: (n,) index of the group of each row, from 0.
        loss: One of `LOSSES`.
        scale: Residual above which the loss reduces weights.
        reason: Returns a clause on why a parameter is not determined, for its name and x; may be empty.
        limits: Bounds of parameters by name that no value can exceed; other bounds limit the search only.
        **known: Further attributes of the result.
    """
    low, high = np.array(list(free.values())).T
    parts = _by_group(slopes, residuals, LOSSES[loss], scale or 1.0, group)
    covariance, degrees, null, none = _covariance(*parts, high - low)
    ends = _exceeded(np.asarray(solution.x), *parts, np.array([low, high]), list(free), limits or {})
    result = Identified(
        **dict(solution.items()),
        names=tuple(free),
        bounds=np.array([low, high]),
        covariance=covariance,
        degrees=degrees,
        groups=int(group.max()) + 1,
        group=group,
        scale=scale,
        **({"law": None} | known),
    )
    result.unidentified = _unidentified(result, null, none, ends, reason)
    return result


def _by_group(
    slopes: Array, residuals: Array, rho: Callable[[Array], Array], scale: float, group: Integers
) -> tuple[Array, Array]:
    """Return the Hessians (G, p, p) and gradients (G, p) of the cost of each group. (I3)"""
    z = (residuals / scale) ** 2
    _, first, second = rho(z)
    count, p = int(group.max()) + 1, slopes.shape[2]
    hessians, gradients = np.zeros((count, p, p)), np.zeros((count, p))
    np.add.at(hessians, group, np.einsum("nki,nk,nkj->nij", slopes, first + 2.0 * second * z, slopes))
    np.add.at(gradients, group, np.einsum("nki,nk->ni", slopes, first * residuals))
    return hessians, gradients


def _covariance(hessians: Array, gradients: Array, widths: Array) -> tuple[Array, Array, Array, Array]:
    """Return the covariance (p, p) (I4), the degrees of freedom (p,), and which parameters lack information.

    The latter are (p,) whether no group, and whether at most one group determines a parameter. In units of
    the ranges of parameters, a combination is undetermined if the Hessian has an eigenvalue of zero within
    rounding, and determined by one group if that holds without the group.
    """
    count, eps = len(gradients), float(np.finfo(float).eps)
    values, vectors = np.linalg.eigh(hessians.sum(axis=0) * np.outer(widths, widths))
    kept = values > eps * count * max(float(values[-1]), 0.0)
    root = widths[:, None] * vectors[:, kept] / np.sqrt(values[kept])  # H⁻¹ = root rootᵀ
    shares, turned = np.linalg.eigh(root.T @ hessians @ root)
    alone = shares > 1.0 - np.sqrt(eps)
    parts = np.einsum("gia,ij,gj->ga", turned, root.T, gradients)
    parts = np.where(alone, 0.0, parts / np.where(alone, 1.0, 1.0 - shares))
    moved = np.einsum("ij,gja,ga->gi", root, turned, parts)  # by leaving out a group
    covariance = (count - 1) / count * moved.T @ moved
    spread = np.where(alone, 0.0, shares / np.where(alone, 1.0, 1.0 - shares) ** 2)
    weights = np.einsum("gia,ga->gi", np.einsum("ij,gja->gia", root, turned) ** 2, spread)
    squares = (weights**2).sum(axis=0)
    most = max(count - 1.0, 1.0)
    degrees = np.full(len(widths), most)
    np.divide(weights.sum(axis=0) ** 2, squares, out=degrees, where=squares > 0.0)
    null = np.linalg.norm(vectors[:, ~kept], axis=1)
    lone = np.linalg.norm(np.einsum("ij,gja,ga->gai", root / widths[:, None], turned, alone), axis=(0, 1))
    none = np.maximum(null, lone) > np.sqrt(eps)
    covariance[none] = covariance[:, none] = 0.0
    covariance[none, none] = np.inf
    return covariance, np.minimum(degrees, most), null > np.sqrt(eps), none


def _exceeded(
    x: Array,
    hessians: Array,
    gradients: Array,
    bounds: Array,
    names: Sequence[str],
    limits: Mapping[str, tuple[float, float]],
) -> Array:
    """Return the bound (p,) at which each parameter ends although the cost falls beyond it, or NaN.

    A Gauss–Newton step from a minimum is zero; from a bound it may lead out of the bounds. A minimum is found
    to half of the digits only, so steps that end less than that beyond a bound end at it.
    """
    widths = bounds[1] - bounds[0]
    hessian = hessians.sum(axis=0) * np.outer(widths, widths)
    step = np.linalg.lstsq(hessian, -gradients.sum(axis=0) * widths, rcond=None)[0] * widths
    ends = np.full(len(x), np.nan)
    for i, name in enumerate(names):
        for bound, sign, limit in zip(bounds[:, i], (-1.0, 1.0), limits.get(name, (None, None)), strict=True):
            near = abs(x[i] - bound) < LITTLE * widths[i]
            beyond = sign * (x[i] + step[i] - bound)
            if near and bound != limit and beyond > HALF_DIGITS * widths[i]:
                ends[i] = bound
    return ends


def _unidentified(
    result: Identified, null: Array, none: Array, ends: Array, reason: Callable[[str, Array], str]
) -> tuple[str, ...]:
    """Return a sentence for each parameter whose error is at least that of a uniform guess in its range.

    So has each parameter that ends at a bound; `ends` (p,) are these bounds, or NaN.
    """
    sentences = []
    errors = result.standard_errors
    for i, name in enumerate(result.names):
        low, high = result.bounds[:, i].tolist()
        guess = (high - low) / np.sqrt(12.0)
        why = reason(name, result.x)
        if null[i]:
            others = [other for j, other in enumerate(result.names) if null[j] and j != i]
            what = "no residual depends on it" if not others else f"it may trade with {', '.join(others)}"
            sentences.append(f"{name} is not determined: {why or what}.")
        elif none[i]:
            sentences.append(f"{name} has no interval: only one group determines it.")
        elif errors[i] >= guess:
            what = (
                f"its standard error, {errors[i]:.2g}, is that of a guess from {low:g} to {high:g}, or more"
            )
            sentences.append(f"{name} is not determined: {what}{why and f'; {why}'}.")
        elif np.isfinite(ends[i]):
            sentences.append(f"{name} is not determined: values beyond its bound {ends[i]:g} fit better.")
    return tuple(sentences)


def group_numbers(group: Any, rows: Sequence[bytes]) -> Integers:
    """Return the index of the group (n,) of each row; None: each row is a group of its own.

    Copies of the data are no further groups; see `numbered`.
    """
    count = len(rows)
    given = range(count) if group is None else group
    labels = list(given) if isinstance(given, Iterable) else []
    if len(labels) != count or not all(isinstance(label, Hashable) for label in labels):
        raise InputError(
            f"group: {in_short(group)} given; {count} labels, one for each row, are expected", value=group
        )
    numbers, groups = numbered(labels, rows), len(set(labels))
    if groups < 2:
        raise InputError(
            f"group: {counted(count, 'row')} in {counted(groups, 'group')}; intervals that are robust to "
            "groups need two groups at least",
            value=group,
        )
    return numbers


def checked_bounds(
    free: Any,
    known: Mapping[str, tuple[float, float]],
    labels: Sequence[str] = (),
    joints: Iterable[str] = (),
) -> dict[str, tuple[float, float]]:
    """Return the checked bounds of free parameters, "friction" for all contacts or "friction:foot".

    Args:
        free: The bounds by name.
        known: Widest bounds of each kind of parameter.
        labels: Contacts that parameters may name.
        joints: Joints that parameters may name.
    """
    if not isinstance(free, Mapping) or not free:
        raise InputError(
            f"free: {in_short(free)} given; bounds by name of parameter are expected, such as "
            f'{{"{next(iter(known))}": (0, 1)}}',
            value=free,
        )
    checked = {}
    for name, bounds in free.items():
        kind, colon, label = name.partition(":") if isinstance(name, str) else (name, "", "")
        choice("free", kind, known, "a parameter")
        if colon:
            of_joint = joints, "a joint with one velocity"
            choice("free", label, *(of_joint if kind == "stiffening" else (labels, "a contact of the scene")))
        pair = real_numbers(f"free[{name!r}]", bounds).ravel()
        low, high = known[kind]
        if pair.shape != (2,) or not low <= pair[0] < pair[1] <= high or not np.isfinite(pair).all():
            raise InputError(
                f"free[{name!r}]: {in_short(bounds)} given; two rising numbers from {low:g} to {high:g} "
                "are expected",
                field="free",
                value=bounds,
            )
        checked[name] = (float(pair[0]), float(pair[1]))
    return checked


def checked_kinds(free: Any, known: Mapping[str, Sequence[str]]) -> tuple[str, ...]:
    """Return the checked kinds of free parameters, at least one, each once."""
    kinds = as_tuple("free", free, str, "a parameter")
    for kind in kinds:
        choice("free", kind, known, "a parameter")
    if not kinds or len(set(kinds)) < len(kinds):
        names = ", ".join(map(repr, known))
        raise InputError(
            f"free: {in_short(free)} given; one or more of {names}, each once, are expected", value=free
        )
    return kinds


def symmetric(matrices: Array) -> bool:
    """Whether matrices (…, m, m) are symmetric to half of their digits."""
    skew = np.abs(matrices - np.swapaxes(matrices, -1, -2)).max(axis=(-1, -2))
    return bool((skew <= HALF_DIGITS * np.abs(matrices).max(axis=(-1, -2))).all())


def whitener(covariance: ArrayLike, count: int, size: int) -> Array:
    """Return L⁻¹ (n, m, m) with L Lᵀ the covariance of each row, or raise `InputError`."""
    given = real_numbers("covariance", covariance)
    matrices = np.broadcast_to(given, (count, size, size)) if given.shape == (size, size) else given
    matrices = finite_array("covariance", matrices, (count, size, size))
    try:
        if not symmetric(matrices):
            raise np.linalg.LinAlgError
        lower = np.linalg.cholesky(matrices)
    except np.linalg.LinAlgError:
        raise InputError(
            "covariance: a matrix is not a covariance; symmetric and positive definite ones are expected",
            value=covariance,
        ) from None
    return np.linalg.inv(lower)
