"""Robots and scenes with simultaneous impacts at several contacts."""

import numpy as np
import pinocchio as pin
import pytest

import pinimpact
from pinimpact import BoundReachedWarning, Contact, InputError, Plane, Scene, simulate
from pinimpact.robot._kernels.responses import taking_part
from pinimpact.robot.matrices import checked_matrices
from pinimpact.robot.placed_robot import PlacedRobot

FEET = ("FL_FOOT", "FR_FOOT", "HL_FOOT", "HR_FOOT")


def mirrored(inertia):
    """Return an inertia mirrored at the plane y = 0."""
    flip = np.diag([1.0, -1.0, 1.0])
    return pin.Inertia(inertia.mass, flip @ inertia.lever, flip @ inertia.inertia @ flip)


@pytest.fixture(scope="module")
def quadruped():
    """Return solo12 above its feet, with the right side replaced by the mirror image of the left one."""
    robot = pinimpact.load_robot("solo12")
    model = robot.model.copy()
    for left, right in (("FL", "FR"), ("HL", "HR")):
        for joint in ("HAA", "HFE", "KFE"):
            i, j = model.getJointId(f"{left}_{joint}"), model.getJointId(f"{right}_{joint}")
            model.inertias[j] = mirrored(model.inertias[i])
            place = model.jointPlacements[i].copy()
            place.translation = place.translation * [1, -1, 1]
            model.jointPlacements[j] = place
        i, j = model.getFrameId(f"{left}_FOOT"), model.getFrameId(f"{right}_FOOT")
        place = model.frames[i].placement.copy()
        place.translation = place.translation * [1, -1, 1]
        model.frames[j].placement = place
    base = model.inertias[1]
    lever = base.lever * [1, 0, 1]
    model.inertias[1] = pin.Inertia(base.mass, lever, 0.5 * (base.inertia + mirrored(base).inertia))
    return model, robot.q0.copy()


def feet(**how):
    return [Contact(foot, Plane(), **{"friction": 0.7, "law": "energetic"} | how) for foot in FEET]


@pytest.mark.parametrize("e", [0.0, 0.5])
def test_landing_is_mirror_symmetric_in_any_numbering(quadruped, e):
    model, q = quadruped
    v = np.zeros(model.nv)
    v[[0, 2, 4]] = 0.3, -1.0, 0.2
    hit = pinimpact.impact(model, model.createData(), q, v, feet(restitution=e))
    image = hit.impulses_world[[1, 0, 3, 2]] * [1, -1, 1]
    assert np.abs(hit.impulses_world - image).max() < 1e-10 * np.abs(hit.impulses_world).max()
    for order in ([3, 1, 0, 2], [2, 3, 1, 0]):
        other = pinimpact.impact(model, model.createData(), q, v, [feet(restitution=e)[i] for i in order])
        assert other.v == pytest.approx(hit.v, abs=1e-11)
        assert other.impulses_world == pytest.approx(hit.impulses_world[order], abs=1e-11)


def test_momentum_and_energy(quadruped):
    model, q = quadruped
    data = model.createData()
    v = np.random.default_rng(1).normal(size=model.nv)
    v[2] = -2.0
    hit = pinimpact.impact(model, data, q, v, feet(restitution=0.4))
    mass = pin.crba(model, data, q)
    mass = np.triu(mass) + np.triu(mass, 1).T
    assert (mass @ (hit.v - v))[:3] == pytest.approx(hit.impulses_world.sum(axis=0), abs=1e-10)
    change = 0.5 * hit.v @ mass @ hit.v - 0.5 * v @ mass @ v
    assert change == pytest.approx(hit.solution.work.total.sum(), abs=1e-10)
    assert change < 0.0


def test_list_of_one_contact_equals_single_contact(quadruped):
    model, q = quadruped
    v = np.random.default_rng(2).normal(size=model.nv)
    v[2] = -2.0
    alone = pinimpact.impact(model, model.createData(), q, v, feet(restitution=0.3)[0])
    listed = pinimpact.impact(model, model.createData(), q, v, feet(restitution=0.3)[:1])
    assert listed.v == pytest.approx(alone.v, abs=1e-10)
    assert listed.impulses_world[0] == pytest.approx(alone.impulse_world, abs=1e-10)


def test_locked_joints_and_held_contacts(quadruped):
    model, q = quadruped
    v = np.zeros(model.nv)
    v[2] = -1.0
    hit = pinimpact.impact(
        model, model.createData(), q, v, feet(restitution=0.2), locked=("FL_HAA", "FR_HAA")
    )
    for name in ("FL_HAA", "FR_HAA"):
        assert hit.v[model.joints[model.getJointId(name)].idx_v] == pytest.approx(0.0, abs=1e-12)
    with pytest.raises(InputError, match=r"held: .* moves at"):
        pinimpact.impact(model, model.createData(), q, v, feet()[:2], held=feet()[2:])


def test_contacts_and_joint_stops_by_dense_algebra(quadruped):
    """Compare W and velocity changes, with a locked joint and joint limits, with M⁻¹ of the free joints."""
    model, q = quadruped
    rng = np.random.default_rng(3)
    q, v = pin.integrate(model, q, rng.normal(size=model.nv)), rng.normal(size=model.nv)
    contacts, data = feet()[:2], model.createData()
    joints = ["FL_HFE", "HR_KFE"]
    stops = np.zeros((2, model.nv))
    for row, joint, sign in zip(stops, joints, (1.0, -1.0), strict=True):
        row[model.joints[model.getJointId(joint)].idx_v] = sign
    free = np.ones(model.nv, dtype=bool)
    free[model.joints[model.getJointId("FR_HFE")].idx_v] = False
    found = checked_matrices(PlacedRobot(model, data, q), contacts, (), free, stops)

    alone = [pinimpact.contact_matrices(model, data, q, contact) for contact in contacts]
    jacobian = np.zeros((12, model.nv))
    jacobian[:6] = np.vstack([one.jacobian for one in alone])
    jacobian[[8, 11]] = stops
    inverse = np.zeros((model.nv, model.nv))
    inverse[np.ix_(free, free)] = np.linalg.inv(pin.crba(model, model.createData(), q)[np.ix_(free, free)])
    np.testing.assert_allclose(found.delassus, jacobian @ inverse @ jacobian.T, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(found.response, inverse @ jacobian.T, rtol=1e-12, atol=1e-11)
    np.testing.assert_allclose(found.velocity(v).ravel(), jacobian @ v, rtol=0, atol=1e-13)
    np.testing.assert_array_equal(found.axes, [one.axes for one in alone])


@pytest.mark.parametrize("seed", range(5))
def test_coupled_contacts_of_block_matrix(seed):
    """Find the contacts of one block of a block-diagonal matrix, in any order."""
    rng = np.random.default_rng(seed)
    n = 9
    block = rng.integers(0, 3, n)
    chain = np.abs(np.subtract.outer(np.arange(n), np.arange(n))) <= 4  # coupled through others
    feels = chain & (block[:, None] == block)
    w = np.kron(feels, np.ones((3, 3))) * rng.normal(size=(3 * n, 3 * n)) + 10.0 * np.eye(3 * n)
    w += 1e-15 * rng.normal(size=w.shape)
    w = 0.5 * (w + w.T)
    found = np.empty(n, dtype=np.int64)
    assert taking_part(w, np.zeros(n), -np.ones(n), 0.0, 4, found)
    reached = np.linalg.matrix_power(feels.astype(int), n)[4] > 0
    np.testing.assert_array_equal(found != 0, reached)


@pytest.mark.parametrize("e", [0.0, 0.6])
def test_contacts_that_are_only_lifted_are_excluded(e):
    # compare with the solution for all contacts: equal velocities, and zero impulse at this contact
    rng, left_out = np.random.default_rng(3), 0
    for _ in range(30):
        n = 3
        points = np.column_stack([rng.uniform(-0.2, 0.2, (n, 2)), np.full(n, -0.1)])
        rows = np.concatenate([np.hstack([np.eye(3), -pin.skew(point)]) for point in points])
        w = rows @ np.diag(1.0 / np.array([1.0, 1.0, 1.0, 0.02, 0.02, 0.03])) @ rows.T
        v = (rows @ rng.normal(size=6)).reshape(n, 3)
        v[0, 2], v[1:, 2] = -1.0, 0.0
        mu, found = np.full(n, rng.uniform(0.0, 0.6)), np.empty(n, dtype=np.int64)
        assert taking_part(w, mu, v[:, 2].copy(), 1e-12, 0, found)
        part = np.flatnonzero(found)
        if len(part) == n:
            continue
        left_out += 1
        whole = pinimpact.solve_impact(pinimpact.ImpactProblem(w, v, mu, e, "energetic"))
        places = (3 * part[:, None] + np.arange(3)).ravel()
        some = pinimpact.ImpactProblem(w[np.ix_(places, places)], v[part], mu[part], e, "energetic")
        solution = pinimpact.solve_impact(some)
        np.testing.assert_allclose(whole.impulse[part], solution.impulse, rtol=0, atol=1e-10)
        assert np.abs(whole.impulse[found == 0]).max() < 1e-12
    assert left_out >= 5


def test_standing_quadruped_is_struck(quadruped):
    # resting feet are part of the impact: their impulses are unilateral, and unloaded feet lift off
    model, q = quadruped
    v = np.zeros(model.nv)
    v[model.joints[model.getJointId("FL_HFE")].idx_v] = -3.0
    hit = pinimpact.impact(model, model.createData(), q, v, feet())
    assert (hit.impulses_world[:, 2] >= 0.0).all()
    assert (hit.solution.velocity[:, 2] >= -1e-9).all()


def test_corners_with_small_gaps_have_rigid_tangential_velocities(quadruped):
    # corners closed up to a tolerance have different gaps. The points below them are in one plane, where
    # tangential velocities of a body have three coordinates; those of its corners differ by effects of gaps.
    model, q = quadruped
    data = model.createData()
    tilted = pin.integrate(model, q, np.r_[0.0, 0.0, 0.0, 1e-7, -2e-7, np.zeros(model.nv - 5)])
    free = np.array([1.0] * 6 + [0.0] * (model.nv - 6))
    args = PlacedRobot(model, data, tilted), feet(), (), free, np.zeros((0, model.nv))
    corners, points = checked_matrices(*args), checked_matrices(*args, on_surface=True)
    along = np.arange(12) % 3 < 2
    sizes = [np.linalg.svd(m.jacobian[along, :6], compute_uv=False)[2:4] for m in (corners, points)]
    assert sizes[0][1] > 1e-9 * sizes[0][0]
    assert sizes[1][1] < 1e-15 * sizes[1][0]
    gaps = np.array([c.gap(model, data, tilted) for c in feet()])
    v = np.random.default_rng(0).normal(size=model.nv)
    expected = np.zeros((4, 3))
    for k, contact in enumerate(feet()):
        frame = model.getFrameId(contact.frame)
        spin = pin.computeFrameJacobian(model, data, tilted, frame, pin.LOCAL_WORLD_ALIGNED)[3:] @ v
        expected[k] = np.cross(spin, [0.0, 0.0, -gaps[k]])
    change = points.velocity(v) - corners.velocity(v)
    world = np.einsum("kij,ki->kj", points.axes, change)
    assert np.abs(world - expected).max() < 1e-15


@pytest.mark.parametrize("friction", [0.1, 0.6, 1.0])
@pytest.mark.parametrize("e", [0.0, 0.2, 0.8])
def test_rigid_body_on_four_feet(quadruped, friction, e):
    # twelve rows of rank six: impulses are not unique, but the velocity is, and it is mirror symmetric
    model, q = quadruped
    v = np.zeros(model.nv)
    v[2] = -1.0
    outcomes = []
    for pitch in (0.5, -0.5):
        v[4] = pitch
        contacts = feet(friction=friction, restitution=e)
        hit = pinimpact.impact(model, model.createData(), q, v, contacts, locked=list(model.names)[2:])
        # simultaneous incipient slip of redundant contacts is integrated by adaptive steps, to 1e-7
        assert all("integrated by adaptive steps" in note for note in hit.solution.notes)
        digits = 1e-6 if hit.solution.notes else 1e-8
        assert np.abs(hit.v[[1, 3, 5]]).max() < digits
        p = hit.impulses_world
        assert p[[0, 2], 2] == pytest.approx(p[[1, 3], 2], abs=digits)
        assert (np.hypot(p[:, 0], p[:, 1]) <= friction * p[:, 2] * (1 + 1e-9)).all()
        outcomes.append(hit.v)
    assert outcomes[0][0] * outcomes[1][0] < 0.0
    assert outcomes[0][2] == pytest.approx(outcomes[1][2], abs=1e-2)


def spokes(yaw):
    """Return two spokes of a rimless wheel in a vertical plane; a yaw of None: by joints along its axes."""
    model = pin.Model()
    joint = 0
    if yaw is None:
        for along, name in ((pin.JointModelPX(), "x"), (pin.JointModelPZ(), "z")):
            joint = model.addJoint(joint, along, pin.SE3.Identity(), name)
        joint = model.addJoint(joint, pin.JointModelRY(), pin.SE3.Identity(), "turn")
        model.armature[:2] = 1e-12  # the massless links
    else:
        upright = pin.utils.rotate("z", yaw) @ pin.utils.rotate("x", 0.5 * np.pi)
        joint = model.addJoint(0, pin.JointModelPlanar(), pin.SE3(upright, np.zeros(3)), "plane")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), 0.075 * np.eye(3)), pin.SE3.Identity())
    model.lowerPositionLimit[:], model.upperPositionLimit[:] = -np.inf, np.inf
    for name, side in (("rear", -1.0), ("front", 1.0)):
        x, z = side * 0.5 * np.sin(np.pi / 6), -0.5 * np.cos(np.pi / 6)
        tip = np.array([x, 0.0, z] if yaw is None else [x, z, 0.0])
        place = pin.SE3(np.eye(3), tip)
        model.addFrame(pin.Frame(name, joint, 0, place, pin.FrameType.OP_FRAME))
    return model


@pytest.mark.parametrize("yaw", [0.0, 0.5 * np.pi, np.pi, 0.3])
@pytest.mark.parametrize(("friction", "e"), [(0.2, 0.5), (0.6, 0.5), (5.0, 0.0), (5.0, 0.5)])
def test_planar_mechanism_has_no_impulses_across_its_plane(yaw, friction, e):
    contacts = [
        Contact(name, Plane(), friction=friction, restitution=e, law="energetic")
        for name in ("rear", "front")
    ]
    model, exact, down = spokes(yaw), spokes(None), 0.5 * np.cos(np.pi / 6)
    along = np.array([[np.cos(yaw), np.sin(yaw), 0.0], [0.0, 0.0, 1.0]])
    across = np.array([-np.sin(yaw), np.cos(yaw), 0.0])
    for vx, vz, rate in ((-0.5, -1.0, 0.0), (-0.5, -1.0, 1.0), (0.0, -1.0, 1.0)):
        hit = pinimpact.impact(model, model.createData(), np.array([0, down, 1, 0]), [vx, vz, rate], contacts)
        wanted = pinimpact.impact(
            exact, exact.createData(), np.array([0, down, 0]), [vx, vz, -rate], contacts
        )
        size = wanted.impulses_world.max()
        assert np.abs(hit.impulses_world @ across).max() < 1e-10 * size
        assert hit.impulses_world[:, 2] == pytest.approx(wanted.impulses_world[:, 2], abs=1e-9 * size)
        total, other = hit.impulses_world.sum(axis=0), wanted.impulses_world.sum(axis=0)
        assert along @ total == pytest.approx(other[::2], abs=1e-9 * size)


def test_bad_lists(quadruped):
    model, q = quadruped
    v = np.zeros(model.nv)
    with pytest.raises(InputError, match="contact: no contact"):
        pinimpact.impact(model, model.createData(), q, v, [])
    with pytest.raises(InputError, match="contact: 'FL_FOOT' is not a Contact"):
        pinimpact.impact(model, model.createData(), q, v, ["FL_FOOT"])
    with pytest.raises(InputError, match=r"stiffness: 0.0 given; it must be above 0"):
        Contact("FL_FOOT", Plane(), stiffness=0.0)
    with pytest.raises(pinimpact.UnknownNameError, match="simultaneous: 'waves' is not a policy"):
        Scene(model, simultaneous="waves")


# ---- scenes


def height_of_feet(model, q):
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    return min(data.oMf[model.getFrameId(foot)].translation[2] for foot in FEET)


@pytest.fixture(scope="module")
def landing(quadruped):
    model, q = quadruped
    q = q.copy()
    q[2] += 0.05 - height_of_feet(model, q)
    return model, q


def test_flat_landing_stays_symmetric(landing):
    model, q = landing
    scene = Scene(model, contacts=feet(restitution=0.5))
    motion = simulate(scene, q, np.zeros(model.nv), 0.13)
    assert len(motion.impacts) >= 4
    first = motion.impacts[:4]
    assert {impact.source for impact in first} == {contact.label for contact in scene.contacts}
    assert len({impact.time for impact in first}) == 1
    assert all(impact.simultaneous for impact in first)
    assert np.abs(motion.q[-1][[1]]).max() < 1e-9  # no lateral motion
    assert np.abs(motion.v[-1][[1, 3, 5]]).max() < 1e-7
    assert np.abs(motion.energy.residual).max() < 1e-8


def test_records_of_impact_at_several_contacts(landing, tmp_path):
    model, q = landing
    motion = simulate(Scene(model, contacts=feet(restitution=0.5)), q, np.zeros(model.nv), 0.11)
    mass = pin.crba(model, model.createData(), motion.impacts[0].q)
    mass = np.triu(mass) + np.triu(mass, 1).T
    one, other = motion.impacts[:2]
    assert one.solution.part_of is other.solution.part_of
    change = (mass @ (one.v_after - one.v_before))[:3]
    assert change == pytest.approx(sum(impact.impulse_world for impact in motion.impacts[:4]), abs=1e-10)
    energy = 0.5 * one.v_after @ mass @ one.v_after - 0.5 * one.v_before @ mass @ one.v_before
    assert energy == pytest.approx(sum(i.solution.work.total for i in motion.impacts[:4]), abs=1e-10)
    motion.save(tmp_path / "landing.npz")
    again = pinimpact.Trajectory.load(tmp_path / "landing.npz")
    for here, there in zip(motion.impacts, again.impacts, strict=True):
        assert np.array_equal(here.solution.impulse, there.solution.impulse)
        assert here.solution.segments == there.solution.segments
        assert np.array_equal(here.impulse_world, there.impulse_world)


def test_uncoupled_impacts_are_resolved_separately():
    # two uncoupled balls in one model
    model = pin.Model()
    for name in ("one", "other"):
        joint = model.addJoint(0, pin.JointModelTranslation(), pin.SE3.Identity(), name)
        model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
        model.addFrame(pin.Frame(f"{name}_ball", joint, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    contacts = [Contact(f"{name}_ball", Plane(), restitution=0.5) for name in ("one", "other")]
    motion = simulate(Scene(model, contacts=contacts), [0, 0, 1.0, 3, 0, 1.0], np.zeros(6), 0.6)
    assert [impact.group for impact in motion.impacts] == [None, None]
    assert motion.v[-1][2] == pytest.approx(motion.v[-1][5], abs=1e-12)


def test_policies_of_scenes_differ(landing):
    model, q = landing
    after = {}
    for policy in ("propagate", "sequence"):
        scene = Scene(model, contacts=feet(restitution=0.5), simultaneous=policy)
        motion = simulate(scene, q, np.zeros(model.nv), 0.102)
        after[policy] = motion.v[-1]
        assert repr(policy) in str(scene.plan())
    assert np.abs(after["propagate"][[1, 3, 5]]).max() < 1e-9
    assert np.abs(after["sequence"][[1, 3, 5]]).max() > 1e-4  # successive impacts of feet


def test_infinite_sequence_of_impacts_reaches_its_limit():
    # a point in a slot that narrows by 2°: in the limit only the velocity along the slot remains
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelTranslation(), pin.SE3.Identity(), "point")
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    model.addFrame(pin.Frame("tip", joint, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    turn = np.radians(1.0)
    walls = [Plane(normal=(side * np.cos(turn), 0.0, np.sin(turn))) for side in (1.0, -1.0)]
    contacts = [
        Contact("tip", wall, restitution=0.5, name=name)
        for name, wall in zip(("left", "right"), walls, strict=True)
    ]
    scene = Scene(model, contacts=contacts, simultaneous="sequence")
    with pytest.warns(BoundReachedWarning, match="After 400 single impacts") as warned:
        motion = simulate(scene, np.zeros(3), [0.3, 0.4, -1.0], 0.01)
    assert len(warned) == 1
    assert motion.v[-1] == pytest.approx([0.0, 0.4, 0.0], abs=1e-9)
    assert len(motion.impacts) == 402
    notes = " ".join(note.text for note in motion.notes)
    assert "After 400 single impacts" in notes
    assert "left, right, left, right" in notes
    lost = sum(impact.solution.work.total for impact in motion.impacts)
    assert lost == pytest.approx(-0.5 * (0.3**2 + 1.0), abs=1e-9)


def test_replay_shows_all_contacts_of_a_simultaneous_impact(landing):
    from pinimpact.visual.impact_marks import impact_mark

    model, q = landing
    motion = simulate(Scene(model, contacts=feet(restitution=0.5)), q, np.zeros(model.nv), 0.105)
    first = motion.impacts[:4]
    places = {impact.source: (np.zeros(3), np.eye(3)) for impact in first}
    mark = impact_mark([(one.source, one, places[one.source]) for one in first], "four feet")
    assert mark.source == "four feet"
    assert [contact.name for contact in mark.contacts] == [impact.source for impact in first]
    for contact, impact in zip(mark.contacts, first, strict=True):
        assert contact.impulse[-1] == pytest.approx(impact.solution.impulse, abs=1e-12)
        assert contact.velocity[0] == pytest.approx(impact.problem.velocity, abs=1e-12)
        assert contact.clock[0] == 0.0
        assert contact.clock[-1] == 1.0
    assert mark.lost == pytest.approx(-sum(impact.solution.work.total for impact in first), rel=1e-12)
    page = pinimpact.replay(model, motion, None)
    assert '"4 contacts"' in page.html or "FL_FOOT on plane + FR_FOOT on plane" in page.html
