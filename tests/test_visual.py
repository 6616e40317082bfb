"""Replays and pictures: what is in the files, and that they need nothing else."""

from __future__ import annotations

import base64
import re
import shutil
import subprocess
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
from matplotlib.image import imread

import pinimpact
from pinimpact.visual.collada import NAMESPACE, one_material_per_mesh
from pinimpact.visual.plots import draw_hodograph, impact_figure, save_figure

umsgpack = pytest.importorskip("umsgpack")


class Fall:
    """A rod that falls, and turns from free to struck at half time."""

    def __init__(self, robot) -> None:
        self.model = robot.model
        self.t = np.array([0.0, 0.5, 0.5, 1.0])
        self.v = np.array([0.2, 0.0, -0.5, 0.3, 0.4])
        self.start = np.array([0.0, 0.0, 1.2, 0.0, 0.5])
        hit = SimpleNamespace(
            time=0.5,
            source="tip",
            q=self.at(0.5)[0],
            solution=SimpleNamespace(impulse=np.array([0.1, 0.2, 1.0])),
        )
        self.impacts = (hit,)

    def at(self, t, side="right"):
        return pin.integrate(self.model, self.start, self.v * t), self.v


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    robot = pinimpact.load_robot("rod")
    contact = pinimpact.Contact("tip", pinimpact.Plane(), name="tip")
    path = tmp_path_factory.mktemp("replay") / "replay.html"
    assert pinimpact.replay(robot, Fall(robot), path, contacts=[contact], speed=0.5) == path
    return robot, path


def commands(path: Path) -> list[dict]:
    lines = re.findall(r'^"([A-Za-z0-9+/=]+)",?$', path.read_text(encoding="utf-8"), flags=re.MULTILINE)
    return [umsgpack.unpackb(base64.b64decode(line)) for line in lines]


def test_the_page_loads_nothing(page) -> None:
    text = page[1].read_text(encoding="utf-8")
    assert not re.search(r"<(script|link|img|iframe)[^>]*(src|href)=", text)
    assert "MeshCat.Viewer" in text
    assert text.count("<script>") == text.count("</script>") == 2


def test_the_animation_is_the_motion(page) -> None:
    robot, path = page
    (animation,) = [command for command in commands(path) if command["type"] == "set_animation"]
    clips = {clip["path"]: clip["clip"] for clip in animation["animations"]}
    shape = robot.visual_model.geometryObjects[0]
    (clip,) = [clip for name, clip in clips.items() if name.endswith(shape.name)]
    tracks = {track["name"]: track["keys"] for track in clip["tracks"]}
    assert len(tracks[".position"]) == 121  # one second at half speed and 60 frames a second
    fall = Fall(robot)
    data, shown = robot.model.createData(), robot.visual_model.createData()
    for frame in (0, 30, 120):
        q, _ = fall.at(frame / 120)
        pin.updateGeometryPlacements(robot.model, data, robot.visual_model, shown, q)
        np.testing.assert_allclose(tracks[".position"][frame]["value"], shown.oMg[0].translation, atol=1e-12)
        turned = pin.Quaternion(np.array(tracks[".quaternion"][frame]["value"])).matrix()
        np.testing.assert_allclose(turned, shown.oMg[0].rotation, atol=1e-12)
    (arrow,) = [clip for name, clip in clips.items() if "impulses" in name]
    keys = arrow["tracks"][0]["keys"]
    assert [(key["time"], key["value"]) for key in keys] == [(0, False), (60, True), (120, True)]


def test_the_arrow_lies_along_the_impulse(page) -> None:
    robot, path = page
    (placed,) = [
        command
        for command in commands(path)
        if command["type"] == "set_transform" and command["path"].endswith("impulses/0")
    ]
    matrix = np.array(placed["matrix"]).reshape(4, 4).T
    impulse = np.array([0.1, 0.2, 1.0])
    np.testing.assert_allclose(matrix[:3, 1], impulse / np.linalg.norm(impulse), atol=1e-12)
    np.testing.assert_allclose(matrix[:3, :3].T @ matrix[:3, :3], np.eye(3), atol=1e-12)
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, Fall(robot).at(0.5)[0])
    tip = data.oMf[robot.model.getFrameId("tip")].translation
    np.testing.assert_allclose(matrix[:3, 3], tip, atol=1e-12)


def test_surfaces_are_drawn_where_they_are(tmp_path: Path) -> None:
    robot = pinimpact.load_robot("rod")
    surfaces = (pinimpact.Sphere((1, 2, 3), 0.4), pinimpact.Plane((0, 0, 0.1), (0, 1, 0)))
    contacts = [pinimpact.Contact("tip", surface) for surface in surfaces]
    path = pinimpact.replay(robot, Fall(robot), tmp_path / "x.html", contacts=contacts)
    sent = [command for command in commands(path) if "surfaces/" in command["path"]]
    shapes = {
        command["path"]: command["object"]["geometries"][0]
        for command in sent
        if command["type"] == "set_object"
    }
    placed = {
        command["path"]: np.array(command["matrix"]).reshape(4, 4).T
        for command in sent
        if command["type"] == "set_transform"
    }
    assert len(shapes) == len(placed) == 2
    (ball,) = [path for path, shape in shapes.items() if shape["type"] == "SphereGeometry"]
    (plate,) = [path for path, shape in shapes.items() if shape["type"] == "BoxGeometry"]
    assert shapes[ball]["radius"] == 0.4
    np.testing.assert_allclose(placed[ball][:3, 3], (1, 2, 3))
    np.testing.assert_allclose(placed[plate][:3, 2], (0, 1, 0), atol=1e-15)
    tip = pinimpact.Contact("tip", surfaces[1])
    data = robot.model.createData()
    for t in (0.0, 0.5, 1.0):  # the plate lies under all of the tip's way
        q = Fall(robot).at(t)[0]
        gap = tip.gap(robot.model, data, q)
        pin.framesForwardKinematics(robot.model, data, q)
        foot = data.oMf[robot.model.getFrameId("tip")].translation - gap * np.array((0, 1, 0))
        local = np.linalg.solve(placed[plate], [*foot, 1.0])[:3]
        assert (
            np.abs(local) <= 0.5 * np.array([shapes[plate][k] for k in ("width", "height", "depth")])
        ).all()


@pytest.mark.skipif(shutil.which("chromium") is None, reason="there is no chromium to look at the page with")
def test_a_browser_shows_it(page, tmp_path: Path) -> None:
    picture = tmp_path / "page.png"
    options = (
        "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking"
    )
    options += (
        " --disable-component-update --disable-sync --use-angle=swiftshader --enable-unsafe-swiftshader"
    )
    command = [
        "chromium",
        *options.split(),
        f"--user-data-dir={tmp_path / 'profile'}",
        "--window-size=400,300",
    ]
    command += ["--virtual-time-budget=3000", f"--screenshot={picture}", f"file://{page[1]}"]
    subprocess.run(command, check=True, capture_output=True, timeout=120)
    pixels = imread(picture)[..., :3]
    blue_rod = (pixels[..., 2] > pixels[..., 0] + 0.2) & (pixels[..., 2] > 0.3)
    brown_floor = pixels[..., 0] > pixels[..., 2] + 0.15
    assert blue_rod.sum() > 100
    assert brown_floor.sum() > 1000


def test_replay_refuses(page, tmp_path: Path) -> None:
    robot = page[0]
    with pytest.raises(pinimpact.InputError, match=r"speed: 0\.0"):
        pinimpact.replay(robot, Fall(robot), tmp_path / "x.html", speed=0.0)
    bare = pin.RobotWrapper(robot.model, pin.GeometryModel(), pin.GeometryModel())
    with pytest.raises(pinimpact.InputError, match="visual geometry"):
        pinimpact.replay(bare, Fall(robot), tmp_path / "x.html")


DAE = f"""<COLLADA xmlns="{NAMESPACE}"><library_geometries><geometry id="g"><mesh><source id="s"/>
<triangles material="a" count="1"/><polylist material="b" count="2"/></mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene><node><instance_geometry url="#g"><bind_material><technique_common>
<instance_material symbol="a" target="#A"/><instance_material symbol="b" target="#B"/>
</technique_common></bind_material></instance_geometry></node></visual_scene></library_visual_scenes></COLLADA>"""


def test_meshes_are_split_by_material() -> None:
    root = ElementTree.fromstring(one_material_per_mesh(DAE))
    tag = f"{{{NAMESPACE}}}"
    pieces = {g.get("id"): [part.get("material") for part in g[0] if part.get("material")] for g in root[0]}
    assert sorted(pieces.values()) == [["a"], ["b"]]
    instances = list(root.iter(f"{tag}instance_geometry"))
    assert len(instances) == 2
    for instance in instances:
        bound = [binding.get("symbol") for binding in instance.iter(f"{tag}instance_material")]
        assert bound == pieces[instance.get("url").lstrip("#")]


def test_the_picture_of_an_impact(tmp_path: Path) -> None:
    problem = pinimpact.ImpactProblem(np.diag([2.0, 3.5, 1.0]), (0.5, 0.5, -1.0), 0.5, 0.5)
    solution = pinimpact.solve_impact(problem, record=True)
    figure = impact_figure(problem, solution, "title")
    hodograph = figure.axes[0]
    drawn = np.vstack(
        [line.get_xydata() for line in hodograph.lines if line.get_label() in ("compression", "restitution")]
    )
    v1, v2 = drawn.T
    np.testing.assert_allclose(v2, 0.5 * (np.maximum(v1, 0.0) / 0.5) ** 1.75, atol=1e-9)  # closed form (32)
    assert "stick" in [line.get_label() for line in hodograph.lines]
    pixels = imread(save_figure(figure, tmp_path / "impact.png"))
    assert min(pixels.shape[:2]) > 500
    assert pixels.std() > 0.05


def test_no_picture_without_a_path() -> None:
    problem = pinimpact.ImpactProblem(np.eye(3), (0.5, 0.5, -1.0), 0.5, 0.5)
    with pytest.raises(pinimpact.InputError, match="record=True"):
        draw_hodograph(None, problem, pinimpact.solve_impact(problem))
