"""Scenes from scene files: robots, initial state, contacts by name, control and output."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from ..arrays import Array
from ..checks import choice, near_matches
from ..errors import InputError, UnknownNameError
from ..geometry.surfaces import Surface
from ..robot.contact import Contact
from ..robot.loading import load_robot
from ..robot.merging import Placed, assemble
from ..robot.names import free_base, joint_id
from ..scene.controls import JointPD
from ..scene.scene import Scene, numbered
from ..scene.simulation import SCHEMES, simulate
from ..scene.switched_off import altered_model
from ..scene.trajectory import Trajectory
from .scene_file import (
    ContactTable,
    ControlTable,
    RobotTable,
    SceneFile,
    StartTable,
    bundled_scenes,
    read_scene_file,
)
from .units import quantity


class JointControl:
    """The control of ``[control]``: control(t, q, v) -> (nv,) generalized forces [N, N m].

    `start` (nq,) is the reference configuration of the stiffness.
    """

    def __init__(self, table: ControlTable, model: pin.Model, start: Array) -> None:
        self._table = table
        self._model = model
        self._data = model.createData() if table.cancel_gravity else None
        self._start = start
        self._driven = np.ones(model.nv)
        for joint in range(1, model.njoints):
            if model.nvs[joint] == 6:
                self._driven[model.idx_vs[joint] : model.idx_vs[joint] + 6] = 0.0

    def __call__(self, t: float, q: Array, v: Array) -> Array:
        """Return the forces at a state; they do not depend on time."""
        table, model = self._table, self._model
        force = -table.stiffness * pin.difference(model, self._start, q) - table.damping * v
        if table.cancel_gravity:
            force += pin.nonLinearEffects(model, self._data, q, v)
        return self._driven * force


@dataclass(frozen=True, eq=False)
class LoadedScene:
    """A scene file that is ready to run."""

    file: SceneFile
    robot: pin.RobotWrapper  # the robot, or all of them in one
    scene: Scene
    q: Array  # (nq,) initial configuration
    v: Array  # (nv,) initial velocity

    def run(self, progress: Any = None) -> Trajectory:
        """Simulate the scene for its duration; errors as in `simulate`."""
        file = self.file
        return simulate(self.scene, self.q, self.v, file.duration, progress=progress, **file.options)

    def write(self, trajectory: Trajectory, folder: Path) -> Iterator[tuple[str, Path]]:
        """Write the files of ``[output]``, and yield a description and the path of each."""
        from ..visual.html_replay import replay
        from ..visual.plots import energy_figure, forces_figure, impact_figure, save_figure

        trajectory.save(folder / "trajectory.npz")
        yield "Trajectory", folder / "trajectory.npz"
        output = self.file.output
        if output.plots:
            yield "Energy", save_figure(energy_figure(trajectory, self.file.title), folder / "energy.png")
            contacts = [contact.label for contact in self.scene.contacts]
            touching = {interval.source for interval in trajectory.modes}
            shown = [contact for contact in contacts if contact in touching]
            if shown:
                figure = forces_figure(trajectory, shown, self.file.title)
                yield "Forces", save_figure(figure, folder / "forces.png")
            impacts = [impact for impact in trajectory.impacts if impact.source in contacts]
            if impacts:
                largest = max(impacts, key=lambda impact: float(impact.solution.impulse[2]))
                title = f"{largest.source}, t = {largest.time:.4f} s: the largest impulse"
                figure = impact_figure(largest.problem, largest.solution, title)
                yield "Impact plot", save_figure(figure, folder / "impact.png")
        if output.replay:
            page = folder / "replay.html"
            speed = output.replay_speed
            yield "Replay", Path(replay(self.robot, trajectory, page, speed=speed))


def load_scene(path: str | Path, control: Mapping[str, Any] | None = None) -> LoadedScene:
    """Read a scene file, or the bundled scene of that name; paths in it are relative to the file.

    Args:
        path: Path or name.
        control: As in `read_scene_file`.

    Raises:
        InputError, UnknownNameError: An invalid value or name; the message names the key.
        ModelError: A robot that cannot be used.
    """
    path = bundled_scenes().get(str(path), Path(path))
    file = read_scene_file(path, control)
    choice("scheme", file.scheme, SCHEMES, "a scheme")
    robot, bases = _robots(file, path.parent)
    model = robot.model
    q, v = _start(file.start, robot, bases)
    contacts, linked = _contacts(file)
    scene = Scene(
        robot,
        [contact for held, contact in contacts if not held],
        **_control(file.control, altered_model(model, file.without), q),
        held=[contact for held, contact in contacts if held],
        locked=file.locked,
        limit_restitution=file.limit_restitution,
        resting_speed=file.resting_speed,
        simultaneous=file.simultaneous,
        record=file.output.plots,
        without=file.without,
    )
    for key, surface, links, coefficients in linked:
        with _at(key):
            scene = scene.contacts_from_geometry(surface, links, **coefficients)
    return LoadedScene(file, robot, scene, q, v)


def _control(table: ControlTable | None, model: pin.Model, start: Array) -> dict[str, Any]:
    """Return the arguments of a scene for its control."""
    if table is None:
        return {}
    if table.delay > 0.0 and table.period is None:
        raise InputError(
            "control.delay: only a sampled control has a delay; set control.period too, or remove the delay",
            value=table.delay,
        )
    return {"control": _law(table, model, start), "period": table.period, "delay": table.delay}


def _law(table: ControlTable, model: pin.Model, start: Array) -> JointPD | JointControl:
    """Return the control: a `JointPD` if possible."""
    limited = table.largest_effort is not None
    if limited and table.cancel_gravity:
        raise InputError(
            f"control.largest_effort: {table.largest_effort:g} given, which cancel_gravity does not support; "
            "remove one of the two",
            value=table.largest_effort,
        )
    drives = JointPD(table.stiffness, table.damping, start, table.largest_effort)
    plain = all(nq == nv == 1 for nq, nv in zip(model.nqs, model.nvs, strict=True) if nv not in (0, 6))
    if limited or (plain and not table.cancel_gravity):
        drives.drives(model)  # raises an error for a joint that it cannot drive
        return drives
    return JointControl(table, model, start)


class _Base(NamedTuple):
    """A free base, with the places of its coordinates in q and v."""

    key: str
    table: RobotTable
    in_q: int
    in_v: int


def _robots(file: SceneFile, folder: Path) -> tuple[pin.RobotWrapper, list[_Base]]:
    """Return all robots as one, and their free bases."""
    parts: list[Placed] = []
    bases = []
    for index, table in enumerate(file.robot):
        key = f"robot[{index}]"
        if (table.name is None) == (table.urdf is None):
            raise InputError(f"{key}: give either name = ... or urdf = ...", value=table.name)
        source = table.name if table.name is not None else folder / str(table.urdf)
        robot = load_robot(source, table.free_flyer)
        if file.gravity is not None:
            robot.model.gravity.linear = np.array(file.gravity)
        rotation = pin.rpy.rpyToMatrix(*(table.rpy or (0.0, 0.0, 0.0)))
        pose = pin.SE3(rotation, np.array(table.position or (0.0, 0.0, 0.0)))
        if free_base(robot.model):
            if table.position or table.rpy:
                robot.q0[:7] = pin.SE3ToXYZQUAT(pose)
            pose = pin.SE3.Identity()
            places = (sum(getattr(part.robot.model, size) for part in parts) for size in ("nq", "nv"))
            bases.append(_Base(key, table, *places))
        elif any((*table.velocity, *table.angular_velocity)):
            raise InputError(
                f"{key}.velocity: the base of {source} is fixed; set free_flyer = true, or remove "
                "the velocity",
                value=table.velocity,
            )
        parts.append(Placed(robot, table.prefix, pose))
    return assemble(parts), bases


def _start(start: StartTable, robot: pin.RobotWrapper, bases: Sequence[_Base]) -> tuple[Array, Array]:
    model = robot.model
    q = np.array(robot.q0 if start.q is None else start.q, dtype=float)
    v = np.array(np.zeros(model.nv) if start.v is None else start.v, dtype=float)
    for key, vector, size in (("start.q", q, model.nq), ("start.v", v, model.nv)):
        if vector.shape != (size,):
            raise InputError(f"{key}: {len(vector)} numbers given, {size} expected", value=vector)
    for key, table, in_q, in_v in bases:
        speeds = *table.velocity, *table.angular_velocity
        for other, given in (("q", table.position or table.rpy), ("v", any(speeds))):
            if given and getattr(start, other) is not None:
                what = "velocity" if other == "v" else "position or rpy"
                raise InputError(
                    f"start.{other}: given beside the {what} of {key}, which it would replace; remove one",
                    value=getattr(start, other),
                )
        if start.v is None:
            inverse = pin.XYZQUATToSE3(q[in_q : in_q + 7]).rotation.T
            v[in_v : in_v + 6] = [*(inverse @ table.velocity), *(inverse @ table.angular_velocity)]
    for name, value in start.joints.items():
        joint, prismatic = _single_joint(model, "start.joints", name)
        number = _quantity(f"start.joints.{name}", value, "length" if prismatic else "angle")
        at = model.idx_qs[joint]
        q[at : at + model.nqs[joint]] = number if model.nqs[joint] == 1 else (np.cos(number), np.sin(number))
    for name, value in start.speeds.items():
        joint, prismatic = _single_joint(model, "start.speeds", name)
        number = _quantity(f"start.speeds.{name}", value, "speed" if prismatic else "angular speed")
        v[model.idx_vs[joint]] = number
    return q, v


def _single_joint(model: pin.Model, key: str, name: str) -> tuple[int, bool]:
    """Return the id of a joint with one degree of freedom, and whether it is prismatic."""
    joint = joint_id(model, name, key)
    if model.nvs[joint] != 1:
        raise InputError(
            f"{key}: {name} has {model.nvs[joint]} degrees of freedom; set them with start.q and start.v, "
            "or those of a free base in its [[robot]] table",
            value=name,
        )
    return joint, model.joints[joint].shortname().startswith("JointModelP")


def _quantity(key: str, value: float | str, kind: str) -> float:
    try:
        return quantity(value, kind)
    except ValueError as error:
        raise InputError(f"{key}: {error}", value=value) from None


_Linked = tuple[str, Surface, str | Sequence[str], dict[str, Any]]
"""Key in the file, surface, links whose shapes make contact with it, and arguments of the contacts."""


def _contacts(file: SceneFile) -> tuple[list[tuple[bool, Contact]], list[_Linked]]:
    """Return pairs of whether a contact is held and the contact, and the contacts of links.

    The default name of a contact is "frame on surface", with the names in the file.
    """
    tables = file.contact
    for index, table in enumerate(tables):
        if table in tables[:index]:
            raise InputError(
                f"contact[{index}]: the same as contact[{tables.index(table)}]; remove one", value=table.frame
            )
    labels = [table.name or f"{table.geometry or table.frame} on {table.plane}" for table in tables]
    labels = numbered(labels, [not table.name for table in tables])
    contacts: list[tuple[bool, Contact]] = []
    linked: list[_Linked] = []
    for index, (table, label) in enumerate(zip(tables, labels, strict=True)):
        key = f"contact[{index}]"
        given = [name for name in ("frame", "geometry", "links") if getattr(table, name) is not None]
        if len(given) != 1:
            what = " and ".join(given) or "none"
            raise InputError(f"{key}: {what} given; give one of frame, geometry and links", value=given)
        if given != ["frame"]:
            _check_shape_table(key, table)
        surface = _surface(key, table.plane, file)
        keys = {name for name in table.model_fields_set if getattr(table, name) is not None}
        values = table.model_dump(include=keys - {"plane", "held", "name", "links"})
        if given == ["links"]:
            linked.append((key, surface, table.links or (), values))
            continue
        name = table.name if given == ["geometry"] else label
        with _at(key):
            contacts.append((table.held, Contact(plane=surface, name=name, **values)))
    return contacts, linked


def _check_shape_table(key: str, table: ContactTable) -> None:
    """Raise an error for keys that do not apply to a collision shape."""
    for name in ("held", "offset", "radius", *(("name",) if table.links is not None else ())):
        if name in table.model_fields_set:
            raise InputError(
                f"{key}.{name}: applies to a frame, not to a geometry or links; remove it",
                value=getattr(table, name),
            )


def _surface(key: str, name: str, file: SceneFile) -> Surface:
    """Return a surface by its name in the file."""
    kinds = [kind for kind, tables in file.surfaces.items() if name in tables]
    if len(kinds) != 1:
        known = [known for tables in file.surfaces.values() for known in tables]
        wanted = " or ".join(f"[{kind}.{name}]" for kind in file.surfaces)
        what = f"no {wanted} in the file; {near_matches(name, known)}"
        if kinds:
            what = f"{name!r} is both a {' and a '.join(kinds)}; give each its own name"
        raise UnknownNameError(f"{key}.plane: {what}", value=name)
    surface = file.surfaces[kinds[0]][name]
    with _at(key):
        values: dict[str, Any] = {"name": name, **surface.model_dump()}
        return surface.kind(**values)


@contextmanager
def _at(key: str) -> Iterator[None]:
    """Add the key in the file to an error."""
    try:
        yield
    except (InputError, UnknownNameError) as error:
        raise type(error)(f"{key}: {error}", field=f"{key}.{error.field}", value=error.value) from None
