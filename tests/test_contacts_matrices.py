"""Gap, J, M and W of contacts, against finite differences, inverse dynamics and dense algebra.

The random states depend on the names of the tests.
"""

import dataclasses
import gc
import weakref

import numpy as np
import pinocchio as pin
import pytest

import pinimpact
from pinimpact.geometry.surfaces import contact_axes
from pinimpact.robot.matrices import contact_geometry

from . import robot_cases as cases


@pytest.fixture
def rng(request):
    return np.random.default_rng(list(request.node.name.encode()))


def points(model, contact, q):
    """Return contact point, gap and normal by forward kinematics, and the point in axes of both frames."""
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    surface, frame = contact.plane, data.oMf[model.getFrameId(contact.frame)]
    carrier = pin.SE3.Identity() if surface.body is None else data.oMf[model.getFrameId(surface.body)]
    tip = frame.act(np.array(contact.offset))
    if isinstance(surface, pinimpact.Plane):
        normal = carrier.rotation @ surface.normal
        distance = normal @ (tip - carrier.act(np.array(surface.point)))
    else:
        away = tip - carrier.act(np.array(surface.center))
        distance = np.linalg.norm(away) - surface.radius
        normal = away / np.linalg.norm(away)
    point = tip - contact.radius * normal
    return point, distance - contact.radius, normal, frame.actInv(point), carrier.actInv(point)


@pytest.mark.parametrize("surface", [cases.random_plane, cases.random_sphere])
@pytest.mark.parametrize("body", [None, "panda_link2"])
def test_gap_and_jacobian_are_those_of_the_moving_points(rng, body, surface):
    model, data = cases.load("panda")
    for _ in range(10):
        q, v = cases.random_state(model, rng)
        contact = cases.random_contact("panda_hand_tcp", rng, surface(rng, body))
        matrices = pinimpact.contact_matrices(model, data, q, contact)
        point, gap, normal, in_frame, in_carrier = points(model, contact, q)
        assert contact.gap(model, data, q) == pytest.approx(gap, abs=1e-14)
        assert matrices.gap == contact.gap(model, data, q)
        assert np.abs(matrices.point - point).max() < 1e-14
        assert np.abs(matrices.axes - contact_axes(normal)).max() < 1e-14

        def displacement(t, q=q, v=v, contact=contact, in_frame=in_frame, in_carrier=in_carrier):
            """Return the relative displacement of the two material points at the contact."""
            moved = model.createData()
            pin.framesForwardKinematics(model, moved, pin.integrate(model, q, t * v))
            carried = in_carrier
            if contact.plane.body is not None:
                carried = moved.oMf[model.getFrameId(contact.plane.body)].act(in_carrier)
            return moved.oMf[model.getFrameId(contact.frame)].act(in_frame) - carried

        step = 1e-5
        rate = (displacement(step) - displacement(-step)) / (2 * step)
        assert np.abs(matrices.velocity(v) - matrices.axes @ rate).max() < 1e-8
        gap_rate = (
            contact.gap(model, data, pin.integrate(model, q, step * v))
            - contact.gap(model, data, pin.integrate(model, q, -step * v))
        ) / (2 * step)
        assert matrices.velocity(v)[2] == pytest.approx(gap_rate, abs=1e-8)


@pytest.mark.parametrize("name", cases.FRAMES)
def test_mass_and_delassus_by_inverse_dynamics_and_dense_algebra(name, rng):
    model, data = cases.load(name)
    for _ in range(3):
        q, _ = cases.random_state(model, rng)
        contact = cases.random_contact(cases.FRAMES[name], rng)
        matrices = pinimpact.contact_matrices(model, data, q, contact)
        mass = cases.mass_by_rnea(model, q)
        assert np.abs(matrices.mass - mass).max() < 1e-12 * np.abs(mass).max()
        response = np.linalg.solve(mass, matrices.jacobian.T)
        scale = 1e-14 * np.linalg.cond(mass)
        assert np.abs(matrices.response - response).max() < scale * np.abs(response).max()
        delassus = matrices.jacobian @ response
        assert np.abs(matrices.delassus - delassus).max() < scale * np.abs(delassus).max()
        assert (matrices.delassus == matrices.delassus.T).all()


def test_rotor_inertia_counts(rng):
    model, data = cases.load("ur5")
    q, _ = cases.random_state(model, rng)
    contact = cases.random_contact("tool0", rng)
    without = pinimpact.contact_matrices(model, data, q, contact)
    armature = rng.uniform(0.1, 1.0, model.nv)
    model.armature = armature
    loaded = pinimpact.contact_matrices(model, data, q, contact)
    assert np.abs(loaded.mass - without.mass - np.diag(armature)).max() < 1e-14
    expected = without.jacobian @ np.linalg.solve(without.mass + np.diag(armature), without.jacobian.T)
    assert np.abs(loaded.delassus - expected).max() < 1e-13


@pytest.mark.parametrize(
    ("surface", "about"), [(cases.random_plane, "point"), (cases.random_sphere, "center")]
)
def test_surface_velocity_is_that_of_the_surface_at_the_contact_point(rng, surface, about):
    model, data = cases.load("panda")
    q, _ = cases.random_state(model, rng)
    velocity, spin = rng.normal(size=3), rng.normal(size=3)
    moving = surface(rng, velocity=velocity, angular_velocity=spin)
    seen = contact_geometry(model, data, q, cases.random_contact("panda_hand_tcp", rng, moving))
    expected = velocity + np.cross(spin, seen.point - getattr(moving, about))
    assert np.abs(seen.surface_velocity - seen.axes @ expected).max() < 1e-14

    carried = surface(rng, "panda_link1", velocity=velocity, angular_velocity=spin)
    seen = contact_geometry(model, data, q, cases.random_contact("panda_hand_tcp", rng, carried))
    placement = data.oMf[model.getFrameId("panda_link1")]
    local = velocity + np.cross(spin, placement.actInv(seen.point) - getattr(carried, about))
    assert np.abs(seen.surface_velocity - seen.axes @ placement.rotation @ local).max() < 1e-14


def test_a_sphere_without_end_is_a_plane(rng):
    model, data = cases.load("panda")
    q, v = cases.random_state(model, rng)
    plane = cases.random_plane(rng, "panda_link2", velocity=(1, 2, 3), angular_velocity=(3, 2, 1))
    flat = cases.random_contact("panda_hand_tcp", rng, plane)
    reach = flat.gap(model, data, q) + np.linalg.norm(plane.point) + 2.0
    for radius in (1e4, 1e6):
        center = np.subtract(plane.point, radius * np.array(plane.normal))
        velocity = plane.velocity + np.cross(plane.angular_velocity, center - plane.point)
        sphere = pinimpact.Sphere(center, radius, velocity, plane.angular_velocity, plane.body)
        curved = dataclasses.replace(flat, plane=sphere)
        one, other = (pinimpact.contact_matrices(model, data, q, contact) for contact in (flat, curved))
        sagitta = reach**2 / radius
        assert abs(one.gap - other.gap) < sagitta
        for field in ("axes", "delassus", "jacobian", "surface_velocity"):
            expected = getattr(one, field)
            error = np.abs(expected - getattr(other, field)).max()
            assert error < 30 * sagitta * max(1.0, np.abs(expected).max()), field
        hits = [pinimpact.impact(model, data, q, -np.sign(one.velocity(v)[2]) * v, c) for c in (flat, curved)]
        assert np.abs(hits[0].v - hits[1].v).max() < 100 * sagitta * np.abs(hits[0].v).max()


def test_axes_on_a_sphere_are_those_of_its_normal_wherever_the_tip_is(rng):
    model, data = cases.load("ur5")
    q, _ = cases.random_state(model, rng)
    tip = pin.Data(model)
    pin.framesForwardKinematics(model, tip, q)
    tip = tip.oMf[model.getFrameId("tool0")].translation
    for normal in (*rng.normal(size=(5, 3)), (0, 0, 1), (0, 0, -1)):
        normal = np.array(normal) / np.linalg.norm(normal)
        sphere = pinimpact.Sphere(center=tip - 0.5 * normal, radius=0.3)
        seen = contact_geometry(model, data, q, pinimpact.Contact("tool0", sphere, radius=0.05))
        assert seen.gap == pytest.approx(0.15, abs=1e-15)
        assert np.abs(seen.axes - contact_axes(seen.axes[2])).max() < 1e-15
        assert seen.axes[2] == pytest.approx(normal, abs=1e-15)


def test_tip_inside_sphere_and_at_its_centre():
    model, data = cases.load("ellipsoid")
    q = pin.neutral(model)
    for depth in (0.1, 0.3, 0.5):
        q[:3] = 0.0, 0.5 - depth, 0.0
        seen = contact_geometry(model, data, q, pinimpact.Contact("ellipsoid", pinimpact.Sphere(radius=0.5)))
        assert seen.gap == pytest.approx(-depth, abs=1e-15)
        assert seen.axes[2].tolist() == ([0.0, 1.0, 0.0] if depth < 0.5 else [0.0, 0.0, 1.0])


def test_a_plane_on_a_fixed_frame_is_a_plane_in_the_world(rng):
    model, data = cases.load("panda")
    q, _ = cases.random_state(model, rng)
    mount = pin.SE3(cases.random_rotation(rng), rng.normal(size=3))
    model.addFrame(pin.Frame("mount", 0, 0, mount, pin.FrameType.OP_FRAME))
    data = model.createData()
    carried = cases.random_plane(rng, "mount", velocity=(1, 2, 3), angular_velocity=(3, 2, 1))
    world = pinimpact.Plane(
        mount.act(np.array(carried.point)),
        mount.rotation @ carried.normal,
        mount.rotation @ carried.velocity,
        mount.rotation @ carried.angular_velocity,
    )
    one, other = (
        pinimpact.contact_matrices(model, data, q, pinimpact.Contact("panda_hand_tcp", plane))
        for plane in (carried, world)
    )
    for field in ("gap", "K", "h", "delassus", "axes", "surface_velocity"):
        assert np.abs(getattr(one, field) - getattr(other, field)).max() < 1e-13, field


@pytest.mark.parametrize("distance", [1.0, 2.0**10])
def test_far_from_the_origin_no_more_is_lost_than_rounding_of_the_distance(distance, rng):
    model, data = cases.load("solo12")
    q, _ = cases.random_state(model, rng)
    far = q.copy()
    far[:3] += distance
    contact = pinimpact.Contact("FL_FOOT", pinimpact.Plane())
    near_w, far_w = (pinimpact.contact_matrices(model, data, x, contact).delassus for x in (q, far))
    assert np.abs(near_w - far_w).max() < 1e-14 * distance * np.abs(near_w).max()


def test_frames_by_name_and_by_id_are_the_same(rng):
    model, data = cases.load("ur5")
    q, _ = cases.random_state(model, rng)
    gaps = [
        pinimpact.Contact(key, pinimpact.Plane(body=body)).gap(model, data, q)
        for key in ("tool0", model.getFrameId("tool0"), np.int64(model.getFrameId("tool0")))
        for body in ("shoulder_link", model.getFrameId("shoulder_link"))
    ]
    assert len(set(gaps)) == 1


def test_wrapper_in_place_of_the_model(rng):
    robot = pinimpact.load_robot("ur5")
    q, _ = cases.random_state(robot.model, rng)
    contact = pinimpact.Contact("tool0", pinimpact.Plane())
    by_wrapper = pinimpact.contact_matrices(robot, robot.data, q, contact)
    assert (
        by_wrapper.delassus == pinimpact.contact_matrices(robot.model, robot.data, q, contact).delassus
    ).all()
    assert contact.gap(robot, robot.data, q) == by_wrapper.gap
    with pytest.raises(pinimpact.InputError, match="Model or RobotWrapper"):
        contact.gap("ur5", robot.data, q)


def test_model_is_left_alone_and_data_is_let_go(rng):
    model, data = cases.load("panda")
    untouched = model.copy()
    q, v = cases.random_state(model, rng)
    contact = cases.random_contact("panda_hand_tcp", rng)
    pinimpact.impact(model, data, q, cases.approaching(model, data, q, v, contact), contact)
    assert model == untouched
    assert vars(model) == vars(untouched)
    gone = [weakref.ref(model), weakref.ref(data)]
    del model, data
    gc.collect()
    assert [reference() for reference in gone] == [None, None]


def test_changes_of_the_model_between_calls_are_seen(rng):
    model, data = cases.load("ur5")
    q, _ = cases.random_state(model, rng)
    contact = pinimpact.Contact("tool0", pinimpact.Plane())
    before = contact.gap(model, data, q)
    frame = model.frames[model.getFrameId("tool0")]
    frame.placement = frame.placement * pin.SE3(np.eye(3), np.array([0, 0, 0.1]))
    assert contact.gap(model, data, q) == pytest.approx(points(model, contact, q)[0][2], abs=1e-14)
    assert contact.gap(model, data, q) != pytest.approx(before, abs=1e-3)
    assert pinimpact.contact_matrices(model, data, q, contact).gap == contact.gap(model, data, q)

    model.addFrame(pin.Frame("late", 0, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    late = pinimpact.Contact("late", pinimpact.Plane(point=(0, 0, -1)))
    with pytest.raises(pinimpact.InputError, match=r"model\.createData\(\)"):
        late.gap(model, data, q)
    assert late.gap(model, model.createData(), q) == 1.0


def test_data_of_another_model_raise():
    panda, data = cases.load("panda")
    ur5, _ = cases.load("ur5")
    contact = pinimpact.Contact("panda_hand_tcp", pinimpact.Plane())
    contact.gap(panda, data, pin.neutral(panda))
    with pytest.raises(pinimpact.InputError, match="data: made for another model"):
        contact.gap(ur5, data, pin.neutral(ur5))


@pytest.mark.parametrize("data", [None, 3, pin.Model()])
def test_invalid_data_raise(data):
    model, _ = cases.load("ur5")
    state, contact = (pin.neutral(model), np.zeros(model.nv)), pinimpact.Contact("tool0", pinimpact.Plane())
    for call in (
        lambda: pinimpact.impact(model, data, *state, contact),
        lambda: pinimpact.impacts(model, data, *state, contact),
        lambda: pinimpact.contact_matrices(model, data, state[0], contact),
        lambda: contact.gap(model, data, state[0]),
    ):
        with pytest.raises(pinimpact.InputError, match=r"data: .*createData") as caught:
            call()
        assert caught.value.field == "data"


def chain(*kinds, parents=(0, 1)):
    model = pin.Model()
    for k, (kind, parent) in enumerate(zip(kinds, parents, strict=True)):
        place = pin.SE3(np.eye(3), np.array([0.1, 0.2, 0.3]))
        joint = model.addJoint(parent, kind, place, f"joint{k}")
        model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.2), pin.SE3.Identity())
        model.addJointFrame(joint)
    return model


@pytest.mark.parametrize(
    ("other", "message"),
    [
        (chain(pin.JointModelRX(), pin.JointModelPZ()), "joint 'joint1' is PZ, not RevoluteUnaligned"),
        (
            chain(pin.JointModelRX(), pin.JointModelRevoluteUnaligned(np.array([0, 0.8, 0.6]))),
            "joint 'joint1' has another axis",
        ),
        (
            chain(
                pin.JointModelRX(),
                pin.JointModelRevoluteUnaligned(np.array([0, 0.6, 0.8])),
                parents=(0, 0),
            ),
            "kinematic tree is another",
        ),
    ],
)
def test_data_of_another_robot_of_the_same_size(other, message):
    axis = np.array([0, 0.6, 0.8])
    model = chain(pin.JointModelRX(), pin.JointModelRevoluteUnaligned(axis))
    contact = pinimpact.Contact(2, pinimpact.Plane())
    q, v = np.array([0.3, 0.4]), np.array([-1.0, 0.2])
    for call in (
        lambda data: pinimpact.impact(model, data, q, v, contact),
        lambda data: pinimpact.impacts(model, data, q, v, contact),
        lambda data: pinimpact.contact_matrices(model, data, q, contact),
        lambda data: contact.gap(model, data, q),
    ):
        with pytest.raises(pinimpact.InputError, match=f"data: made for another robot, whose {message}"):
            call(other.createData())
        call(model.createData())
    call(chain(pin.JointModelRX(), pin.JointModelRevoluteUnaligned(axis)).createData())  # equal


def test_model_without_joints_raises():
    model = pin.Model()
    contact = pinimpact.Contact(0, pinimpact.Plane(point=(0, 0, -0.5)))
    nothing = np.zeros(0)
    assert contact.gap(model, model.createData(), nothing) == 0.5
    for call in (
        lambda data: pinimpact.impact(model, data, nothing, nothing, contact),
        lambda data: pinimpact.impacts(model, data, nothing, nothing, contact),
        lambda data: pinimpact.contact_matrices(model, data, nothing, contact),
    ):
        with pytest.raises(pinimpact.ModelError, match="no joints"):
            call(model.createData())


INERTIAL = (
    '<inertial><origin xyz="0.5 0 0"/><mass value="1"/>'
    '<inertia ixx="0.1" iyy="0.2" izz="0.3" ixy="0" ixz="0" iyz="0"/></inertial>'
)


def test_mimic_joints():
    gripper = cases.gripper("left", INERTIAL)
    coupled, free = pin.buildModelFromXML(gripper, mimic=True), pin.buildModelFromXML(gripper)
    assert (coupled.nv, free.nv) == (2, 3)
    coupling = np.array([[1, 0], [0, 1], [0, -2]])
    q = np.array([0.3, 0.7])
    full = coupling @ q + [0, 0, 0.1]
    contact = pinimpact.Contact("right_finger", pinimpact.Plane(normal=(1, 2, 3)), offset=(1, 0, 0))
    one = pinimpact.contact_matrices(coupled, coupled.createData(), q, contact)
    other = pinimpact.contact_matrices(free, free.createData(), full, contact)
    mass = coupling.T @ other.mass @ coupling
    jacobian = other.jacobian @ coupling
    assert np.abs(one.mass - mass).max() < 1e-14
    assert np.abs(one.jacobian - jacobian).max() < 1e-14
    assert np.abs(one.delassus - jacobian @ np.linalg.solve(mass, jacobian.T)).max() < 1e-14
    data, v = coupled.createData(), np.array([-1.0, 0.3])
    for carrier in (None, "left_finger"):
        struck = pinimpact.Contact("right_finger", pinimpact.Plane(normal=(1, 2, 3), body=carrier))
        hit = pinimpact.impact(coupled, data, q, v, struck)
        assert pinimpact.impacts(coupled, data, q, v, struck).v[0].tolist() == hit.v.tolist()


@pytest.mark.parametrize("leader", ["arm", "left"])
def test_mass_matrix_with_mimic_joint_does_not_depend_on_calls_before(leader):
    # Pinocchio's crba adds to forces of its last call: M, and with it impacts, changed with every call
    more = """<joint name="last" type="revolute"><parent link="right_finger"/><child link="tip"/>
      <origin xyz="1 0 0"/><axis xyz="0 1 0"/>{limit}</joint><link name="tip">{inertial}</link>"""
    urdf = cases.gripper(leader, INERTIAL, more)
    coupled, free = pin.buildModelFromXML(urdf, mimic=True), pin.buildModelFromXML(urdf)
    place = {name: k for k, name in enumerate(free.names[1:])}
    own = [name for name in free.names[1:] if name != "right"]
    coupling, offset = np.zeros((free.nv, coupled.nv)), np.zeros(free.nv)
    for name in own:
        coupling[place[name], coupled.joints[coupled.getJointId(name)].idx_v] = 1.0
    coupling[place["right"]] = -2.0 * coupling[place[leader]]
    offset[place["right"]] = 0.1
    data, v = coupled.createData(), np.array([-1.0, 0.3, 0.5])
    contact = pinimpact.Contact("tip", pinimpact.Plane(normal=(1, 2, 3)), 0.3, 0.5, offset=(1, 0, 0))
    for q in np.random.default_rng(0).uniform(-1.0, 1.0, (4, 3)):
        full = coupling @ q + offset
        other = pinimpact.contact_matrices(free, free.createData(), full, contact)
        mass, jacobian = coupling.T @ other.mass @ coupling, other.jacobian @ coupling
        w = jacobian @ np.linalg.solve(mass, jacobian.T)
        velocity = jacobian @ v
        plane = contact.plane if velocity[2] <= 0.0 else pinimpact.Plane(normal=(-1, -2, -3))
        struck = dataclasses.replace(contact, plane=plane)
        axes = pinimpact.contact_matrices(free, free.createData(), full, struck).axes @ other.axes.T
        problem = pinimpact.ImpactProblem(axes @ w @ axes.T, axes @ velocity, 0.3, 0.5)
        impulse = axes.T @ pinimpact.solve_impact(problem).impulse
        expected = v + np.linalg.solve(mass, jacobian.T @ impulse)
        for _ in range(2):
            found = pinimpact.contact_matrices(coupled, data, q, contact)
            assert found.mass == pytest.approx(mass, abs=1e-13)
            assert pinimpact.impact(coupled, data, q, v, struck).v == pytest.approx(expected, abs=1e-12)


def test_mimic_joint_of_robot_with_one_velocity():
    # Pinocchio returns the Jacobian of such a frame as a vector
    limit = '<limit lower="-3" upper="3" effort="1" velocity="1"/>'
    model = pin.buildModelFromXML(
        f"""<robot name="fold"><link name="world"/><link name="arm">{INERTIAL}</link>
        <link name="hand">{INERTIAL}</link>
        <joint name="shoulder" type="revolute"><parent link="world"/><child link="arm"/>
          <axis xyz="0 1 0"/>{limit}</joint>
        <joint name="elbow" type="revolute"><parent link="arm"/><child link="hand"/><origin xyz="1 0 0"/>
          <axis xyz="0 1 0"/>{limit}<mimic joint="shoulder" multiplier="-2"/></joint></robot>""",
        mimic=True,
    )
    assert model.nv == 1
    angle, rate = 0.4, 0.7
    tip = pinimpact.Contact("hand", pinimpact.Plane(), offset=(1, 0, 0), restitution=0.5)
    # arm and hand are at ∓angle to the horizontal, so the tip moves along x
    across = pinimpact.Contact("hand", pinimpact.Plane(normal=(1, 0, 0)), offset=(1, 0, 0), restitution=0.5)
    matrices = pinimpact.contact_matrices(model, model.createData(), [angle], across)
    assert np.allclose(matrices.jacobian, [[0.0], [0.0], [-2.0 * np.sin(angle)]], atol=1e-15)
    hit = pinimpact.impact(model, model.createData(), [angle], [rate], across)
    assert hit.v == pytest.approx([-0.5 * rate])
    still = pinimpact.impact(model, model.createData(), [angle], [rate], tip)
    assert still.solution.status == pinimpact.Status.NO_IMPACT


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        (
            {"frame": "tool"},
            pinimpact.UnknownNameError,
            "frame: no frame is called 'tool'; did you mean 'tool0'",
        ),
        ({"frame": 99}, pinimpact.UnknownNameError, "frame: there is no frame 99"),
        ({"frame": -1}, pinimpact.UnknownNameError, "frame: there is no frame -1"),
        (
            {"plane": pinimpact.Plane(body="Wrist_1_link")},
            pinimpact.UnknownNameError,
            "body: no frame .* 'wrist_1_link'",
        ),
    ],
)
def test_unknown_frames(changes, error, message):
    model, data = cases.load("ur5")
    contact = pinimpact.Contact(**({"frame": "tool0", "plane": pinimpact.Plane()} | changes))
    for call in (contact.gap, lambda *state: pinimpact.contact_matrices(*state, contact)):
        with pytest.raises(error, match=message):
            call(model, data, pin.neutral(model))


def test_ambiguous_frame_name():
    model, data = cases.load("z1")
    names = [frame.name for frame in model.frames]
    twice = next(name for name in names if names.count(name) > 1)
    with pytest.raises(pinimpact.UnknownNameError) as caught:
        pinimpact.Contact(twice, pinimpact.Plane()).gap(model, data, pin.neutral(model))
    ids = [i for i, name in enumerate(names) if name == twice]
    assert all(f"{i} (" in str(caught.value) for i in ids)
    assert np.isfinite(pinimpact.Contact(ids[-1], pinimpact.Plane()).gap(model, data, pin.neutral(model)))


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("friction", -0.1),
        ("friction", np.nan),
        ("friction", np.inf),
        ("friction", "low"),
        ("restitution", -0.01),
        ("restitution", 1.01),
        ("restitution", None),
        ("radius", -1.0),
        ("offset", (0, 0)),
        ("offset", (0, 0, np.nan)),
        ("plane", (0, 0, 1)),
        ("frame", None),
        ("frame", 1.0),
    ],
)
def test_contact_with_value_out_of_range_raises(field, value):
    with pytest.raises(pinimpact.InputError, match=field) as caught:
        pinimpact.Contact(**({"frame": "tip", "plane": pinimpact.Plane()} | {field: value}))
    assert caught.value.field == field


def test_contact_with_unknown_law_raises():
    with pytest.raises(pinimpact.UnknownNameError, match="did you mean 'poisson'"):
        pinimpact.Contact("tip", pinimpact.Plane(), law="poison")


def test_contacts_are_compared_by_value():
    one, other = (
        pinimpact.Contact("tip", pinimpact.Plane(), offset=offset) for offset in ([0, 0, 1], (0.0, 0.0, 1.0))
    )
    assert one == other
    assert hash(one) == hash(other)


@pytest.mark.parametrize(
    ("q", "message"),
    [
        (np.zeros(5), r"q: shape \(5,\) given, \(7,\) expected"),
        (np.zeros((7, 1)), "q: shape"),
        ("home", "q"),
        ([0, 0, 0, 0, 0, 0, np.nan], "not finite"),
        ([0, 0, 0, 0, 0, 0, 1.1], r"pinocchio\.normalize"),
        ([0, 0, 0, 0, 0, 0, 0], r"pinocchio\.normalize"),
    ],
)
def test_invalid_configuration_raises(q, message):
    robot = pinimpact.load_robot("ellipsoid")
    contact = pinimpact.Contact("tip", pinimpact.Plane())
    for call in (
        contact.gap,
        lambda *state: pinimpact.contact_matrices(*state, contact),
        lambda *state: pinimpact.impact(*state, np.zeros(6), contact),
    ):
        with pytest.raises(pinimpact.InputError, match=message):
            call(robot.model, robot.data, q)


def test_link_without_inertia_needs_armature_or_lock():
    model, data = cases.load("romeo")
    contact = pinimpact.Contact("l_sole", pinimpact.Plane())
    q = pin.neutral(model)
    with pytest.raises(pinimpact.ModelError, match=r"'RThumb3'.*armature"):
        pinimpact.contact_matrices(model, data, q, contact)
    with pytest.raises(pinimpact.ModelError, match=r"'RThumb3'.*armature"):
        pinimpact.impact(model, data, q, np.zeros(model.nv), contact)
