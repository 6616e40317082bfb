"""Pairs of convex shapes in time steps: the points of the patches in which they face each other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ..geometry._kernels.constants import AXES, KIND, PLANE, POINT, TIP
from ..geometry.convex_pair import Touch
from ..geometry.convex_shape import PlacedShape
from ..geometry.patch import Patch, patch
from ..geometry.surfaces import contact_axes
from ..robot.contact import Contact
from ..robot.names import motion_signs
from ..robot.shape_pair import CarriedShape, ShapePair, point_contact
from .dynamics import SceneDynamics
from .layout import SceneLayout

Array = NDArray[np.float64]


@dataclass(eq=False)
class _Places:
    """The contacts that are kept for a pair.

    Attributes:
        pair: The shapes.
        numbers: Of the contacts.
        blanks: What stands there where nothing touches, as contacts and as constants.
        signs: (nv,) see `SceneWorkspace.velocity_signs`.
        used: How many of them stand for points of the present patch.
    """

    pair: ShapePair
    numbers: list[int]
    blanks: list[Contact]
    constants: Array
    signs: Array
    used: int = 0


class FacingShapes:
    """Fills the places of pairs of shapes with the points of their patches.

    Args:
        model: The robot.
        dynamics: The scene's contacts.
        layout: Of the scene.
    """

    def __init__(self, model: pin.Model, dynamics: SceneDynamics, layout: SceneLayout) -> None:
        self._model, self._data = model, model.createData()
        self._dynamics, self._work = dynamics, dynamics.work
        groups: dict[int, tuple[Contact, list[int]]] = {}
        for i, contact in enumerate(dynamics.contacts):
            if contact.pair is not None:
                groups.setdefault(id(contact.pair), (contact.pair, []))[1].append(i)
        pairs = tuple(contact for contact, _ in groups.values())
        self._places = [
            _Places(
                layout.pairs[contact],
                numbers,
                [dynamics.contacts[i] for i in numbers],
                self._work.contact_constants[numbers].copy(),
                motion_signs(model, layout.pairs[contact].a.joint, layout.pairs[contact].b.joint),
            )
            for contact, numbers in groups.values()
        ]
        if pairs:
            tables = layout.pair_tables(pairs)
            self._joints = tables.joints.reshape(-1)
            self._centers, self._reaches = tables.centers, tables.reaches.reshape(-1)

    def place(self, q: Array, v: Array, h: float, touching: float | None = None) -> None:
        """Fill the places of pairs that may touch within a time.

        Args:
            q: (nq,) configuration.
            v: (nv,) velocity.
            h: The time [s].
            touching: For impacts, the gap up to which shapes touch [m]; `dynamics.contacts` is filled too.
        """
        if not self._places:
            return
        model, data = self._model, self._data
        pin.forwardKinematics(model, data, q, v)
        rotations = np.array([placement.rotation for placement in data.oMi])[self._joints]
        origins = np.array([placement.translation for placement in data.oMi])[self._joints]
        centers = np.einsum("ijk,ik->ij", rotations, self._centers) + origins
        motions = np.array([motion.vector for motion in data.v])[self._joints]
        speeds = np.linalg.norm(motions[:, :3], axis=1) + np.linalg.norm(motions[:, 3:], axis=1) * (
            np.linalg.norm(self._centers, axis=1) + self._reaches
        )
        gravity = float(np.linalg.norm(model.gravity.linear))
        within = h * (speeds[::2] + speeds[1::2]) + 8.0 * gravity * h * h
        if touching is not None:
            within = np.full(len(self._places), touching)
        apart = (
            np.linalg.norm(centers[::2] - centers[1::2], axis=1) - self._reaches[::2] - self._reaches[1::2]
        )
        placed: dict[tuple[int, str], PlacedShape] = {}
        for number, places in enumerate(self._places):
            found = None
            if apart[number] <= within[number]:
                shapes = self._placed(placed, places.pair.a), self._placed(placed, places.pair.b)
                found = patch(*shapes, float(within[number]))
            self._fill(places, found, touching is not None)

    def _placed(self, known: dict[tuple[int, str], PlacedShape], one: CarriedShape) -> PlacedShape:
        key = one.joint, one.name
        if key not in known:
            placement = self._data.oMi[one.joint] * one.in_joint
            known[key] = one.shape.at(placement.rotation, placement.translation)
        return known[key]

    def _fill(self, places: _Places, found: Patch | None, contacts: bool) -> None:
        work, data, pair = self._work, self._data, places.pair
        count = 0
        if found is not None:
            count = min(len(found.gaps), len(places.numbers))
            chosen = np.argsort(found.gaps, kind="stable")[:count]
            tip, base = data.oMi[pair.a.joint], data.oMi[pair.b.joint]
            axes = contact_axes(base.rotation.T @ found.normal)
            for place, k in enumerate(np.sort(chosen).tolist()):
                i = places.numbers[place]
                row = work.contact_constants[i]
                row[:] = 0.0
                row[TIP : TIP + 3] = tip.actInv(found.points[k])
                row[POINT : POINT + 3] = base.actInv(found.others[k])
                row[AXES : AXES + 9] = axes.ravel()
                row[KIND] = PLANE
                work.contact_joints[i] = pair.a.joint, pair.b.joint
                work.velocity_signs[i] = places.signs
                if contacts:
                    core = Touch(
                        "vertex-face",
                        found.points[k] + pair.a.shape.radius * found.normal,
                        found.others[k] - pair.b.shape.radius * found.normal,
                        (0, 0),
                    )
                    self._dynamics.contacts[i] = point_contact(
                        pair, data, (), found.normal, core, places.blanks[place]
                    ).instant
        for place in range(count, places.used):
            i = places.numbers[place]
            work.contact_constants[i] = places.constants[place]
            self._dynamics.contacts[i] = places.blanks[place]
        places.used = count
