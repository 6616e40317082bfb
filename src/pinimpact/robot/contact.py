"""A contact of a robot: which point, which surface, friction and restitution; and its gap."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from ..checks import above_zero, at_least_zero, coefficient
from ..contact_space.laws import law_code
from ..errors import InputError
from ._kernels import contact_kinematics
from ._kernels.constants import AXES, KIND, POINT, RADIUS, TIP
from .data_cache import checked_configuration, data_cache
from .names import frame_id, model_of, motion_signs
from .surfaces import Surface, Vector, check_frame_key, vector

Array = NDArray[np.float64]
_placement = pin.updateFramePlacement

WORLD = np.eye(4)
"""The placement that the kernels take where no body carries a surface."""


@dataclass(frozen=True)
class Contact:
    """A point of a robot that may meet a surface, with its friction and restitution.

    The contact point is the frame's origin + `offset` (in the frame's axes) − `radius`·n, so a sphere of
    that radius about the offset touches the surface where the gap is zero.

    Attributes:
        frame: Frame that carries the point, by name or id.
        plane: The surface it meets: a `Plane` or a `Sphere`.
        friction: Coulomb coefficient μ ≥ 0, of impacts and, without `sliding_friction`, of all.
        restitution: Coefficient 0 ≤ e ≤ 1, or a function that returns it for an approach speed [m/s].
        law: ``"poisson"``, ``"energetic"`` or ``"newton"``.
        offset: From the frame's origin, in the frame's axes [m].
        radius: Of a spherical tip [m], 0 for a point.
        name: How reports call the contact; None for "frame on surface", with the surface's own name, or that
            of the body that carries it, or "plane" or "sphere".
        sliding_friction: Coulomb coefficient μ ≥ 0 of sustained contact, slip and stick between impacts; None
            for `friction`.
        stiffness: Relative normal stiffness > 0, which counts where several contacts collide at one instant.

    Raises:
        InputError: A number out of its range or not finite.
        UnknownNameError: An unknown law.
    """

    frame: str | int
    plane: Surface
    friction: float = 0.0
    restitution: float | Callable[[float], float] = 0.0
    law: str = "poisson"
    offset: Vector = (0.0, 0.0, 0.0)
    radius: float = 0.0
    name: str | None = None
    sliding_friction: float | None = None
    stiffness: float = 1.0
    constants: Array = field(init=False, repr=False, compare=False)
    law_code: int = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        check_frame_key("frame", self.frame)
        if not isinstance(self.plane, Surface):
            raise InputError(
                f"plane: {self.plane!r} is not a Plane or a Sphere", field="plane", value=self.plane
            )
        keep = object.__setattr__
        keep(self, "friction", at_least_zero("friction", self.friction))
        if self.sliding_friction is not None:
            keep(self, "sliding_friction", at_least_zero("sliding_friction", self.sliding_friction))
        keep(self, "stiffness", above_zero("stiffness", self.stiffness))
        if not callable(self.restitution):
            keep(self, "restitution", coefficient("restitution", self.restitution))
        keep(self, "law_code", law_code(self.law))
        keep(self, "offset", vector("offset", self.offset))
        keep(self, "radius", at_least_zero("radius", self.radius))
        constants = np.array([*self.offset, self.radius, *self.plane.constants])
        constants.setflags(write=False)
        keep(self, "constants", constants)

    @property
    def label(self) -> str:
        """The name, or what stands in for it."""
        if self.name is not None:
            return self.name
        return f"{self.frame} on {self.plane.label}"

    @property
    def sustained_friction(self) -> float:
        """The coefficient of friction of sustained contact."""
        return self.friction if self.sliding_friction is None else self.sliding_friction

    def restitution_at(self, speed: float) -> float:
        """Return e for an approach speed [m/s].

        Raises:
            InputError: The contact's function returns no number between 0 and 1.
        """
        if callable(self.restitution):
            return coefficient(f"restitution({speed:.6g} m/s)", self.restitution(speed))
        return self.restitution

    def gap(self, model: pin.Model, data: pin.Data, q: ArrayLike) -> float:
        """Return the signed distance of the contact point from the surface [m], negative inside.

        Changes ``data.oMi``, ``data.liMi`` and the two frames' ``data.oMf``.

        Raises:
            InputError: A q of the wrong length or not finite.
            UnknownNameError: A frame that the model does not have.
        """
        model = model_of(model)
        cache = data_cache(model, data)
        cache.forward_kinematics(model, data, checked_configuration(cache, model, q))
        frame = _placement(model, data, cache.frame(self.frame)).homogeneous
        carrier = WORLD
        if self.plane.body is not None:
            carrier = _placement(model, data, cache.frame(self.plane.body, "body")).homogeneous
        return float(contact_kinematics.locate(frame, carrier, self.constants)[0])


def contact_constants(model: pin.Model, contact: Contact) -> tuple[int, int, Array, Array]:
    """Return a contact's joints (of the tip, of the surface), its constants in their axes, and signs.

    The signs (nv,) are 1 for a velocity that moves the tip alone, −1 the surface alone, else 0.
    """
    frame = model.frames[frame_id(model, contact.frame)]
    tip, base, carrier = frame.parentJoint, 0, pin.SE3.Identity()
    if contact.plane.body is not None:
        body = model.frames[frame_id(model, contact.plane.body, "body")]
        base, carrier = body.parentJoint, body.placement
    k = contact.constants.copy()
    k[TIP:RADIUS] = frame.placement.act(k[TIP:RADIUS])
    k[POINT:AXES] = carrier.act(k[POINT:AXES])
    directions = k[AXES:KIND].reshape(-1, 3)
    directions[:] = directions @ carrier.rotation.T
    return tip, base, k, motion_signs(model, tip, base)


def check_contact(field: str, value: Any) -> None:
    """Refuse what is no `Contact`."""
    if not isinstance(value, Contact):
        raise InputError(f"{field}: {value!r} is not a Contact", field=field, value=value)


def check_held(held: Contact | Sequence[Contact]) -> tuple[Contact, ...]:
    """Return the held contacts as a tuple; one alone need not be wrapped."""
    anchors = (held,) if isinstance(held, (Contact, str)) else tuple(held)
    for anchor in anchors:
        check_contact("held", anchor)
    return anchors
