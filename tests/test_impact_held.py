"""Impacts with held contacts and locked joints, against reduced models."""

import warnings

import numpy as np
import pinocchio as pin
import pytest

import pinimpact
from pinimpact.robot.held import HeldContactWarning
from pinimpact.robot.matrices import contact_geometry

from . import robot_cases as cases


@pytest.fixture
def rng(request):
    return np.random.default_rng(list(request.node.name.encode()))


@pytest.fixture
def quiet():
    """Ignore warnings about held contacts that pull."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", HeldContactWarning)
        yield


GROUND = pinimpact.Plane()
THREE_POINTS = [(0.1, 0, 0), (-0.1, 0.1, 0), (0, -0.1, 0.05)]


def floating_and_fixed(name, rng):
    """Return a robot with a free base, and the same one with a fixed base at the same placement."""
    free, fixed = (pinimpact.load_robot(name, free_flyer=flyer).model for flyer in (True, False))
    base = pin.SE3(cases.random_rotation(rng), rng.normal(size=3))
    for joint in range(1, fixed.njoints):
        if fixed.parents[joint] == 0:
            fixed.jointPlacements[joint] = base * fixed.jointPlacements[joint]
    q, v = cases.random_state(fixed, rng)
    return free, fixed, np.concatenate([pin.SE3ToXYZQUAT(base), q]), np.concatenate([np.zeros(6), v])


@pytest.mark.parametrize("way", ["held in three points", "held in more points", "locked"])
@pytest.mark.parametrize(
    ("name", "frame", "base"), [("ur5", "tool0", "base_link"), ("panda", "panda_hand", "panda_link0")]
)
def test_held_or_locked_base_equals_fixed_base(name, frame, base, way, rng, quiet):
    free, fixed, q, v = floating_and_fixed(name, rng)
    free_data, fixed_data = free.createData(), fixed.createData()
    contact = cases.random_contact(frame, rng)
    v[6:] = cases.approaching(fixed, fixed_data, q[7:], v[6:], contact)
    points = THREE_POINTS + [(0, 0, 0), (0.2, 0.1, -0.1)] * (way == "held in more points")
    held = [pinimpact.Contact(base, GROUND, offset=point) for point in points]
    keep = {"locked": ["root_joint"]} if way == "locked" else {"held": held}
    one = pinimpact.impact(free, free_data, q, v, contact, **keep)
    other = pinimpact.impact(fixed, fixed_data, q[7:], v[6:], contact)
    assert np.abs(one.v[:6]).max() < 1e-13
    assert np.abs(one.v[6:] - other.v).max() < 1e-11
    assert np.abs(one.impulse_world - other.impulse_world).max() < 1e-11
    w = [
        pinimpact.contact_matrices(free, free_data, q, contact, **keep).delassus,
        pinimpact.contact_matrices(fixed, fixed_data, q[7:], contact).delassus,
    ]
    assert np.abs(w[0] - w[1]).max() < 1e-12 * np.abs(w[1]).max()
    if way != "locked":
        # impulses of the ground balance the wrench on the base
        gained = pin.crba(free, free_data, q) @ (one.v - v)
        rows = [contact_geometry(free, free_data, q, anchor) for anchor in held]
        given = sum(
            (seen.axes.T @ seen.jacobian).T @ impulse
            for seen, impulse in zip(rows, one.held_impulses, strict=True)
        )
        struck = contact_geometry(free, free_data, q, contact)
        given = given + (struck.axes.T @ struck.jacobian).T @ one.impulse_world
        assert np.abs(gained - given).max() < 1e-11


@pytest.mark.parametrize("still", [True, False])
def test_locked_joints_equal_removed_joints(still, rng):
    model, data = cases.load("panda")
    q, v = cases.random_state(model, rng)
    names = ["panda_joint2", "panda_joint5", "panda_finger_joint1"]
    ids = [model.getJointId(name) for name in names]
    rows = [model.idx_vs[i] for i in ids]
    free = np.setdiff1d(np.arange(model.nv), rows)
    if still:
        v[rows] = 0
    contact = cases.random_contact("panda_hand_tcp", rng)
    v = cases.approaching(model, data, q, v, contact)
    by_name = pinimpact.impact(model, data, q, v, contact, locked=names)
    by_id = pinimpact.impact(model, data, q, v, contact, locked=ids)
    assert by_name.v.tolist() == by_id.v.tolist()
    assert by_name.v[rows].tolist() == v[rows].tolist()
    if still:
        reduced = pin.buildReducedModel(model, ids, q)
        other = pinimpact.impact(reduced, reduced.createData(), q[free], v[free], contact)
        assert np.abs(by_name.v[free] - other.v).max() < 1e-12
        assert np.abs(by_name.impulse_world - other.impulse_world).max() < 1e-12


def test_locking_one_joint_given_as_string(rng):
    model, data = cases.load("ur5")
    q, v = cases.random_state(model, rng)
    contact = cases.random_contact("tool0", rng)
    v = cases.approaching(model, data, q, v, contact)
    hit = pinimpact.impact(model, data, q, v, contact, locked="elbow_joint")
    assert hit.v[2] == v[2]


def test_locking_all_joints_makes_approach_unstoppable(rng):
    model, data = cases.load("ur5")
    q, v = cases.random_state(model, rng)
    contact = cases.random_contact("tool0", rng)
    v = cases.approaching(model, data, q, v, contact)
    with pytest.raises(pinimpact.UnstoppableApproachError):
        pinimpact.impact(model, data, q, v, contact, locked=list(model.names)[1:])


@pytest.mark.parametrize(
    ("frame", "options"),
    [
        ("tool0", {"locked": list(range(1, 7))}),
        ("tool0", {"stiffening": 1.0}),
        ("base_link", {"record": True}),
    ],
)
def test_separating_point_that_no_impulse_moves_keeps_its_velocity(frame, options, rng):
    # the factor of W = 0 is empty; `v` lacked its last seven entries, and all other results were shifted
    model, data = cases.load("ur5")
    q, v = pin.neutral(model), rng.normal(size=6)
    geometry = contact_geometry(model, data, q, pinimpact.Contact(frame, pinimpact.Plane()))
    velocity = geometry.velocity(v)
    normal = (0, 0, 1) if velocity[2] >= 0.0 else (0, 0, -1)
    plane = pinimpact.Plane(normal=normal, velocity=(0.3, 0.2, 0.0))
    hit = pinimpact.impact(model, data, q, v, pinimpact.Contact(frame, plane, 0.5, 0.5), **options)
    assert hit.v.tolist() == v.tolist()
    assert not hit.impulse_world.any()
    assert hit.axes[2] == pytest.approx(normal, abs=0.0)
    moves = pin.computeFrameJacobian(model, data, q, model.getFrameId(frame), pin.LOCAL_WORLD_ALIGNED)[:3] @ v
    expected = hit.axes @ (moves - plane.velocity)
    assert hit.problem.velocity == pytest.approx(expected, abs=1e-13)
    assert hit.solution.velocity == pytest.approx(expected, abs=1e-13)
    assert hit.solution.status == pinimpact.Status.NO_IMPACT


def test_locked_joint_without_inertia():
    model, data = cases.load("romeo")
    massless = [name for name in model.names if name[1:5] in ("Hand", "Thum", "Fing")]
    contact = pinimpact.Contact("l_sole", pinimpact.Plane())
    q = pin.neutral(model)
    assert np.isfinite(pinimpact.contact_matrices(model, data, q, contact, locked=massless).delassus).all()


def standing(rng, feet=("FL_FOOT", "HR_FOOT")):
    """Return a state of solo12 in which some feet are at rest and the front right one approaches."""
    model, data = cases.load("solo12")
    q, v = cases.random_state(model, rng)
    held = [pinimpact.Contact(foot, GROUND, name=foot) for foot in feet]
    rows = np.vstack([contact_geometry(model, data, q, foot).jacobian for foot in held])
    v -= np.linalg.pinv(rows) @ (rows @ v)
    contact = pinimpact.Contact("FR_FOOT", pinimpact.Plane(), friction=0.5, restitution=0.3)
    return model, data, q, cases.approaching(model, data, q, v, contact), contact, held, rows


def test_held_feet_stay_at_rest_and_momentum_balances(rng, quiet):
    model, data, q, v, contact, held, rows = standing(rng)
    hit = pinimpact.impact(model, data, q, v, contact, held=held)
    assert np.abs(rows @ hit.v).max() < 1e-12
    mass = cases.mass_by_rnea(model, q)
    struck = contact_geometry(model, data, q, contact)
    gained = mass @ (hit.v - v)
    impulses = np.concatenate(hit.held_impulses)  # axes of the ground are those of the world
    balance = struck.jacobian.T @ hit.solution.impulse + rows.T @ impulses
    assert np.abs(gained - balance).max() < 1e-12
    assert hit.solution.work.total == pytest.approx(
        cases.kinetic_energy(model, q, hit.v) - cases.kinetic_energy(model, q, v), rel=1e-10
    )
    # alternative: saddle-point system of the bilateral rows
    saddle = np.block([[mass, rows.T], [rows, np.zeros((6, 6))]])
    response = np.linalg.solve(saddle, np.vstack([struck.jacobian.T, np.zeros((6, 3))]))[: model.nv]
    matrices = pinimpact.contact_matrices(model, data, q, contact, held=held)
    assert np.abs(matrices.response - response).max() < 1e-10 * np.abs(response).max()
    assert (
        np.abs(matrices.delassus - struck.jacobian @ response).max() < 1e-11 * np.abs(matrices.delassus).max()
    )


def test_foot_held_twice_shares_the_impulse(rng, quiet):
    model, data, q, v, contact, held, _ = standing(rng)
    once = pinimpact.impact(model, data, q, v, contact, held=held)
    twice = pinimpact.impact(model, data, q, v, contact, held=[held[0], held[0], held[1]])
    assert np.abs(once.v - twice.v).max() < 1e-11
    assert np.abs(twice.held_impulses[0] - once.held_impulses[0] / 2).max() < 1e-11
    assert np.abs(twice.held_impulses[1] - once.held_impulses[0] / 2).max() < 1e-11
    assert np.abs(twice.held_impulses[2] - once.held_impulses[1]).max() < 1e-11


def test_single_held_contact_without_list(rng, quiet):
    model, data, q, v, contact, held, _ = standing(rng, feet=("FL_FOOT",))
    one, other = (pinimpact.impact(model, data, q, v, contact, held=x) for x in (held, held[0]))
    assert one.v.tolist() == other.v.tolist()


def test_held_impulses_are_in_world_axes_for_any_plane(rng, quiet):
    model, data, q, v, contact, held, _ = standing(rng)
    tilted = [pinimpact.Contact(foot.frame, cases.random_plane(rng)) for foot in held]
    one, other = (pinimpact.impact(model, data, q, v, contact, held=feet) for feet in (held, tilted))
    assert np.abs(one.held_impulses - other.held_impulses).max() < 1e-12
    assert one.held_impulses.shape == (2, 3)
    assert pinimpact.impact(model, data, q, v, contact).held_impulses.shape == (0, 3)


def test_closed_loop_stays_closed(rng, quiet):
    """The hands of two arms in one model are held together while one arm is struck."""
    model, data = cases.two_arms()
    q, v = cases.random_state(model, rng)
    loop = pinimpact.Contact("tool0", pinimpact.Plane(body="other_tool0"))
    rows = contact_geometry(model, data, q, loop).jacobian
    v -= np.linalg.pinv(rows) @ (rows @ v)
    contact = cases.random_contact("wrist_2_link", rng)
    v = cases.approaching(model, data, q, v, contact)
    hit = pinimpact.impact(model, data, q, v, contact, held=[loop])
    assert np.abs(rows @ hit.v).max() < 1e-12
    assert np.abs(hit.v[6:] - v[6:]).max() > 1e-6  # the other arm is coupled
    assert hit.solution.work.total == pytest.approx(
        cases.kinetic_energy(model, q, hit.v) - cases.kinetic_energy(model, q, v), rel=1e-10
    )


def test_pulling_held_contact_causes_warning():
    """A body of unit mass and inertia on a hinge beside its centre is stopped by an impulse from below."""
    robot = pinimpact.load_robot("ellipsoid")
    model, data, q = robot.model, robot.data, robot.q0
    struck = pinimpact.Contact("ellipsoid", pinimpact.Plane(), offset=(2, 0, 0))
    held = pinimpact.Contact("ellipsoid", pinimpact.Plane(), offset=(1, 0, 0), name="hinge")
    v = np.array([0, 0, 1.0, 0, 1.0, 0])  # rotates about the hinge, with the long end moving down
    with pytest.warns(HeldContactWarning, match="'hinge' pulls on its surface with 3 N s"):
        hit = pinimpact.impact(model, data, q, v, struck, held=held)
    assert hit.impulse_world == pytest.approx([0, 0, 2])
    assert hit.held_impulses[0] == pytest.approx([0, 0, -3])
    other_side = pinimpact.Contact("ellipsoid", pinimpact.Plane(), offset=(-1, 0, 0))
    v = np.array([0, 0, -1.0, 0, 1.0, 0])
    pushed = pinimpact.impact(model, data, q, v, struck, held=[other_side])
    assert pushed.impulse_world == pytest.approx([0, 0, 2 / 3])
    assert pushed.held_impulses[0] == pytest.approx([0, 0, 1 / 3])


def test_moving_held_contact_raises(rng):
    model, data, q, v, contact, held, _ = standing(rng)
    moving = v + 0.01 * rng.normal(size=model.nv)
    with pytest.raises(pinimpact.InputError, match=r"held: 'FL_FOOT' moves at .* m/s"):
        pinimpact.impact(model, data, q, moving, contact, held=held)
    belt = pinimpact.Contact("FL_FOOT", pinimpact.Plane(velocity=(1, 0, 0)))
    with pytest.raises(pinimpact.InputError, match="moves at 1 m/s"):
        pinimpact.impact(model, data, q, v, contact, held=[belt])


@pytest.mark.filterwarnings("ignore::pinimpact.HeldContactWarning")
def test_held_point_with_rounding_errors_of_velocity_is_accepted(rng):
    """The held point requires zero velocities of three joints, here zero up to rounding errors."""
    robot = pinimpact.load_robot("ur5")
    model, data, q = robot.model, robot.data, rng.uniform(-1.0, 1.0, 6)
    tool = pinimpact.Contact("tool0", pinimpact.Plane(), friction=0.4, restitution=0.3, law="energetic")
    held = [pinimpact.Contact("wrist_1_link", pinimpact.Plane())]
    v = np.array([0.0, 0.0, 0.0, *rng.normal(size=3)])
    v *= -np.sign(pinimpact.contact_matrices(model, data, q, tool).velocity(v)[2])
    nearly = v + 1e-15 * rng.normal(size=6)
    expected = pinimpact.impact(model, data, q, v, tool, held=held)
    assert np.abs(expected.impulse_world).max() > 0.01
    several = pinimpact.impact(model, data, q, nearly, [tool], held=held)
    batch = pinimpact.impacts(model, data, q, nearly[None], tool, held=held)
    derivatives = pinimpact.impact_derivatives(model, data, q, nearly, tool, held=held)
    one = pinimpact.impact(model, data, q, nearly, tool, held=held)
    for after in (one.v, several.v, batch.v[0], derivatives.v):
        np.testing.assert_allclose(after, expected.v, rtol=0, atol=1e-12)


@pytest.mark.parametrize("held", ["FL_FOOT", ["FL_FOOT"], [None]])
def test_invalid_held_contacts_raise(held, rng):
    model, data, q, v, contact, *_ = standing(rng)
    with pytest.raises(pinimpact.InputError, match=r"held: .* is not a Contact"):
        pinimpact.impact(model, data, q, v, contact, held=held)


@pytest.mark.parametrize(
    ("keep", "message"),
    [
        ({"held": [pinimpact.Contact("FL_FOT", GROUND)]}, "'FL_FOOT'"),
        ({"locked": ["FL_HA"]}, "locked: no joint is called 'FL_HA'; did you mean 'FL_HAA'"),
        ({"locked": [99]}, "locked: there is no joint 99"),
        ({"locked": [0]}, "locked: there is no joint 0"),
    ],
)
def test_unknown_names(keep, message, rng):
    model, data, q, v, contact, _, _ = standing(rng)
    with pytest.raises(pinimpact.UnknownNameError, match=message):
        pinimpact.impact(model, data, q, v, contact, **keep)


@pytest.mark.filterwarnings("ignore::pinimpact.HeldContactWarning")
@pytest.mark.parametrize(("robot", "held"), [("panda", ()), ("solo12", ()), ("solo12", ("HR_FOOT",))])
def test_joint_reactions_satisfy_momentum_balance_of_links(robot, held):
    model, data = cases.load(robot)
    rng = np.random.default_rng(7)
    model.armature = rng.uniform(0, 0.3, model.nv) * (np.arange(model.nv) >= model.nv - 9)
    contact = pinimpact.Contact(cases.FRAMES[robot], GROUND, friction=0.4, restitution=0.5, radius=0.02)
    if robot == "panda":  # a plane fixed to another link
        contact = pinimpact.Contact("panda_hand_tcp", pinimpact.Plane(body="panda_link3"), 0.4, 0.5)
    anchors = [pinimpact.Contact(frame, GROUND) for frame in held]
    q, v = cases.random_state(model, rng)
    matrices = pinimpact.contact_matrices(model, data, q, contact, anchors)
    rows = np.vstack([np.zeros((0, model.nv)), *(anchor.jacobian for anchor in matrices.held)])
    v -= np.linalg.pinv(rows) @ rows @ v
    v *= -np.sign(matrices.velocity(v)[2])
    hit = pinimpact.impact(model, data, q, v, contact, held=anchors)
    found = hit.joint_reactions(model, data, q, v, anchors)
    pushes = [hit.impulse_world, *hit.held_impulses]
    check_balance(model, data, q, hit.v - v, found, [contact, *anchors], pushes)


def check_balance(model, data, q, change, found, contacts, pushes):
    """Check that the wrenches through the joints and the impulses at contacts change the momenta of links."""
    pin.forwardKinematics(model, data, q, change)
    pin.updateFramePlacements(model, data)
    momenta = [data.oMi[i].act(model.inertias[i] * data.v[i]).vector for i in range(model.njoints)]
    momenta[0] = np.zeros(6)
    wrenches = [found[0], *(data.oMi[i].act(pin.Force(found[i])).vector for i in range(1, model.njoints))]
    balance = np.array(momenta)
    for i in range(1, model.njoints):
        balance[i] -= wrenches[i]
        balance[model.parents[i]] += wrenches[i]
    balance[0] += wrenches[0]
    for one, push in zip(contacts, pushes, strict=True):
        at = contact_geometry(model, data, q, one).point
        tip = model.frames[model.getFrameId(one.frame)].parentJoint
        balance[tip] -= [*push, *np.cross(at, push)]
        if one.plane.body is not None:
            base = model.frames[model.getFrameId(one.plane.body)].parentJoint
            balance[base] += [*push, *np.cross(at, push)]
    assert np.abs(balance).max() < 1e-12 * np.abs(wrenches).max()
    for i in range(1, model.njoints):  # along its axes a joint transmits only the impulse on its rotor
        own = slice(model.idx_vs[i], model.idx_vs[i] + model.nvs[i])
        free = np.asarray(data.joints[i].S).T @ found[i] + model.armature[own] * change[own]
        assert np.abs(free).max() < 1e-11 * np.abs(wrenches).max()


@pytest.mark.filterwarnings("ignore::pinimpact.HeldContactWarning")
@pytest.mark.parametrize("held", [(), ("HR_FOOT",)])
@pytest.mark.parametrize("policy", ["propagate", "together"])
def test_joint_reactions_of_impact_at_many_contacts(policy, held):
    model, data = cases.load("solo12")
    rng = np.random.default_rng(11)
    model.armature = rng.uniform(0, 0.3, model.nv) * (np.arange(model.nv) >= 6)
    contacts = [
        pinimpact.Contact("FL_FOOT", GROUND, friction=0.4, restitution=0.5, radius=0.02),
        pinimpact.Contact("FR_FOOT", pinimpact.Plane(body="HL_UPPER_LEG"), friction=0.3, restitution=0.2),
    ]
    anchors = [pinimpact.Contact(frame, GROUND) for frame in held]
    q, v = cases.random_state(model, rng)
    matrices = [pinimpact.contact_matrices(model, data, q, one, anchors) for one in contacts]
    rows = np.vstack([one.jacobian[2:] for one in matrices] + [one.jacobian for one in matrices[0].held])
    wanted = np.r_[-1.0, -0.7, np.zeros(len(rows) - 2)]
    v += np.linalg.pinv(rows) @ (wanted - rows @ v)
    hit = pinimpact.impact(model, data, q, v, contacts, held=anchors, simultaneous=policy)
    assert (hit.solution.impulse[:, 2] > 0).all()
    found = hit.joint_reactions(model, data, q, v, anchors)
    pushes = [*hit.impulses_world, *hit.held_impulses]
    check_balance(model, data, q, hit.v - v, found, [*contacts, *anchors], pushes)
    with pytest.raises(pinimpact.InputError, match="held: 2 given, "):
        hit.joint_reactions(model, data, q, v, [anchors[0] if held else contacts[0]] * 2)


@pytest.mark.parametrize("scheme", ["event-driven", "time-stepping"])
@pytest.mark.parametrize("angles", [(0.99, 0.2), (0.99, 0.999)])
def test_locked_joint_reaching_its_limit_raises(scheme, angles):
    """No impulse changes its velocity; rounding errors of the projected inverse mass matrix are ignored."""
    model, joint = pin.Model(), 0
    for k in range(3):
        place = pin.SE3(np.eye(3), np.array([0.3 if k else 0.0, 0, 0]))
        joint = model.addJoint(joint, pin.JointModelRY(), place, f"j{k}")
        rod = pin.Inertia(0.5, np.array([0.15, 0, 0]), 0.01 * np.eye(3))
        model.appendBodyToJoint(joint, rod, pin.SE3.Identity())
    model.lowerPositionLimit[:], model.upperPositionLimit[:] = -1.0, 1.0
    scene = pinimpact.Scene(model, locked=["j0"])
    q0, v0 = np.array([*angles, -0.3]), np.array([1.0, 2.5, 0.0])
    with pytest.raises(pinimpact.SimulationError, match="'j0 upper' is hit"):
        pinimpact.simulate(scene, q0, v0, 0.05, scheme=scheme)
