"""The cases of docs/hard-cases.md that need a robot: 8, 9 and 10."""

import numpy as np
import pinocchio as pin
import pytest

import pinimpact
from pinimpact import Flag, Status

from . import robot_cases as cases

LAWS = pinimpact.LAWS
ROBOTS = {
    **cases.FRAMES,
    "icub": "r_sole",  # free-flyer
}


@pytest.fixture
def rng(request):
    return np.random.default_rng(list(request.node.name.encode()))


def checked_impact(model, q, v, contact):
    """Compute an impact and compare its work with Pinocchio's energies before and after."""
    data = model.createData()
    hit = pinimpact.impact(model, data, q, v, contact)
    work = hit.solution.work
    before, after = cases.kinetic_energy(model, q, v), cases.kinetic_energy(model, q, hit.v)
    size = before + after + abs(work.compression) + abs(work.restitution) + abs(work.friction)
    assert np.isfinite(hit.v).all()
    assert after - before == pytest.approx(work.total, abs=1e-9 * size)
    assert hit.solution.velocity[2] >= 0
    return hit


@pytest.mark.parametrize("name", ROBOTS)
def test_10_energy_of_robots(name, rng):
    model = cases.load(name)[0]
    for law in LAWS:
        for _ in range(4):
            q, v = cases.random_state(model, rng)
            v *= 10.0 ** rng.uniform(-3, 3)
            contact = cases.random_contact(ROBOTS[name], rng, law=law)
            v = cases.approaching(model, model.createData(), q, v, contact)
            checked_impact(model, q, v, contact)


@pytest.mark.parametrize("name", ["solo12", "talos"])
def test_10_the_placement_of_the_base_does_not_matter(name, rng):
    """Moving robot and plane together changes neither joint velocities nor the base velocity in base axes."""
    model = cases.load(name)[0]
    q, v = cases.random_state(model, rng)
    plane = cases.random_plane(rng)
    contact = cases.random_contact(ROBOTS[name], rng, plane)
    v = cases.approaching(model, model.createData(), q, v, contact)
    here = pinimpact.impact(model, model.createData(), q, v, contact)
    move = pin.SE3(cases.random_rotation(rng), rng.normal(size=3) * 10)
    base = move * pin.XYZQUATToSE3(q[:7])
    moved_q = np.concatenate([pin.SE3ToXYZQUAT(base), q[7:]])
    moved = pinimpact.Plane(point=move.act(np.array(plane.point)), normal=move.rotation @ plane.normal)
    settings = dict(friction=contact.friction, restitution=contact.restitution, law=contact.law)
    elsewhere = pinimpact.Contact(
        contact.frame, moved, offset=contact.offset, radius=contact.radius, **settings
    )
    there = pinimpact.impact(model, model.createData(), moved_q, v, elsewhere)
    assert there.v == pytest.approx(here.v, abs=1e-10 * np.abs(v).max())
    assert there.impulse_world == pytest.approx(move.rotation @ here.impulse_world, rel=1e-10, abs=1e-12)


def chain(masses, lengths=None, axes="YZ", inertia=0.01):
    """Return a chain of rods with alternating axes; `inertia` is that of a rod about its centre over m l²."""
    model = pin.Model()
    parent = 0
    lengths = np.full(len(masses), 0.2) if lengths is None else lengths
    for k, mass in enumerate(masses):
        joint = {"Y": pin.JointModelRY, "Z": pin.JointModelRZ}[axes[k % len(axes)]]()
        place = pin.SE3(np.eye(3), np.array([lengths[k - 1] if k else 0.0, 0, 0]))
        parent = model.addJoint(parent, joint, place, f"joint{k}")
        link = pin.Inertia(
            mass, np.array([lengths[k] / 2, 0, 0]), np.eye(3) * inertia * mass * lengths[k] ** 2
        )
        model.appendBodyToJoint(parent, link, pin.SE3.Identity())
    tip = pin.SE3(np.eye(3), np.array([lengths[-1], 0, 0]))
    model.addFrame(pin.Frame("tip", parent, 0, tip, pin.FrameType.OP_FRAME))
    return model


def struck(model, rng, law="energetic", speed=1.0, scale=0.5):
    q = rng.uniform(-scale, scale, model.nv)
    v = rng.normal(size=model.nv) * speed
    contact = cases.random_contact("tip", rng, law=law, offset=(0, 0, 0), radius=0.0)
    return q, cases.approaching(model, model.createData(), q, v, contact), contact


def test_10_a_chain_of_sixty_joints(rng):
    model = chain(np.full(60, 0.5))
    for law in LAWS:
        checked_impact(model, *struck(model, rng, law))


@pytest.mark.parametrize("masses", [np.logspace(4, -4, 8), np.logspace(-4, 4, 8), [1, 1e-8, 1, 1e8]])
def test_10_inertia_ratios_of_1e8_along_a_chain(masses, rng):
    """The condition number of the mass matrix is at least 1e8; the energy balance shows its accuracy."""
    model = chain(np.asarray(masses, dtype=float))
    for _ in range(5):
        checked_impact(model, *struck(model, rng))


@pytest.mark.parametrize("inertia", [1e-6, 1e-12])
def test_10_links_with_nearly_no_inertia(inertia, rng):
    model = chain([1.0, 1.0, 1e-9, 1.0], inertia=inertia)
    for _ in range(5):
        checked_impact(model, *struck(model, rng))


def test_10_a_mass_matrix_that_is_singular_is_named(rng):
    """The last link has no inertia; the message names its joint."""
    model = chain([1.0, 1.0, 0.0])
    with pytest.raises(pinimpact.ModelError, match="joint2"):
        pinimpact.impact(model, model.createData(), *struck_blindly(model, rng))


def head(apart):
    """Return a body with a point mass on three axes, one `apart` from the intersection of the others."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
    model.appendBodyToJoint(joint, pin.Inertia.FromBox(3.0, 0.3, 0.2, 0.1), pin.SE3.Identity())
    corner = pin.SE3(np.eye(3), np.array([0.15, 0.1, -0.05]))
    model.addFrame(pin.Frame("tip", joint, 0, corner, pin.FrameType.OP_FRAME))
    for name, axis, place in (
        ("pitch", pin.JointModelRY(), [0.03, 0.02, 0.2]),
        ("roll", pin.JointModelRX(), [0.0, 0.0, 0.0]),
        ("yaw", pin.JointModelRZ(), [0.0, apart, 0.0]),
    ):
        joint = model.addJoint(joint, axis, pin.SE3(np.eye(3), np.array(place)), name)
    mass = pin.Inertia(1.3, np.array([0.1, 1e-6, 0.12]), np.zeros((3, 3)))  # next to the plane of two axes
    model.appendBodyToJoint(joint, mass, pin.SE3.Identity())
    return model


def test_10_joints_that_together_move_no_inertia_are_named():
    """A point mass has no inertia about the line to the intersection of axes; pivots of M are positive."""
    contact = pinimpact.Contact("tip", pinimpact.Plane(), friction=0.3)
    v = np.array([0.2, 0.0, -1.0, *np.zeros(6)])
    for apart in (0.0, 1e-8):
        model = head(apart)
        message = r"joint '(pitch|roll|yaw)' \(velocity [678]\) moves no inertia"
        with pytest.raises(pinimpact.ModelError, match=message):
            pinimpact.impact(model, model.createData(), pin.neutral(model), v, contact)
        with pytest.raises(pinimpact.ModelError, match=message):
            pinimpact.simulate(pinimpact.Scene(model), pin.neutral(model), v, 0.1)
    model = head(1e-4)
    checked_impact(model, pin.neutral(model), v, contact)


def struck_blindly(model, rng):
    plane = pinimpact.Plane(normal=(0, 0, 1))
    contact = pinimpact.Contact("tip", plane, friction=0.3, restitution=0.5)
    return rng.uniform(-0.5, 0.5, model.nv), rng.normal(size=model.nv), contact


@pytest.mark.parametrize("scale", [1e-6, 1e-3, 1e3, 1e6])
def test_9_lengths_from_micrometres_to_kilometres(scale, rng):
    """A chain scaled by s has the same joint velocities after the impact."""
    model, scaled = chain(np.ones(4)), chain(np.ones(4), np.full(4, 0.2 * scale))
    q, v, contact = struck(model, rng)
    small = pinimpact.impact(model, model.createData(), q, v, contact)
    large = pinimpact.impact(scaled, scaled.createData(), q, v, contact)
    assert large.v == pytest.approx(small.v, rel=1e-9, abs=1e-10)
    assert large.impulse_world == pytest.approx(scale * small.impulse_world, rel=1e-9, abs=1e-10 * scale)


def test_8_full_extension_hit_along_the_arm():
    """A stretched chain cannot yield along itself: W is singular, and an approach along it is unstoppable."""
    model = chain(np.ones(3), axes="Y")
    plane = pinimpact.Plane(point=(0.6, 0, 0), normal=(-1, 0, 0))
    contact = pinimpact.Contact("tip", plane, friction=0.3, restitution=0.5)
    matrices = pinimpact.contact_matrices(model, model.createData(), np.zeros(3), contact)
    assert np.linalg.matrix_rank(matrices.delassus) == 1
    away = pinimpact.impact(model, model.createData(), np.zeros(3), np.ones(3), contact)
    assert away.solution.status == Status.NO_IMPACT  # all of its velocity is along the plane
    for bend in (1e-3, 1e-6):  # nearly stretched, with a decreasing response
        q = np.array([-bend, 2 * bend, -bend])
        contact = pinimpact.Contact("tip", plane, friction=0.0, restitution=0.5)
        v = np.array([1.0, -2.0, 1.0])
        v *= -np.sign(pinimpact.contact_matrices(model, model.createData(), q, contact).velocity(v)[2])
        checked_impact(model, q, v, contact)


@pytest.mark.parametrize("name", ["ur5", "panda"])
def test_8_arms_stretched_out(name, rng):
    robot = pinimpact.load_robot(name)
    q, v = pin.neutral(robot.model), rng.normal(size=robot.model.nv)
    contact = cases.random_contact(ROBOTS[name], rng, law="energetic")
    checked_impact(robot.model, q, cases.approaching(robot.model, robot.data, q, v, contact), contact)


def test_8_a_frame_on_the_base():
    """W = 0: a fixed frame has no impact, and the approach of a moving surface is unstoppable."""
    model = cases.load("panda")[0]
    v = np.ones(model.nv)
    still = pinimpact.Contact("panda_link0", pinimpact.Plane(), friction=0.3, restitution=0.5)
    hit = pinimpact.impact(model, model.createData(), pin.neutral(model), v, still)
    assert hit.solution.status == Status.NO_IMPACT
    assert hit.v.tolist() == v.tolist()
    rising = pinimpact.Plane(velocity=(0, 0, 1))
    with pytest.raises(pinimpact.UnstoppableApproachError):
        pinimpact.impact(
            model,
            model.createData(),
            pin.neutral(model),
            v,
            pinimpact.Contact("panda_link0", rising, friction=0.3, restitution=0.5),
        )


@pytest.mark.parametrize("law", LAWS)
def test_8_the_pendulum_as_pinocchio_forms_it(law, rng):
    """A spherical pendulum: W has rank two, and an eigenvalue of the order of rounding of either sign."""
    model = chain([0.0, 1.0], [0.0, 1.0], axes="ZY", inertia=1 / 12)
    smallest = []
    for _ in range(30):
        q, v = np.array([rng.uniform(-3, 3), 0.9]), np.array([0.3, -1.0])
        contact = pinimpact.Contact("tip", pinimpact.Plane(), friction=3.0, restitution=0.5, law=law)
        v = cases.approaching(model, model.createData(), q, v, contact)
        matrices = pinimpact.contact_matrices(model, model.createData(), q, contact)
        smallest.append(np.linalg.eigvalsh(matrices.delassus)[0])
        hit = pinimpact.impact(model, model.createData(), q, v, contact)
        assert hit.solution.status == Status.LOCKED
        assert Flag.SINGULAR_DELASSUS in hit.solution.flags
        assert np.abs(hit.v).max() < 1e-14
    assert min(smallest) < 0 < max(smallest)
