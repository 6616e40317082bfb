"""Replays: contents of the page, its independence of other files, and its appearance in a browser."""

from __future__ import annotations

import base64
import gzip
import html
import json
import re
import shutil
import warnings
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import coal
import numpy as np
import pinocchio as pin
import pytest
from matplotlib.image import imread

import pinimpact
from pinimpact.robot.matrices import contact_geometry
from pinimpact.visual.browser import find_browser, open_page
from pinimpact.visual.collada import NAMESPACE, for_viewer
from pinimpact.visual.video import _write_gif

from .scene_models import shaped_body

umsgpack = pytest.importorskip("umsgpack")

BROWSER = find_browser()
needs_browser = pytest.mark.skipif(BROWSER is None, reason="no browser was found")

FLOOR = pinimpact.Plane()


@pytest.fixture(scope="module")
def fall():
    """Return a rod and its motion: the tip bounces on the floor and comes to rest, then the rod topples."""
    robot = pinimpact.load_robot("rod")
    tip = pinimpact.Contact("tip", FLOOR, friction=0.6, restitution=0.3, name="tip")
    scene = pinimpact.Scene(robot, [tip], without=["joint limits"])
    return robot, pinimpact.simulate(scene, [0, 0, 0.6, 0, 0.5], [0.3, 0.1, 0, 0, 0], 0.6)


@pytest.fixture(scope="module")
def page(fall, tmp_path_factory):
    return pinimpact.replay(*fall, tmp_path_factory.mktemp("replay") / "replay.html", speed=0.5)


def motion_of(shown: pinimpact.visual.html_replay.Replay) -> dict:
    (text,) = re.findall(r'<script id="motion" type="application/json">(.*?)</script>', shown.html)
    return json.loads(text)


def numbers(text: str, kind: str = "<f4") -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), dtype=kind).astype(float)


def commands_of(shown) -> list[dict]:
    (text,) = re.findall(r'<script id="shapes" type="application/gzip">(.*?)</script>', shown.html)
    rest, found = gzip.decompress(base64.b64decode(text)), []
    while rest:
        length = int.from_bytes(rest[:4], "little")
        found.append(umsgpack.unpackb(rest[4 : 4 + length]))
        rest = rest[4 + length :]
    return found


def open_in_browser(shown, fragment: str) -> tuple[dict[str, str], list[str]]:
    """Open a page, check that it has no errors, and return its data attributes and rows of its overlay."""
    return content_of(*open_page(BROWSER, shown, fragment))


def content_of(dom: str, console: list[str]) -> tuple[dict[str, str], list[str]]:
    """Check that an opened page has no errors, and return its data attributes and rows of its overlay."""
    data = dict(re.findall(r'data-([a-z]+)="([^"]*)"', dom.split(">", 2)[1] + ">"))
    assert data["errors"] == "[]"
    assert data["ready"] == "yes"
    assert not [row for row in console if re.search(r"uncaught|error|fail", row, re.IGNORECASE)]
    (overlay,) = re.findall(r'<div id="overlay".*?>(.*?)</div></div>', dom, re.DOTALL)
    rows = re.findall(r"<div[^>]*>([^<]*)(?:</div>|$)", overlay)
    return data, [html.unescape(row) for row in rows]


TELLS = """<script>setInterval(() => {
  parent.postMessage([%d, "<!doctype html>" + document.documentElement.outerHTML], "*"); }, 500);
</script></body>"""
LISTENS = """<script>addEventListener("message", (told) => {
  document.getElementById(told.data[0]).textContent = told.data[1]; });</script>"""


def opened_together(shown, folder: Path, sizes) -> tuple[list[str], list[str]]:
    """Return the documents of pages at their fragments, in windows of these sizes, and the console.

    They are frames of one page, since each start of the browser takes seconds.
    """
    sheet = f"<!doctype html>{LISTENS}"
    for k, ((page, at), (wide, tall)) in enumerate(zip(shown, sizes, strict=True)):
        path = folder / f"frame{k}.html"
        path.write_text(page.html.replace("</body>", TELLS % k), encoding="utf-8")
        sheet += (
            f'<pre id="{k}"></pre><iframe src="{path.as_uri()}#{at}" width="{wide}" height="{tall}"></iframe>'
        )
    (folder / "sheet.html").write_text(sheet, encoding="utf-8")
    dom, console = open_page(BROWSER, folder / "sheet.html", size=(1200, 1000))
    return [html.unescape(text) for text in re.findall(r'<pre id="\d">(.*?)</pre>', dom, re.DOTALL)], console


def pictures_of(shown: list[tuple[object, str]], folder: Path, size: tuple[int, int]) -> list[np.ndarray]:
    """Return pictures of pages at their fragments, made by one start of the browser."""
    frames = "".join(f'<iframe src="{Path(page).absolute().as_uri()}#{at}"></iframe>' for page, at in shown)
    box = f"display: block; border: 0; width: {size[0]}px; height: {size[1]}px"
    style = f"body {{ margin: 0 }} iframe {{ {box} }}"
    sheet, picture = folder / "sheet.html", folder / "sheet.png"
    sheet.write_text(f"<!doctype html><style>{style}</style>{frames}", encoding="utf-8")
    open_page(BROWSER, sheet, size=(size[0], len(shown) * size[1]), screenshot=picture)
    return np.split(imread(picture), len(shown))


def test_page_loads_no_other_files(page) -> None:
    text = page.path.read_text(encoding="utf-8")
    assert text == page.html
    assert not re.search(r"<(script|link|img|iframe)[^>]*(src|href)=", text)
    assert text.count("<script") == text.count("</script>") == 5


def test_frames_agree_with_motion(fall, page) -> None:
    robot, trajectory = fall
    motion = motion_of(page)
    times = numbers(motion["times"], "<f8")
    assert (times[0], times[-1]) == (0.0, 0.6)
    assert np.diff(times).min() >= 0.0
    assert np.diff(times).max() <= 0.5 / 60 + 1e-12
    assert {impact.time for impact in trajectory.impacts} == set(times[1:][np.diff(times) == 0.0])
    poses = {int(joint): numbers(text).reshape(-1, 7) for joint, text in motion["joints"].items()}
    assert poses.keys() == {shape.parentJoint for shape in robot.visual_model.geometryObjects}
    data = robot.model.createData()
    for frame in range(0, len(times), 50):
        pin.forwardKinematics(robot.model, data, trajectory.at(times[frame])[0])
        for joint, found in poses.items():
            np.testing.assert_allclose(found[frame, :3], data.oMi[joint].translation, atol=1e-6)
            turned = pin.Quaternion(found[frame, 3:] / np.linalg.norm(found[frame, 3:])).matrix()
            np.testing.assert_allclose(turned, data.oMi[joint].rotation, atol=1e-6)


def test_placements_of_shapes_are_relative_to_their_joints(fall, page) -> None:
    robot, _ = fall
    placed = {
        command["path"]: np.array(command["matrix"]).reshape(4, 4).T
        for command in commands_of(page)
        if command["type"] == "set_transform"
    }
    for number, shape in enumerate(robot.visual_model.geometryObjects):
        place = placed[f"/meshcat/robot/{shape.parentJoint}/{number}"]
        np.testing.assert_allclose(place, shape.placement.homogeneous, atol=1e-12)


def test_impulses_velocities_and_energy_of_impacts(fall, page) -> None:
    robot, trajectory = fall
    shown = motion_of(page)["impacts"]
    assert len(shown) == len(trajectory.impacts) > 1
    data = robot.model.createData()
    for impact, seen in zip(trajectory.impacts, shown, strict=True):
        assert (seen["time"], seen["source"], seen["law"]) == (impact.time, "tip", "poisson")
        before, after = (
            pin.computeKineticEnergy(robot.model, data, impact.q, v)
            for v in (impact.v_before, impact.v_after)
        )
        assert seen["lost"] == pytest.approx(before - after, abs=1e-12)
        (mark,) = seen["contacts"]
        pin.framesForwardKinematics(robot.model, data, impact.q)
        tip = robot.model.getFrameId("tip")
        np.testing.assert_allclose(mark["point"], data.oMf[tip].translation, atol=1e-6)
        jacobian = pin.computeFrameJacobian(robot.model, data, impact.q, tip, pin.LOCAL_WORLD_ALIGNED)[:3]
        axes = np.array(mark["axes"]).reshape(3, 3)
        for row, v in ((0, impact.v_before), (-1, impact.v_after)):
            np.testing.assert_allclose(mark["velocity"][row] @ axes, jacobian @ v, atol=1e-6)
        np.testing.assert_allclose(mark["impulse"][-1] @ axes, impact.impulse_world, rtol=1e-5, atol=1e-9)


def test_forces_agree_with_motion(fall, page) -> None:
    _, trajectory = fall
    motion = motion_of(page)
    (contact,) = motion["contacts"]
    times = numbers(motion["times"], "<f8")
    forces = numbers(contact["forces"]).reshape(-1, 3)
    once = np.flatnonzero((np.diff(times, prepend=-1.0) > 0.0) & (np.diff(times, append=1.0) > 0.0))
    free = [k for k in once if trajectory.mode_at("tip", times[k]) == "free"]
    closed = [k for k in once if k not in free][1:-1]
    assert len(free) > 10
    assert len(closed) > 10
    assert not forces[free].any()
    np.testing.assert_allclose(
        forces[closed], trajectory.forces_world("tip", times[closed]), rtol=1e-5, atol=1e-5
    )
    assert (forces[closed, 2] > 0.0).all()


def fall_of(robot, surface) -> pinimpact.visual.html_replay.Replay:
    tip = pinimpact.Contact("tip", surface)
    trajectory = pinimpact.simulate(pinimpact.Scene(robot, [tip]), [0, 1, 1, 0, 0.5], [0, 0, 0, 0, 1], 0.1)
    return pinimpact.replay(robot, trajectory, None)


def test_fixed_surfaces_lie_under_the_paths_of_their_contacts() -> None:
    robot = pinimpact.load_robot("rod")
    plane = pinimpact.Plane((0, 0, 0.1), (0, 0.6, 0.8))
    motion = motion_of(fall_of(robot, plane))
    (plate,) = motion["surfaces"]
    assert (plate["kind"], plate["joint"]) == ("plane", 0)
    matrix = np.array(plate["matrix"]).reshape(4, 4).T
    np.testing.assert_allclose(matrix[:3, 2], plane.normal, atol=1e-6)
    path = numbers(motion["contacts"][0]["path"]).reshape(-1, 3)
    assert len(path) > 5
    for point in path:
        foot = point - np.dot(plane.normal, point - np.array(plane.point)) * np.array(plane.normal)
        local = np.linalg.solve(matrix, [*foot, 1.0])[:3]
        assert (np.abs(local) <= 0.5 * np.array(plate["size"]) + 1e-6).all()
        assert local[2] == pytest.approx(0.5 * plate["size"][2], abs=1e-6)  # the upper side
    (ball,) = motion_of(fall_of(robot, pinimpact.Sphere((1, 2, 3), 0.4)))["surfaces"]
    assert (ball["kind"], ball["size"][0]) == ("sphere", 0.4)
    np.testing.assert_allclose(np.array(ball["matrix"]).reshape(4, 4).T[:3, 3], (1, 2, 3))


def test_moving_surfaces_are_drawn_with_their_velocity() -> None:
    """The drawn motion of a belt, a turntable and a ball is the surface velocity at contacts."""
    robot = pinimpact.load_robot("rod")
    data = robot.model.createData()
    for surface in (
        pinimpact.Plane((0.1, 0.2, 0.1), (0, 0.6, 0.8), velocity=(0.5, -0.8, 0.6)),
        pinimpact.Plane((1.0, 2.0, 0.1), angular_velocity=(0, 0, 3.0)),
        pinimpact.Sphere((1, 2, 3), 0.4, angular_velocity=(1.0, 0, 2.0)),
    ):
        (drawn,) = motion_of(fall_of(robot, surface))["surfaces"]
        matrix = np.array(drawn["matrix"]).reshape(4, 4).T
        contact = pinimpact.Contact("tip", surface)
        q = np.array([0.3, 1.1, 1.2, 0.0, 0.5])
        expected = contact_geometry(robot.model, data, q, contact)
        on = expected.point - matrix[:3, 3]
        here = matrix[:3, :3] @ drawn["slide"] + np.cross(matrix[:3, :3] @ drawn["spin"], on)
        np.testing.assert_allclose(here, expected.surface_velocity @ expected.axes, atol=1e-6)


@pytest.mark.parametrize("kind", ["plane", "sphere"])
def test_surfaces_on_bodies_move_with_them(kind) -> None:
    robot = pinimpact.load_robot("two_link_arm")
    model = robot.model
    body = next(frame.name for frame in model.frames if frame.parentJoint == 2)
    place = (0.1, 0.2, 0.3)
    surface = {
        "plane": pinimpact.Plane(place, (0, 0, 1), body=body),
        "sphere": pinimpact.Sphere(place, 0.05, body=body),
    }[kind]
    contact = pinimpact.Contact(0, surface)
    trajectory = pinimpact.simulate(pinimpact.Scene(model, [contact]), [0.3, 0.4], [1.0, -2.0], 0.1)
    motion = motion_of(pinimpact.replay(robot, trajectory, None))
    (shown,) = motion["surfaces"]
    times, poses = (
        numbers(motion["times"], "<f8"),
        numbers(motion["joints"][str(shown["joint"])]).reshape(-1, 7),
    )
    data = model.createData()
    for frame in (0, len(times) - 1):
        pin.framesForwardKinematics(model, data, trajectory.at(times[frame])[0])
        carrier = data.oMf[model.getFrameId(body)]
        drawn = pin.XYZQUATToSE3(poses[frame]).homogeneous @ np.array(shown["matrix"]).reshape(4, 4).T
        if kind == "sphere":
            np.testing.assert_allclose(drawn[:3, 3], carrier.act(np.array(place)), atol=1e-5)
        else:
            np.testing.assert_allclose(drawn[:3, 2], carrier.rotation[:, 2], atol=1e-5)
            side = drawn[:3, 3] + 0.5 * shown["size"][2] * drawn[:3, 2]
            off = carrier.rotation.T @ (side - carrier.act(np.array(place)))
            assert abs(off[2]) < 1e-5
            assert (np.abs(off[:2]) < 0.5 * np.array(shown["size"][:2])).all()


def test_model_without_shapes_is_drawn_in_lines(fall) -> None:
    robot, trajectory = fall
    motion = motion_of(pinimpact.replay(robot.model, trajectory, None))
    sliding = sum("P" in joint.shortname() for joint in robot.model.joints)  # how the rod's base moves
    assert sliding > 0
    chain = [[int(robot.model.parents[j]), j] for j in range(1, robot.model.njoints)]
    assert motion["links"] == [link for link in chain if link[0] > 0]
    assert len(motion["joints"]) + len(motion["still"]) == robot.model.njoints - 1
    tip = robot.model.frames[robot.model.getFrameId("tip")]
    assert any(
        spot[0] == tip.parentJoint and np.allclose(spot[1:], tip.placement.translation, atol=1e-6)
        for spot in motion["spots"]
    )


def test_saved_trajectory_has_its_contacts(fall, tmp_path: Path) -> None:
    robot, trajectory = fall
    trajectory.save(tmp_path / "fall.npz")
    loaded = pinimpact.Trajectory.load(tmp_path / "fall.npz")
    assert loaded.contacts == trajectory.contacts
    seen, again = (motion_of(pinimpact.replay(robot, t, None)) for t in (trajectory, loaded))
    for name in ("times", "surfaces", "impacts", "modes", "joints"):
        assert seen[name] == again[name]


def test_contacts_of_every_kind_are_saved(tmp_path: Path) -> None:
    robot = pinimpact.load_robot("rod")
    ball = pinimpact.Sphere((0, 0, -5), 0.4, angular_velocity=(0, 0, 1))
    contacts = [
        pinimpact.Contact("tip", ball, 0.3, lambda speed: 0.5, "newton", (0.1, 0, 0), 0.01, "head", 0.2),
        pinimpact.Contact(robot.model.getFrameId("tip"), FLOOR, 0.3, 0.5),
    ]
    trajectory = pinimpact.simulate(
        pinimpact.Scene(robot, contacts), np.add(robot.q0, [0, 0, 2, 0, 0]), np.zeros(5), 0.01
    )
    trajectory.save(tmp_path / "x.npz")
    head, tip = pinimpact.Trajectory.load(tmp_path / "x.npz").contacts
    assert tip == trajectory.contacts[1]
    assert (head.plane, head.offset, head.radius, head.name) == (ball, (0.1, 0, 0), 0.01, "head")
    assert head.restitution == 0.0  # functions are not saved


def test_single_impact_with_and_without_robot(fall) -> None:
    robot, trajectory = fall
    record = trajectory.impacts[0]
    hit = pinimpact.impact(robot.model, robot.data, record.q, record.v_before, trajectory.contacts[0])
    alone = motion_of(pinimpact.replay(hit, path=None))
    for motion in (
        motion_of(pinimpact.replay(robot, hit, None, q=record.q)),
        motion_of(pinimpact.replay(robot, record, None, contacts=trajectory.contacts)),
        alone,
    ):
        assert motion["within"]
        (mark,) = motion["impacts"][0]["contacts"]
        np.testing.assert_allclose(mark["impulse"][-1], hit.solution.impulse, rtol=1e-6)
        v, p = np.array(mark["velocity"]), np.array(mark["impulse"])
        np.testing.assert_allclose(v, v[0] + p @ hit.problem.delassus, atol=1e-5)  # v = v° + W P
        assert len(v) > 10
    assert (alone["surfaces"], alone["joints"], alone["contacts"]) == ([], {}, [])
    with pytest.raises(pinimpact.InputError, match="q: None given; a hit does not contain"):
        pinimpact.replay(robot, hit, None)
    with pytest.raises(pinimpact.InputError, match="contacts: no contact is called 'tip'"):
        pinimpact.replay(robot, record, None)


def test_single_impact_at_several_contacts() -> None:
    robot = pinimpact.load_robot("solo12")
    feet = [
        pinimpact.Contact(f, FLOOR, 0.5, 0.3, "energetic", name=f) for f in ("FL_FOOT", "FR_FOOT", "HL_FOOT")
    ]
    v = np.zeros(robot.model.nv)
    v[:3] = 0.3, 0.1, -1.0
    hit = pinimpact.impact(robot.model, robot.data, robot.q0, v, feet)
    (shown,) = motion_of(pinimpact.replay(robot, hit, None, q=robot.q0))["impacts"]
    alone = motion_of(pinimpact.replay(hit, path=None))
    assert alone["impacts"] == [shown]
    assert alone["joints"] == {}
    assert (shown["e"], shown["mu"], shown["law"]) == (0.3, 0.5, "energetic")
    data = robot.model.createData()
    before, after = (pin.computeKineticEnergy(robot.model, data, robot.q0, u) for u in (v, hit.v))
    assert shown["lost"] == pytest.approx(before - after, rel=1e-6)
    pin.framesForwardKinematics(robot.model, data, robot.q0)
    assert [mark["name"] for mark in shown["contacts"]] == [foot.label for foot in feet]
    for mark, impulse, foot in zip(shown["contacts"], hit.impulses_world, feet, strict=True):
        place = data.oMf[robot.model.getFrameId(foot.frame)].translation
        np.testing.assert_allclose(mark["point"], place, atol=1e-6)
        axes = np.array(mark["axes"]).reshape(3, 3)
        np.testing.assert_allclose(mark["impulse"][-1] @ axes, impulse, rtol=1e-5, atol=1e-7)
        np.testing.assert_allclose(mark["velocity"][0] @ axes, v[:3], atol=1e-6)
        assert np.all(np.diff(mark["clock"]) >= 0.0)
        assert (mark["clock"][0], mark["clock"][-1]) == (0.0, 1.0)
    with pytest.raises(pinimpact.InputError, match="q: None given; a hit does not contain"):
        pinimpact.replay(robot, hit, None)


def test_invalid_arguments_raise(fall) -> None:
    robot, trajectory = fall
    with pytest.raises(pinimpact.InputError, match=r"speed: 0\.0"):
        pinimpact.replay(robot, trajectory, None, speed=0.0)
    with pytest.raises(pinimpact.InputError, match=r"slowdown: 0\.5"):
        pinimpact.replay(robot, trajectory, None, slowdown=0.5)
    with pytest.raises(pinimpact.InputError, match="slowdown: 'slow'"):
        pinimpact.replay(robot, trajectory, None, slowdown="slow")
    for wrong in ("tip", ["tip"], 3):
        with pytest.raises(pinimpact.InputError, match="contacts: "):
            pinimpact.replay(robot, trajectory, None, contacts=wrong)
    with pytest.raises(pinimpact.InputError, match="motion: None"):
        pinimpact.replay(robot, None, None)
    other = pinimpact.load_robot("ur5")
    with pytest.raises(pinimpact.InputError, match=r"'ur5' is not the robot .* 6 coordinates .* 5"):
        pinimpact.replay(other, trajectory, None)
    twin = pin.Model()  # five coordinates too, of other joints
    twin.addJoint(0, pin.JointModelSpherical(), pin.SE3.Identity(), "a")
    twin.addJoint(1, pin.JointModelRX(), pin.SE3.Identity(), "b")
    with pytest.raises(pinimpact.InputError, match="is not the robot"):
        pinimpact.replay(twin, trajectory, None)
    absent = pinimpact.Contact("nose", FLOOR)
    with pytest.raises(pinimpact.UnknownNameError, match="nose"):
        pinimpact.replay(robot, trajectory, None, contacts=[absent])


def test_replay_in_notebook_and_browser(fall, page, monkeypatch, tmp_path: Path) -> None:
    frame = page._repr_html_()
    (inner,) = re.findall(r'<iframe srcdoc="([^"]*)"', frame)
    assert html.unescape(inner) == page.html
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    shown = pinimpact.replay(*fall, tmp_path / "a b.html", open=True)
    assert opened == [(tmp_path / "a b.html").as_uri()]
    assert Path(shown) == tmp_path / "a b.html" == Path(str(shown))
    unwritten = pinimpact.replay(*fall, None)
    with pytest.raises(pinimpact.InputError, match=r"save\(\)"):
        unwritten.open()
    assert unwritten.save(tmp_path / "c.html").read_text(encoding="utf-8") == unwritten.html


@pytest.fixture(scope="module")
def dropped():
    """Return a barrel with a knob, and its motion: it falls on its side and both rims strike the floor."""
    robot = shaped_body(coal.Cylinder(0.1, 0.3), pin.Inertia.FromCylinder(1.0, 0.1, 0.3))
    place = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.5]))
    shapes = robot.collision_model
    shapes.addGeometryObject(
        pin.GeometryObject("knob", 1, robot.model.getFrameId("thing"), place, coal.Box(*[0.02] * 3))
    )
    scene = pinimpact.Scene(robot).contacts_from_geometry(FLOOR, friction=0.3, restitution=0.5)
    lying = pin.Quaternion(pin.utils.rotate("x", 0.5 * np.pi)).coeffs()
    return robot, pinimpact.simulate(scene, [0, 0, 0.2, *lying], np.zeros(6), 0.35)


def test_shapes_are_highlighted_during_contact(dropped, tmp_path: Path) -> None:
    robot, trajectory = dropped
    shown = pinimpact.replay(robot, trajectory, tmp_path / "replay.html")
    (lit,) = motion_of(shown)["lit"]  # the knob touches nothing
    assert (lit["name"], lit["joint"]) == ("thing_0", 1)
    times = [impact.time for impact in trajectory.impacts]
    assert all(any(start <= t <= end for start, end in lit["times"]) for t in times)
    assert not any(start <= 0.5 * (times[0] + times[2]) <= end for start, end in lit["times"])
    corners = numbers(lit["triangles"]).reshape(-1, 3)
    assert np.abs(corners[:, 2]) == pytest.approx(np.full(len(corners), 0.15), abs=1e-6)
    assert np.hypot(corners[:, 0], corners[:, 1]) == pytest.approx(np.full(len(corners), 0.1), abs=1e-6)
    # paths are drawn for these contacts only
    assert [one["name"] for one in motion_of(shown)["contacts"]] == [
        "thing_0 rim 1 on plane",
        "thing_0 rim 2 on plane",
    ]
    bare = pinimpact.replay(robot.model, trajectory, None)
    assert motion_of(bare)["lit"] == []


@needs_browser
@pytest.mark.slow
def test_highlighted_shapes_in_browser(dropped, tmp_path: Path) -> None:
    robot, trajectory = dropped
    shown = pinimpact.replay(robot, trajectory, tmp_path / "replay.html", slowdown=1.0)
    times = (0.05, trajectory.impacts[0].time + 1e-4)
    pictures = pictures_of([(shown.path, f"t={time}") for time in times], tmp_path, (480, 360))
    seen = [np.count_nonzero(is_yellow(picture)) for picture in pictures]
    assert seen[1] > seen[0] + 300


def is_yellow(pixels: np.ndarray) -> np.ndarray:
    """Return which pixels have the colour of highlighted shapes, blended with any background."""
    red, green, blue = (pixels[..., k] for k in range(3))
    return (red > blue + 0.2) & (green > blue + 0.2) & (abs(red - green) < 0.12)


@pytest.mark.slow
def test_size_of_replay_with_meshes() -> None:
    robot = pinimpact.load_robot("panda")
    trajectory = pinimpact.simulate(pinimpact.Scene(robot), robot.q0, np.zeros(9), 0.5)
    assert len(pinimpact.replay(robot, trajectory, None).html) < 20e6


def film_length(motion: dict) -> float:
    """Return the duration of a film in which impacts are slowed down, by Simpson's rule."""
    times = numbers(motion["times"], "<f8")
    fine = np.linspace(times[0], times[-1], 200001)
    slow = [impact["time"] for impact in motion["impacts"] if impact["slow"]]
    rate = np.ones_like(fine)
    for moment in slow:
        bell = np.exp(-(((fine - moment) / motion["width"]) ** 2))
        rate = np.maximum(rate, 1.0 + (motion["slowdown"] - 1.0) * bell)
    weights = np.ones_like(fine)
    weights[1:-1:2], weights[2:-1:2] = 4.0, 2.0
    return float(weights @ rate) * (fine[1] - fine[0]) / 3.0 / motion["speed"] + motion["hold"] * len(slow)


@needs_browser
def test_browser_plays_motion_to_its_end(fall, page, tmp_path: Path) -> None:
    _, trajectory = fall
    motion = motion_of(page)
    first = trajectory.impacts[0]
    places = f"t={0.5 * first.time}", "impact=1", "t=0.6"
    doms, console = opened_together([(page, at) for at in places], tmp_path, [(960, 540)] * 3)
    before, at_impact, at_end = (content_of(dom, console) for dom in doms)
    data, rows = before
    assert float(data["duration"]) == pytest.approx(film_length(motion), rel=2e-3)
    assert int(data["tracks"]) == len(motion["joints"])
    assert int(data["frames"]) == len(numbers(motion["times"], "<f8"))
    assert rows == [f"t = {0.5 * first.time:.4f} s", "free"]

    _, rows = at_impact
    segment = first.solution.segments[-1]
    number = f"impact 1 of {len(trajectory.impacts)}"
    assert rows[:2] == [f"t = {first.time:.4f} s", f"tip: {segment.mode} in {segment.phase}"]
    whole = first.solution.impulse[2]
    now, of = map(float, re.fullmatch(r"P₃ = (\S+) of (\S+) N s", rows[2]).groups())
    assert of == pytest.approx(whole, abs=5e-4)
    assert now == pytest.approx(whole, rel=5e-3)
    assert rows[3] == number
    assert rows[4] == "Poisson's law, e = 0.3, μ = 0.6"
    lost = float(re.fullmatch(r"energy lost (\S+) J", rows[5])[1])
    assert lost == pytest.approx(-first.solution.work.total, rel=5e-3)

    data, rows = at_end
    assert float(data["time"]) == pytest.approx(0.6, abs=1e-9)
    assert rows[0] == "t = 0.6000 s"
    mode = trajectory.mode_at("tip", 0.6)
    assert mode in ("slip", "stick")
    assert rows[1] == f"tip: {mode}"
    assert rows[2].startswith(f"impact {len(trajectory.impacts)} of {len(trajectory.impacts)}")


def colored(pixels: np.ndarray, color: str) -> int:
    """Return the number of pixels of a colour, #rrggbb, within 0.05 of each component."""
    wanted = np.array([int(color[k : k + 2], 16) for k in (1, 3, 5)]) / 255.0
    return int((np.abs(pixels - wanted).max(axis=-1) < 0.05).sum())


@needs_browser
def test_browser_shows_robot_surface_and_impact(page, tmp_path: Path) -> None:
    pictures = pictures_of([(page, "t=0.05"), (page, "impact=1")], tmp_path, (800, 500))
    before, at = views = [picture[50:450, 250:, :3].copy() for picture in pictures]
    for view in views:
        view[:220, 280:] = 1.0  # the hodograph may cover this part
        assert view.std() > 0.05
        assert ((view[..., 2] > view[..., 0] + 0.2) & (view[..., 2] > 0.3)).sum() > 100  # the rod is blue
        assert (view[..., 0] > view[..., 2] + 0.15).sum() > 1000  # the floor is brown
    impulse, after = "#d55e00", "#0072b2"
    assert colored(before, impulse) < 20
    assert colored(at, impulse) > 100
    assert colored(at, after) > 30


@needs_browser
def test_robot_fills_window_beside_panels(page, tmp_path: Path) -> None:
    wide, tall = 800, 500
    bare = tmp_path / "bare.html"
    bare.write_text(page.html.replace(".panel {", ".panel { visibility: hidden;"), encoding="utf-8")
    seen = np.zeros((tall, wide), dtype=bool)
    shown = [(bare, f"t={time}") for time in (0.0, 0.2, 0.4, 0.6)]
    for picture in pictures_of(shown, tmp_path, (wide, tall)):
        red, _, blue = np.moveaxis(picture[..., :3], -1, 0)
        seen |= (blue > red + 0.2) & (blue > 0.3) & (blue < 0.75)  # the rod
    rows, columns = np.flatnonzero(seen.any(axis=1)), np.flatnonzero(seen.any(axis=0))
    left = int(0.27 * wide)
    assert left < columns[0] < columns[-1] < wide - 1
    assert 0 < rows[0] < rows[-1] < tall - 57
    assert max(np.ptp(rows) / (tall - 56), np.ptp(columns) / (wide - left)) > 0.6


@needs_browser
def test_text_of_impact_is_not_cut_off_in_any_window(page, tmp_path: Path) -> None:
    probe = """<script>setInterval(() => {
      const words = document.getElementById("overlay");
      document.body.dataset.cut = words.scrollHeight > words.clientHeight + 1;
      document.body.dataset.inset = !document.getElementById("hodograph").hidden;
    }, 100);</script></body>"""
    probed = SimpleNamespace(html=page.html.replace("</body>", probe))
    heights = 340, 460, 900
    doms, _ = opened_together([(probed, "impact=1")] * 3, tmp_path, [(800, tall) for tall in heights])
    for tall, dom in zip(heights, doms, strict=True):
        assert 'data-cut="false"' in dom
        assert f'data-inset="{str(tall == 900).lower()}"' in dom or tall == 460


def test_grid_at_lowest_point() -> None:
    """A ball falls onto a table at a height of 0.5 m, next to a post; the grid is at the foot of the post."""
    robot = shaped_body(coal.Sphere(0.1), pin.Inertia.FromSphere(1.0, 0.1))
    robot.visual_model = pin.GeometryModel()
    post = pin.SE3(np.eye(3), np.array([0.5, 0.0, 0.2]))
    for name, joint, place, solid in (
        ("ball", 1, pin.SE3.Identity(), coal.Sphere(0.1)),
        ("post", 0, post, coal.Box(0.1, 0.1, 0.4)),
    ):
        robot.visual_model.addGeometryObject(pin.GeometryObject(name, joint, 0, place, solid))
    for height, grids in ((0.5, True), (0.0, False)):
        table = pinimpact.Plane(point=(0, 0, height))
        ball = pinimpact.Contact(robot.model.frames[-1].name, table, radius=0.1, friction=0.5)
        scene = pinimpact.Scene(robot, [ball])
        q = np.array([0, 0, 1.0, 0, 0, 0, 1.0])
        shown = pinimpact.replay(robot, pinimpact.simulate(scene, q, np.zeros(6), 0.4), None)
        commands = commands_of(shown)
        (visible,) = [c["value"] for c in commands if c["path"] == "/Grid" and c["type"] == "set_property"]
        places = [c["matrix"] for c in commands if c["path"] == "/Grid" and c["type"] == "set_transform"]
        assert visible == grids == (motion_of(shown)["view"]["grid"] > 0.0) == bool(places)
        for matrix in places:
            assert np.reshape(matrix, (4, 4)).T[2, 3] == pytest.approx(0.0, abs=1e-9)  # the foot of the post
    colors = [c["object"]["materials"][0]["color"] for c in commands if c["type"] == "set_object"]
    assert len(colors) == 2
    for color in colors:  # the default gray, since neither shape has a colour
        red, green, blue = color >> 16, color >> 8 & 255, color & 255
        assert min(red, green, blue) > 100
        assert max(red, green, blue) - min(red, green, blue) < 20
    assert not any(shape.meshColor[:3].any() for shape in robot.visual_model.geometryObjects)  # unchanged


def spinning(speed: float, duration: float) -> tuple[pin.Model, pinimpact.Trajectory]:
    """Return a wheel with an eccentric disc, which turns at constant speed, and its motion."""
    model = pin.Model()
    for parent, name in ((0, "wheel"), (1, "disc")):
        place = pin.SE3(np.eye(3), np.array([0.3 * parent, 0.0, 0.0]))
        joint = model.addJoint(parent, pin.JointModelRZ(), place, name)
        model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    model.gravity.linear[:] = 0.0
    scene = pinimpact.Scene(model)
    return model, pinimpact.simulate(scene, [0.0, 0.0], [speed, 0.0], duration)


@pytest.mark.parametrize(("speed", "duration"), [(20.0, 0.5), (314.0, 0.5), (20.0, 100.0), (-20.0, 100.0)])
def test_bodies_turn_between_frames_as_they_move(speed: float, duration: float) -> None:
    model, trajectory = spinning(speed, duration)
    motion = motion_of(pinimpact.replay(model, trajectory, None))
    assert not motion["coarse"]
    times = numbers(motion["times"], "<f8")
    for joint in range(1, 3):
        _, _, z, w = numbers(motion["joints"][str(joint)]).reshape(-1, 7)[:, 3:].T
        turns = np.diff(2.0 * np.arctan2(z, w))
        turns = (turns + np.pi) % (2.0 * np.pi) - np.pi  # the shorter way, as the player does
        pairs = [(trajectory.at(float(t))[0][:joint].sum()) for t in times]
        np.testing.assert_allclose(turns, np.diff(pairs), atol=1e-5)
        assert np.abs(turns).max() < 1.0 + 1e-5
    if abs(speed) * duration < 20.0:  # slow in each of 60 frames per second
        assert len(times) == 31


@needs_browser
def test_page_says_if_rotation_needs_more_frames(tmp_path: Path) -> None:
    pages = [pinimpact.replay(*spinning(3000.0, duration), None) for duration in (1.0, 10.0)]
    assert [motion_of(shown)["coarse"] for shown in pages] == [False, True]
    assert len(numbers(motion_of(pages[1])["times"], "<f8")) < 13_000
    doms, console = opened_together([(shown, "t=0.5") for shown in pages], tmp_path, [(960, 540)] * 2)
    said = [any("fewer frames" in row for row in content_of(dom, console)[1]) for dom in doms]
    assert said == [False, True]


@needs_browser
def test_contacts_of_two_bodies_are_listed_in_one_row(tmp_path: Path) -> None:
    box = shaped_body(coal.Box(0.2, 0.2, 0.2), pin.Inertia.FromBox(1.0, 0.2, 0.2, 0.2))
    scene = pinimpact.Scene(box).contacts_from_geometry(FLOOR, friction=0.5, restitution=0.0)
    q = np.array([0, 0, 0.1, 0, 0, 0, 1.0])
    shown = pinimpact.replay(box, pinimpact.simulate(scene, q, np.zeros(6), 0.1), tmp_path / "box.html")
    _, rows = open_in_browser(shown, "t=0.05")
    assert rows == ["t = 0.0500 s", "thing_0 on plane: stick (4 points)"]


@needs_browser
def test_browser_shows_single_impact(fall, tmp_path: Path) -> None:
    robot, trajectory = fall
    record = trajectory.impacts[0]
    hit = pinimpact.impact(robot.model, robot.data, record.q, record.v_before, trajectory.contacts[0])
    pages = [pinimpact.replay(robot, hit, None, q=record.q), pinimpact.replay(hit, path=None)]
    doms, console = opened_together([(shown, "film=4") for shown in pages], tmp_path, [(960, 540)] * 2)
    for dom in doms:
        data, rows = content_of(dom, console)
        assert float(data["duration"]) == 8.0
        middle = 0.5 * hit.solution.impulse[2]
        (segment,) = [s for s in hit.solution.segments if s.start <= middle < s.end]
        assert rows[0] == f"tip: {segment.mode} in {segment.phase}"
        assert float(re.fullmatch(r"P₃ = (\S+) of .* N s", rows[1])[1]) == pytest.approx(middle, abs=6e-4)


@needs_browser
@pytest.mark.slow
def test_film_as_gif(fall, tmp_path: Path) -> None:
    from PIL import Image

    shown = pinimpact.replay(*fall, None, slowdown=1.0)  # a film of 0.6 s
    with Image.open(shown.video(tmp_path / "fall.gif", rate=10, size=(320, 240))) as film:
        assert film.n_frames == 7
        assert film.info["duration"] == 100
        film.seek(0)
        first = np.asarray(film.convert("RGB"), dtype=float)
        film.seek(6)
        last = np.asarray(film.convert("RGB"), dtype=float)
    assert first.std() > 10.0
    assert np.abs(first - last).mean() > 1.0
    if shutil.which("ffmpeg"):
        assert shown.video(tmp_path / "fall.mp4", rate=10, size=(320, 240)).stat().st_size > 1000


@pytest.mark.parametrize("rate", [7.0, 15.0, 25.0, 26.0, 30.0, 40.0, 50.0])
def test_frames_of_gif_are_shown_at_their_times(rate: float, tmp_path: Path) -> None:
    from PIL import Image, ImageSequence

    frames = []
    for k in range(61):
        file = BytesIO()
        picture = Image.new("RGB", (61, 8))
        picture.putpixel((k, 4), (255, 255, 255))
        picture.save(file, "png")
        frames.append(file.getvalue())
    _write_gif(frames, tmp_path / "film.gif", rate)
    with Image.open(tmp_path / "film.gif") as film:
        durations = [frame.info["duration"] for frame in ImageSequence.Iterator(film)]
    assert len(durations) == 61
    ends = np.arange(1, 62) / rate  # of a steady film [s]
    assert np.abs(np.cumsum(durations) / 1000 - ends).max() < 0.0051
    assert min(durations) >= 20  # players slow down shorter frames


def test_film_without_its_tools_raises(fall, tmp_path: Path, monkeypatch) -> None:
    shown = pinimpact.replay(*fall, None)
    with pytest.raises(pinimpact.InputError, match=r"'x\.avi' given"):
        shown.video(tmp_path / "x.avi")
    monkeypatch.setattr("shutil.which", lambda name: None)
    with pytest.raises(pinimpact.InputError, match="ffmpeg"):
        shown.video(tmp_path / "x.mp4")
    with pytest.raises(pinimpact.InputError, match="button"):
        shown.video(tmp_path / "x.gif")


def test_film_is_checked_before_it_is_drawn(fall, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr("pinimpact.visual.video._frames", lambda *_: pytest.fail("frames are drawn"))
    monkeypatch.setattr("pinimpact.visual.video.find_browser", lambda: "browser")
    shown = pinimpact.replay(*fall, None)
    with pytest.raises(pinimpact.InputError, match="path: there is no folder"):
        shown.video(tmp_path / "none" / "x.gif")
    for size in ((0, 0), (320, -1), (320,), 320, (320, np.nan), "ab"):
        with pytest.raises(pinimpact.InputError, match="size: "):
            shown.video(tmp_path / "x.gif", size=size)


@pytest.mark.parametrize("name", ["a\0b.html", "a" * 300, "a" * 300 + "/b.html"])
def test_paths_that_no_file_can_have_raise(page, name: str, tmp_path: Path) -> None:
    with pytest.raises(pinimpact.InputError, match=r"path: .* cannot be a file"):
        page.save(tmp_path / name)
    assert not any(tmp_path.iterdir())


def test_names_that_are_not_unicode_are_drawn(fall, tmp_path: Path) -> None:
    """Names of files may have bytes that are not UTF-8, which Python represents by surrogates."""
    robot, trajectory = fall
    (tip,) = trajectory.contacts
    odd = replace(tip, name=b"f\xfc\xdf\xe9".decode("utf-8", "surrogateescape"))
    shown = pinimpact.replay(robot, trajectory, tmp_path / "odd.html", contacts=[odd])
    assert (tmp_path / "odd.html").read_text(encoding="utf-8") == shown.html
    assert [contact["name"] for contact in motion_of(shown)["contacts"]] == ["f???"]


DAE = f"""<COLLADA xmlns="{NAMESPACE}"><library_geometries><geometry id="g"><mesh><source id="s"/>
<triangles material="a" count="1"/><polylist material="b" count="2"/></mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene><node><instance_geometry url="#g"><bind_material><technique_common>
<instance_material symbol="a" target="#A"/><instance_material symbol="b" target="#B"/>
</technique_common></bind_material></instance_geometry></node></visual_scene></library_visual_scenes></COLLADA>"""


def test_meshes_are_split_by_material() -> None:
    root = ElementTree.fromstring(for_viewer(DAE))
    tag = f"{{{NAMESPACE}}}"
    pieces = {g.get("id"): [part.get("material") for part in g[0] if part.get("material")] for g in root[0]}
    assert sorted(pieces.values()) == [["a"], ["b"]]
    instances = list(root.iter(f"{tag}instance_geometry"))
    assert len(instances) == 2
    for instance in instances:
        bound = [binding.get("symbol") for binding in instance.iter(f"{tag}instance_material")]
        assert bound == pieces[instance.get("url").lstrip("#")]


def test_numbers_of_meshes_are_rounded() -> None:
    """Positions have 5 digits and normals 3: relative errors of at most 5e-5 and 5e-3."""
    exact = np.random.default_rng(1).normal(size=(2, 30))
    sources = "".join(
        f'<source id="{name}"><float_array>{" ".join(map(repr, row.tolist()))}</float_array></source>'
        for name, row in zip("pn", exact, strict=True)
    )
    inputs = '<triangles><input semantic="NORMAL" source="#n"/></triangles>'
    document = (
        f'<COLLADA xmlns="{NAMESPACE}"><library_geometries><geometry id="g"><mesh>{sources}{inputs}'
        "</mesh></geometry></library_geometries></COLLADA>"
    )
    text = for_viewer(document)
    arrays = ElementTree.fromstring(text).iter(f"{{{NAMESPACE}}}float_array")
    for array, row, relative in zip(arrays, exact, (5e-5, 5e-3), strict=True):
        np.testing.assert_allclose(np.array(array.text.split(), dtype=float), row, rtol=relative)
    assert len(text) < 0.6 * len(document)


def test_all_triangles_have_texture_coordinates_or_none() -> None:
    """The viewer rejects a mixture; added coordinates refer to a source of zeros of sufficient length."""
    points = (
        '<source id="{0}s"><technique_common><accessor count="3" stride="3"/></technique_common></source>'
    )
    vertex = '<input semantic="VERTEX" source="#{0}v" offset="1"/>'
    bare = (
        f'<geometry id="bare"><mesh>{points}<triangles count="1">{vertex}'
        "<p>0 2 0 0 0 1</p></triangles></mesh>"
    )
    worn = (
        f'<geometry id="worn"><mesh>{points}<triangles count="1">{vertex}'
        '<input semantic="TEXCOORD" source="#t" offset="0" set="0"/><p>0 2 0 0 0 1</p></triangles></mesh>'
    )
    start, end = f'<COLLADA xmlns="{NAMESPACE}"><library_geometries>', "</library_geometries></COLLADA>"
    tag = f"{{{NAMESPACE}}}"
    for shapes, sources in ((f"{bare}</geometry>{worn}</geometry>", 1), (f"{bare}</geometry>", 0)):
        root = ElementTree.fromstring(for_viewer(start + shapes + end))
        arrays = {a.get("id"): (a.text or "").split() for a in root.iter(f"{tag}float_array")}
        assert len(arrays) == sources
        for part in root.iter(f"{tag}triangles"):
            inputs = {one.get("semantic"): one for one in part.findall(f"{tag}input")}
            assert ("TEXCOORD" in inputs) == bool(sources)
            if sources and inputs["TEXCOORD"].get("source") != "#t":
                assert arrays[inputs["TEXCOORD"].get("source")[1:] + "-array"] == ["0"] * 6
                assert inputs["TEXCOORD"].get("offset") == "1"  # the stride remains 2


def test_meshes_load_when_warnings_are_errors(monkeypatch) -> None:
    """Since Python 3.12 Pinocchio warns about Collada meshes, and omits a mesh if the warning raises."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # meshcat imports a retired module of pyzmq
        from pinocchio.visualize import MeshcatVisualizer

    load = MeshcatVisualizer.loadMeshFromFile

    def warns(self, shape):
        warnings.warn("Testing an element's truth value", DeprecationWarning, stacklevel=1)
        return load(self, shape)

    monkeypatch.setattr(MeshcatVisualizer, "loadMeshFromFile", warns)
    robot = pinimpact.load_robot("panda")
    trajectory = pinimpact.simulate(pinimpact.Scene(robot), robot.q0, np.zeros(9), 0.01)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        shown = pinimpact.replay(robot, trajectory, None)
    drawn = [c for c in commands_of(shown) if c["type"] == "set_object"]
    assert len(drawn) == robot.visual_model.ngeoms
