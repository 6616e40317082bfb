"""Check Coulomb's law between the samples of a trajectory, from its states and forces alone."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from pinimpact import Scene, Trajectory
from pinimpact.geometry.surfaces import contact_axes

TIMES = 60

SHORT = 1e-9
"""Duration [s] below which modes are not checked: forces may become unbounded within it, before a jam."""


def law_violation(scene: Scene, trajectory: Trajectory, rtol: float, seed: int) -> str:
    """Return a violation of Coulomb's law at random times, or an empty string.

    Contacts must be frames above planes at rest. Checked are: no penetration, normal forces ≥ 0, zero forces
    of open contacts, friction within its cone and opposite to slip. Forces are not checked while some slip
    is so slow that its direction is undetermined within the tolerance. Slip may lose velocity only
    at impacts or when contacts close.
    """
    rng = np.random.default_rng(seed)
    model, data = scene.model, scene.model.createData()
    closed = [m for m in trajectory.modes if m.mode in ("slip", "stick") and m.end > m.start + SHORT]
    chosen = rng.permutation(len(closed))[:TIMES]
    times = [
        rng.uniform(0.0, trajectory.t[-1], TIMES),
        [rng.uniform(closed[k].start, closed[k].end) for k in chosen],
    ]
    times = np.sort(np.concatenate(times))
    forces = {c.label: trajectory.forces_world(c.label, times) for c in scene.contacts}
    weight = 9.81 * pin.computeTotalMass(model)
    atol, slow = 1e-2 * rtol, 0.1 * scene.rest
    for k, t in enumerate(times):
        q, v = trajectory.at(t)
        pin.forwardKinematics(model, data, q, v)
        error = 10.0 * (atol + rtol * np.abs(v).max())
        crossed = any(one.start <= t <= one.end for one in trajectory.stepped)
        slips = {m.source for m in closed if m.mode == "slip" and m.start <= t <= m.end}
        gaps, speeds, vague = [], [], False
        for contact in scene.contacts:
            frame = model.getFrameId(contact.frame)
            placement = pin.updateFramePlacement(model, data, frame)
            gaps.append(
                np.array(contact.plane.normal) @ (placement.translation - np.array(contact.plane.point))
            )
            velocity = pin.getFrameVelocity(model, data, frame, pin.LOCAL_WORLD_ALIGNED).linear
            speeds.append((contact_axes(contact.plane.normal) @ velocity)[:2])
            vague |= contact.label in slips and np.linalg.norm(speeds[-1]) < error
        # the error of all forces is relative to the largest one
        near = (1e-7 + 10.0 * rtol) * (weight + max(np.abs(force[k]).max() for force in forces.values()))
        for contact, gap, slip in zip(scene.contacts, gaps, speeds, strict=True):
            *tangent, push = contact_axes(contact.plane.normal) @ forces[contact.label][k]
            size, most = np.linalg.norm(slip), contact.sustained_friction * push
            where = f"{contact.label} at {t:.6g} s"
            if gap < -1e-7 - error:
                return f"{where} sinks in by {-gap:.3g} m"
            if vague:
                continue
            if push < -near:
                return f"{where} pulls with {-push:.3g} N"
            if push > near and gap > 1e-7 + error:
                return f"{where} pushes with {push:.3g} N from {gap:.3g} m"
            if np.linalg.norm(tangent) > most + near:
                return (
                    f"{where} has friction of {np.linalg.norm(tangent):.6g} N where {most:.6g} N is the most"
                )
            if push > near and size > slow + error and not crossed:  # forces of time steps are means
                missed = np.linalg.norm(tangent + most * slip / size)
                if missed > near + most * error / size:
                    return (
                        f"{where} slips at {size:.3g} m/s with friction off by {missed:.3g} N of {most:.3g} N"
                    )
    return unexplained_velocity_loss(scene, trajectory, rtol)


def unexplained_velocity_loss(scene: Scene, trajectory: Trajectory, rtol: float) -> str:
    """Return a sliding contact that loses velocity at a time without an impact, or an empty string."""
    model, data = scene.model, scene.model.createData()
    struck = {impact.time for impact in trajectory.impacts}
    t, v = trajectory.t, trajectory.v
    for k in np.flatnonzero((t[1:] == t[:-1]) & (v[1:] != v[:-1]).any(axis=1)):
        began = [m for m in trajectory.modes if m.start == t[k]]
        crossed = any(one.start <= t[k] <= one.end for one in trajectory.stepped)
        twice = np.count_nonzero(t == t[k]) > 2  # modes of zero duration are not recorded
        if (
            crossed
            or twice
            or t[k] in struck
            or any(all(m.end != t[k] or m.source != b.source for m in trajectory.modes) for b in began)
        ):
            continue
        slips = {m.source for m in trajectory.modes if m.mode == "slip" and m.start < t[k] <= m.end}
        pin.computeJointJacobians(model, data, trajectory.q[k])
        start = max(np.searchsorted(t, t[k]) - 1, 0)  # start of the previous step, where its error may arise
        tolerance = 1e-2 * rtol + rtol * np.abs(v[start : k + 1]).max()  # of each velocity in the step
        for contact in scene.contacts:
            if contact.label in slips:
                jacobian = pin.getFrameJacobian(
                    model, data, model.getFrameId(contact.frame), pin.LOCAL_WORLD_ALIGNED
                )[:3]
                error = 30.0 * tolerance * np.linalg.norm(np.abs(jacobian).sum(axis=1))  # of thirty steps
                before, change = np.linalg.norm(jacobian @ v[k]), np.linalg.norm(jacobian @ (v[k + 1] - v[k]))
                if before > error and change > error:
                    return f"{contact.label} at {t[k]:.9g} s loses {change:.3g} of {before:.3g} m/s, unstruck"
    return ""
