"""Replays: a motion, or one impact, as one HTML file that opens offline."""

from __future__ import annotations

import html
import math
import os
import webbrowser
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ..arrays import Array
from ..checks import above_zero, as_tuple, finite_array, in_short, output_file, real_number
from ..errors import InputError
from ..geometry.collision_shapes import extreme_points
from ..geometry.plane import Plane
from ..geometry.surfaces import Surface
from ..robot.contact import Contact
from ..robot.forest import data_of
from ..robot.many_impact import ManyHit
from ..robot.matrices import contact_geometry
from ..robot.names import frame_id, model_of
from ..robot.robot_impact import Hit
from ..robot.solids import Shape
from ..scene.joint_charts import joint_table
from ..scene.records import ImpactRecord, by_impact
from ..scene.trajectory import Trajectory
from .film import FRAMES_PER_SECOND, frame_times, slowed, turning_times, width_of_slowness
from .impact_marks import ImpactMark, impact_mark
from .page_file import Recorder, packed, page
from .robot_shapes import (
    grid_square,
    joint_poses,
    joints_as_data,
    outline,
    send_background,
    send_meshes,
    skeleton,
    turning_speeds,
)
from .shapes_in_contact import bodies_of, contacts_to_draw, lit_shapes
from .smooth_path import parts_at
from .surface_shapes import surface_as_data
from .video import write_video

HOLD = 1.5
"""Duration of the pause within an impact [s]."""
HOLD_WITHIN = 8.0
"""Duration of the replay of one impact [s]."""
WITHIN = {"speed": 1.0, "slowdown": 2.0, "hold": HOLD_WITHIN, "width": 1.0, "within": True}
"""Settings of the player for one impact."""
LISTED = 3
"""Maximum number of names that are listed for an impact at several contacts."""
LEVEL, NEAR = 0.99, 0.1
"""Minimum vertical component of the normal of a floor, and its maximum height above the lowest point relative
to the size of the scene."""
CLOUD_FRAMES = 240
"""Maximum number of frames of a translucent motion, to limit the file size."""
LONGEST_IMPULSE, LONGEST_VELOCITY, LONGEST_FORCE = 0.28, 0.22, 0.4
"""Lengths of the longest arrows, relative to the size of the scene."""


class Replay(os.PathLike[str]):
    """A replay, with its file and its display in notebooks.

    Attributes:
        path: The file, or None.
        html: The HTML text.
    """

    def __init__(self, text: str, path: Path | None) -> None:
        self.html = text
        self.path = path

    def save(self, path: str | Path) -> Path:
        """Write the page to a file and return its path."""
        self.path = output_file("path", path)
        self.path.write_text(self.html, encoding="utf-8")
        return self.path

    def open(self) -> None:
        """Open the file in the browser of this machine.

        Raises:
            InputError: A replay without a file.
        """
        webbrowser.open(Path(self).absolute().as_uri())

    def video(self, path: str | Path, *, rate: float = 25.0, size: tuple[int, int] = (960, 540)) -> Path:
        """Write the replay as a video; see `pinimpact.visual.video.write_video`."""
        return write_video(self.html, path, rate=rate, size=size)

    def _repr_html_(self) -> str:
        return (
            f'<iframe srcdoc="{html.escape(self.html)}" width="100%" height="560" style="border: 0" '
            'allow="fullscreen"></iframe>'
        )

    def __fspath__(self) -> str:
        if self.path is None:
            raise InputError("path: the replay has no file; write it by save()")
        return str(self.path)

    def __repr__(self) -> str:
        return f"Replay({'not written' if self.path is None else str(self.path)!r})"

    def __str__(self) -> str:
        return repr(self) if self.path is None else str(self.path)


def replay(
    robot: pin.RobotWrapper | pin.Model | Hit | ManyHit,
    motion: Trajectory | Hit | ManyHit | ImpactRecord | None = None,
    path: str | Path | None = "replay.html",
    *,
    contacts: Sequence[Contact] | None = None,
    q: ArrayLike | None = None,
    speed: float = 1.0,
    slowdown: float = 20.0,
    open: bool = False,
) -> Replay:
    """Write a motion or an impact to one HTML file that opens in any browser, offline.

    The page shows the robot, the surfaces, the paths of the contact points, and the forces of sustained
    contact; collision shapes in contact are highlighted. At an impact the replay slows down and pauses while
    the impulse grows: arrows show the impulse, the contact velocity before and after, and the friction cone.
    The keys n and p, and the marks on the bar, select impacts; the speed and the slowdown can be changed in
    the page.

    ``replay(robot, hit, q=q)`` shows one impact over its normal impulse P₃, with the path of the sliding
    velocity beside the robot, which does not move; ``replay(hit)`` does so without a robot. In a notebook the
    result displays itself.

    Args:
        robot: The robot with its visual geometry; without it, or as a bare model, it is drawn in lines.
        motion: A `Trajectory`, a `Hit`, a `ManyHit`, or an impact of a trajectory.
        path: The file to write, in a folder that exists; None for none.
        contacts: Contacts to draw, with surfaces, paths, forces and impacts; by default those of the
            trajectory. An impact of a trajectory needs those of its scene; a hit has its own.
        q: (nq,) the configuration of a hit.
        speed: Seconds of motion per second of replay, > 0, away from impacts.
        slowdown: Factor ≥ 1 by which it is slower at an impact; with 1 it does not pause either.
        open: Whether to open the page in the browser.

    Raises:
        InputError: A robot other than that of the motion, a speed that is not positive, contacts that are not
            `Contact` objects, a hit without configuration.
        UnknownNameError: A contact at a frame that the robot does not have.
    """
    if isinstance(robot, (Hit, ManyHit)):
        robot, motion = None, robot
    speed = above_zero("speed", speed)
    if path is not None:
        output_file("path", path)  # before anything is computed
    slowdown = real_number("slowdown", slowdown)
    if not math.isfinite(slowdown) or slowdown < 1.0:
        raise InputError(f"slowdown: {slowdown} given, a number of at least 1 expected", value=slowdown)
    if contacts is not None:
        contacts = as_tuple("contacts", contacts, Contact, "a Contact")
        if not all(isinstance(contact, Contact) for contact in contacts):
            raise InputError(f"contacts: {in_short(contacts)} given, Contacts expected", value=contacts)
    if isinstance(motion, (Hit, ManyHit, ImpactRecord)):
        text = _impact_page(robot, motion, contacts, q)
    elif isinstance(motion, Trajectory):
        text = _motion_page(robot, motion, contacts, speed, slowdown)
    else:
        raise InputError(f"motion: {in_short(motion)} is neither a trajectory nor an impact", value=motion)
    shown = Replay(text, None)
    if path is not None:
        shown.save(path)
    if open:
        shown.open()
    return shown


def cloud_replay(
    robot: Any, trajectory: Trajectory, others: Sequence[Trajectory], path: str | Path | None
) -> Replay:
    """Return the replay of a motion among others of the same robot, which are translucent; see `replay`."""
    if path is not None:
        output_file("path", path)
    shown = Replay(_motion_page(robot, trajectory, None, 1.0, 20.0, others), None)
    if path is not None:
        shown.save(path)
    return shown


def _motion_page(
    robot: Any,
    trajectory: Trajectory,
    given: Sequence[Contact] | None,
    speed: float,
    slowdown: float,
    others: Sequence[Trajectory] = (),
) -> str:
    model = model_of(robot)
    _check_robot(model, trajectory)
    every = _contacts(model, trajectory.contacts if given is None else given)
    paired = [contact for contact in every if contact.pair is not None]
    contacts = contacts_to_draw(trajectory, [contact for contact in every if contact.pair is None])
    together = by_impact(trajectory.impacts)
    absorbed = [-sum(float(one.solution.work.compression) for one in records) for records in together]
    slow = slowed(absorbed)
    moments = [records[0].time for records in together]
    start, end = float(trajectory.t[0]), float(trajectory.t[-1])
    width = width_of_slowness(end - start, speed, slowdown)
    slow_moments = [time for time, on in zip(moments, slow, strict=True) if on]
    times = frame_times(start, end, speed, moments, slow_moments, width)
    speeds = turning_speeds(model, trajectory.v)
    times, coarse = turning_times(times, trajectory.t, speeds)
    configurations = [trajectory.at(float(t))[0] for t in times]
    data = data_of(model)
    by_name = {contact.label: contact for contact in contacts}
    bodies = {contact.label: bodies_of(contact) for contact in every}
    marks = []
    for records, on in zip(together, slow, strict=True):
        places = {}
        for impact in records:
            contact = impact.contact or by_name.get(impact.source)
            if contact is not None:
                geometry = contact_geometry(model, data, impact.q, contact)
                places[impact.source] = (geometry.point, geometry.axes)
        first = records[0]
        source = first.source
        if first.group is not None:
            source = _counted(bodies.get(one.source, one.source) for one in records)
        parts = [(one.source, one, places.get(one.source)) for one in records]
        marks.append(impact_mark(parts, source, first.time, on))
    forces = [_forces(trajectory, contact.label, times) for contact in contacts]
    settings = {"speed": speed, "slowdown": slowdown, "hold": HOLD, "width": width, "within": False}
    settings["coarse"] = coarse
    modes = [[bodies.get(m.source, m.source), m.mode, m.start, m.end] for m in trajectory.modes]
    lit = lit_shapes(robot, trajectory, [*contacts, *paired])
    solids = dict.fromkeys(contact.pair.plane for contact in paired if contact.pair is not None)
    shown = [solid for solid in solids if not isinstance(solid, Shape)]  # the robot has those itself
    cloud = _cloud_as_data(model, others, start, end)
    return _page(
        robot, model, times, configurations, contacts, forces, marks, settings, modes, lit, shown, cloud
    )


def _cloud_as_data(
    model: pin.Model, others: Sequence[Trajectory], start: float, end: float
) -> dict[str, Any] | None:
    """Return motions from `start` to `end` [s] as data for the player, and their last configurations.

    A motion that ends earlier keeps its last configuration. Without motions the result is None.
    """
    if not others:
        return None
    count = int(np.clip(np.ceil((end - start) * FRAMES_PER_SECOND), 1, CLOUD_FRAMES)) + 1
    times = np.linspace(start, end, count)
    robots = []
    for other in others:
        poses = joint_poses(model, [other.at(min(float(t), float(other.t[-1])))[0] for t in times])
        moving = [joint for joint in range(1, model.njoints) if np.ptp(poses[:, joint], axis=0).any()]
        robots.append({str(joint): packed(poses[:, joint]) for joint in moving})
    return {"times": packed(times, np.float64), "robots": robots, "ends": [other.q[-1] for other in others]}


def _impact_page(
    robot: Any, impact: Hit | ManyHit | ImpactRecord, given: Sequence[Contact] | None, q: Any
) -> str:
    """Return the page of one impact, in which the robot, if any, does not move."""
    model, drawn = pin.Model() if robot is None else model_of(robot), []
    if robot is not None:
        q = impact.q if q is None and isinstance(impact, ImpactRecord) else q
        if q is None:
            raise InputError("q: None given; a hit does not contain the configuration of the robot, give q=")
        q = finite_array("q", q, (model.nq,))
    if isinstance(impact, ManyHit):
        names, places = [one.label for one in impact.contacts], zip(impact.points, impact.axes, strict=True)
        parts = zip(names, parts_at(impact.problem, impact.solution), places, strict=True)
        mark = impact_mark(list(parts), f"{len(names)} contacts")
        drawn = [] if robot is None else _contacts(model, impact.contacts)
    else:
        contacts = [impact.contact] if given is None and isinstance(impact, Hit) else given or ()
        source = contacts[0].label if isinstance(impact, Hit) else impact.source
        if robot is None:
            assert isinstance(impact, Hit)  # only a hit can be shown without a robot
            place = np.zeros(3), impact.axes
        else:
            drawn = [contact for contact in _contacts(model, contacts) if contact.label == source][:1]
            if not drawn:
                raise InputError(
                    f"contacts: no contact is called {source!r}; give the contacts of the scene as contacts= "
                    "(impacts of joint limits cannot be shown)",
                    value=given,
                )
            geometry = contact_geometry(model, data_of(model), q, drawn[0])
            place = geometry.point, geometry.axes
        mark = impact_mark([(source, impact, place)], source)
    still = np.zeros(0) if robot is None else q
    return _page(robot, model, np.zeros(2), [still] * 2, drawn, [None] * len(drawn), [mark], WITHIN, [])


def _scales(marks: Sequence[ImpactMark], forces: Sequence[Array | None], size: float) -> dict[str, Any]:
    """Return the lengths of arrows [m] per unit of impulse, velocity and force, and the largest of these."""
    longest = {
        "impulse": max((mark.strength for mark in marks), default=0.0),
        "velocity": max((mark.speed for mark in marks), default=0.0),
        "force": max((float(np.linalg.norm(f, axis=1).max()) for f in forces if f is not None), default=0.0),
    }
    parts = {"impulse": LONGEST_IMPULSE, "velocity": LONGEST_VELOCITY, "force": LONGEST_FORCE}
    scales = {name: parts[name] * size / value if value > 0.0 else 0.0 for name, value in longest.items()}
    return {**scales, "longest": longest}


def _tips(marks: Sequence[ImpactMark], reach: float) -> list[Array]:
    """Return points (3,) around the ends of impulse arrows of the length `reach` [m], for the view."""
    return [
        part.point + reach * (part.axes[2] + aside @ part.axes[:2])
        for mark in marks
        for part in mark.contacts
        for aside in 0.6 * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
    ]


def _page(
    robot: Any,
    model: pin.Model,
    times: Array,
    configurations: Sequence[Array],
    contacts: Sequence[Contact],
    forces: Sequence[Array | None],
    marks: Sequence[ImpactMark],
    settings: dict[str, Any],
    modes: Sequence[Sequence[Any]],
    lit: Sequence[dict[str, Any]] = (),
    solids: Sequence[Surface] = (),
    cloud: dict[str, Any] | None = None,
) -> str:
    """Return the page of a motion at times (m,) with m configurations."""
    poses = joint_poses(model, configurations)
    data = data_of(model)
    paths = np.array(
        [[contact_geometry(model, data, q, contact).point for q in configurations] for contact in contacts]
    ).reshape(len(contacts), len(times), 3)
    shapes = getattr(robot, "visual_model", None)
    points = outline(model, shapes, [*configurations, *([] if cloud is None else cloud.pop("ends"))])
    points = np.vstack(
        [points, paths.reshape(-1, 3), *(part.point for mark in marks for part in mark.contacts)]
    )
    points = extreme_points(points, "outline") if len(points) else np.zeros((1, 3))
    size = float(np.linalg.norm(np.ptp(points, axis=0))) or 1.0
    points = np.vstack([points, *_tips(marks, LONGEST_IMPULSE * size)])
    surfaces = []
    for surface in dict.fromkeys(contact.plane for contact in contacts):
        own = paths[[k for k, contact in enumerate(contacts) if contact.plane == surface]]
        surfaces.append(surface_as_data(model, surface, poses, own, size))
    surfaces += [surface_as_data(model, solid, poses, np.zeros((0, len(times), 3)), size) for solid in solids]
    recorder = Recorder()
    links: list[tuple[int, int]] = []
    spots: list[list[float]] = []
    wanted = {what["joint"] for what in (*surfaces, *lit)} - {0}
    if shapes is not None and shapes.ngeoms > 0:
        send_meshes(model, shapes, recorder)
        wanted |= {int(shape.parentJoint) for shape in shapes.geometryObjects} - {0}
    else:
        links, spots = skeleton(model)
        wanted |= set(range(1, model.njoints))
    low = float(points[:, 2].min())
    floor = any(
        isinstance(plane := contact.plane, Plane)
        and plane.body is None
        and plane.axes[2, 2] > LEVEL
        and plane.point[2] < low + NEAR * size
        for contact in contacts
    )
    grid = 0.0 if floor or not configurations[0].size else grid_square(size)
    send_background(recorder, low, grid)
    motion = {
        **settings,
        "times": packed(times, np.float64),
        **joints_as_data(poses, sorted(wanted)),
        "links": links,
        "spots": spots,
        "surfaces": surfaces,
        "lit": lit,
        "contacts": [
            {"name": contact.label, "path": packed(path), "forces": None if force is None else packed(force)}
            for contact, path, force in zip(contacts, paths, forces, strict=True)
        ],
        "modes": modes,
        "cloud": cloud,
        "impacts": [mark.as_data() for mark in marks],
        "scales": _scales(marks, forces, size),
        "view": {"points": packed(points), "size": size, "thickness": 0.006 * size, "grid": grid},
    }
    return page(model.name or "impact", recorder.commands, motion)


def _contacts(model: pin.Model, contacts: Sequence[Contact]) -> list[Contact]:
    for contact in contacts:
        frame_id(model, contact.frame)
        if contact.plane.body is not None:
            frame_id(model, contact.plane.body, "body")
    return list(contacts)


def _check_robot(model: pin.Model, trajectory: Trajectory) -> None:
    """Raise an error if a robot differs from that of the trajectory."""
    ours, theirs = (model.nq, model.nv), (trajectory.q.shape[1], trajectory.v.shape[1])
    if ours != theirs:
        what = "it has {} coordinates and {} velocities, the trajectory {} and {}".format(*ours, *theirs)
    elif not np.array_equal(joint_table(model), trajectory.joint_table):
        what = "its joints are of other kinds"
    else:
        return
    raise InputError(
        f"robot: {model.name!r} is not the robot of the trajectory: {what}; give the one that was simulated",
        value=model.name,
    )


def _forces(trajectory: Trajectory, name: str, times: Array) -> Array | None:
    """Return the forces of a contact at the frames, (frames, 3) in world axes, or None if it has none."""
    closed = [mode for mode in trajectory.modes if mode.source == name]
    if not closed:
        return None
    forces = np.zeros((len(times), 3))
    for interval in closed:
        inside = np.flatnonzero((times >= interval.start) & (times < interval.end))
        forces[inside] = trajectory.forces_world(name, times[inside]).reshape(-1, 3)
        at_end = np.flatnonzero(times == interval.end)[:1]
        forces[at_end] = trajectory.forces_world(name, times[at_end], "left").reshape(-1, 3)
    return forces


def _counted(names: Iterable[str]) -> str:
    """Return names with the number of their occurrences."""
    counts = Counter(names)
    if len(counts) > LISTED:
        return f"{sum(counts.values())} contacts"
    return " + ".join(name if n == 1 else f"{name} ({n} points)" for name, n in counts.items())
