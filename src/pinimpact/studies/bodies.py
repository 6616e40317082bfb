"""Centre of mass, inertia and radius of a body, from the momentum balance of its impacts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin

from ..arrays import Array
from ..errors import InputError
from ..robot.matrices import contact_geometry
from ..scene.scene import Scene
from .estimate import Identified, checked_kinds, fit, group_numbers, set_coefficient
from .found import FoundImpacts, free_body
from .measured import digests

_AXES = "xyz"
_ENTRIES = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
_NAMES = {
    "com": tuple(f"com:{axis}" for axis in _AXES),
    "inertia": tuple(f"inertia:{_AXES[i]}{_AXES[j]}" for i, j in _ENTRIES),
    "radius": ("radius",),
}


def identify_body(
    found: FoundImpacts, free: Sequence[str] = ("com", "inertia", "radius"), *, loss: str = "soft_l1"
) -> Identified:
    """Fit the inertia of a free body to its impacts, without a law of friction or restitution.

    An impulse at the contact point changes linear and angular momentum together (I9).

    Args:
        found: Result of `impacts`.
        free: "com", the centre of mass in the axes of the body [m]; "inertia", about it, over the mass [m²];
            "radius" of the contacts [m], one for all. What is not free is that of the scene of `found`.
        loss: As in `identify`.

    Raises:
        InputError: Impacts without a scene of one free body, or no free parameter, or one twice.
        UnknownNameError: An unknown parameter or loss.
    """
    if not isinstance(found, FoundImpacts) or found.scene is None:
        raise InputError("found: the result of studies.impacts is expected", value=found)
    scene = found.scene
    inertia = free_body(scene, "identify_body")
    names = [name for kind in checked_kinds(free, _NAMES) for name in _NAMES[kind]]
    every = [name for group in _NAMES.values() for name in group]
    given = np.array(inertia.inertia) / inertia.mass
    default = np.array([*inertia.lever, *(given[i, j] for i, j in _ENTRIES), 0.0])
    where = [every.index(name) for name in names]
    balance = _Balance(found, scene, given)
    rows = digests(found.q, found.v_before, found.v_after, found.contact, [balance.root] * len(found))

    def whole(x: Array) -> Array:
        values = default.copy()
        values[where] = x
        return values

    trace, size = float(np.trace(given)), float(np.sqrt(np.trace(given)))
    fixed = "radius" not in names
    widths = [size] * 3 + [2.0 * trace] * 6 + [size]
    lows = [-size] * 3 + [0.0] * 3 + [-2.0 * trace] * 3 + [0.0]
    bounds = {
        name: (default[k] - widths[k], default[k] + widths[k]) if k < 3 else (lows[k], widths[k])
        for name, k in zip(names, where, strict=True)
    }
    return fit(
        lambda x: balance.residual(whole(x), fixed),
        lambda x: balance.jacobian(whole(x), fixed)[:, :, where],
        bounds,
        group_numbers(found.group, rows),
        loss,
        measure="impacts by momentum",
        rows=rows,
        limits=dict.fromkeys((*_NAMES["inertia"][:3], "radius"), (0.0, np.inf)),
        setters={"com": _set_inertia, "inertia": _set_inertia, "radius": set_coefficient},
    )


class _Balance:
    """The angular momentum about the contact point before and after each impact, per mass, body axes."""

    def __init__(self, found: FoundImpacts, scene: Scene, inertia: Array) -> None:
        data, contacts = scene.model.createData(), {one.label: one for one in scene.contacts}
        mine = [contacts[name] for name in found.contact.tolist()]
        places = [contact_geometry(scene.model, data, q, one) for q, one in zip(found.q, mine, strict=True)]
        rotations = [pin.XYZQUATToSE3(q).rotation for q in found.q]
        self.normal = np.array([R.T @ place.axes[2] for R, place in zip(rotations, places, strict=True)])
        self.radius = np.array([one.radius for one in mine])
        arms = np.array(
            [R.T @ (at.point - q[:3]) for R, at, q in zip(rotations, places, found.q, strict=True)]
        )
        self.offset = arms + self.radius[:, None] * self.normal
        change = found.v_after - found.v_before
        self.dv, self.dw = change[:, :3], change[:, 3:]
        # weighs angular momentum as kinetic energy
        values, vectors = np.linalg.eigh(inertia)
        self.root = (vectors / np.sqrt(values)) @ vectors.T

    def _parts(self, x: Array, fixed: bool) -> tuple[Array, Array]:
        radius = self.radius if fixed else np.full(len(self.radius), x[9])
        arm = self.offset - radius[:, None] * self.normal - x[:3]
        return arm, self.dv + np.cross(self.dw, x[:3])

    def residual(self, x: Array, fixed: bool) -> Array:
        """Return the residuals (n, 3) of (I9) for com, inertia and radius (10,)."""
        arm, dv = self._parts(x, fixed)
        inertia = np.empty((3, 3))
        for (i, j), value in zip(_ENTRIES, x[3:9], strict=True):
            inertia[i, j] = inertia[j, i] = value
        return np.asarray((self.dw @ inertia - np.cross(arm, dv)) @ self.root)

    def jacobian(self, x: Array, fixed: bool) -> Array:
        """Return its derivatives (n, 3, 10)."""
        arm, dv = self._parts(x, fixed)
        slopes = np.zeros((len(arm), 3, 10))
        for k, axis in enumerate(np.eye(3)):
            slopes[:, :, k] = np.cross(axis, dv) - np.cross(arm, np.cross(self.dw, axis))
        for k, (i, j) in enumerate(_ENTRIES, start=3):
            slopes[:, i, k] = self.dw[:, j]
            slopes[:, j, k] = self.dw[:, i]
        slopes[:, :, 9] = np.cross(self.normal, dv)
        return np.asarray(np.einsum("ij,njk->nik", self.root, slopes))


def _set_inertia(scene: Scene, name: str, value: float) -> Scene:
    model = scene.model.copy()
    inertia = model.inertias[1]
    lever, matrix = np.array(inertia.lever), np.array(inertia.inertia)
    kind, _, entry = name.partition(":")
    if kind == "com":
        lever[_AXES.index(entry)] = value
    else:
        i, j = (_AXES.index(axis) for axis in entry)
        matrix[i, j] = matrix[j, i] = value * inertia.mass
    model.inertias[1] = pin.Inertia(inertia.mass, lever, matrix)
    return replace(scene, model=model)
