"""A scene: a robot, its contacts, what acts on it; all that a simulation needs but the state."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError
from ..robot.contact import Contact
from ..robot.names import frame_id, free_velocities, model_of
from .effects import Plan, check_names, make_plan

Array = NDArray[np.float64]
Control = Callable[[float, Array, Array], ArrayLike]
"""control(t, q, v) -> (nv,) generalized forces [N, N m]."""

RESTING_FRACTION = 1e-4
"""The default resting speed, in parts of √(g L): such a bounce rises 5·10⁻⁹ of the robot's size L."""

STANDARD_GRAVITY = 9.80665


@dataclass(frozen=True, slots=True)
class JointLimit:
    """One bound of one joint coordinate: sign · (q[index_q] − bound) ≥ 0.

    Attributes:
        name: "joint_name lower" or "joint_name upper".
        index_q, index_v: Where the coordinate stands in q and in v.
        sign: 1 for a lower bound, −1 for an upper one.
        bound: Its value [rad or m].
    """

    name: str
    index_q: int
    index_v: int
    sign: float
    bound: float


@dataclass(frozen=True, eq=False)
class Scene:
    """A robot among surfaces.

    Attributes:
        model: Pinocchio model, or a RobotWrapper; gravity, rotor inertia, joint damping and dry friction and
            the joint limits are the model's own.
        contacts: The points that may meet their planes.
        control: control(t, q, v) -> (nv,) generalized forces; None for none.
        held: Contacts that hold throughout, in both directions: a grasp, a bolted foot, a closed loop.
        locked: Joints, by name or id, whose velocity an impact does not change (stiff position control).
        limit_restitution: Restitution e of the joint limits, which act as one-sided impacts.
        resting_speed: Bounce speed [m/s] below which a contact is taken as resting; None for 10⁻⁴ √(g L),
            with the model's gravity (standard gravity if it has none) and L the size of the robot, `extent`.
        record: Whether each impact's path is recorded.
        without: Effects to leave out, by the names in `plan`.

    Raises:
        InputError: Numbers out of range, two contacts of one name, a plane that moves along its normal.
        UnknownNameError: A frame, joint or effect that does not exist.
    """

    model: pin.Model
    contacts: Sequence[Contact] = ()
    control: Control | None = None
    held: Sequence[Contact] = ()
    locked: Sequence[str | int] = ()
    limit_restitution: float = 0.0
    resting_speed: float | None = None
    record: bool = False
    without: Sequence[str] = ()

    def __post_init__(self) -> None:
        keep = object.__setattr__
        keep(self, "model", model_of(self.model))
        for field in ("contacts", "held"):
            keep(self, field, _contacts(field, getattr(self, field), self.model))
        labels = [contact.label for contact in (*self.contacts, *self.held)]
        for label in labels:
            if labels.count(label) > 1:
                raise InputError(
                    f"contacts: {labels.count(label)} contacts are called {label!r}; give each its own name=",
                    field="contacts",
                    value=label,
                )
        keep(self, "locked", (self.locked,) if isinstance(self.locked, (str, int)) else tuple(self.locked))
        free_velocities(self.model, self.locked)
        keep(self, "without", check_names(self.without))
        if self.control is not None and not callable(self.control):
            raise InputError(
                f"control: {self.control!r} is no function of (t, q, v)", field="control", value=self.control
            )
        if not 0.0 <= self.limit_restitution <= 1.0:
            raise InputError(
                f"limit_restitution: {self.limit_restitution!r} given, a number from 0 to 1 expected",
                field="limit_restitution",
                value=self.limit_restitution,
            )
        speed = self.resting_speed
        if speed is not None and not (math.isfinite(speed) and speed > 0.0):
            raise InputError(
                f"resting_speed: {self.resting_speed!r} given, a speed > 0 [m/s] expected",
                field="resting_speed",
                value=self.resting_speed,
            )

    def plan(self) -> Plan:
        """Return the effects that this scene calls for, and why each other one is left out."""
        return make_plan(self)

    @property
    def rest(self) -> float:
        """The resting speed that is used [m/s]."""
        if self.resting_speed is None:
            gravity = float(np.linalg.norm(self.model.gravity.linear))
            return RESTING_FRACTION * math.sqrt((gravity or STANDARD_GRAVITY) * self.extent)
        return self.resting_speed

    @property
    def joint_damping(self) -> Array:
        """(nv,) viscous damping of the model's joints [N m s/rad or N s/m]."""
        return np.array(self.model.damping)

    @property
    def joint_friction(self) -> Array:
        """(nv,) dry friction of the model's joints [N m or N]."""
        return np.array(self.model.friction)

    @property
    def extent(self) -> float:
        """The robot's size L [m]: the longest chain to a contact, the longest link, or 1 m for a point."""
        links = link_lengths(self.model)
        chains = [span(self.model, links, contact) for contact in (*self.contacts, *self.held)]
        return max([length for length in (*chains, *links) if length > 0.0], default=1.0)

    def limits(self) -> tuple[JointLimit, ...]:
        """Return the finite bounds of the coordinates that are plain numbers."""
        model = self.model
        found = []
        for joint in range(1, model.njoints):
            if model.nqs[joint] != model.nvs[joint]:
                continue
            for k in range(model.nqs[joint]):
                i, j = model.idx_qs[joint] + k, model.idx_vs[joint] + k
                name = model.names[joint] + (f"[{k}]" if model.nqs[joint] > 1 else "")
                lower, upper = float(model.lowerPositionLimit[i]), float(model.upperPositionLimit[i])
                if lower == upper == 0.0:
                    continue  # as Pinocchio fills in where a description gives none
                if abs(lower) < 1e300:
                    found.append(JointLimit(f"{name} lower", i, j, 1.0, lower))
                if abs(upper) < 1e300:
                    found.append(JointLimit(f"{name} upper", i, j, -1.0, upper))
        return tuple(found)

    def unreachable(self) -> tuple[str, ...]:
        """Return the names of the contacts that can never reach their plane, whatever the joints do."""
        model, links, names = self.model, link_lengths(self.model), []
        for contact in self.contacts:
            if contact.plane.body is not None:
                continue
            joint = model.frames[frame_id(model, contact.frame)].parentJoint
            support = list(model.supports[joint])
            if len(support) == 1:
                frame = model.frames[frame_id(model, contact.frame)].placement
                gap = contact.plane.distance(frame.act(np.array(contact.offset))) - contact.radius
            else:
                root = model.jointPlacements[support[1]].translation
                gap = contact.plane.distance(root) - span(model, links, contact) - travel(model, contact)
            if gap > 0.0:
                names.append(contact.label)
        return tuple(names)


def link_lengths(model: pin.Model) -> list[float]:
    """Return each joint's distance from the joint before it [m], zero where that is the world."""
    parents = list(model.parents)
    return [
        math.hypot(*placement.translation.tolist()) if parent > 0 else 0.0
        for parent, placement in zip(parents, model.jointPlacements, strict=True)
    ]


def span(model: pin.Model, links: list[float], contact: Contact) -> float:
    """Return the length of the chain from a contact's first joint to its point, joints at zero travel [m]."""
    frame = model.frames[frame_id(model, contact.frame)]
    tip = math.hypot(*frame.placement.act(np.array(contact.offset)).tolist())
    return tip + contact.radius + sum(links[joint] for joint in list(model.supports[frame.parentJoint])[2:])


def travel(model: pin.Model, contact: Contact) -> float:
    """Return how far the joints of a contact's chain can slide in all [m]; infinite where one has no end."""
    total = 0.0
    for joint in list(model.supports[model.frames[frame_id(model, contact.frame)].parentJoint])[1:]:
        kind = model.joints[joint].shortname()
        if any(word in kind for word in ("RX", "RY", "RZ", "RUB", "Revolute", "Spherical", "Universal")):
            continue
        i = model.idx_qs[joint]
        bound = max(abs(float(model.lowerPositionLimit[i])), abs(float(model.upperPositionLimit[i])))
        if not any(word in kind for word in ("PX", "PY", "PZ", "Prismatic")) or not 0.0 < bound < 1e300:
            return math.inf
        total += bound
    return total


def _contacts(field: str, contacts: Any, model: pin.Model) -> tuple[Contact, ...]:
    if isinstance(contacts, Contact):
        contacts = (contacts,)
    contacts = tuple(contacts)
    for contact in contacts:
        if not isinstance(contact, Contact):
            raise InputError(f"{field}: {contact!r} is not a Contact", field=field, value=contact)
        frame_id(model, contact.frame)
        plane = contact.plane
        if plane.body is not None:
            frame_id(model, plane.body, "body")
        _check_surface_motion(field, contact)
    return contacts


def _check_surface_motion(field: str, contact: Contact) -> None:
    departure = contact.plane.departure()
    if departure is not None:
        raise InputError(
            f"{field}: the {contact.plane.kind} of {contact.label!r} {departure}; in a scene a surface may "
            "only move within itself, for it stays where it is; let a body carry it instead",
            field=field,
            value=contact,
        )
