"""Common scenes: stairs, the edge of a table, a peg in a hole, a gap between walls, a handover.

Each must reach a possible final state and satisfy the energy balance.
"""

from __future__ import annotations

import dataclasses
import itertools
import warnings

import coal
import numpy as np
import pinocchio as pin
import pytest

from pinimpact import Boundary, Box, Contact, Plane, Scene, Shape, SteppedWarning, simulate
from pinimpact.geometry.convex_pair import gap
from pinimpact.geometry.convex_shape import box
from pinimpact.scene import scene_impacts

from .drawing import one_of_each
from .scene_models import UP, G, unbounded
from .test_time_stepping import boxes


def body(name, size, mass):
    """Return a model with a free box, and its shapes."""
    model, shapes = pin.Model(), pin.GeometryModel()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), name)
    model.appendBodyToJoint(joint, pin.Inertia.FromBox(mass, *size), pin.SE3.Identity())
    model.addJointFrame(joint)
    shapes.addGeometryObject(pin.GeometryObject(f"{name}_0", joint, pin.SE3.Identity(), coal.Box(*size)))
    unbounded(model)
    return model, shapes


def among(size, mass, solids, friction, restitution=0.0):
    """Return a scene of a free box with fixed solids and a floor."""
    model, shapes = body("box", size, mass)
    every = {"floor": Plane(), **solids}
    contacts = [
        Contact(geometry="box_0", plane=solid, friction=friction, restitution=restitution, name=name)
        for name, solid in every.items()
    ]
    return Scene(model, contacts, geometry=shapes)


def stairs(rng):
    """A cube slides off the top of five stairs of 0.2 m."""
    steps = {
        f"step {k}": Box((0.2, 1.0, 1.0 - 0.2 * k), center=(0.2 * k, 0, 0.5 - 0.1 * k)) for k in range(5)
    }
    q0, v0 = (
        pin.SE3ToXYZQUAT(pin.SE3(turned(rng, 0.1), np.array([0, 0, 1.09]))),
        np.array([1.2, *np.zeros(5)]),
    )
    return among((0.1, 0.1, 0.1), 1.0, steps, 0.5), q0, v0 + rng.normal(0.0, 0.1, 6), 1.5


def edge(rng):
    """A cube slides over the edge of a table."""
    table = {"table": Box((1.0, 1.0, 0.1), center=(-0.5, 0, 0.45))}
    q0, v0 = pin.SE3ToXYZQUAT(pin.SE3(turned(rng, 0.1), np.array([-0.2, 0, 0.59]))), [1.3, 0, 0, 0, 0, 0]
    return among((0.1, 0.1, 0.1), 1.0, table, 0.3), q0, v0 + rng.normal(0.0, 0.1, 6), 1.2


def peg(rng):
    """A peg with 1 mm of clearance falls into a hole, or stays on its rim."""
    w = 0.021
    sides = [((0.1, 0.3, 0.1), (w + 0.05, 0)), ((2 * w, 0.1, 0.1), (0, w + 0.05))]
    walls = {
        f"wall {k} {s}": Box(size, center=(s * x, s * y, 0.05))
        for (k, (size, (x, y))), s in itertools.product(enumerate(sides), (-1, 1))
    }
    q0 = pin.SE3ToXYZQUAT(pin.SE3(turned(rng, 0.005), np.array([*rng.normal(0.0, 3e-4, 2), 0.17])))
    return among((0.04, 0.04, 0.1), 0.2, walls, 0.2), q0, rng.normal(0.0, 0.01, 6), 0.6


def walls(rng):
    """A cube falls between two walls, with a clearance of 1 mm on each side."""
    sides = {f"wall {s}": Box((0.1, 1.0, 1.0), center=(s * 0.101, 0, 0.5)) for s in (-1, 1)}
    q0 = pin.SE3ToXYZQUAT(pin.SE3(turned(rng, 0.002), np.array([0, 0, 0.3])))
    return among((0.1, 0.1, 0.1), 1.0, sides, 0.4), q0, np.array([0.3, 0, 0, 0, 1.0, 0]), 0.6


def turned(rng, angle):
    return pin.exp3(rng.normal(0.0, angle, 3))


def lowest(q, size):
    """Return the height of the lowest corner of a box."""
    corners = np.array(list(itertools.product((-0.5, 0.5), repeat=3))) * size
    return (corners @ pin.XYZQUATToSE3(q).rotation.T + q[:3])[:, 2].min()


@pytest.mark.parametrize(("scene", "seed"), one_of_each([stairs, edge, peg, walls], [0, 1, 2]))
def test_box_among_solids_satisfies_energy_balance(scene, seed):
    built, q0, v0, duration = scene(np.random.default_rng(seed))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SteppedWarning)
        run = simulate(built, q0, v0, duration)
    assert run.complete
    mass = pin.computeTotalMass(built.model)
    lost = mass * G * (q0[2] - run.q[-1, 2])
    assert lost > 0.0
    # intervals of time steps are of first order in rotations
    assert np.abs(run.energy.residual).max() < (1e-5 if run.stepped else 1e-6) * lost
    size = (0.04, 0.04, 0.1) if scene is peg else (0.1, 0.1, 0.1)
    assert min(lowest(q, size) for q in run.q) > -1e-6
    steps = simulate(built, q0, v0, duration, scheme="time-stepping", dt=1e-3)
    assert steps.complete
    assert lowest(steps.q[-1], size) > -1e-6
    # first-order energy error of these steps
    assert np.abs(steps.energy.residual).max() < 1e-2 * lost


@pytest.mark.parametrize("restitution", [0.0, 0.5, 1.0])
def test_plank_falling_flat_onto_two_blocks_rebounds_without_rotation(restitution):
    """It hits both at the same time up to rounding, so both contacts belong to one impact."""
    blocks = {side: Box((0.1, 0.2, 0.1), center=(x, 0, 0.05)) for side, x in (("left", -0.4), ("right", 0.4))}
    scene, t = among((1.0, 0.2, 0.05), 2.0, blocks, 0.5, restitution), np.sqrt(2.0 * 0.2 / G)
    run = simulate(scene, [0, 0, 0.325, *UP], np.zeros(6), t + 0.05)
    rise = restitution * G * t - 0.05 * G if restitution > 0.0 else 0.0
    np.testing.assert_allclose(run.v[-1], [0, 0, rise, 0, 0, 0], atol=1e-9)
    assert len({impact.time for impact in run.impacts}) == 1
    assert len(run.impacts) == 4  # the outer corners; those at the inner edges lie between them


def grippers(squeeze):
    """Return a scene of two grippers at a cube: the second closes at 0.15 s, the first opens at 0.3 s."""
    model, shapes = body("cube", (0.05, 0.05, 0.05), 0.1)
    fingers = [(axis, side) for axis in "xy" for side in (-1, 1)]
    for axis, side in fingers:
        slide = pin.JointModelPX() if axis == "x" else pin.JointModelPY()
        base = pin.SE3(np.eye(3), np.array([0, 0, 0.5]))
        joint = model.addJoint(0, slide, base, f"finger {axis}{side}")
        model.appendBodyToJoint(joint, pin.Inertia.FromBox(0.2, 0.02, 0.02, 0.02), pin.SE3.Identity())
        model.addJointFrame(joint)
        size = (0.01, 0.03, 0.03) if axis == "x" else (0.03, 0.01, 0.03)
        shapes.addGeometryObject(
            pin.GeometryObject(f"finger {axis}{side}_0", joint, pin.SE3.Identity(), coal.Box(*size))
        )
    unbounded(model)
    contacts = [
        Contact(geometry="cube_0", plane=Shape(f"finger {a}{s}_0"), friction=0.6, name=f"grasp {a}{s}")
        for a, s in fingers
    ]
    contacts.append(Contact(geometry="cube_0", plane=Plane(), friction=0.5, name="floor"))

    def control(t, q, v):
        tau = np.zeros(model.nv)
        for k, (axis, side) in enumerate(fingers):
            closes = t < 0.3 if axis == "x" else t >= 0.15
            tau[6 + k] = -side * (squeeze if closes else -1.0) - 10.0 * v[6 + k]
        return tau

    q0 = np.array([0, 0, 0.5, *UP, *(side * (0.03 if axis == "x" else 0.04) for axis, side in fingers)])
    return Scene(model, contacts, geometry=shapes, control=control, period=2e-3), q0


@pytest.mark.parametrize("scheme", ["auto", "time-stepping"])
def test_cube_is_handed_over(scheme):
    """Forces of 3 N on each side hold 0.1 kg with μ = 0.6, so the cube does not move."""
    scene, q0 = grippers(3.0)
    run = simulate(scene, q0, np.zeros(10), 0.6, scheme=scheme)
    assert np.abs(run.q[-1, :7] - q0[:7]).max() < 1e-6
    assert np.abs(run.energy.residual).max() < 1e-6 * 0.1 * G * 0.5
    assert run.q[-1, 8] - q0[8] > 0.01
    for axis, force in (("x", 0.0), ("y", 3.0)):
        names = [name for name in run.sources if name.startswith(f"grasp {axis}1")]
        pushes = sum(np.array(run.forces(name, 0.55)) for name in names)
        assert np.ravel(pushes)[-1] == pytest.approx(force, abs=1e-6)


@pytest.mark.parametrize("scheme", ["auto", "time-stepping"])
@pytest.mark.parametrize(("part", "numbering"), one_of_each([0.4, 0.6, 0.8, 1.0, 1.2], [1, -1]))
def test_squeezed_cube_falls_without_rotation(part, numbering, scheme):
    """The squeezing force at eight corners is not unique, but must be mirror symmetric like the scene."""
    squeeze, t = part * 0.1 * G / (2.0 * 0.6), 0.1
    scene, q0 = grippers(squeeze)
    scene = dataclasses.replace(scene, contacts=scene.contacts[::numbering])
    run = simulate(scene, q0, np.zeros(10), t, scheme=scheme)
    fallen = 0.5 * max(G - 2.0 * 0.6 * squeeze / 0.1, 0.0) * t**2
    assert q0[2] - run.q[-1, 2] == pytest.approx(fallen, abs=1e-8)
    assert np.abs(run.q[:, [0, 1, 3, 4, 5]]).max() < 1e-9
    assert np.abs(run.v[:, [0, 1, 3, 4, 5]]).max() < 1e-9


def rack(turn, numbering, restitution):
    """Return a scene of a ball moving towards six touching balls, q, v, and the function `seen`."""
    radius, model, shapes = 0.03, pin.Model(), pin.GeometryModel()
    places = [
        (-0.1, 0.0),
        *((k * 3**0.5 * radius, (2 * j - k) * radius) for k in range(3) for j in range(k + 1)),
    ]
    order = range(7)[::numbering]
    for ball in order:
        joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), f"ball {ball}")
        model.appendBodyToJoint(joint, pin.Inertia.FromSphere(0.2, radius), pin.SE3.Identity())
        model.addJointFrame(joint)
        solid = coal.Sphere(radius)
        shapes.addGeometryObject(pin.GeometryObject(f"ball {ball}_0", joint, pin.SE3.Identity(), solid))
    unbounded(model)
    model.gravity.linear = np.zeros(3)
    contacts = [
        Contact(geometry=f"ball {b}_0", plane=Shape(f"ball {a}_0"), restitution=restitution)
        for a, b in itertools.combinations(order, 2)
    ]
    axes = pin.utils.rotate("z", turn)
    q0 = np.concatenate([[*(axes @ [*places[ball], 0.0]), *UP] for ball in order])
    v0 = np.zeros((7, 6))
    v0[order.index(0), :3] = axes[:, 0]

    def seen(v):
        """Return the velocities of the balls, in the order of their places and axes of the rack."""
        return (v.reshape(7, 6)[:, :3] @ axes)[np.argsort(order)]

    return Scene(model, contacts, geometry=shapes), q0, v0.ravel(), seen


@pytest.mark.parametrize("turn", [0.0, 1.6, 3.8, 5.1])
@pytest.mark.parametrize("numbering", [1, -1])
@pytest.mark.parametrize("restitution", [0.9, 1.0])
def test_rack_of_balls_breaks_symmetrically_in_both_schemes(turn, numbering, restitution):
    """Contacts between balls at rest also belong to the impact of balls that strike them."""
    scene, q0, v0, seen = rack(turn, numbering, restitution)
    breaks = []
    for scheme in ("event-driven", "time-stepping"):
        run = simulate(scene, q0, v0, 0.1, scheme=scheme)
        after = seen(run.v[-1])
        np.testing.assert_allclose(after.sum(axis=0), [1.0, 0.0, 0.0], atol=1e-9)
        mirrored = after[[0, 1, 3, 2, 6, 5, 4]] * [1.0, -1.0, 1.0]
        np.testing.assert_allclose(after, mirrored, atol=1e-9)
        breaks.append(after)
    np.testing.assert_allclose(*breaks, atol=1e-9)


@pytest.mark.filterwarnings("ignore::pinimpact.SteppedWarning")
@pytest.mark.parametrize("scheme", ["time-stepping", "auto"])
@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_impact_whose_waves_are_not_followed_is_that_of_newtons_law(friction, scheme, monkeypatch):
    monkeypatch.setattr(scene_impacts, "BRIEF", 0)
    monkeypatch.setattr(scene_impacts, "FEW", 3)
    monkeypatch.setattr(scene_impacts, "CROWD", 3)
    model, e, height, dt = pin.Model(), 0.6, 0.1, 1e-3
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "box")
    model.appendBodyToJoint(joint, pin.Inertia.FromBox(2.0, 0.2, 0.3, 0.1), pin.SE3.Identity())
    contacts = []
    for k, (x, y) in enumerate(itertools.product((-0.1, 0.1), (-0.15, 0.15))):
        model.addFrame(pin.Frame(f"{k}", joint, pin.SE3(np.eye(3), np.array([x, y, -0.05])), pin.OP_FRAME))
        contacts.append(Contact(f"{k}", Plane(), friction, e))
    unbounded(model)
    fall = (2.0 * height / G) ** 0.5
    q0, duration = np.array([0, 0, 0.05 + height, *UP]), (1.0 + e) * fall  # the end is the next peak
    run = simulate(
        *(Scene(model, contacts), q0, np.zeros(6), duration),
        scheme=scheme,
        dt=dt,
        sensitivities="state" if scheme == "time-stepping" else (),
    )
    assert not run.impacts
    assert scheme == "time-stepping" or "4 contacts take part in an impact" in run.stepped[0].reason
    assert any("Newton's law" in note.text for note in run.notes)
    assert run.q[-1, 2] - 0.05 == pytest.approx(e**2 * height, abs=2.0 * G * fall * dt)
    assert run.energy.residual == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(run.q[-1, [0, 1, 3, 4, 5]], 0.0, atol=1e-9)
    if scheme == "auto":
        return
    left = run.sensitivity(duration)
    assert left.boundary & Boundary.EVENTS_COINCIDE
    assert np.isnan(left.state).all()


def test_locked_joint_is_locked_in_impacts_at_many_contacts(monkeypatch):
    monkeypatch.setattr(scene_impacts, "BRIEF", 0)
    monkeypatch.setattr(scene_impacts, "FEW", 3)
    monkeypatch.setattr(scene_impacts, "CROWD", 3)
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "box")
    model.appendBodyToJoint(joint, pin.Inertia.FromBox(2.0, 0.2, 0.3, 0.1), pin.SE3.Identity())
    slider = model.addJoint(joint, pin.JointModelPZ(), pin.SE3.Identity(), "slider")
    model.appendBodyToJoint(slider, pin.Inertia.FromSphere(1.0, 0.02), pin.SE3.Identity())
    contacts = []
    for k, (x, y) in enumerate(itertools.product((-0.1, 0.1), (-0.15, 0.15))):
        model.addFrame(pin.Frame(f"{k}", joint, pin.SE3(np.eye(3), np.array([x, y, -0.05])), pin.OP_FRAME))
        contacts.append(Contact(f"{k}", Plane(), 0.5, 0.6))
    unbounded(model)
    scene = Scene(model, contacts, locked=("slider",))
    run = simulate(scene, np.array([0, 0, 0.15, *UP, 0]), np.zeros(7), 0.2, scheme="time-stepping")
    assert run.v[-1, 2] > 0.2
    np.testing.assert_allclose(run.q[:, 7], 0.0, atol=1e-12)


def test_pile_with_restitution_gains_no_energy():
    count, size = 6, (0.2, 0.2, 0.1)
    scene = boxes(count, size, 1.0, restitution=0.4)
    q0, rng = np.tile([0, 0, 0, *UP], count), np.random.default_rng(0)
    for k in range(count):
        q0[7 * k : 7 * k + 3] = *rng.normal(0.0, 0.05, 2), 0.06 + 0.13 * k
    run = simulate(scene, q0, np.zeros(6 * count), 0.4, scheme="time-stepping", dt=1e-3)
    assert any("Newton's law" in note.text for note in run.notes)
    model, data = scene.model, scene.model.createData()
    energy = np.array(
        [
            pin.computeKineticEnergy(model, data, q, v) + pin.computePotentialEnergy(model, data, q)
            for q, v in zip(run.q, run.v, strict=True)
        ]
    )
    assert np.diff(energy).max() < 1e-3 * energy[0]


def test_pile_comes_to_rest_without_penetration():
    # boxes rock and rotate fast: impulses at one corner accelerate others into the surface
    count, size = 8, (0.2, 0.2, 0.1)
    scene = boxes(count, size, 1.0)
    q0, rng = np.tile([0, 0, 0, *UP], count), np.random.default_rng(4)
    for k in range(count):
        q0[7 * k : 7 * k + 3] = *rng.normal(0.0, 0.05, 2), 0.06 + 0.13 * k
    run = simulate(scene, q0, np.zeros(6 * count), 2.0, scheme="time-stepping", dt=1e-3)
    assert np.abs(run.v[-1]).max() == 0.0
    shape = box(size)
    worst = 0.0
    for q in run.q[::3]:
        at = [pin.XYZQUATToSE3(q[7 * k : 7 * k + 7]) for k in range(count)]
        placed = [shape.at(one.rotation, one.translation) for one in at]
        worst = min([worst, *(gap(a, b).value for a, b in itertools.pairwise(placed))])
        worst = min([worst, *(one.vertices[:, 2].min() for one in placed)])
    assert worst > -1e-6


@pytest.mark.parametrize(("light", "duration"), [(1e-3, 1.0), (1e-6, 0.1)])
def test_light_box_between_heavy_ones_rests_in_few_steps(light, duration):
    """Rounding errors of forces of 10⁴ N must neither move a box of 1 mg nor shorten the steps."""
    masses, q0 = np.array([1e3, light, 1e3]), np.concatenate([[0, 0, 0.05 + 0.1 * k, *UP] for k in range(3)])
    run = simulate(boxes(3, (0.1, 0.1, 0.1), masses), q0, np.zeros(18), duration, scheme="event-driven")
    assert run.statistics["steps"] < 20
    np.testing.assert_allclose(run.q[-1], q0, rtol=0, atol=1e-10)
    names = [contact.label for contact in run.contacts]
    for k, start in enumerate(("floor 0", "pair 0", "pair 1")):
        held = sum(run.forces(name, 0.05) for name in names if name.startswith(start))
        np.testing.assert_allclose(held[2], masses[k:].sum() * G, rtol=1e-9)


@pytest.mark.filterwarnings("ignore::pinimpact.BoundReachedWarning")
def test_heavy_box_that_has_fallen_on_a_light_one_rests_in_few_steps():
    """The inverse inertias of the heavy box are 10⁻⁷ of those of the light one, and not zero."""
    q0 = np.array([0, 0, 0.05, *UP, 0, 0, 0.3, *UP])
    scene = boxes(2, (0.1, 0.1, 0.1), [1e-3, 1e3], restitution=0.3)
    run = simulate(scene, q0, np.zeros(12), 0.3, scheme="event-driven")
    assert run.statistics["steps"] < 30
    q0[9] = 0.15
    np.testing.assert_allclose(run.q[-1], q0, rtol=0, atol=1e-9)


@pytest.mark.parametrize("weight", [0.0, 1.0])
@pytest.mark.parametrize("press", [1.0, 1e3])
def test_box_pressed_by_far_more_than_its_weight_stays(press, weight):
    """Friction times velocity errors must not increase the energy, with and without gravity."""
    size, mass = (0.1, 0.1, 0.2), 0.1
    model, shapes = body("box", size, mass)
    model.gravity.linear = np.array([0.0, 0.0, -weight * G])
    wall = Contact(geometry="box_0", plane=Plane(), friction=0.5)
    force = np.array([0.1 * press, 0, -press, 0, 0, 0])
    scene, q0 = Scene(model, wall, geometry=shapes, control=lambda t, q, v: force), [0, 0, 0.1, *UP]
    run = simulate(scene, q0, np.zeros(6), 1.0, scheme="event-driven")
    np.testing.assert_allclose(run.q[-1], q0, atol=1e-10)
    pressed = sum(run.forces(name, 0.5) for name in (c.label for c in run.contacts))
    np.testing.assert_allclose(pressed[2], press + weight * mass * G, rtol=1e-9)


def several(pieces, contacts, gravity):
    """Return a scene of free bodies by name, each with a shape, and their configuration."""
    model, shapes = pin.Model(), pin.GeometryModel()
    for name, (shape, _) in pieces.items():
        joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), name)
        model.appendBodyToJoint(joint, pin.Inertia.FromBox(1.0, 0.2, 0.2, 0.2), pin.SE3.Identity())
        model.addJointFrame(joint)
        shapes.addGeometryObject(pin.GeometryObject(name, joint, pin.SE3.Identity(), shape))
    unbounded(model)
    if not gravity:
        model.gravity = pin.Motion.Zero()
    q0 = np.concatenate([pin.SE3ToXYZQUAT(place) for _, place in pieces.values()])
    return Scene(model, contacts, geometry=shapes), q0


@pytest.mark.parametrize("scheme", ["event-driven", "auto", "time-stepping"])
@pytest.mark.parametrize("before", [0.0, 0.1])
@pytest.mark.parametrize("floor", [False, True])
@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("order", [("near", "far"), ("far", "near")])
def test_cube_moves_past_another_that_it_touches_along_an_edge(order, mirrored, floor, before, scheme):
    """A ball pushes it along their common plane, at the start or later; the other cube stays at rest."""
    cube, side = coal.Box(0.2, 0.2, 0.2), -1.0 if mirrored else 1.0
    pieces = {
        "near": (cube, pin.SE3(np.eye(3), np.array([0.0, 0.2 * side, 0.1]))),
        "far": (cube, pin.SE3(np.eye(3), np.array([0.2, 0.0, 0.1]))),
        "ball": (coal.Sphere(0.05), pin.SE3(np.eye(3), np.array([-0.15 - before, 0.2 * side, 0.1]))),
    }
    pairs = [order, ("ball", "near")]
    contacts = [Contact(geometry=a, plane=Shape(b), friction=0.0, name=f"{a} {b}") for a, b in pairs]
    if floor:
        contacts += [Contact(geometry=name, plane=Plane(), friction=0.0) for name in ("near", "far")]
    scene, q0 = several(pieces, contacts, gravity=floor)
    v0 = np.zeros(18)
    v0[12] = 2.0
    run = simulate(scene, q0, v0, 0.15, scheme=scheme)
    assert run.v[-1, :6] == pytest.approx([1.0, 0.0, 0.0, 0.0, 0.0, 0.0], abs=0.02)
    assert run.v[-1, 6:12] == pytest.approx(np.zeros(6), abs=1e-9)
    assert run.q[-1, 7:14] == pytest.approx(q0[7:14], abs=1e-7)


@pytest.mark.parametrize("scheme", ["event-driven", "auto", "time-stepping"])
@pytest.mark.parametrize("force", [(1.0, 0.0), (0.0, -1.0)])
@pytest.mark.parametrize("order", [("near", "far"), ("far", "near")])
def test_force_along_the_side_of_a_cube_moves_another_past_it(order, force, scheme):
    cube = coal.Box(0.2, 0.2, 0.2)
    places = {"near": (0.0, 0.2, 0.1), "far": (0.2, 0.0, 0.1)}
    pieces = {name: (cube, pin.SE3(np.eye(3), np.array(place))) for name, place in places.items()}
    scene, q0 = several(pieces, [Contact(geometry=order[0], plane=Shape(order[1]))], gravity=False)
    tau = np.array([*force, *np.zeros(10)])
    scene = dataclasses.replace(scene, control=lambda t, q, v: tau)
    run = simulate(scene, q0, np.zeros(12), 0.2, scheme=scheme)
    assert run.v[-1] == pytest.approx(0.2 * tau, abs=1e-8)


@pytest.mark.parametrize("scheme", ["event-driven", "auto"])
@pytest.mark.parametrize("order", ["ab", "ba"])
def test_two_boards_that_lean_against_each_other_stay_at_rest(order, scheme):
    """Their upper edges, which carry them, are in contact from the start, without an impact."""
    turned = [pin.utils.rotate("y", angle) for angle in (0.2, -0.2)]
    centers = [-turn @ np.array([x, 0.0, 0.15]) for turn, x in zip(turned, (0.01, -0.01), strict=True)]
    low = min((turned[0] @ np.array([x, 0.0, -0.15]) + centers[0])[2] for x in (-0.01, 0.01))
    pieces = {
        name: (coal.Box(0.02, 0.2, 0.3), pin.SE3(turn, center))
        for name, turn, center in zip("ab", turned, centers, strict=True)
    }
    contacts = [Contact(geometry=order[0], plane=Shape(order[1]), friction=0.6)]
    contacts += [Contact(geometry=name, plane=Plane(point=(0, 0, low)), friction=0.6) for name in "ab"]
    scene, q0 = several(pieces, contacts, gravity=True)
    run = simulate(scene, q0, np.zeros(12), 0.2, scheme=scheme)
    assert not run.impacts
    assert run.q[-1] == pytest.approx(q0, abs=1e-8)
    assert any(mode.source.startswith(f"{order[0]} on {order[1]}") for mode in run.modes)


@pytest.mark.parametrize("scheme", ["event-driven", "auto"])
@pytest.mark.parametrize("tilt", [0.0, 1e-14, 1e-13, 1e-12])
def test_cube_that_spins_on_an_equal_cube_does_not_depend_on_rounding(tilt, scheme):
    """Edges that coincided cross under small angles; their faces determine the normal, as in time steps."""
    cube = coal.Box(0.2, 0.2, 0.2)
    random = np.random.default_rng(4)
    pieces = {
        name: (cube, pin.SE3(pin.exp3(tilt * random.normal(size=3)), np.array([0.0, 0.0, height])))
        for name, height in (("low", 0.1), ("high", 0.3))
    }
    contacts = [
        Contact(geometry="low", plane=Plane(), friction=0.4),
        Contact(geometry="high", plane=Shape("low"), friction=0.4),
    ]
    scene, q0 = several(pieces, contacts, gravity=True)
    v0 = np.array([*np.zeros(11), 4.0])
    run = simulate(scene, q0, v0, 0.3, scheme=scheme)
    steps = simulate(scene, q0, v0, 0.3, scheme="time-stepping", dt=1e-3)
    assert not run.impacts
    assert run.q[-1] == pytest.approx(steps.q[-1], abs=1e-4)
