"""Friction and restitution from measured impacts, by least squares with exact derivatives."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Executor
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import Array, Integers
from ..checks import at_least_zero, choice, coefficient, finite_array
from ..contact_space.batch import BatchSolution, solve_impacts
from ..contact_space.laws import LAWS
from ..errors import InputError
from ..robot.names import single_joints
from ..scene.scene import Scene
from ..scene.switched_off import in_impacts
from ..status import Flag, Status
from . import estimate
from .found import FoundImpacts, arrays_of, as_found, matrices_of
from .measured import digests
from .motion_fit import fit_motions
from .one_step import ONE_STEP, OneStepSolution, solve_one_step
from .recordings import Motion
from .stiff_joints import StiffJoints, stiff_joints

RANGES = {"friction": (0.0, np.inf), "restitution": (0.0, 1.0)}
STIFFENING = {"stiffening": (0.0, 1.0)}
SLIDING = {"sliding_friction": (0.0, np.inf)}
FREE = {"friction": (0.0, 2.0), "restitution": (0.0, 1.0)}

_Batch = BatchSolution | OneStepSolution


class _Rows(NamedTuple):
    """N impacts in contact space; residuals are ``map P − target``."""

    delassus: Array  # (N, 3, 3) W
    velocity: Array  # (N, 3) before the impact
    scale: Array  # (N,) `ImpactProblem.velocity_scale`
    map: Array  # (N, m, 3)
    target: Array  # (N, m)
    contact: NDArray[Any]  # (N,) names, empty for arrays in contact space
    coefficients: Array  # (2, N) μ and e where they are not free
    law: str
    measure: str  # what the residuals are
    digests: tuple[bytes, ...]  # of the measurements and weights of each row
    stiff: StiffJoints | None = None  # joints with fitted stiffening, on which W and the map then depend

    def at(self, x: Array) -> tuple[_Rows, Array, Array]:
        """Return the rows for stiffenings x (p,), and the derivatives (p, …) of W and of the map."""
        if self.stiff is None:
            return self, np.zeros((0, *self.delassus.shape)), np.zeros((0, *self.map.shape))
        delassus, to_residuals, *slopes = self.stiff.matrices(x)
        return self._replace(delassus=delassus, map=to_residuals), slopes[0], slopes[1]


def identify(
    found: Any = None,
    scene: Scene | None = None,
    free: Mapping[str, tuple[float, float]] | None = None,
    *,
    law: str | None = None,
    loss: str = "soft_l1",
    group: ArrayLike | None = None,
    covariance: ArrayLike | None = None,
    contact: Any = None,
    fixed: Mapping[str, float] | None = None,
    trajectories: Sequence[Motion] | None = None,
    restart: bool = False,
    executor: Executor | None = None,
) -> estimate.Identified:
    """Fit friction and restitution, and the stiffening of joints, to measured impacts or whole motions.

    The residuals are the differences of predicted and measured velocities after the impact, as kinetic energy
    weighs them, or as a covariance does (I1); with stiffening, those of all joints (I11).

    Args:
        found: Result of `impacts`; or the arrays (W, v⁻, v⁺) of contact space, (N, 3, 3), (N, 3) and (N, 3),
            without a scene; or (q, v⁻, v⁺) of the robot of a scene, (N, nq), (N, nv) and (N, nv).
        scene: The robot and its contacts; their coefficients are those that are not free. Impacts are without
            the effects that it switches off, see ``Scene.without``.
        free: Bounds of each parameter: "friction" and "restitution" for all contacts, "friction:foot" for the
            contact "foot"; "stiffening" for all joints with one velocity, "stiffening:elbow" for one, see
            `impact`. None: friction and restitution, from 0 to 2 and from 0 to 1.
        law: Restitution law; None: that of the contacts, or Poisson's law for arrays. For comparison also
            "moreau" and "convex", which leave out the path of the impact (I13).
        loss: "soft_l1", which gives outliers less weight, or "linear".
        group: (N,) labels of impacts with common errors, such as those of one toss; None: those of `found`,
            or each impact on its own.
        covariance: (N, 3, 3) of the measured v⁺ in contact space, or (N, nv, nv) of the robot's, such as
            ``found.covariance[:, nv:, nv:]``; or one for all.
        contact: Name of the contact that collides, or (N,) names, for (q, v⁻, v⁺).
        fixed: Coefficients of arrays (W, v⁻, v⁺) that are not free.
        trajectories: Recorded motions of one free body instead of `found`: they are simulated from their
            first flights, and the poses compared (I12); "sliding_friction" can be free too.
        restart: Whether these simulations start again in each flight, up to the end of the next one. Whole
            motions may jump where a coefficient changes, and have no intervals then.
        executor: Runs these simulations, such as a ``ProcessPoolExecutor``; None: this process does.

    Returns:
        An `Identified`.

    Raises:
        InputError: Wrong shapes, bounds, or covariances; impacts that have no solution; stiffening without a
            scene or with held contacts.
        UnknownNameError: An unknown parameter, contact, joint, law or loss.
    """
    if trajectories is not None:
        others = dict(found=found, covariance=covariance, contact=contact, fixed=fixed, group=group)
        return _of_motions(trajectories, scene, free, law, loss, executor, restart, others)
    joints = () if scene is None else single_joints(scene.model)
    bounds = _checked(free, RANGES | STIFFENING, scene, joints)
    if law is not None:
        choice("law", law, LAWS + ONE_STEP, "a restitution law or a model in one step")
    if scene is None:
        rows = _of_arrays(found, law or "poisson", covariance, bounds, fixed or {})
    else:
        if fixed is not None:
            raise InputError(
                "fixed: with a scene, its contacts have the coefficients that are not free", value=fixed
            )
        scene = in_impacts(scene)
        given = as_found(found, scene, contact)
        if group is None and isinstance(found, FoundImpacts):
            group = given.group
        rows = _of_robot(given, scene, law, covariance, _stiffened(bounds))
    numbers = estimate.group_numbers(group, rows.digests)
    return _fitted(rows, bounds, numbers, loss)


def _fitted(
    rows: _Rows, bounds: dict[str, tuple[float, float]], group: Integers, loss: str
) -> estimate.Identified:
    """Return the fit to impacts in contact space."""
    names = list(bounds)
    stiffened = [j for j, name in enumerate(names) if name in _stiffened(bounds)]
    kinds = {
        j: list(RANGES).index(names[j].partition(":")[0]) for j in range(len(names)) if j not in stiffened
    }
    owner = np.full(rows.coefficients.shape, -1)
    for j in (j for j in estimate.general_first(names) if j in kinds):
        label = names[j].partition(":")[2]
        owner[kinds[j], (rows.contact == label) if label else slice(None)] = j
    solved: dict[bytes, tuple[_Batch, tuple[_Rows, Array, Array]]] = {}

    def solve(x: Array, derivatives: bool = True) -> tuple[_Batch, tuple[_Rows, Array, Array]]:
        if x.tobytes() not in solved:
            solved.clear()
            mu, e = np.where(owner >= 0, x[owner], rows.coefficients)
            now = rows.at(x[stiffened])
            problems = now[0].delassus, rows.velocity, mu, e, rows.law
            if rows.law in ONE_STEP:
                batch: _Batch = solve_one_step(*problems)
            else:
                batch = solve_impacts(*problems, rows.scale, derivatives=derivatives)
            _check_solved(batch)
            if not derivatives:
                return batch, now
            solved[x.tobytes()] = batch, now
        return solved[x.tobytes()]

    def residual(x: Array, derivatives: bool = True) -> Array:
        batch, (now, _, _) = solve(x, derivatives)
        return np.einsum("nij,nj->ni", now.map, batch.impulse) - rows.target

    def jacobian(x: Array) -> Array:
        batch, (now, W_slopes, map_slopes) = solve(x)
        slopes: Any = batch.derivatives
        by = np.zeros((len(names), *batch.impulse.shape))
        for j, kind in kinds.items():
            by[j] = (slopes.dP_dfriction, slopes.dP_drestitution)[kind] * (owner[kind] == j)[:, None]
        by[stiffened] = np.einsum("nkij,pnij->pnk", slopes.dP_ddelassus, W_slopes)
        # impacts without a derivative (at a boundary) are ignored in this step
        out = np.einsum("nij,pnj->nip", now.map, np.nan_to_num(by))
        out[:, :, stiffened] += np.einsum("pnij,nj->nip", map_slopes, batch.impulse)
        return out

    def reason(name: str, x: Array) -> str:
        if names.index(name) in stiffened:
            return ""
        used = (owner == names.index(name)).any(axis=0)
        if not used.any():
            return "no impact is of this contact"
        batch = solve(x)[0]
        struck = used & (batch.status != Status.NO_IMPACT)
        if not struck.any():
            return "the contact approaches in no row, so there is no impact"
        if name.startswith("friction") and ((batch.flags & Flag.STICK) != 0)[struck].all():
            return "all impacts end sticking, and more friction would change nothing"
        speed = -np.median(rows.velocity[used, 2])
        return f"the median approach speed is {speed:.2g} m/s" if name.startswith("restitution") else ""

    setters = dict.fromkeys(RANGES, estimate.set_coefficient) | dict.fromkeys(STIFFENING, _no_setting)
    return estimate.fit(
        residual,
        jacobian,
        bounds,
        group,
        loss,
        reason=reason,
        trial=partial(residual, derivatives=False),
        limits=_limits(bounds, RANGES | STIFFENING),
        law=rows.law,
        measure=rows.measure,
        rows=rows.digests,
        setters=setters,
    )


def _limits(
    bounds: Iterable[str], known: Mapping[str, tuple[float, float]]
) -> dict[str, tuple[float, float]]:
    """Return the range of each parameter, from the ranges of their kinds."""
    return {name: known[name.partition(":")[0]] for name in bounds}


def _checked(
    free: Mapping[str, tuple[float, float]] | None,
    known: Mapping[str, tuple[float, float]],
    scene: Scene | None,
    joints: Iterable[str] = (),
) -> dict[str, tuple[float, float]]:
    """Return the checked bounds of free parameters, whose effects the scene must not switch off."""
    labels = [] if scene is None else [one.label for one in scene.contacts]
    bounds = estimate.checked_bounds(FREE if free is None else free, known, labels, joints)
    for name in bounds:
        kind = name.partition(":")[0]
        effect = "contact friction" if kind in ("friction", "sliding_friction") else kind
        if scene is not None and effect in scene.without:
            raise InputError(f"free: {name} is free, but the scene is without {effect}", value=free)
    return bounds


def _of_motions(
    motions: Any,
    scene: Scene | None,
    free: Mapping[str, tuple[float, float]] | None,
    law: str | None,
    loss: str,
    executor: Executor | None,
    restart: bool,
    others: Mapping[str, Any],
) -> estimate.Identified:
    """Return the fit to motions; raise an error for arguments that apply to impacts only."""
    for name, value in others.items():
        if value is not None:
            raise InputError(
                f"{name}: given beside trajectories=; motions have their groups, and no {name}", value=value
            )
    if scene is None:
        raise InputError("scene: None given; trajectories= needs the scene of the body", value=scene)
    bounds = _checked(free, RANGES | SLIDING, scene)
    if law is not None:
        choice("law", law, LAWS, "a restitution law")
    setters = dict.fromkeys(RANGES | SLIDING, estimate.set_coefficient)
    limits = _limits(bounds, RANGES | SLIDING)
    return fit_motions(motions, scene, bounds, limits, law, loss, setters, executor, restart)


def _stiffened(bounds: Mapping[str, Any]) -> list[str]:
    """Return the parameters that are stiffenings of joints."""
    return [name for name in bounds if name.partition(":")[0] in STIFFENING]


def _no_setting(scene: Scene, name: str, value: float) -> Scene:
    """Raise an error: scenes have no stiffening, only single impacts."""
    _, _, joint = name.partition(":")
    option = f"{{{joint!r}: {value:.6g}}}" if joint else f"{value:.6g}"
    raise InputError(f"scene: a scene has no {name}; use impact(…, stiffening={option})", value=name)


def _check_solved(batch: _Batch) -> None:
    """Check that all impacts have a solution."""
    failed = np.flatnonzero(~np.isfinite(batch.velocity).all(axis=1))
    if len(failed):
        raise InputError(
            f"found: impact {failed[0]} has no solution: {Status(int(batch.status[failed[0]]))} "
            f"({len(failed)} of {len(batch.status)} such impacts)",
            value=failed.tolist(),
        )


def _of_arrays(
    found: Any, law: str, covariance: ArrayLike | None, free: Mapping[str, Any], fixed: Mapping[str, float]
) -> _Rows:
    """Return impacts given by (W, v⁻, v⁺)."""
    if stiff := _stiffened(free):
        raise InputError(
            f"free: {stiff[0]} is a parameter of robot joints; give (q, v_before, v_after) and a scene",
            value=stiff,
        )
    W, before, after = arrays_of(found, "(delassus, v_before, v_after) without a scene")
    count = len(before)
    if W.ndim == 2:
        raise InputError(
            f"found: a first array of shape {W.shape} given; without a scene it is the Delassus matrices, "
            f"({count}, 3, 3); for (q, v_before, v_after) give the scene",
            value=found,
        )
    W = finite_array("delassus", W, (count, 3, 3))
    before, after = finite_array("v_before", before, (count, 3)), finite_array("v_after", after, (count, 3))
    coefficients = np.zeros((2, count))
    for name in fixed:
        choice("fixed", name, RANGES, "a parameter")
    for row, name in zip(coefficients, RANGES, strict=True):
        if name not in free:
            if name not in fixed:
                raise InputError(
                    f"fixed: {name} is neither free nor fixed; give fixed={{{name!r}: …}}", value=fixed
                )
            row[:] = (coefficient if name == "restitution" else at_least_zero)(name, fixed[name])
    weights = _energy_root(W) if covariance is None else estimate.whitener(covariance, count, 3) @ W
    target = _targets(weights, W, after - before)
    data = _measured(covariance, before, after, W)
    return _Rows(W, before, np.zeros(count), weights, target, np.full(count, ""), coefficients, law, *data)


def _of_robot(
    found: FoundImpacts, scene: Scene, law: str | None, covariance: ArrayLike | None, stiff: list[str]
) -> _Rows:
    """Return impacts of a robot. (I1), and with stiff joints (I11)"""
    contacts = {one.label: one for one in scene.contacts}
    laws = {contacts[name].law for name in found.contact.tolist()}
    if law is None and len(laws) > 1:
        raise InputError(
            f"law: the contacts have the laws {', '.join(sorted(laws))}; give the one of the fit", value=law
        )
    all_of = matrices_of(found, scene)
    W = np.array([one.delassus for one in all_of])
    before = np.array([one.velocity(v) for one, v in zip(all_of, found.v_before, strict=True)])
    scale = np.array([one.velocity_scale(v) for one, v in zip(all_of, found.v_before, strict=True)])
    change = found.v_after - found.v_before
    root = None
    if covariance is not None:
        root = estimate.whitener(covariance, len(found), scene.model.nv)
    elif stiff:
        root = _energy_root(np.array([one.mass for one in all_of]))
    if root is None:
        weights = _energy_root(W)
        jump = np.array([one.jacobian @ dv for one, dv in zip(all_of, change, strict=True)])
        target = _targets(weights, W, jump)
    else:
        weights = root @ np.array([one.response for one in all_of])
        target = np.einsum("nij,nj->ni", root, change)
    struck, approach = [contacts[name] for name in found.contact.tolist()], np.maximum(-before[:, 2], 0.0)
    e = [one.restitution_at(speed) for one, speed in zip(struck, approach.tolist(), strict=True)]
    coefficients, names = np.array([[one.friction for one in struck], e]), np.asarray(found.contact)
    joints = None if root is None or not stiff else stiff_joints(stiff, scene, all_of, root)
    inertia = np.array([one.mass for one in all_of]) if stiff else W
    data = _measured(covariance, found.q, found.v_before, found.v_after, names, inertia)
    return _Rows(W, before, scale, weights, target, names, coefficients, law or laws.pop(), *data, joints)


def _measured(covariance: ArrayLike | None, *columns: Any) -> tuple[str, tuple[bytes, ...]]:
    """Return what residuals are, and digests of the data and of their weights.

    The last column are the matrices that weigh the kinetic energy, if there is no covariance.
    """
    if covariance is None:
        return "impacts by energy", digests(*columns)
    given = np.asarray(covariance, dtype=float)
    matrices = np.broadcast_to(given, (len(columns[0]), *given.shape[-2:]))
    return "impacts by covariance", digests(*columns[:-1], matrices)


def _energy_root(W: Array) -> Array:
    """Return the symmetric roots of W (N, n, n): |√W ΔP|² is twice the kinetic energy of W ΔP."""
    values, vectors = np.linalg.eigh(W)
    return (vectors * np.sqrt(np.maximum(values, 0.0))[:, None]) @ np.swapaxes(vectors, 1, 2)


def _targets(weights: Array, W: Array, jump: Array) -> Array:
    """Return ``weights @ P`` (N, m) for the impulses P of least norm with W P = jump."""
    rounding = 32.0 * np.finfo(float).eps  # of ‖W‖, within which an eigenvalue is zero
    return np.einsum("nij,njk,nk->ni", weights, np.linalg.pinv(W, rcond=rounding, hermitian=True), jump)
