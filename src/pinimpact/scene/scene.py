"""Scenes: a robot with its contacts, control and events, without its state."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin

from ..checks import above_zero, as_tuple, at_least_zero, coefficient, counted, in_short
from ..contact_space.simultaneous import find_policy
from ..display import changed_fields
from ..errors import InputError, ModelError
from ..geometry.collision_shapes import collision_model, shapes_of_links
from ..geometry.surfaces import Surface
from ..robot.contact import Contact, check_contact, check_surface, is_pair, points_of_rim
from ..robot.inertias import check_coefficients
from ..robot.names import (
    ShapedRobot,
    frame_id,
    free_velocities,
    joint_keys,
    model_of,
    motion_signs,
)
from ..robot.shape_pair import places
from ..robot.solids import Shape, Solid
from ._kernels.tolerances import RESTING
from .controls import Control, JointPD
from .effects import Plan, check_names, make_plan
from .events import Event, Guard, as_events
from .layout import SceneLayout

CACHED = "_layout", "_fixed"
"""Attributes that are computed from the others when needed."""

STANDARD_GRAVITY = 9.80665


@dataclass(frozen=True, eq=False)
class Scene:
    """A robot with its contacts, control and events, to be simulated.

    Contacts without a name whose labels are equal are numbered: "foot on plane 1", "foot on plane 2". Reports
    use the labels of `contacts` and `held`.

    A contact of a collision shape is replaced by its tips, see `Contact.tips`; `contacts` has all of them.

    Attributes:
        model: Pinocchio model, or a RobotWrapper. Gravity, rotor inertia, joint damping, dry friction and
            joint limits are those of the model.
        contacts: The contacts.
        control: control(t, q, v) -> (nv,) generalized forces, or a `JointPD`, or None. Without `period` it
            must depend on its arguments only; it is called as often as the steps need. Sensitivities use its
            attribute ``jacobian``, see `simulate`.
        period: Period T [s] of a sampled control. It is called once at each of the times 0, T, 2T, …, in this
            order and after the events at these times; its force is constant until the next one acts. It may
            have a state.
        simultaneous: Policy for contacts and joint limits that collide or rest at one instant and are
            coupled; see `POLICIES`.
        geometry: Collision shapes; None for those of the RobotWrapper.
        delay: Time [s] from a sample of the control until its force acts; before the first, forces are zero.
        held: Contacts that are bilateral constraints throughout: a grasp, a bolted foot, a closed loop. They
            start at their surfaces, see `simulate`.
        locked: Joints, by name or id, whose velocity impacts do not change (stiff position control).
        limit_restitution: Coefficient of restitution of the joint limits, which are unilateral impacts.
        resting_speed: Bounce speed [m/s] below which a contact stays closed; None for 10⁻⁴ √(g L), with the
            model's gravity (standard gravity if it has none) and the size L of the robot, `extent`.
        record: Whether to record the path of each impact.
        without: Effects to switch off, by the names in `plan`.
        events: User events, see `Event`; functions are accepted too, with the attributes ``terminal`` and
            ``direction`` as in SciPy.

    Raises:
        InputError: Numbers out of range, two contacts with one name or one contact twice, a contact with the
            name of a joint limit or of a joint with dry friction, a surface that does not move within itself.
        UnknownNameError: A frame, joint or effect that does not exist.
        ModelError: Invalid gravity, joint damping, dry friction, rotor inertia or joint limits of the model.
    """

    model: pin.Model
    contacts: Sequence[Contact] = ()
    control: Control | JointPD | None = None
    held: Sequence[Contact] = ()
    locked: Sequence[str | int] = ()
    limit_restitution: float = 0.0
    resting_speed: float | None = None
    record: bool = False
    without: Sequence[str] = ()
    events: Sequence[Event | Guard] = ()
    period: float | None = None
    delay: float = 0.0
    simultaneous: str = "propagate"
    geometry: pin.GeometryModel | None = None

    def __post_init__(self) -> None:
        assign = object.__setattr__
        if self.geometry is None:
            assign(self, "geometry", getattr(self.model, "collision_model", None))
        elif not isinstance(self.geometry, pin.GeometryModel):
            raise InputError(
                f"geometry: {in_short(self.geometry)} is not a pinocchio GeometryModel", value=self.geometry
            )
        assign(self, "model", model_of(self.model))
        check_numbers(self.model)
        assign(self, "without", check_names(self.without))
        tips, default = self._tips(self.contacts)
        contacts, held = _contacts("contacts", tips, self.model), _contacts("held", self.held, self.model)
        named = _named([*contacts, *held], [*default, *(contact.name is None for contact in held)])
        assign(self, "contacts", _with_rim_points(named[: len(contacts)]))
        assign(self, "held", tuple(named[len(contacts) :]))
        self._check_names([contact.label for contact in (*self.contacts, *self.held)])
        assign(self, "locked", joint_keys(self.locked))
        free_velocities(self.model, self.locked)
        assign(self, "events", as_events(self.events))
        if isinstance(self.control, JointPD):
            self.control.drives(self.model)
        elif self.control is not None and not callable(self.control):
            raise InputError(
                f"control: {in_short(self.control)} is neither a function of (t, q, v) nor a JointPD",
                value=self.control,
            )
        self._check_sampling()
        find_policy(self.simultaneous)
        assign(self, "limit_restitution", coefficient("limit_restitution", self.limit_restitution))
        if self.resting_speed is not None and not at_least_zero("resting_speed", self.resting_speed) > 0.0:
            raise InputError(
                f"resting_speed: {self.resting_speed!r} given, a speed > 0 [m/s] expected",
                value=self.resting_speed,
            )

    def _tips(self, contacts: Any) -> tuple[Any, list[bool]]:
        """Replace contacts of collision shapes by their tips; return also whose names can be numbered.

        Names of a shape that is given twice with one surface cannot, so that this raises an error.
        """
        given = (contacts,) if isinstance(contacts, Contact) else contacts
        if not isinstance(given, Sequence) or not all(isinstance(contact, Contact) for contact in given):
            return contacts, []
        robot = ShapedRobot(self.model, self.geometry) if self.geometry is not None else self.model
        found: list[Contact] = []
        default: list[bool] = []
        counts = Counter((contact.geometry or contact.shape, contact.plane) for contact in given)
        for contact in given:
            once = contact.geometry is None or counts[contact.geometry, contact.plane] == 1
            tips = places(robot, contact) if is_pair(robot, contact) else contact.tips(robot)
            found += tips
            default += [contact.name is None and once] * len(tips)
        return found, default

    def contacts_from_geometry(
        self, surface: Surface, links: str | Sequence[str] = "all", **coefficients: Any
    ) -> Scene:
        """Return this scene with additional contacts of collision shapes with a surface.

        Shapes that cannot move relative to the surface are left out.

        Args:
            surface: The surface.
            links: Names of the frames of links, whose shapes are used, or "all".
            **coefficients: Keywords of each `Contact`: friction, restitution and others.

        Raises:
            InputError: A robot without collision shapes, or a shape that is not supported.
            UnknownNameError: A link that has no shape.
        """
        check_surface("surface", surface)
        model = self.model
        robot = ShapedRobot(model, self.geometry) if self.geometry is not None else model
        shapes = shapes_of_links(model, collision_model(robot), links)
        carrier = 0
        if isinstance(surface, Solid):
            carrier = surface.carried_by(robot).joint
        elif surface.body is not None:
            carrier = model.frames[frame_id(model, surface.body, "body")].parentJoint
        added = [
            Contact(geometry=shape.name, plane=surface, **coefficients)
            for shape in shapes
            if motion_signs(model, shape.parentJoint, carrier).any()
        ]
        return replace(self, contacts=[*self.contacts, *added])

    def _check_sampling(self) -> None:
        """Check that a period or delay is given only with a control to sample."""
        assign = object.__setattr__
        assign(self, "delay", at_least_zero("delay", self.delay))
        if self.period is not None:
            assign(self, "period", above_zero("period", self.period))
            if self.control is None:
                raise InputError(
                    f"period: {self.period!r} given, but no control= to sample", value=self.period
                )
        elif self.delay > 0.0:
            raise InputError(
                f"delay: {self.delay!r} given without a period; only a sampled control has a "
                "delay, set period=",
                value=self.delay,
            )

    def _check_names(self, labels: list[str]) -> None:
        """Check that names of contacts are unique, also among joint limits and joints with dry friction."""
        limits = {limit.name for limit in self.layout().limits}
        rubbing = {
            name
            for name, start, count in zip(self.model.names, self.model.idx_vs, self.model.nvs, strict=True)
            if self.model.friction[start : start + count].any()
        }
        counts = Counter(labels)
        for label in counts:
            if counts[label] > 1:
                raise InputError(
                    f"contacts: {counts[label]} contacts are called {label!r}; give each its own name=",
                    value=label,
                )
            if label in limits | rubbing:
                raise InputError(
                    f"contacts: {label!r} is the name of a contact and of a joint "
                    f"{'limit' if label in limits else 'with dry friction'}; give the contact another name=",
                    value=label,
                )

    def __getstate__(self) -> dict[str, Any]:
        """Omit cached data, and collision shapes of no contact, since meshes are large."""
        state = {name: value for name, value in vars(self).items() if name not in CACHED}
        pairs = [contact.pair for contact in (*self.contacts, *self.held) if contact.pair is not None]
        named = {pair.geometry for pair in pairs} | {
            pair.plane.geometry for pair in pairs if isinstance(pair.plane, Shape)
        }
        if self.geometry is not None:
            kept = pin.GeometryModel()
            for shape in self.geometry.geometryObjects:
                if shape.name in named:
                    kept.addGeometryObject(shape)
            state["geometry"] = kept if named else None
        limits = self.model.lowerPositionLimit.copy(), self.model.upperPositionLimit.copy()
        if not np.isfinite(limits).all():  # Pinocchio 4.0 writes infinite numbers, but cannot read them
            model = self.model.copy()
            model.lowerPositionLimit = model.upperPositionLimit = np.zeros(model.nq)
            state |= {"model": model, "_limits": limits}
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        limits = state.pop("_limits", None)
        vars(self).update(state)
        if limits is not None:
            self.model.lowerPositionLimit, self.model.upperPositionLimit = limits

    def __repr__(self) -> str:
        """Return the scene in a line: the robot, its contacts, and what differs from the defaults."""
        parts = [
            f"{self.model.name or 'unnamed model'}: {counted(self.model.nv, 'velocity')}",
            counted(len(self.contacts), "contact"),
        ]
        if self.held:
            parts.append(f"{len(self.held)} held")
        if self.control is not None:
            parts.append("a control" if self.period is None else f"a control sampled every {self.period:g} s")
        if self.events:
            parts.append(counted(len(as_events(self.events)), "event"))
        given = changed_fields(
            self, ("model", "contacts", "held", "control", "period", "events", "geometry"), width=40
        )
        return f"Scene({', '.join([*parts, *given])})"

    def fixed(self) -> Scene:
        """Return this scene with a copy of its model, so that later changes of the model do not affect it.

        It is made once, and again after the model has changed.
        """
        if "_is_fixed" in vars(self):
            return self
        known: Scene | None = vars(self).get("_fixed")
        if known is None or known.model != self.model:
            known = object.__new__(Scene)
            vars(known).update({name: value for name, value in vars(self).items() if name not in CACHED})
            vars(known).update(model=self.model.copy(), _is_fixed=True)
            object.__setattr__(self, "_fixed", known)
        return known

    def layout(self) -> SceneLayout:
        """Return the layout of the scene, computed again if the model has changed."""
        scene = self.fixed()
        known: SceneLayout | None = vars(scene).get("_layout")
        if known is None:
            limited = "joint limits" not in self.without
            known = SceneLayout(scene.model, self.contacts, self.held, limited, self.geometry)
            object.__setattr__(scene, "_layout", known)
        return known

    def plan(self) -> Plan:
        """Return which effects are computed, and why."""
        return make_plan(self, self._control_in_words(), [event.label for event in as_events(self.events)])

    def _control_in_words(self) -> str:
        """Return a phrase that describes the control, empty without one."""
        if self.control is None:
            return ""
        what = "a control callback is given"
        if isinstance(self.control, JointPD):
            count = len(self.control.drives(self.model).velocity)
            what = f"PD control of {count} joint{'' if count == 1 else 's'}"
        if self.period is None:
            return what
        late = f", {self.delay:g} s late" if self.delay > 0.0 else ""
        return f"{what.removesuffix(' is given')}, sampled every {self.period:g} s and held{late}"

    @property
    def rest(self) -> float:
        """The resting speed [m/s]."""
        if self.resting_speed is not None:
            return self.resting_speed
        return RESTING * math.sqrt(self._gravity * self.extent)

    @property
    def time_scale(self) -> float:
        """The time √(L/g) [s] in which the robot falls half its size L, with g as for the resting speed."""
        return math.sqrt(self.extent / self._gravity)

    @property
    def _gravity(self) -> float:
        return float(np.linalg.norm(self.model.gravity.linear)) or STANDARD_GRAVITY

    @property
    def extent(self) -> float:
        """The robot's size L [m]: its longest chain or link, else largest radius of gyration, else 1 m."""
        return self.layout().extent

    def sources(self) -> tuple[str, ...]:
        """Return the names that impacts and modes can have: contacts, joint limits and joints."""
        return self.layout().sources


def numbered(labels: Sequence[str], default: Sequence[bool]) -> list[str]:
    """Return labels, with equal default labels numbered.

    Args:
        labels: Label of each contact.
        default: Whether the label is a default and not a given name.
    """
    taken, result, counts = set(labels), [], Counter(labels)
    for label, free in zip(labels, default, strict=True):
        if free and counts[label] > 1:
            numbers = itertools.count(1)
            label = next(name for name in (f"{label} {k}" for k in numbers) if name not in taken)
            taken.add(label)
        result.append(label)
    return result


def _named(contacts: Sequence[Contact], default: Sequence[bool]) -> list[Contact]:
    """Return contacts with unique labels; only default names are changed."""
    for contact, count in Counter(contacts).items():
        if count > 1:
            raise InputError(
                f"contacts: {contact.label!r} is given twice; leave one out, or give each its own name=",
                value=contact,
            )
    labels = numbered([c.label for c in contacts], default)
    return [
        contact if contact.label == label else replace(contact, name=label)
        for contact, label in zip(contacts, labels, strict=True)
    ]


def _with_rim_points(contacts: Sequence[Contact]) -> tuple[Contact, ...]:
    """Return contacts with those at the points of rims, which replace each rim while it lies flat."""
    given, found = {contact.of_rim for contact in contacts}, list[Contact]()
    for contact in contacts:
        found.append(contact)
        if contact.rim > 0.0 and contact.label not in given:
            found += points_of_rim(contact)
    return tuple(found)


def _contacts(field: str, contacts: Any, model: pin.Model) -> tuple[Contact, ...]:
    contacts = as_tuple(field, contacts, Contact, "a Contact")
    for contact in contacts:
        check_contact(field, contact, placed=field == "held")
    for frame in dict.fromkeys(contact.frame for contact in contacts):
        frame_id(model, frame)
    for contact in {contact.plane: contact for contact in reversed(contacts)}.values():
        if contact.plane.body is not None:
            frame_id(model, contact.plane.body, "body")
        _check_surface_motion(field, contact)
    pairs: dict[Contact, Contact] = {}
    return tuple(contact if contact.pair is None else _of_own_pair(contact, pairs) for contact in contacts)


def _of_own_pair(contact: Contact, pairs: dict[Contact, Contact]) -> Contact:
    """Return a contact of two shapes whose pair has the same coefficients, which may have been replaced."""
    assert contact.pair is not None
    names = "friction", "restitution", "law", "sliding_friction", "stiffness"
    own = replace(contact.pair, **{name: getattr(contact, name) for name in names})
    return contact if own == contact.pair else replace(contact, pair=pairs.setdefault(own, own))


def _check_surface_motion(field: str, contact: Contact) -> None:
    departure = contact.plane.departure()
    if departure is not None:
        raise InputError(
            f"{field}: the {contact.plane.kind} of {contact.label!r} {departure}; in a scene a "
            "surface can move only within itself; attach it to a moving body instead",
            value=contact,
        )


def check_numbers(model: pin.Model) -> None:
    """Raise `ModelError` for invalid gravity, damping, dry friction, armature or joint limits of a model."""
    gravity = model.gravity.vector
    if not np.isfinite(gravity).all():
        raise _refused("gravity", gravity.tolist(), "finite numbers [m/s²]")
    if gravity[3:].any():  # no potential has it
        raise _refused("gravity.angular", gravity[3:].tolist(), "zeros")
    check_coefficients(model, "damping", "N m s/rad or N s/m")
    check_coefficients(model, "friction", "N m or N")
    check_coefficients(model, "armature", "kg m² or kg")
    for field in ("lowerPositionLimit", "upperPositionLimit"):
        values = np.asarray(getattr(model, field))
        for k in np.flatnonzero(np.isnan(values))[:1].tolist():
            raise _refused(f"{field}[{k}]", values[k], "a bound [rad or m], infinite where there is none,")


def _refused(field: str, value: object, expected: str) -> ModelError:
    return ModelError(f"model.{field}: {value} given, {expected} expected", value=value)
