"""A motion as one self-contained HTML file that opens offline in any browser with WebGL."""

from __future__ import annotations

import base64
import html
import math
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ..errors import InputError
from ..robot.contact import Contact
from ..robot.matrices import contact_geometry
from ..robot.plane import Plane
from ..robot.sphere import Sphere
from ..robot.surfaces import Surface, contact_axes
from .collada import one_material_per_mesh

Array = NDArray[np.float64]

FRAMES_PER_SECOND = 60
MAX_FRAMES = 3000
"""Beyond this many frames (50 s of replay) frames are spaced wider, to keep the file small."""
ARROW_LENGTH = 0.3
"""Of the largest impulse's arrow [m]; the others are in proportion, down to their radius."""
ARROW_RADIUS = 0.006
SURFACE_MARGIN = 0.15
"""How far a surface is drawn beyond the contacts' way over it [m]."""

_PAGE = """<!DOCTYPE html>
<html lang="en">
<head><meta charset="utf-8"><title>{title}</title>
<style>body {{ margin: 0 }} #view {{ width: 100vw; height: 100vh; overflow: hidden }}</style></head>
<body>
<div id="view"></div>
<script>{viewer}</script>
<script>
const viewer = new MeshCat.Viewer(document.getElementById("view"));
const bytes = text => Uint8Array.from(atob(text), c => c.charCodeAt(0));
for (const command of [
{commands}
]) viewer.handle_command_bytearray(bytes(command));
viewer.controls.target.set({x}, {z}, -({y}));
viewer.camera.position.set({x} + {distance}, {z} + 0.5 * {distance}, -({y}) + {distance});
viewer.controls.update();
</script>
</body>
</html>
"""


def replay(
    robot: pin.RobotWrapper,
    trajectory: Any,
    path: str | Path = "replay.html",
    *,
    contacts: Sequence[Contact] = (),
    speed: float = 1.0,
) -> Path:
    """Write a trajectory as an animation to one HTML file, which needs no server and no network.

    Args:
        robot: The robot with its visual geometry.
        trajectory: The `Trajectory`: its times, `at` and its impacts are used.
        path: The file to write; its folder must exist.
        contacts: Contacts whose surfaces are drawn, as in ``scene.contacts``; their impacts also get an arrow
            along the impulse.
        speed: Seconds of motion per second of replay, > 0; 0.1 is slow motion.

    Returns:
        The path of the file.

    Raises:
        InputError: A robot without visual geometry, or a speed that is not positive.
    """
    if not speed > 0.0 or not math.isfinite(speed):
        raise InputError(f"speed: {speed!r} is not a positive number", field="speed", value=speed)
    model, visual_model = robot.model, robot.visual_model
    if visual_model is None or visual_model.ngeoms == 0:
        raise InputError(
            f"robot: {model.name!r} has no visual geometry to show; load it with its meshes",
            field="robot",
            value=model.name,
        )
    times = _frame_times(trajectory.t[0], trajectory.t[-1], speed)
    configurations = [trajectory.at(float(t))[0] for t in times]
    rate = (len(times) - 1) / (times[-1] - times[0]) * speed if len(times) > 1 else FRAMES_PER_SECOND

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # meshcat imports a retired module of pyzmq
        import meshcat
        from pinocchio.visualize import MeshcatVisualizer
    recorder = _Recorder()
    view = meshcat.Visualizer(window=recorder)
    display = MeshcatVisualizer(model, robot.collision_model, visual_model)
    display.initViewer(viewer=view)
    display.loadViewerModel()
    display.setBackgroundColor("gray")
    display.displayCollisions(False)
    display.display(configurations[0])
    names = [
        display.getViewerNodeName(shape, pin.GeometryType.VISUAL) for shape in visual_model.geometryObjects
    ]
    animation = _animation(names, *_placements(model, visual_model, configurations), rate)
    points = _contact_points(model, configurations, contacts)
    for index, surface in enumerate({contact.plane for contact in contacts if contact.plane.body is None}):
        met = np.vstack([points[contact.label] for contact in contacts if contact.plane == surface])
        _draw_surface(view[f"surfaces/{index}"], surface, met)
    drawn = [impact for impact in trajectory.impacts if impact.source in points]
    largest = max((float(np.linalg.norm(impact.solution.impulse)) for impact in drawn), default=0.0)
    for index, impact in enumerate(drawn):
        contact = next(contact for contact in contacts if contact.label == impact.source)
        geometry = contact_geometry(model, model.createData(), impact.q, contact)
        arrow = impact.solution.impulse @ geometry.axes * (ARROW_LENGTH / largest) if largest else np.zeros(3)
        if np.linalg.norm(arrow) > ARROW_RADIUS:
            _draw_arrow(view[f"impulses/{index}"], geometry.point, arrow)
            animation.append(_appearance(f"impulses/{index}", times, impact.time, rate))
    options = {"play": True, "repetitions": 1000}
    recorder.add({"type": "set_animation", "animations": animation, "options": options, "path": ""})
    path = Path(path)
    path.write_text(recorder.page(model.name, *_middle(model, configurations)), encoding="utf-8")
    return path


class _Recorder:
    """Stands where meshcat's Visualizer has its window to a server: it collects what would be sent."""

    web_url = None

    def __init__(self) -> None:
        self.commands: list[str] = []

    def send(self, command: Any) -> None:
        message = command.lower()
        if message["type"] == "set_object" and message["object"]["object"].get("format") == "dae":
            mesh = message["object"]["object"]
            mesh["data"] = one_material_per_mesh(mesh["data"])
        self.add(message)

    def add(self, message: dict[str, Any]) -> None:
        import umsgpack  # with meshcat

        self.commands.append(base64.b64encode(umsgpack.packb(message)).decode("ascii"))

    def page(self, title: str, centre: Array, size: float) -> str:
        """Return the page; the camera looks at `centre`. In the viewer's own axes y is up."""
        import meshcat

        viewer = Path(meshcat.__file__).parent / "viewer" / "dist" / "main.min.js"
        return _PAGE.format(
            title=html.escape(title),
            viewer=viewer.read_text(encoding="utf-8").replace("</script", "<\\/script"),
            commands=",\n".join(f'"{command}"' for command in self.commands),
            x=centre[0],
            y=centre[1],
            z=centre[2],
            distance=0.7 * size,
        )


def _frame_times(start: float, end: float, speed: float) -> Array:
    count = math.ceil((end - start) * FRAMES_PER_SECOND / speed) + 1
    return np.linspace(start, end, max(1, min(count, MAX_FRAMES)))


def _placements(
    model: pin.Model, visual_model: pin.GeometryModel, configurations: list[Array]
) -> tuple[Array, Array]:
    """Return positions (frames, shapes, 3) and unit quaternions x, y, z, w (frames, shapes, 4)."""
    data, visual_data = model.createData(), visual_model.createData()
    positions = np.empty((len(configurations), visual_model.ngeoms, 3))
    quaternions = np.empty((len(configurations), visual_model.ngeoms, 4))
    for frame, q in enumerate(configurations):
        pin.updateGeometryPlacements(model, data, visual_model, visual_data, q)
        for shape, placement in enumerate(visual_data.oMg):
            positions[frame, shape] = placement.translation
            quaternions[frame, shape] = pin.Quaternion(placement.rotation).coeffs()
    for frame in range(1, len(configurations)):  # a quaternion and its negative turn alike: take the nearer
        away = np.sum(quaternions[frame] * quaternions[frame - 1], axis=1) < 0.0
        quaternions[frame, away] *= -1.0
    return positions, quaternions


def _animation(names: list[str], positions: Array, quaternions: Array, rate: float) -> list[dict[str, Any]]:
    """Return meshcat's animation clips: one for each shape that moves at all."""
    kinds = (("position", "vector3", positions), ("quaternion", "quaternion", quaternions))
    clips = []
    for shape, name in enumerate(names):
        tracks = [
            _track(kind, jstype, values[:, shape].tolist())
            for kind, jstype, values in kinds
            if np.ptp(values[:, shape], axis=0).any()
        ]
        if tracks:
            clips.append(_clip(name, rate, tracks))
    return clips


def _appearance(name: str, times: Array, moment: float, rate: float) -> dict[str, Any]:
    """Return a clip that hides an object until a moment."""
    shown = times >= moment
    first = int(np.argmax(shown)) if shown.any() else len(times) - 1
    last = len(times) - 1  # a clip that ended before the others would start over before them
    keys = [{"time": f, "value": f >= first} for f in sorted({0, first, last})]
    return _clip(name, rate, [{"name": ".visible", "type": "boolean", "keys": keys}])


def _clip(name: str, rate: float, tracks: list[dict[str, Any]]) -> dict[str, Any]:
    clip = {"fps": rate, "name": "default", "tracks": tracks}
    return {"path": f"/meshcat/{name}", "clip": clip}


def _track(name: str, jstype: str, values: list[list[float]]) -> dict[str, Any]:
    keys = [{"time": frame, "value": value} for frame, value in enumerate(values)]
    return {"name": f".{name}", "type": jstype, "keys": keys}


def _contact_points(
    model: pin.Model, configurations: list[Array], contacts: Sequence[Contact]
) -> dict[str, Array]:
    """Return where each contact's point goes, (m, 3) in world axes, at some fifty of the configurations."""
    data = model.createData()
    few = configurations[:: max(1, len(configurations) // 50)]
    return {
        contact.label: np.array([contact_geometry(model, data, q, contact).point for q in few])
        for contact in contacts
    }


def _middle(model: pin.Model, configurations: list[Array]) -> tuple[Array, float]:
    """Return the centre and the size of the box that the joints stay in."""
    data = model.createData()
    few = configurations[:: max(1, len(configurations) // 20)]
    positions = []
    for q in few:
        pin.framesForwardKinematics(model, data, q)
        positions += [placement.translation for placement in data.oMf]
    low, high = np.min(positions, axis=0), np.max(positions, axis=0)
    return 0.5 * (low + high), max(0.5, float(np.linalg.norm(high - low)))


def _draw_surface(node: Any, surface: Surface, points: Array) -> None:
    """Draw a surface where the contact points (m, 3) come over it."""
    import meshcat.geometry as shapes

    shape, placement = _SOLIDS[type(surface)](surface, points)
    node.set_object(shape, shapes.MeshLambertMaterial(color=0xB08D57, opacity=0.75, transparent=True))
    node.set_transform(placement)


def _plate(plane: Plane, points: Array) -> tuple[Any, Array]:
    """Return the part of a plane that the points come over, as a thin plate with a margin; its placement."""
    import meshcat.geometry as shapes

    axes = contact_axes(plane.normal)
    local = (points - np.asarray(plane.point)) @ axes.T
    low, high = local.min(axis=0) - SURFACE_MARGIN, local.max(axis=0) + SURFACE_MARGIN
    thickness = 0.02
    centre = np.array([*(0.5 * (low + high))[:2], -0.5 * thickness])
    placement = np.eye(4)
    placement[:3, :3] = axes.T
    placement[:3, 3] = np.asarray(plane.point) + centre @ axes
    return shapes.Box([high[0] - low[0], high[1] - low[1], thickness]), placement


def _ball(sphere: Sphere, _: Array) -> tuple[Any, Array]:
    """Return a whole sphere, and its placement."""
    import meshcat.geometry as shapes

    placement = np.eye(4)
    placement[:3, 3] = sphere.center
    return shapes.Sphere(sphere.radius), placement


_SOLIDS: dict[type[Surface], Callable[[Any, Array], tuple[Any, Array]]] = {Plane: _plate, Sphere: _ball}
"""What each kind of surface is drawn as: (surface, points) -> shape, placement."""


def _draw_arrow(node: Any, tail: Array, arrow: Array) -> None:
    """Draw an arrow as a shaft and a tip; meshcat's cylinders lie along y."""
    import meshcat.geometry as shapes

    length = float(np.linalg.norm(arrow))
    placement = np.eye(4)
    placement[:3, :3] = contact_axes(arrow)[[1, 2, 0]].T
    placement[:3, 3] = tail
    red = shapes.MeshLambertMaterial(
        color=0xC0392B, transparent=True, depthTest=False
    )  # seen through the robot
    tip = min(0.4 * length, 6.0 * ARROW_RADIUS)
    parts = (
        ("shaft", shapes.Cylinder(length - tip, ARROW_RADIUS), 0.5 * (length - tip)),
        ("tip", shapes.Cylinder(tip, radiusTop=0.0, radiusBottom=2.5 * ARROW_RADIUS), length - 0.5 * tip),
    )
    node.set_transform(placement)
    for part, shape, middle in parts:
        along = np.eye(4)
        along[1, 3] = middle
        node[part].set_object(shape, red)
        node[part].set_transform(along)
