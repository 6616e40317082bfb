"""Model, contacts and joints of a scene without the effects that are switched off, see `Scene.without`."""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin

from ..robot.contact import Contact
from .scene import Scene


def altered_model(model: pin.Model, without: Container[str]) -> pin.Model:
    """Return a model without the effects that are switched off."""
    if "gravity" in without or "rotor inertia" in without:
        model = model.copy()
    if "gravity" in without:
        model.gravity = pin.Motion.Zero()
    if "rotor inertia" in without:
        model.armature = np.zeros(model.nv)
    return model


def altered(contact: Contact, without: Container[str]) -> Contact:
    """Return a contact without the effects that are switched off."""
    if "contact friction" in without:
        contact = replace(contact, friction=0.0, sliding_friction=None)
    if "restitution" in without:
        contact = replace(contact, restitution=0.0)
    if "moving surfaces" in without:
        contact = replace(contact, plane=contact.plane.at_rest())
    return contact


def held_contacts(scene: Scene) -> list[Contact]:
    """Return the held contacts that are not switched off, without the effects that are."""
    off = scene.without
    return [] if "held contacts" in off else [altered(contact, off) for contact in scene.held]


def locked_joints(scene: Scene) -> Sequence[str | int]:
    """Return the locked joints that are not switched off."""
    return () if "locked joints" in scene.without else scene.locked


def limit_restitution(scene: Scene) -> float:
    """Return the coefficient of restitution of the joint limits, zero if it is switched off."""
    return 0.0 if "restitution" in scene.without else scene.limit_restitution


def in_impacts(scene: Scene) -> Scene:
    """Return a scene with the switched-off effects removed from its model, contacts and joints."""
    return replace(
        scene,
        model=altered_model(scene.model, scene.without),
        contacts=[altered(contact, scene.without) for contact in scene.contacts],
        held=held_contacts(scene),
        locked=locked_joints(scene),
    )
