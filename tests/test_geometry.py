"""Contacts of collision shapes, against closed forms, distances of coal, and explicit contacts."""

from __future__ import annotations

import functools
import re
from dataclasses import replace

import coal
import numpy as np
import pinocchio as pin
import pytest

import pinimpact
from pinimpact import Contact, InputError, ModelError, Plane, Scene, Sphere, UnknownNameError
from pinimpact.geometry.collision_shapes import extreme_points
from pinimpact.scene import dynamics

from .scene_models import G, free_body, hull_mesh, mesh, run, shaped_body

FLOOR = Plane(name="floor")

panda = functools.cache(lambda: pinimpact.load_robot("panda"))
SIDES = (0.2, 0.3, 0.4)
BOX = pin.Inertia.FromBox(1.5, *SIDES)


def turned(rotation, position=(0.0, 0.0, 0.0)):
    """Return the configuration of a free body."""
    return np.array([*position, *pin.Quaternion(rotation).coeffs()])


def tilted(down):
    """Return a rotation that turns a direction of the body into that of gravity."""
    down = np.array(down, dtype=float) / np.linalg.norm(down)
    return pin.Quaternion.FromTwoVectors(down, np.array([0.0, 0.0, -1.0])).matrix()


def cylinder_inertia(mass, radius, length):
    across = mass * (3.0 * radius**2 + length**2) / 12.0
    return pin.Inertia(mass, np.zeros(3), np.diag([across, across, 0.5 * mass * radius**2]))


def with_explicit_contacts(scene):
    """Return the same scene with explicit contacts instead of shapes, each evaluated separately."""
    return replace(scene, contacts=[replace(contact, shape=None) for contact in scene.contacts])


def same_motion(one, other):
    """Check that two runs agree up to rounding; simultaneous contacts may be numbered differently."""
    assert [i.source for i in one.impacts] == [i.source for i in other.impacts]
    np.testing.assert_allclose(one.t, other.t, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(one.q, other.q, rtol=0.0, atol=1e-12)
    assert [(m.source, m.mode) for m in one.modes] == [(m.source, m.mode) for m in other.modes]
    for part in ("start", "end"):
        times = [[getattr(mode, part) for mode in run.modes] for run in (one, other)]
        np.testing.assert_allclose(*times, rtol=0.0, atol=1e-12)


# ---- boxes


FACES = [(0, 0, -1), (0, 1, 0), (-1, 0, 0)]
EDGES = [(0, SIDES[1], -SIDES[2]), (SIDES[0], 0, SIDES[2])]
CORNERS = [SIDES, (-SIDES[0], SIDES[1], SIDES[2])]


@pytest.mark.parametrize("down", [*FACES, *EDGES, *CORNERS, (0.3, -0.5, 0.9)])
def test_box_is_equivalent_to_its_eight_corners(down):
    robot = shaped_body(coal.Box(*SIDES), BOX)
    scene = Scene(robot, contacts=Contact(geometry="thing_0", plane=FLOOR, friction=0.4, restitution=0.3))
    half = 0.5 * np.array(SIDES)
    corners = [(x, y, z) for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)]
    points = [
        Contact("thing", FLOOR, friction=0.4, restitution=0.3, offset=half * corner, name=shaped.name)
        for corner, shaped in zip(corners, scene.contacts, strict=True)
    ]
    q0, v0 = turned(tilted(down), (0.0, 0.0, 0.5)), np.array([0.2, 0.1, 0.0, 0.0, 0.0, 0.0])
    one, other = run(scene, q0, v0, 0.45), run(Scene(robot, contacts=points), q0, v0, 0.45)
    same_motion(one, other)
    assert len(one.impacts) > 0


@pytest.mark.parametrize(("down", "touching"), [(FACES[1], 4), (EDGES[0], 2), (CORNERS[0], 1)])
def test_impact_includes_touching_tips(down, touching):
    robot = shaped_body(coal.Box(*SIDES), BOX, pin.SE3(pin.utils.rotate("x", 0.4), np.array([0.02, 0, 0.01])))
    shape = robot.collision_model.geometryObjects[0].placement
    q = turned(tilted(down) @ shape.rotation.T, (0.0, 0.0, 1.0))
    v = np.array([0.5, 0.2, -1.0, 0.3, 0.1, -0.2])
    contact = Contact(geometry="thing_0", plane=FLOOR, friction=0.4, restitution=0.3, law="energetic")
    hit = pinimpact.impact(robot, robot.data, q, v, contact)
    corners = [
        Contact("thing", FLOOR, friction=0.4, restitution=0.3, law="energetic", offset=shape.act(0.5 * c))
        for c in np.array([(x, y, z) for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)]) * SIDES
    ]
    corners.sort(key=lambda c: c.gap(robot.model, robot.data, q))
    lowest = corners[0] if touching == 1 else corners[:touching]
    expected = pinimpact.impact(robot.model, robot.data, q, v, lowest)
    assert np.allclose(hit.v, expected.v, rtol=0.0, atol=1e-12)
    assert isinstance(hit, pinimpact.Hit) == (touching == 1)
    wall = Contact("thing", Plane(normal=(0.0, -1.0, 0.0)), friction=0.4, law="energetic")
    listed = pinimpact.impact(robot, robot.data, q, v, [contact, wall])
    expected = pinimpact.impact(robot.model, robot.data, q, v, [*corners[:touching], wall])
    assert np.allclose(listed.v, expected.v, rtol=0.0, atol=1e-12)
    assert contact.gap(robot, robot.data, q) == pytest.approx(corners[0].gap(robot, robot.data, q), abs=1e-15)


# ---- rolling


@pytest.mark.parametrize("friction", [0.6, 0.06])
def test_cylinder_rolls_down_slope(friction):
    angle, radius = 0.3, 0.1
    robot = shaped_body(coal.Cylinder(radius, 0.3), cylinder_inertia(2.0, radius, 0.3))
    normal = np.array([np.sin(angle), 0.0, np.cos(angle)])
    scene = Scene(robot, contacts=Contact(geometry="thing_0", plane=Plane(normal=normal), friction=friction))
    trajectory = run(scene, turned(pin.utils.rotate("x", np.pi / 2), radius * normal), np.zeros(6), 1.0)
    rolls = friction > np.tan(angle) / 3.0
    pull = 2.0 / 3.0 * np.sin(angle) if rolls else np.sin(angle) - friction * np.cos(angle)
    spin = -pull * G / radius if rolls else -2.0 * friction * G * np.cos(angle) / radius
    down = np.array([np.cos(angle), 0.0, -np.sin(angle)])
    assert trajectory.q[-1, :3] == pytest.approx(radius * normal + 0.5 * pull * G * down, abs=1e-8)
    assert abs(trajectory.v[-1, 5]) == pytest.approx(abs(spin), abs=1e-7)
    assert {mode.mode for mode in trajectory.modes} == {"stick" if rolls else "slip"}


def test_capsule_rests_on_its_ends_and_rolls():
    radius, mass, axial = 0.05, 0.7, 0.4 * 0.7 * 0.05**2
    inertia = pin.Inertia(mass, np.zeros(3), np.diag([0.01, 0.01, axial]))
    robot = shaped_body(coal.Capsule(radius, 0.2), inertia)
    scene = Scene(robot, contacts=Contact(geometry="thing_0", plane=FLOOR, friction=0.5))
    lying = turned(pin.utils.rotate("x", np.pi / 2), (0.0, 0.0, radius))
    rest = run(scene, lying, np.zeros(6), 0.2)
    forces = [rest.forces(contact.label, [0.1])[0] for contact in scene.contacts]
    assert forces == pytest.approx(np.array([[0.0, 0.0, 0.5 * mass * G]] * 2), abs=1e-9)
    pushed = run(scene, lying, np.array([0.4, 0, 0, 0, 0, 0]), 1.0)  # slides, then rolls
    speed = np.linalg.norm(pushed.v[-1, :3])
    assert speed == pytest.approx(0.4 / (1.0 + axial / (mass * radius**2)), abs=1e-8)


@pytest.mark.parametrize(("tilt", "precession"), [(60.0, 2.0), (100.0, 3.0), (20.0, 6.0)])
def test_rolling_disc_precesses_steadily(tilt, precession):
    """With θ between axis and vertical: (C + mρ²) Ω ω sin θ = A Ω² sin θ cos θ − m g ρ cos θ."""
    mass, rho, theta = 1.3, 0.2, np.radians(tilt)
    across, along = 0.25 * mass * rho**2, 0.5 * mass * rho**2
    sine, cosine = np.sin(theta), np.cos(theta)
    spin = (across * precession**2 * sine * cosine - mass * G * rho * cosine) / (
        (along + mass * rho**2) * precession * sine
    )
    rotation = pin.utils.rotate("y", theta)
    omega = spin * rotation[:, 2] + precession * sine * np.array([-cosine, 0.0, sine])
    velocity = np.array([0.0, -rho * spin, 0.0])
    robot = free_body(pin.Inertia(mass, np.zeros(3), np.diag([across, across, along])))
    scene = Scene(robot, contacts=Contact("center", FLOOR, friction=5.0, rim=rho, name="rim"))
    trajectory = run(
        scene,
        turned(rotation, (0.0, 0.0, rho * sine)),
        np.concatenate([rotation.T @ velocity, rotation.T @ omega]),
        0.7,
        rtol=1e-10,
        atol=1e-12,
    )
    turn, circle = 0.7 * precession, -rho * spin / precession
    axis = pin.Quaternion(trajectory.q[-1, 3:]).matrix()[:, 2]
    assert axis == pytest.approx([sine * np.cos(turn), sine * np.sin(turn), cosine], abs=1e-9)
    expected = [circle * (np.cos(turn) - 1.0), circle * np.sin(turn), rho * sine]
    assert trajectory.q[-1, :3] == pytest.approx(expected, abs=1e-9)
    force = trajectory.forces_world("rim", [0.4])[0]
    assert np.hypot(*force[:2]) == pytest.approx(mass * abs(rho * spin * precession), abs=1e-7)


def test_wheel_rolls_on_swinging_tray():
    """Both are free to move, and rolling conserves energy."""
    model = pin.Model()
    tray = model.addJoint(0, pin.JointModelRX(), pin.SE3(np.eye(3), np.array([0.0, 0.0, 1.0])), "hinge")
    model.appendBodyToJoint(tray, pin.Inertia.FromBox(3.0, 1.0, 1.0, 0.1), pin.SE3.Identity())
    model.addFrame(pin.Frame("tray", tray, 0, pin.SE3.Identity(), pin.FrameType.BODY))
    wheel = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "wheel")
    model.appendBodyToJoint(wheel, cylinder_inertia(0.5, 0.1, 0.02), pin.SE3.Identity())
    model.addFrame(pin.Frame("hub", wheel, 0, pin.SE3.Identity(), pin.FrameType.BODY))
    model.lowerPositionLimit[0], model.upperPositionLimit[0] = -9.0, 9.0
    contact = Contact("hub", Plane(body="tray", point=(0, 0, 0.05)), friction=4.0, rim=0.1, radius=0.01)
    rotation = pin.utils.rotate("x", np.pi / 2 + 0.1) @ pin.utils.rotate("y", 0.3)
    # move up until the lowest point of the rim touches
    q0 = np.concatenate([[0.0], turned(rotation, (0.1, 0.15, 1.5))])
    q0[3] -= contact.gap(model, model.createData(), q0)
    trajectory = run(Scene(model, contacts=contact), q0, np.array([0.3, *np.zeros(6)]), 0.3, audit=1e-8)
    assert [mode.mode for mode in trajectory.modes if mode.source == contact.label] == ["stick"]
    begun = trajectory.impacts[-1].time if trajectory.impacts else 0.0
    total = (trajectory.energy.kinetic + trajectory.energy.potential)[trajectory.t > begun]
    assert np.ptp(total) < 1e-7 * np.ptp(trajectory.energy.potential)


# ---- time of contact


def solids():
    """Return shapes by name."""
    rng = np.random.default_rng(7)
    return {
        "cylinder": coal.Cylinder(0.1, 0.3),
        "cone": coal.Cone(0.1, 0.3),
        "capsule": coal.Capsule(0.06, 0.3),
        "disc": coal.Cylinder(0.2, 0.002),
        "hull": hull_mesh(rng.normal(size=(60, 3)) * [0.1, 0.15, 0.05]),
    }


def height(robot, q):
    """Return the distance of the shape from the floor by coal, exact up to rounding for a halfspace."""
    shape = robot.collision_model.geometryObjects[0]
    solid = shape.geometry
    if isinstance(solid, coal.BVHModelOBBRSS):
        solid.buildConvexHull(True, "Qt")
        solid = solid.convex
    place = pin.XYZQUATToSE3(q) * shape.placement
    return coal.distance(
        solid,
        coal.Transform3s(place.rotation, place.translation),
        coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0),
        coal.Transform3s(),
        coal.DistanceRequest(),
        coal.DistanceResult(),
    )


@pytest.mark.parametrize("name", list(solids()))
def test_contact_time_of_tumbling_shape_agrees_with_coal(name):
    rng = np.random.default_rng(11)
    placement = pin.SE3(pin.utils.rpyToMatrix(0.3, -0.5, 1.0), np.array([0.02, -0.03, 0.05]))
    robot = shaped_body(solids()[name], pin.Inertia.FromBox(1.0, 0.1, 0.2, 0.3), placement)
    scene = Scene(robot, contacts=Contact(geometry="thing_0", plane=FLOOR))
    for _ in range(4):
        q0 = turned(pin.exp3(2.0 * rng.normal(size=3)), (0.0, 0.0, 0.7))
        trajectory = pinimpact.simulate(scene, q0, rng.normal(size=6) * [1, 1, 1, 9, 9, 9], 0.6)
        first = trajectory.impacts[0].time
        assert abs(height(robot, trajectory.at(first)[0])) <= 5e-16
        # and not before, nor between samples, by the bound of the rate of the distance
        times = np.linspace(0.0, first, 400, endpoint=False)
        states = [trajectory.at(t) for t in times]
        fastest = 1.2 * max(np.linalg.norm(v[:3]) + 0.25 * np.linalg.norm(v[3:]) for _, v in states)
        heights = np.array([height(robot, q) for q, _ in states])
        sure = heights > 0.5 * fastest * first / 400
        assert (heights > 0.0).all()
        assert sure[:-20].all()


def test_hull_is_equivalent_to_corners_of_its_mesh():
    rng = np.random.default_rng(3)
    grid = np.array(np.meshgrid(*[np.linspace(-1.0, 1.0, 5)] * 3)).reshape(3, -1).T
    for points, count in (
        (grid, 8),
        (grid[grid[:, 2] == 1.0], 4),
        (grid[:1], 1),
        (rng.normal(size=(40, 3)), None),
    ):
        corners = extreme_points(points, "thing")
        assert count is None or len(corners) == count
        directions = rng.normal(size=(200, 3))
        assert (directions @ corners.T).max(axis=1) == pytest.approx((directions @ points.T).max(axis=1))
        assert all((points == corner).all(axis=1).any() for corner in corners)


def test_shapes_monitored_as_a_whole_move_as_their_points():
    robot = panda()
    links = ["panda_hand", "panda_leftfinger", "panda_rightfinger", "panda_link6"]
    scene = Scene(robot).contacts_from_geometry(FLOOR, links, friction=0.4, restitution=0.2)
    q0 = robot.q0.copy()
    q0[:7] = 0.0, 0.5, 0.0, -1.8, 0.0, 1.6, 0.7
    same_motion(run(scene, q0, np.zeros(9), 0.45), run(with_explicit_contacts(scene), q0, np.zeros(9), 0.45))


def test_workspace_grows_with_closing_contacts(monkeypatch):
    robot = shaped_body(coal.Box(*SIDES), BOX)
    scene = Scene(robot, contacts=Contact(geometry="thing_0", plane=FLOOR, friction=0.4))
    start = turned(np.eye(3), (0.0, 0.0, 0.3)), np.array([0.3, 0.1, 0.0, 0.0, 0.0, 0.5])
    usual = run(scene, *start, 0.5)
    monkeypatch.setattr(dynamics, "CLOSABLE", 1)
    tight = run(scene, *start, 0.5)
    same_motion(usual, tight)
    name = scene.contacts[0].label
    assert np.array_equal(usual.forces(name, [0.2, 0.4]), tight.forces(name, [0.2, 0.4]))
    stepper = pinimpact.Stepper(scene, *start)
    stepper.step(np.zeros(6), 0.4)
    twin = stepper.copy()
    assert np.array_equal(twin.step(np.zeros(6), 0.1)[0], stepper.step(np.zeros(6), 0.1)[0])


# ---- faces


def can(**keywords):
    robot = shaped_body(coal.Cylinder(0.1, 0.3), cylinder_inertia(2.0, 0.1, 0.3))
    return robot, Scene(robot, contacts=Contact(geometry="thing_0", plane=FLOOR, friction=0.5, **keywords))


def test_rim_of_points_stands():
    _, scene = can(rim_points=6, restitution=0.2)
    assert len(scene.contacts) == 12
    trajectory = run(scene, turned(np.eye(3), (0.0, 0.0, 0.2)), np.array([0.1, 0, 0, 0, 0, 0]), 0.6)
    assert trajectory.q[-1, 2:] == pytest.approx([0.15, 0.0, 0.0, 0.0, 1.0], abs=2e-8)
    forces = sum(trajectory.forces_world(contact.label, [0.59])[0] for contact in scene.contacts)
    assert forces == pytest.approx([0.0, 0.0, 2.0 * G], abs=1e-8)


# ---- monitored shapes


def test_links_out_of_reach_are_excluded():
    robot = panda()
    scene = Scene(robot).contacts_from_geometry(FLOOR, friction=0.3)
    shapes = {contact.shape for contact in scene.contacts}
    assert shapes == {s.name for s in robot.collision_model.geometryObjects} - {"panda_link0_0"}
    frames = {robot.model.frames[s.parentFrame].name for s in robot.collision_model.geometryObjects}
    named = Scene(robot).contacts_from_geometry(FLOOR, sorted(frames))
    assert {contact.shape for contact in named.contacts} == shapes
    reason = scene.plan()["contact guards"].reason
    assert "panda_link1_0 on floor (152 points), panda_link2_0 on floor (152 points)" in reason
    base = Scene(robot, contacts=Contact(geometry="panda_link0_0", plane=FLOOR))
    assert len(base.plan().unreachable) == len(base.contacts) > 0


def test_bounding_spheres_contain_shapes():
    robot = panda()
    scene = Scene(robot).contacts_from_geometry(FLOOR)
    tables = scene.layout().tables(scene.contacts)
    for first, stop, k in tables.blocks:
        centres, radius = tables.constants[first:stop, :3], tables.spheres[k, 3]
        assert np.linalg.norm(centres - tables.spheres[k, :3], axis=1).max() <= radius


def test_reduced_and_merged_robots_keep_shapes():
    whole = panda()
    reduced = whole.buildReducedRobot([8, 9], whole.q0)
    full = Contact(geometry="panda_leftfinger_3", plane=FLOOR)
    q = whole.q0.copy()
    assert full.gap(reduced, reduced.model.createData(), q[:7]) == pytest.approx(
        full.gap(whole, whole.data, q)
    )


# ---- invalid input


def test_invalid_input_raises():
    robot = shaped_body(coal.Box(*SIDES), BOX)
    with pytest.raises(InputError, match="neither a frame nor a geometry"):
        Contact(plane=FLOOR)
    with pytest.raises(InputError, match="the frame 'thing' and the geometry 'thing_0'"):
        Contact("thing", FLOOR, geometry="thing_0")
    with pytest.raises(InputError, match="plane: None"):
        Contact("thing")
    with pytest.raises(InputError, match="offset, radius and rim apply to a frame"):
        Contact(geometry="thing_0", plane=FLOOR, radius=0.1)
    with pytest.raises(InputError, match="rim_points: 2 given"):
        Contact(geometry="thing_0", plane=FLOOR, rim_points=2)
    with pytest.raises(InputError, match="rim_points applies"):
        Contact("thing", FLOOR, rim_points=8)
    with pytest.raises(InputError, match="a rim can make contact with planes only"):
        Contact("thing", Sphere(radius=1.0), rim=0.1)
    with pytest.raises(
        UnknownNameError, match="no collision shape is called 'thing_1'; did you mean 'thing_0'"
    ):
        Scene(robot, contacts=Contact(geometry="thing_1", plane=FLOOR))
    with pytest.raises(InputError, match="a pinocchio Model has no collision shapes"):
        Scene(robot.model, contacts=Contact(geometry="thing_0", plane=FLOOR))
    assert (
        len(
            Scene(
                robot.model, Contact(geometry="thing_0", plane=FLOOR), geometry=robot.collision_model
            ).contacts
        )
        == 8
    )
    with pytest.raises(
        UnknownNameError, match="links: no link 'thong' has a collision shape; did you mean 'thing'"
    ):
        Scene(robot).contacts_from_geometry(FLOOR, links=["thong"])
    with pytest.raises(InputError, match="geometry: 'thing_0' is not a pinocchio GeometryModel"):
        Scene(robot.model, geometry="thing_0")
    with pytest.raises(
        InputError, match="is a box, whose contact points with a sphere depend on the configuration"
    ):
        Contact(geometry="thing_0", plane=Sphere(radius=1.0)).tips(robot)
    ball = Contact(geometry="thing_0", plane=Sphere(radius=1.0))
    with pytest.raises(InputError, match=re.escape("impact() and scenes take it")):
        pinimpact.place_in_contact(robot, robot.data, pin.neutral(robot.model), ball)
    with pytest.raises(InputError, match="is a contact of a collision shape, which has no single point"):
        pinimpact.contact_matrices(
            robot, robot.data, pin.neutral(robot.model), Contact(geometry="thing_0", plane=FLOOR)
        )
    scene = Scene(robot, contacts=Contact(geometry="thing_0", plane=FLOOR))
    with pytest.raises(InputError, match=r"corner 1 on floor' at shape 'thing_0' starts 0.1 m below"):
        pinimpact.simulate(scene, turned(np.eye(3), (0.0, 0.0, 0.1)), np.zeros(6), 0.1)
    for solid, error, words in (
        (coal.Ellipsoid(0.1, 0.2, 0.3), InputError, "'thing_0' is a Ellipsoid, which is not supported"),
        (
            coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0),
            InputError,
            "is a Halfspace, which is not supported",
        ),
        (coal.BVHModelOBBRSS(), ModelError, "'thing_0' has no vertices"),
    ):
        with pytest.raises(error, match=words):
            Contact(geometry="thing_0", plane=FLOOR).tips(shaped_body(solid, BOX))


def test_shape_without_link_uses_frame_of_its_joint():
    model = pin.Model()
    model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "slide")
    shapes = pin.GeometryModel()
    shapes.addGeometryObject(pin.GeometryObject("crate", 1, pin.SE3.Identity(), coal.Box(*SIDES)))
    contact = Contact(geometry="crate", plane=FLOOR)
    with pytest.raises(
        ModelError, match=r"'crate' is attached to joint 1, which has no frame; add one: model.addJoint"
    ):
        contact.tips(pin.RobotWrapper(model, shapes))
    model.addJointFrame(1)
    assert {tip.frame for tip in contact.tips(pin.RobotWrapper(model, shapes))} == {model.getFrameId("slide")}


def test_other_shapes_and_swept_spheres():
    cone = Contact(geometry="thing_0", plane=FLOOR).tips(shaped_body(coal.Cone(0.1, 0.4), BOX))
    assert [(tip.rim, tip.offset[2]) for tip in cone] == [(0.1, -0.2), (0.0, 0.2)]
    flat = mesh([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0.2, 0.2, 0)], [(0, 1, 3), (1, 2, 3)])
    assert len(Contact(geometry="thing_0", plane=FLOOR).tips(shaped_body(flat, BOX))) == 3
    rounded = coal.Box(*SIDES)
    rounded.setSweptSphereRadius(0.01)
    assert {
        tip.radius for tip in Contact(geometry="thing_0", plane=FLOOR).tips(shaped_body(rounded, BOX))
    } == {0.01}
    ball = Contact(geometry="thing_0", plane=Sphere(radius=1.0, name="post")).tips(
        shaped_body(coal.Sphere(0.2), BOX)
    )
    assert [(tip.label, tip.radius) for tip in ball] == [("thing_0 on post", 0.2)]
