"""The saltation matrix of a single impact. (docs/derivatives.md, 9)"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array
from ..checks import in_short
from ..errors import InputError, UnknownNameError
from ..robot.contact import Contact
from .forces import ClosedSet
from .integrator import Integrator
from .options import Options
from .saltation import Saltation
from .scene import Scene


def saltation_matrix(
    scene: Scene, contact: Contact | str, q: ArrayLike, v: ArrayLike, t: float = 0.0
) -> Array:
    """Return the derivative of the state after an impact by the state before it, in the motion of a scene.

    It includes the change of the time of the impact. (docs/derivatives.md, D25)

    Args:
        scene: The scene; its other contacts and joint limits are open.
        contact: The contact that collides, or its name.
        q: (nq,) configuration, at which the gap of the contact is zero.
        v: (nv,) velocity before the impact.
        t: Time [s], at which a control is evaluated.

    Returns:
        Ξ (2nv, 2nv) for changes (δq, δv), with δq in the tangent space; columns that do not exist are NaN.
        Changes that held contacts do not admit are projected onto those that they admit.

    Raises:
        InputError: As in `simulate` and `impact_derivatives`; nothing collides, or something else; another
            contact or a joint limit is closed; a sampled control.
        UnknownNameError: A contact that the scene does not have.
    """
    name = contact.label if isinstance(contact, Contact) else contact
    if scene.period is not None and scene.control is not None and "control" not in scene.without:
        raise InputError(
            f"period: {scene.period} given; the force of a sampled control depends on an earlier state, "
            "which is not an argument; use simulate(..., sensitivities=)",
            value=scene.period,
        )
    integrator = Integrator(scene, q, v, Options(max_impacts=1))
    saltation = Saltation(scene, integrator.dynamics, integrator.model, (), np.zeros(integrator.model.nv))
    if name not in [one.label for one in scene.contacts]:
        raise UnknownNameError(f"contact: the scene has no contact {in_short(contact)}", value=contact)
    integrator.state.t = float(t)
    integrator.begin()
    impacts = integrator.record.impacts
    if [record.source for record in impacts] != [name]:
        struck = ", ".join(repr(record.source) for record in impacts) or "nothing"
        raise InputError(f"contact: {struck} collides in this state instead of {name!r} alone", value=name)
    work, instant = integrator.work, integrator.instant
    rates = instant.approach(impacts[0].q, impacts[0].v_before, work.touching_gap)
    for other, rate in zip(instant.names, rates.tolist(), strict=True):
        if rate <= work.resting_speed and other != name:
            raise InputError(
                f"contact: {other!r} is active while {name!r} collides; use simulate(..., sensitivities=)",
                value=name,
            )
    after = saltation.before(impacts[0], None)
    after.v, after.closed = integrator.state.v, ClosedSet.of(work, np.zeros(0, dtype=np.int64))
    after.directions = np.array([work.start_directions, work.start_directions])
    return saltation.start(np.eye(2 * len(after.v)), after, impacts)
