"""The plan of a scene: which effects are computed, why, and which of them were switched off."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from ..checks import as_tuple, counted, in_short, near_matches
from ..display import html_table
from ..errors import InputError, UnknownNameError
from ..robot.contact import Contact

if TYPE_CHECKING:
    from .scene import Scene

SWITCHABLE = (
    "gravity",
    "control",
    "joint damping",
    "joint friction",
    "rotor inertia",
    "contact friction",
    "restitution",
    "contact guards",
    "sustained contact",
    "moving surfaces",
    "joint limits",
    "held contacts",
    "locked joints",
    "recorded path",
    "user events",
)
"""Effects that can be switched off by name."""

LARGE = 30
"""Number of contacts above which a plan names `scheme="auto"`, and time steps of intervals are full."""

DERIVED = ("normal-tangential coupling", "spatial slip", "simultaneous impacts")
"""Effects that each impact decides from its own W and v; they cannot be switched off."""


@dataclass(frozen=True, slots=True)
class Effect:
    """One line of a plan.

    Attributes:
        name: Name, one of `SWITCHABLE` and `DERIVED`.
        on: Whether it is computed.
        reason: Why it is computed, or why not.
        changes_answer: Whether it was switched off although it applies.
    """

    name: str
    on: bool
    reason: str
    changes_answer: bool = False


@dataclass(frozen=True, slots=True, repr=False)
class Plan:
    """The effects of a scene, each with its reason; ``str(plan)`` is a table, ``plan["gravity"]`` one line.

    Attributes:
        effects: The effects, in the order of the vocabulary.
        resting_speed: Bounce speed below which a contact stays closed [m/s].
        unreachable: Names of the contacts that cannot reach their surfaces, and are not watched.
        scheme: Scheme that `simulate` needs: "auto" if faces of bodies can be aligned or many points can be
            closed, so that events may not be located one by one, else "event-driven".
    """

    effects: tuple[Effect, ...]
    resting_speed: float
    unreachable: tuple[str, ...]
    scheme: str

    def __iter__(self) -> Iterator[Effect]:
        return iter(self.effects)

    def __getitem__(self, name: str) -> Effect:
        for effect in self.effects:
            if effect.name == name:
                return effect
        raise UnknownNameError(f"effect: unknown effect {name!r}; {near_matches(name, SWITCHABLE + DERIVED)}")

    @property
    def switched_off(self) -> tuple[str, ...]:
        """Effects switched off although they apply, so that the result changes."""
        return tuple(effect.name for effect in self.effects if effect.changes_answer)

    def __repr__(self) -> str:
        computed = ", ".join(effect.name for effect in self.effects if effect.on)
        off = f"; switched off: {', '.join(self.switched_off)}" if self.switched_off else ""
        return f"Plan({computed or 'no effects'}{off})"

    def _rows(self) -> list[tuple[str, str, str]]:
        return [
            (e.name, "OFF" if e.changes_answer else "yes" if e.on else "no", e.reason) for e in self.effects
        ]

    def _repr_html_(self) -> str:
        return html_table("Effects", ("effect", "computed", "why"), self._rows())

    def __str__(self) -> str:
        width = max(len(effect.name) for effect in self.effects)
        return "\n".join(f"{name:<{width}}  {mark:<3}  {reason}" for name, mark, reason in self._rows())


def check_names(without: Sequence[str]) -> tuple[str, ...]:
    """Return the effects to switch off; raise an error for unknown ones and those of `DERIVED`."""
    without = as_tuple("without", without, str, "the name of an effect")
    for name in without:
        if isinstance(name, str) and name in DERIVED:
            raise InputError(
                f"without: {name!r} depends on each impact and cannot be switched off", value=name
            )
        if not isinstance(name, str) or name not in SWITCHABLE:
            raise UnknownNameError(
                f"without: unknown effect {in_short(name)}; {near_matches(name, SWITCHABLE)}", value=name
            )
    return without


def _in_words(contacts: Iterable[Contact]) -> str:
    """Return the names of contacts; those of one collision shape appear once, with their number."""
    names = Counter(c.label if c.shape is None else f"{c.shape} on {c.plane.label}" for c in contacts)
    return ", ".join(name if count == 1 else f"{name} ({count} points)" for name, count in names.items())


def make_plan(scene: Scene, control: str, events: Sequence[str]) -> Plan:
    """Return the plan of a scene; `control` describes its control (empty: none), `events` are names."""
    layout, contacts, without, resting_speed = scene.layout(), scene.contacts, scene.without, scene.rest
    unreachable, limits = layout.unreachable, len(layout.limits)
    watched = len(contacts) - len(unreachable)
    called_for = _of_model(scene.model, control) | _of_contacts(contacts, unreachable)
    called_for |= {
        "sustained contact": (
            watched > 0 or limits > 0,
            f"a bounce slower than {resting_speed:.3g} m/s is taken as rest",
            "no contact can close",
        ),
        "joint limits": (
            limits > 0,
            f"{counted(limits, 'finite bound')}, one-sided impacts with e = {scene.limit_restitution:g}",
            "no joint has a finite bound",
        ),
        "held contacts": (bool(scene.held), f"held: {_in_words(scene.held)}", "no contact is held"),
        "locked joints": (
            bool(scene.locked),
            f"locked during impacts: {', '.join(map(str, scene.locked))}",
            "no joint is locked",
        ),
        "recorded path": (scene.record, "record=True", "record=False"),
        "user events": (bool(events), f"located: {', '.join(events)}", "no events are given"),
    }
    effects = [_effect(name, *called_for[name], without) for name in SWITCHABLE]
    touching = watched > 0 and "contact guards" not in without
    rubbing = called_for["contact friction"][0] and "contact friction" not in without
    none = "no impact with friction can occur" if touching else "no contact can touch"
    coupled = "each impact computes it unless its W has none (b = 0)" if touching else none
    spatial = (
        "each impact integrates it unless its slip keeps its direction" if touching and rubbing else none
    )
    effects.append(Effect("normal-tangential coupling", touching, coupled))
    effects.append(Effect("spatial slip", touching and rubbing, spatial))
    several = (watched * touching + limits * ("joint limits" not in without)) > 1
    resolved = "coupled contacts and joint limits that collide or rest at one instant are resolved by "
    none = "no two contacts or joint limits can touch at one instant"
    effects.append(
        Effect("simultaneous impacts", several, f"{resolved}{scene.simultaneous!r}" if several else none)
    )
    faces = any(contact.pair is not None for contact in contacts)
    scheme = "auto" if faces or watched > LARGE else "event-driven"
    return Plan(tuple(effects), resting_speed, unreachable, scheme)


_Called = dict[str, tuple[bool, str, str]]
"""For each effect: whether a scene calls for it, the reason if it does, and the reason if not."""


def _of_model(model: pin.Model, control: str) -> _Called:
    """Return the effects of the robot and its control."""
    damping, dry, rotor = (np.asarray(x) for x in (model.damping, model.friction, model.armature))
    g = float(np.linalg.norm(model.gravity.linear))
    return {
        "gravity": (g > 0.0, f"{g:.4g} m/s² in the model", "the model's gravity is zero"),
        "control": (bool(control), control, "no control callback is given"),
        "joint damping": (
            bool(damping.any()),
            f"{counted(int((damping != 0).sum()), 'velocity')} damped",
            "the model's damping is zero",
        ),
        "joint friction": (
            bool(dry.any()),
            f"dry friction in {counted(int((dry != 0).sum()), 'joint')}",
            "the model's joint friction is zero",
        ),
        "rotor inertia": (
            bool(rotor.any()),
            f"armature on {counted(int((rotor != 0).sum()), 'joint')}",
            "the model's armature is zero",
        ),
    }


def _of_contacts(contacts: Sequence[Contact], unreachable: tuple[str, ...]) -> _Called:
    """Return the effects of contacts."""
    watched, far = len(contacts) - len(unreachable), set(unreachable)
    away = _in_words(contact for contact in contacts if contact.label in far)
    rubbing = _in_words(c for c in contacts if max(c.friction, c.sustained_friction) > 0.0)
    bouncing = _in_words(c for c in contacts if callable(c.restitution) or c.restitution > 0.0)
    moving = _in_words(c for c in contacts if any(c.plane.velocity) or any(c.plane.angular_velocity))
    return {
        "contact friction": (
            bool(rubbing),
            f"μ > 0 at {rubbing}",
            "no contact has μ > 0" if contacts else "there are no contacts",
        ),
        "restitution": (
            bool(bouncing),
            f"e > 0 at {bouncing}",
            "no contact has e > 0" if contacts else "there are no contacts",
        ),
        "contact guards": (
            watched > 0,
            f"{counted(watched, 'contact')} watched"
            + (f"; out of reach and not watched: {away}" if unreachable else ""),
            f"out of reach of their surfaces: {away}" if unreachable else "there are no contacts",
        ),
        "moving surfaces": (bool(moving), f"the surface moves at {moving}", "no surface moves by itself"),
    }


def _effect(name: str, present: bool, reason: str, absence: str, without: Sequence[str]) -> Effect:
    """Return the entry of an effect in the plan."""
    if not present:
        return Effect(name, False, absence)
    if name in without:
        return Effect(name, False, f"switched off, although it applies: {reason}", name != "recorded path")
    return Effect(name, True, reason)
