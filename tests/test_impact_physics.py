"""Conservation laws and invariances of robots' impacts; batches; errors of input.

The random states depend on the names of the tests.
"""

import pickle

import numpy as np
import pinocchio as pin
import pytest

import pinimpact

from . import robot_cases as cases


@pytest.fixture
def rng(request):
    return np.random.default_rng(list(request.node.name.encode()))


def random_hit(name, rng, law):
    """Return model, data, state, contact and result of a random impact."""
    model, data = cases.load(name)
    model.armature = rng.uniform(0, 0.1, model.nv)
    q, v = cases.random_state(model, rng)
    plane = cases.random_plane(rng, velocity=rng.normal(size=3), angular_velocity=rng.normal(size=3))
    contact = cases.random_contact(cases.FRAMES[name], rng, plane, law=law)
    v = cases.approaching(model, data, q, v, contact)
    return model, data, q, v, contact, pinimpact.impact(model, data, q, v, contact)


@pytest.mark.parametrize("law", pinimpact.LAWS)
@pytest.mark.parametrize("name", cases.FRAMES)
def test_energy_by_pinocchio_is_the_ledger(name, law, rng):
    for _ in range(3):
        model, data, q, v, contact, hit = random_hit(name, rng, law)
        work = hit.solution.work
        before, after = cases.kinetic_energy(model, q, v), cases.kinetic_energy(model, q, hit.v)
        size = before + after + abs(work.compression) + abs(work.restitution) + abs(work.friction)
        assert after - before == pytest.approx(work.total, abs=1e-12 * size)
        mean = (
            0.5
            * hit.solution.impulse
            @ (hit.solution.velocity + pinimpact.contact_matrices(model, data, q, contact).velocity(v))
        )
        assert work.total == pytest.approx(mean + work.surface, abs=1e-12 * size)
        assert hit.solution.impulse[2] > 0


@pytest.mark.parametrize("name", cases.FRAMES)
def test_momentum_changes_by_the_impulse(name, rng):
    model, data, q, v, contact, hit = random_hit(name, rng, "poisson")
    matrices = pinimpact.contact_matrices(model, data, q, contact)
    gained = cases.mass_by_rnea(model, q) @ (hit.v - v)
    assert np.abs(gained - matrices.jacobian.T @ hit.solution.impulse).max() < 1e-12 * np.abs(gained).max()
    assert np.abs(hit.impulse_world - matrices.axes.T @ hit.solution.impulse).max() < 1e-15
    assert np.abs(matrices.velocity(hit.v) - hit.solution.velocity).max() < 1e-12
    alone = pinimpact.solve_impact(hit.problem)
    expected = {
        "delassus": matrices.delassus,
        "velocity": matrices.velocity(v),
        "friction": contact.friction,
        "restitution": contact.restitution,
        "surface_velocity": matrices.surface_velocity,
    }
    for field, value in expected.items():
        assert getattr(hit.problem, field) == pytest.approx(value, rel=1e-12, abs=1e-12), field
    assert hit.problem.law == contact.law
    assert np.abs(alone.impulse - hit.solution.impulse).max() < 1e-10 * np.abs(alone.impulse).max()


@pytest.mark.parametrize("turn", ["any", "upside down", "nearly upside down"])
@pytest.mark.parametrize("name", ["panda", "kinova", "solo12"])
def test_it_does_not_matter_how_the_world_axes_lie(name, turn, rng):
    model, data = cases.load(name)
    q, v = cases.random_state(model, rng)
    plane = pinimpact.Plane(rng.normal(size=3), (0, 0, 1), rng.normal(size=3), rng.normal(size=3))
    settings = {"friction": 0.4, "restitution": 0.6, "offset": rng.normal(scale=0.1, size=3), "radius": 0.05}
    contact = pinimpact.Contact(cases.FRAMES[name], plane, **settings)
    v = cases.approaching(model, data, q, v, contact)
    rotation = {
        "any": cases.random_rotation(rng),
        "upside down": np.diag([1.0, -1.0, -1.0]),
        "nearly upside down": pin.exp3(np.array([1e-13, np.pi, 2e-13])),
    }[turn]
    world = pin.SE3(rotation, rng.normal(size=3))

    turned = model.copy()
    turned_q = q.copy()
    if model.joints[1].nq == 7:  # a free-flyer: its coordinates are the placement of the base
        turned_q[:7] = pin.SE3ToXYZQUAT(world * pin.XYZQUATToSE3(q[:7]))
    else:
        for joint in range(1, model.njoints):
            if model.parents[joint] == 0:
                turned.jointPlacements[joint] = world * model.jointPlacements[joint]
    turned_plane = pinimpact.Plane(
        world.act(np.array(plane.point)),
        *(rotation @ x for x in (plane.normal, plane.velocity, plane.angular_velocity)),
    )
    one = pinimpact.impact(model, data, q, v, contact)
    other = pinimpact.impact(
        turned, turned.createData(), turned_q, v, pinimpact.Contact(contact.frame, turned_plane, **settings)
    )
    assert np.abs(one.v - other.v).max() < 1e-11 * np.abs(v).max()
    assert np.abs(rotation @ one.impulse_world - other.impulse_world).max() < 1e-11
    assert one.solution.status == other.solution.status


def two_bodies(rng):
    """Return a model of two free ellipsoids."""
    body = pinimpact.load_robot("ellipsoid").model
    other = body.copy()
    for model, name in ((body, "one_"), (other, "two_")):
        for frame in model.frames:
            frame.name = name + frame.name
        model.names[1] = name + model.names[1]
    model = pin.appendModel(body, other, 0, pin.SE3(cases.random_rotation(rng), rng.normal(size=3)))
    for joint in (1, 2):
        shape = pin.Inertia.FromEllipsoid(*rng.uniform(0.5, 2, 4))
        model.inertias[joint] = pin.Inertia(shape.mass, 0.1 * rng.normal(size=3), shape.inertia)
    return model


def momentum(model, q, v):
    """Return linear momentum, and angular momentum about the world's origin, summed over bodies."""
    data = model.createData()
    pin.forwardKinematics(model, data, q, v)
    total = sum(
        data.oMi[joint].act(model.inertias[joint] * data.v[joint]).vector for joint in range(1, model.njoints)
    )
    return np.array(total)


@pytest.mark.parametrize("seed", range(5))
def test_two_free_bodies_conserve_linear_and_angular_momentum(seed):
    rng = np.random.default_rng(seed)
    model = two_bodies(rng)
    data = model.createData()
    q, v = cases.random_state(model, rng)
    plane = cases.random_plane(rng, "two_ellipsoid", velocity=rng.normal(size=3))
    contact = cases.random_contact("one_tip", rng, plane)
    v = cases.approaching(model, data, q, v, contact)
    hit = pinimpact.impact(model, data, q, v, contact)
    assert hit.solution.impulse[2] > 0
    before, after = momentum(model, q, v), momentum(model, q, hit.v)
    assert np.abs(after - before).max() < 1e-13 * np.abs(before).max()
    assert np.abs(hit.v[:6] - v[:6]).max() > 1e-3
    assert np.abs(hit.v[6:] - v[6:]).max() > 1e-3
    gained = cases.kinetic_energy(model, q, hit.v) - cases.kinetic_energy(model, q, v)
    assert gained == pytest.approx(hit.solution.work.total, rel=1e-10)


def test_roles_of_the_two_bodies_can_be_exchanged():
    rng = np.random.default_rng(0)
    model = two_bodies(rng)
    data = model.createData()
    q, v = cases.random_state(model, rng)
    pin.framesForwardKinematics(model, data, q)
    one, two = (data.oMf[model.getFrameId(name)].copy() for name in ("one_tip", "two_tip"))
    normal = rng.normal(size=3)
    first = pinimpact.Contact(
        "one_tip",
        pinimpact.Plane(normal=two.rotation.T @ normal, body="two_tip"),
        friction=0.5,
        restitution=0.5,
    )
    # the same contact point as a point of the other body, with the plane on the first body
    second = pinimpact.Contact(
        "two_tip",
        pinimpact.Plane(normal=-one.rotation.T @ normal, body="one_tip"),
        friction=0.5,
        restitution=0.5,
        offset=two.actInv(one.translation),
    )
    v = cases.approaching(model, data, q, v, first)
    hits = [pinimpact.impact(model, data, q, v, contact) for contact in (first, second)]
    assert np.abs(hits[0].v - hits[1].v).max() < 1e-12
    assert np.abs(hits[0].impulse_world + hits[1].impulse_world).max() < 1e-12


def test_two_robots_in_one_model_strike_each_other(rng):
    model, data = cases.two_arms()
    q, v = cases.random_state(model, rng)
    contact = pinimpact.Contact(
        "tool0", cases.random_plane(rng, "other_tool0"), friction=0.3, restitution=0.5
    )
    v = cases.approaching(model, data, q, v, contact)
    hit = pinimpact.impact(model, data, q, v, contact)
    moved = np.abs(hit.v - v) > 1e-6
    assert moved[:6].any()
    assert moved[6:].any()
    gained = cases.kinetic_energy(model, q, hit.v) - cases.kinetic_energy(model, q, v)
    assert gained == pytest.approx(hit.solution.work.total, rel=1e-11)
    assert gained < 0


def test_a_surface_that_moves_is_a_surface_at_rest_for_who_moves_with_it(rng):
    robot = pinimpact.load_robot("ellipsoid")
    drift = rng.normal(size=3)
    v = np.array([1.0, 0.5, -2.0, 0.3, -0.2, 0.7])  # at the neutral configuration, in world axes
    moving = pinimpact.Contact("tip", pinimpact.Plane(velocity=drift), friction=0.3, restitution=0.5)
    still = pinimpact.Contact("tip", pinimpact.Plane(), friction=0.3, restitution=0.5)
    shift = np.array([*drift, 0, 0, 0])
    one = pinimpact.impact(robot.model, robot.data, robot.q0, v + shift, moving)
    other = pinimpact.impact(robot.model, robot.data, robot.q0, v, still)
    assert np.abs(one.v - shift - other.v).max() < 1e-14
    assert one.solution.work.surface == pytest.approx(one.impulse_world @ drift, abs=1e-14)
    assert other.solution.work.surface == 0


def test_a_turntable_drags_as_the_belt_of_its_speed_there(rng):
    robot = pinimpact.load_robot("ellipsoid")
    v = np.array([0, 0, -1.0, 0, 0, 0])
    turntable = pinimpact.Plane(point=(0.3, 0.4, -1.0), angular_velocity=(0, 0, 2.0))
    belt = pinimpact.Plane(point=(0, 0, -1.0), velocity=np.cross([0, 0, 2.0], [-0.3, -0.4, 0]))
    hits = [
        pinimpact.impact(robot.model, robot.data, robot.q0, v, pinimpact.Contact("tip", plane, friction=0.5))
        for plane in (turntable, belt)
    ]
    assert np.abs(hits[0].v - hits[1].v).max() < 1e-15
    assert hits[0].solution.work.surface > 0


def test_a_heavy_carrier_is_a_wall_that_moves(rng):
    model = two_bodies(rng)
    model.inertias[2] = pin.Inertia(1e12, np.zeros(3), 1e12 * np.eye(3))
    data = model.createData()
    q, v = cases.random_state(model, rng)
    carried = pinimpact.Contact(
        "one_tip", cases.random_plane(rng, "two_ellipsoid"), friction=0.5, restitution=0.5
    )
    v = cases.approaching(model, data, q, v, carried)
    pin.forwardKinematics(model, data, q, v)
    pin.updateFramePlacements(model, data)
    frame = model.getFrameId("two_ellipsoid")
    placement, twist = data.oMf[frame], pin.getFrameVelocity(model, data, frame, pin.LOCAL_WORLD_ALIGNED)
    point = placement.act(np.array(carried.plane.point))
    wall = pinimpact.Plane(
        point,
        placement.rotation @ carried.plane.normal,
        twist.linear + np.cross(twist.angular, point - placement.translation),
        twist.angular,
    )
    settings = {name: getattr(carried, name) for name in ("friction", "restitution", "offset", "radius")}
    hits = [
        pinimpact.impact(model, model.createData(), q, v, contact)
        for contact in (carried, pinimpact.Contact("one_tip", wall, **settings))
    ]
    assert np.abs(hits[0].v[:6] - hits[1].v[:6]).max() < 1e-9


def test_no_approach_is_no_impact(rng):
    model, data = cases.load("panda")
    q, v = cases.random_state(model, rng)
    contact = cases.random_contact("panda_hand_tcp", rng)
    v = -cases.approaching(model, data, q, v, contact)
    hit = pinimpact.impact(model, data, q, v, contact)
    assert hit.solution.status == pinimpact.Status.NO_IMPACT
    assert hit.v.tolist() == v.tolist()
    assert hit.impulse_world.tolist() == [0, 0, 0]
    assert hit.solution.segments == ()
    assert hit.solution.work.total == 0


def test_restitution_may_depend_on_the_approach_speed(rng):
    model, data = cases.load("ur5")
    q, v = cases.random_state(model, rng)
    asked = []

    def law(speed):
        asked.append(speed)
        return 1 / (1 + speed)

    plane = cases.random_plane(rng)
    varying = pinimpact.Contact("tool0", plane, friction=0.3, restitution=law)
    v = cases.approaching(model, data, q, v, varying)
    speed = -pinimpact.contact_matrices(model, data, q, varying).velocity(v)[2]
    fixed = pinimpact.Contact("tool0", plane, friction=0.3, restitution=1 / (1 + speed))
    expected = pinimpact.impact(model, data, q, v, fixed)
    for options in ({}, {"record": True}):
        hit = pinimpact.impact(model, data, q, v, varying, **options)
        assert hit.v == pytest.approx(expected.v, abs=1e-13)
    many = pinimpact.impacts(model, data, [q, q], [v, 2 * v], varying)
    assert np.abs(many.v[0] - expected.v).max() < 1e-14
    assert asked == pytest.approx([speed, speed, speed, 2 * speed])
    with pytest.raises(pinimpact.InputError, match="not between 0 and 1"):
        pinimpact.impact(model, data, q, v, pinimpact.Contact("tool0", plane, restitution=lambda speed: 2.0))
    failing = pinimpact.Contact("tool0", plane, restitution=lambda speed: 1 / 0)
    for contact in (failing, [failing]):
        with pytest.raises(pinimpact.InputError, match=r"^restitution: ZeroDivisionError at an approach of"):
            pinimpact.impact(model, data, q, v, contact)


def test_every_way_through_gives_the_same_answer(rng):
    model, data = cases.load("panda")
    q, v = cases.random_state(model, rng)
    contact = cases.random_contact("panda_hand_tcp", rng)
    v = cases.approaching(model, data, q, v, contact)
    direct = pinimpact.impact(model, data, q, v, contact)
    recorded = pinimpact.impact(model, data, q, v, contact, record=True)
    stepped = pinimpact.impact(model, data, q, v, contact, method="euler", steps=20000)
    listed = pinimpact.impact(model, data, q.tolist(), v.tolist(), contact)
    assert np.abs(direct.v - recorded.v).max() < 1e-13
    assert np.abs(direct.v - stepped.v).max() < 1e-3
    assert listed.v.tolist() == direct.v.tolist()
    assert recorded.solution.path is not None
    assert direct.solution.path is None
    assert direct.solution is direct.solution
    for one, other in zip(direct.solution.segments, recorded.solution.segments, strict=True):
        assert (one.mode, one.phase) == (other.mode, other.phase)
        assert (one.start, one.end) == pytest.approx((other.start, other.end))
    assert f"status={direct.solution.status.name}" in repr(direct)


def test_many_states_at_once(rng):
    model, data = cases.load("solo12")
    contact = cases.random_contact("FL_FOOT", rng)
    states = [cases.random_state(model, rng) for _ in range(20)]
    q, v = (np.array(x) for x in zip(*states, strict=True))
    found = pinimpact.impacts(model, data, q, v, contact)
    for row in range(20):
        hit = pinimpact.impact(model, data, q[row], v[row], contact)
        assert found.v[row].tolist() == hit.v.tolist()
        assert found.impulse_world[row] == pytest.approx(hit.impulse_world, rel=1e-14, abs=1e-15)
        assert found.status[row] == hit.solution.status
        assert found.flags[row] == hit.solution.flags
    assert len(set(found.status)) > 1


def test_many_coefficients_at_once(rng):
    model, data = cases.load("ur5")
    q, v = cases.random_state(model, rng)
    plane = cases.random_plane(rng)
    v = cases.approaching(model, data, q, v, pinimpact.Contact("tool0", plane))
    mu, e = np.linspace(0, 1, 5), np.linspace(0, 0.8, 5)
    found = pinimpact.impacts(model, data, [q] * 5, [v] * 5, pinimpact.Contact("tool0", plane), mu, e)
    for row in range(5):
        contact = pinimpact.Contact("tool0", plane, friction=mu[row], restitution=e[row])
        assert found.v[row].tolist() == pinimpact.impact(model, data, q, v, contact).v.tolist()


def test_what_is_given_once_holds_for_all_rows(rng):
    model, data = cases.load("ur5")
    states = [cases.random_state(model, rng) for _ in range(4)]
    qs, vs = (np.array(x) for x in zip(*states, strict=True))
    contact = cases.random_contact("tool0", rng)

    def one_by_one(*rows):
        return [pinimpact.impact(model, data, q, v, contact).v.tolist() for q, v in rows]

    one_q = pinimpact.impacts(model, data, qs[0], vs, contact)
    assert one_q.v.tolist() == one_by_one(*((qs[0], v) for v in vs))
    one_v = pinimpact.impacts(model, data, qs, vs[0], contact)
    assert one_v.v.tolist() == one_by_one(*((q, vs[0]) for q in qs))
    assert pinimpact.impacts(model, data, qs[0], vs[0], contact).v.tolist() == one_by_one((qs[0], vs[0]))
    carried = cases.random_contact("tool0", rng, cases.random_plane(rng, "shoulder_link"))
    found = pinimpact.impacts(model, data, qs, vs, carried)
    hits = [pinimpact.impact(model, data, q, v, carried) for q, v in zip(qs, vs, strict=True)]
    assert found.v.tolist() == [hit.v.tolist() for hit in hits]
    assert found.impulse_world == pytest.approx(np.array([hit.impulse_world for hit in hits]), abs=1e-13)
    mu = np.linspace(0, 1, 5)
    many = pinimpact.impacts(model, data, qs[0], vs[0], contact, friction=mu)
    tiled = pinimpact.impacts(model, data, [qs[0]] * 5, [vs[0]] * 5, contact, friction=mu)
    assert many.v.tolist() == tiled.v.tolist()


def test_hits_can_be_pickled(rng):
    model, data = cases.load("panda")
    q, v = cases.random_state(model, rng)
    plane = cases.random_plane(rng, "panda_link1", velocity=(0.1, 0.2, 0.3))
    contact = cases.random_contact("panda_hand_tcp", rng, plane, name="hand")
    v = cases.approaching(model, data, q, v, contact)
    for options in ({}, {"record": True}, {"locked": ["panda_joint1"]}):
        hit = pinimpact.impact(model, data, q, v, contact, **options)
        again = pickle.loads(pickle.dumps(hit))
        assert again.v.tolist() == hit.v.tolist()
        assert again.impulse_world.tolist() == hit.impulse_world.tolist()
        assert again.solution.segments == hit.solution.segments
        assert again.solution.work == hit.solution.work
        assert (again.solution.path is None) is (not options.get("record"))
        assert again.problem.delassus.tolist() == hit.problem.delassus.tolist()
    hits = pinimpact.impacts(model, data, [q, q], v, contact)
    again = pickle.loads(pickle.dumps(hits))
    assert (again.v.tolist(), again.flags.tolist()) == (hits.v.tolist(), hits.flags.tolist())
    assert pickle.loads(pickle.dumps(contact)) == contact
    struck = pinimpact.impact(model, data, q, v, pickle.loads(pickle.dumps(contact)))
    assert struck.v.tolist() == hits.v[0].tolist()


def test_a_bad_row_spoils_no_other(rng):
    model, data = cases.load("solo12")
    contact = cases.random_contact("FL_FOOT", rng)
    states = [cases.random_state(model, rng) for _ in range(6)]
    q, v = (np.array(x) for x in zip(*states, strict=True))
    good = pinimpact.impacts(model, data, q, v, contact, friction=0.3)
    q[0, 8], v[1, 0], q[2, 3:7] = np.nan, np.inf, 0
    mu = np.array([0.3, 0.3, 0.3, -1.0, 0.3, 0.3])
    found = pinimpact.impacts(model, data, q, v, contact, mu)
    bad = [0, 1, 2, 3]
    assert (found.status[bad] == pinimpact.Status.INVALID_NUMBERS).all()
    assert np.isnan(found.v[bad]).all()
    assert np.isnan(found.impulse_world[bad]).all()
    assert found.v[4:].tolist() == good.v[4:].tolist()
    assert pinimpact.impacts(model, data, q[:0], v[:0], contact).v.shape == (0, model.nv)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"q": np.zeros(6)}, r"q: shape \(6,\) given, \(7,\) expected"),
        ({"q": np.zeros((2, 8))}, "q: shape"),
        ({"q": np.zeros((1, 2, 7))}, "q: shape"),
        ({"q": "home"}, "q: 'home'"),
        ({"v": np.zeros((3, 6))}, "v: shape"),
        ({"friction": np.zeros(3)}, "friction: shape"),
        ({"restitution": [[0.5]]}, "restitution: shape"),
    ],
)
def test_wrong_shapes_of_many_raise(change, message):
    robot = pinimpact.load_robot("ellipsoid")
    arguments = {"q": np.tile(robot.q0, (2, 1)), "v": np.zeros((2, 6))} | change
    with pytest.raises(pinimpact.InputError, match=message):
        pinimpact.impacts(
            robot.model, robot.data, contact=pinimpact.Contact("tip", pinimpact.Plane()), **arguments
        )


@pytest.mark.parametrize("options", [{}, {"record": True}])
@pytest.mark.parametrize(
    ("v", "message"),
    [
        (np.zeros(5), r"v: shape \(5,\) given, \(6,\) expected"),
        ([0, 0, -1, 0, 0, np.nan], "v: .* not finite"),
        ([0, 0, -np.inf, 0, 0, 0], "v: .* not finite"),
        ("fast", "v: 'fast'"),
    ],
)
def test_invalid_velocity_raises(v, message, options):
    robot = pinimpact.load_robot("ellipsoid")
    contact = pinimpact.Contact("tip", pinimpact.Plane())
    with pytest.raises(pinimpact.InputError, match=message):
        pinimpact.impact(robot.model, robot.data, robot.q0, v, contact, **options)


def test_an_approach_that_the_mechanism_cannot_stop(rng):
    model, data = cases.load("ur5")
    plane = pinimpact.Plane(velocity=(0, 0, 1.0))  # rises against the fixed base
    with pytest.raises(pinimpact.UnstoppableApproachError, match="no normal impulse can stop it"):
        pinimpact.impact(
            model, data, pin.neutral(model), np.zeros(6), pinimpact.Contact("base_link", plane, friction=0.5)
        )


@pytest.mark.parametrize("call", [pinimpact.impact, pinimpact.impacts])
def test_invalid_contact_raises(call):
    robot = pinimpact.load_robot("ellipsoid")
    with pytest.raises(pinimpact.InputError, match="contact: 'tip' is not a Contact"):
        call(robot.model, robot.data, robot.q0, np.zeros(6), "tip")


def test_unknown_method_and_option(rng):
    robot = pinimpact.load_robot("ellipsoid")
    state = (robot.model, robot.data, robot.q0, np.zeros(6), pinimpact.Contact("tip", pinimpact.Plane()))
    with pytest.raises(pinimpact.UnknownNameError, match="method: 'magic'"):
        pinimpact.impact(*state, method="magic")
    with pytest.raises(pinimpact.UnknownNameError, match="steps"):
        pinimpact.impact(*state, steps=3)
    with pytest.raises(pinimpact.UnknownNameError, match="lockd: unknown option; did you mean 'locked'"):
        pinimpact.impact(*state, lockd=["tip"])
    with pytest.raises(pinimpact.UnknownNameError, match=r"friction: .*an argument of Contact"):
        pinimpact.impact(*state, friction=0.3)
    with pytest.raises(pinimpact.UnknownNameError, match=r"friction: .*an argument of Contact"):
        pinimpact.impact(*state[:4], [state[4]], friction=0.3)
