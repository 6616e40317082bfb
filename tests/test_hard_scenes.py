"""Scenes with unbounded forces (Painlevé), non-unique forces, or many simultaneous contacts."""

from __future__ import annotations

import numba
import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import block_diag
from scipy.optimize import brentq

from pinimpact import Contact, Event, Plane, Scene, load_robot, simulate
from pinimpact.contact_space.jam_growth import growing_indentations
from pinimpact.errors import IrregularMotionError
from pinimpact.geometry.surfaces import contact_axes
from pinimpact.scene.instant import Instant
from pinimpact.scene.integrator import Integrator
from pinimpact.scene.options import Options

from .drawing import one_of_each
from .random_scenes import draw, relative_energy_residual
from .robot_cases import load
from .scene_models import UP, G, free_body, run, unbounded

pytestmark = pytest.mark.filterwarnings("ignore::pinimpact.BoundReachedWarning")
"""Some impacts reach a bound of the solver, which does not affect these checks."""

MU = 2.0
INERTIA = 1.0 / 3.0


def planar_rod(about=INERTIA):
    """Return a planar rod of mass 1 and half length 1; it is level at zero, and rotation lowers ``tip``."""
    model, parent = pin.Model(), 0
    for name, joint in (("x", pin.JointModelPX()), ("z", pin.JointModelPZ()), ("turn", pin.JointModelRY())):
        parent = model.addJoint(parent, joint, pin.SE3.Identity(), name)
    inertia = pin.Inertia(1.0, np.zeros(3), np.diag([1e-3, about, about]))
    model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
    tip = pin.SE3(np.eye(3), np.array([1.0, 0.0, 0.0]))
    model.addFrame(pin.Frame("tip", parent, 0, tip, pin.FrameType.OP_FRAME))
    unbounded(model)
    return model


def pushed_rod(angle, rate, speed=6.0):
    """Return q and v of a rod that pushes its tip ahead along the floor."""
    q = [0.0, np.sin(angle), angle]
    return q, [speed + rate * np.sin(angle), rate * np.cos(angle), rate]


def effective(angle):
    """Return the derivative of the tip's vertical acceleration by the normal force while the tip slides."""
    return 1.0 + np.cos(angle) * (np.cos(angle) - MU * np.sin(angle)) / INERTIA


def singular_state(q, v):
    """Return time, configuration and velocity at which the normal force becomes unbounded."""

    def rates(t, y):
        s, c = np.sin(y[2]), np.cos(y[2])
        force = (G - y[5] ** 2 * s) / effective(y[2])
        return [*y[3:], -MU * force, force - G, (MU * s - c) * force / INERTIA]

    def nearly(t, y):
        return effective(y[2]) - 1e-7

    nearly.terminal = True
    end = solve_ivp(rates, (0.0, 1.0), [*q, *v], method="DOP853", rtol=1e-12, atol=1e-13, events=nearly)
    assert end.status == 1
    return end.t[-1], end.y[:3, -1], end.y[3:, -1]


def velocity_after_stop(q, v):
    """Return the velocity of the rod after an impulse that stops its tip."""
    s, c = np.sin(q[2]), np.cos(q[2])
    rows = np.array([[1.0, 0.0, -s], [0.0, 1.0, -c]])
    response = rows.T / np.array([[1.0], [1.0], [INERTIA]])
    return v - response @ np.linalg.solve(rows @ response, rows @ v)


@pytest.mark.parametrize(("angle", "rate"), [(0.3, 3.0), (0.5, 2.5), (0.6, 1.5)])
@pytest.mark.parametrize("rtol", [1e-6, 1e-9])
def test_rod_jams_where_forces_become_unbounded(angle, rate, rtol):
    """At the singularity of Painlevé's rod an impact without collision stops the tip, and it lifts off."""
    q, v = pushed_rod(angle, rate)
    scene = Scene(planar_rod(), [Contact("tip", Plane(), friction=MU)])
    trajectory = run(scene, q, v, 0.3, rtol=rtol, atol=1e-2 * rtol)
    (jam,) = (note for note in trajectory.notes if "jam" in note.text)
    time, q, v = singular_state(q, v)
    assert jam.time == pytest.approx(time, abs=1e-5)
    after = velocity_after_stop(q, v)
    assert trajectory.at(jam.time, "right")[1] == pytest.approx(after, rel=1e-3)
    assert trajectory.v[trajectory.t == jam.time][-1] == pytest.approx(after, rel=1e-3)
    assert [m.mode for m in trajectory.modes] == ["slip"]
    # the end of existence of forces within a step is located with few evaluations
    assert trajectory.statistics["evaluations"] < 1500


@pytest.mark.parametrize("left", [1e-11, 1e-14, 0.0, -1e-12])
@pytest.mark.parametrize("rate", [2.0, -2.0])
def test_rod_that_starts_within_rounding_of_singularity_has_an_impact(rate, left):
    """The forces are unbounded, or so large that no slip is left; then the tip is stopped at once."""
    q, v = pushed_rod(brentq(lambda angle: effective(angle) - left, 0.3, 1.0, xtol=1e-16), rate)
    (hit,) = run(Scene(planar_rod(), [Contact("tip", Plane(), friction=MU)]), q, v, 1e-3).impacts
    assert hit.time == 0.0
    assert hit.v_after == pytest.approx(velocity_after_stop(q, v), rel=1e-6)


def forked_rod():
    """Return the rod in space, with two tips side by side that share the load."""
    return free_body(pin.Inertia(1.0, np.zeros(3), INERTIA * np.eye(3)), [(1, 0.3, 0), (1, -0.3, 0)])


def spatial_state(q, v):
    """Return the state of the rod in space that corresponds to a state of the planar rod."""
    turn = pin.utils.rotate("y", q[2])
    state = np.array([q[0], 0.0, q[1], *pin.Quaternion(turn).coeffs()])
    return state, np.array([*(turn.T @ [v[0], 0.0, v[1]]), 0.0, v[2], 0.0])


def test_two_tips_jam_together_like_one():
    """Neither contact alone would jam; the singularity is that of both."""
    q, v = pushed_rod(0.5, 2.5)
    contacts = [Contact(f"tip{k}", Plane(), friction=MU) for k in range(2)]
    trajectory = run(Scene(forked_rod(), contacts), *spatial_state(q, v), 0.3, rtol=1e-8, atol=1e-10)
    # reported as unbounded forces or, depending on rounding, as slip without forces
    (jam,) = trajectory.notes
    assert "an impact" in jam.text
    time, q, v = singular_state(q, v)
    assert jam.time == pytest.approx(time, abs=1e-5)
    after = velocity_after_stop(q, v)
    assert trajectory.at(jam.time, "right")[1] == pytest.approx(spatial_state(q, after)[1], abs=1e-3)


@pytest.mark.parametrize("restitution", [0.0, 0.5])
def test_two_sliding_tips_without_consistent_forces_have_an_impact(restitution):
    """Beyond the singularity each tip alone could slide; compare with one tip in the middle."""
    q, v = pushed_rod(1.0, 0.5)
    assert effective(q[2]) < 0.0
    inertia = pin.Inertia(1.0, np.zeros(3), INERTIA * np.eye(3))
    ends = []
    for rod, tips in ((forked_rod(), 2), (free_body(inertia, [(1, 0, 0)]), 1)):
        contact = {"friction": MU, "restitution": restitution, "law": "energetic"}
        contacts = [Contact(f"tip{k}", Plane(), **contact) for k in range(tips)]
        ends.append(run(Scene(rod, contacts), *spatial_state(q, v), 1e-4).impacts)
    both, one = ends
    assert len(one) == 1
    assert len(both) == 2
    assert both[0].impulse_world + both[1].impulse_world == pytest.approx(
        one[0].impulse_world, rel=1e-6, abs=1e-6
    )
    assert both[0].v_after == pytest.approx(one[0].v_after, abs=1e-6)


def test_very_slow_slip_without_consistent_forces_has_an_impact():
    """The tips do not count as at rest: to stop them changes the rotation by more than the tolerance."""
    length, angle, rate, slow, rtol = 0.1, 1.0, 0.5, 3e-6, 1e-6
    inertia = pin.Inertia(1.0, np.zeros(3), INERTIA * length**2 * np.eye(3))
    rod = free_body(inertia, [(length, 0.3 * length, 0), (length, -0.3 * length, 0)])

    def state(speed, angle, rate):
        s, c = np.sin(angle), np.cos(angle)
        return spatial_state([0.0, length * s, angle], [speed + length * rate * s, length * rate * c, rate])

    def push(t, q, v):
        return state(slow, 2.0 * np.arctan2(q[4], q[6]), v[4])[1]

    contacts = [Contact(f"tip{k}", Plane(), friction=MU) for k in range(2)]
    scene = Scene(rod, contacts, events=[Event(lambda t, q, v: t - 1e-3, push)])
    q, v = state(-1.0, angle, rate)  # sliding backwards is regular
    trajectory = run(scene, q, v, 1.2e-3, rtol=rtol, atol=1e-2 * rtol)
    jam, other = trajectory.impacts
    assert jam.time == other.time == pytest.approx(1e-3)
    assert not any("not found" in note.text for note in trajectory.notes)
    error = rtol * (0.01 + np.abs(jam.v_before).max())
    assert error < slow < 10.0 * error
    assert slow < 0.1 * scene.rest
    data = rod.createData()
    pin.computeJointJacobians(rod, data, jam.q)
    frames = [rod.getFrameId(contact.frame) for contact in contacts]
    rows = np.vstack([pin.getFrameJacobian(rod, data, f, pin.LOCAL_WORLD_ALIGNED)[:3] for f in frames])
    response = np.linalg.solve(pin.crba(rod, data, jam.q), rows.T)
    stopping = response @ np.linalg.pinv(rows @ response, rcond=1e-10) @ rows @ jam.v_before
    assert np.abs(stopping).max() > 10.0 * error
    assert jam.v_after == pytest.approx(jam.v_before - stopping, abs=1e-10)


def test_rod_held_by_dry_hinge_keeps_sliding_without_jamming():
    """Dry friction in the hinge prevents rotation, so the rod slides like a point mass."""
    angle, speed, time = 1.0, 6.0, 0.2
    assert effective(angle) < 0.0
    model = planar_rod()
    model.friction = np.array([0.0, 0.0, 20.0])
    assert G * abs(np.cos(angle) - MU * np.sin(angle)) < model.friction[2]
    scene = Scene(model, [Contact("tip", Plane(), friction=MU)])
    trajectory = run(scene, [0.0, np.sin(angle), angle], [speed, 0.0, 0.0], time)
    assert not trajectory.impacts
    assert not trajectory.notes
    assert trajectory.v[-1] == pytest.approx([speed - MU * G * time, 0.0, 0.0], abs=1e-12)
    assert trajectory.q[-1] - trajectory.q[0] == pytest.approx(
        [speed * time - 0.5 * MU * G * time**2, 0.0, 0.0], abs=1e-12
    )


def test_force_margin_beside_redundant_contacts():
    """Rod and table together: the force margin is the smallest of the margins of each alone."""
    angle, held, mass = 1.0, 20.0, 2.0
    model = planar_rod()
    table = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "table")
    model.appendBodyToJoint(table, pin.Inertia.FromBox(mass, 0.4, 0.4, 0.2), pin.SE3.Identity())
    contacts = [Contact("tip", Plane(), friction=MU)]
    for k, (x, y) in enumerate([(-0.2, -0.2), (0.2, -0.2), (-0.2, 0.2), (0.2, 0.2)]):
        corner = pin.SE3(np.eye(3), np.array([x, y, -0.1]))
        model.addFrame(pin.Frame(f"foot{k}", table, 0, corner, pin.FrameType.OP_FRAME))
        contacts.append(Contact(f"foot{k}", Plane(), friction=MU))
    unbounded(model)
    model.friction = np.array([0.0, 0.0, held, *[0.0] * 6])
    q, v = [0.0, np.sin(angle), angle, 0.0, 5.0, 0.1, *UP], [6.0, *[0.0] * 8]
    integrator = Integrator(Scene(model, contacts), q, v, Options())
    integrator.begin()
    assert not integrator.work.forces_unique
    spare = held - G * abs(np.cos(angle) - MU * np.sin(angle))
    assert integrator.work.force_margin == pytest.approx(min(G, 0.25 * mass * G, spare), rel=1e-6)


def test_belt_against_body_held_by_other_contacts_does_not_jam():
    """In both directions the forces are those of equal springs; the body without feet would jam in one."""
    feet = [(-0.2, -0.2, -1.0), (-0.2, 0.2, -1.0), (0.2, 0.0, -1.0)]
    about, place, mu = 0.05, 0.5, 1.0
    assert 1.0 + place * (place - mu) / about < 0.0 < 1.0 + place * (place + mu) / about
    points = np.array([*feet, (place, 0.0, -1.0)])
    model = free_body(pin.Inertia(1.0, np.zeros(3), about * np.eye(3)), points)
    for speed in (3.0, -3.0):
        belt = Plane(velocity=(speed, 0.0, 0.0))
        contacts = [Contact(f"tip{k}", Plane(), friction=2.0 * mu) for k in range(3)]
        contacts.append(Contact("tip3", belt, friction=mu))
        trajectory = run(Scene(model, contacts), [0.0, 0.0, 1.0, *UP], np.zeros(6), 0.1)
        # wrenches about the centre per unit force of the feet, and per unit normal force of the belt
        forces = [*np.tile(np.eye(3), (3, 1)), np.array([np.sign(speed) * mu, 0.0, 1.0])]
        arms = [*np.repeat(points[:3], 3, axis=0), points[3]]
        wrenches = np.array([[*f, *np.cross(arm, f)] for f, arm in zip(forces, arms, strict=True)]).T
        # a small displacement d compresses the springs by `rows @ d`; that of the belt along its normal only
        rows = np.vstack([wrenches[:, :9].T, [0.0, 0.0, 1.0, *np.cross(points[3], [0.0, 0.0, 1.0])]])
        shared = rows @ np.linalg.solve(wrenches @ rows, [0.0, 0.0, G, 0.0, 0.0, 0.0])
        for k, contact in enumerate(contacts):
            expected = shared[3 * k : 3 * k + 3] if k < 3 else shared[9] * forces[9]
            assert trajectory.forces_world(contact.label, [0.05])[0] == pytest.approx(expected, abs=1e-9)


def test_planar_sticking_robot_has_no_note_on_non_unique_forces():
    """The model cannot move out of its plane, so forces perpendicular to it are zero."""
    angle = -0.5 * np.pi + 0.1
    scene = Scene(planar_rod(), [Contact("tip", Plane(point=(0, 0, 1), normal=(0, 0, 1)), friction=MU)])
    trajectory = run(scene, [0.0, 1.0 + np.sin(angle), angle], np.zeros(3), 0.2)
    assert trajectory.notes == ()
    assert [m.mode for m in trajectory.modes] == ["stick"]


@pytest.mark.parametrize("rtol", [1e-3, 1e-4, 1e-5])
def test_panda_falling_against_joint_limits_at_loose_tolerances(rtol):
    """Corrections of active limits may leave inactive ones slightly negative, which is not an event."""
    robot = load_robot("panda")
    hand = Contact("panda_hand_tcp", Plane(point=(0, 0, 0.2)), friction=0.4, restitution=0.5)
    q0 = [0, 0.3, 0, -1.5, 0, 1.5, 0, 0.02, 0.02]
    trajectory = run(Scene(robot, [hand]), q0, np.zeros(9), 1.0, audit=1e-2, rtol=rtol, atol=1e-2 * rtol)
    assert trajectory.complete
    assert trajectory.statistics["steps"] < 1000


@pytest.mark.parametrize(("seed", "friction"), one_of_each(range(6), [0.2, 0.8]))
def test_uncontrolled_solo12_falls_and_slides_without_penetration(seed, friction):
    rng = np.random.default_rng(seed)
    model, _ = load("solo12")
    feet = ("FL_FOOT", "FR_FOOT", "HL_FOOT", "HR_FOOT")
    q0 = pin.integrate(model, pin.neutral(model), 0.3 * rng.normal(size=model.nv))
    data = model.createData()
    pin.framesForwardKinematics(model, data, q0)
    lowest = min(data.oMf[model.getFrameId(foot)].translation[2] for foot in feet)
    floor = Plane(point=(0, 0, lowest - 0.05))
    contacts = [Contact(foot, floor, friction=friction, restitution=0.3) for foot in feet]
    scene = Scene(model, contacts, without=["joint limits"])
    trajectory = run(scene, q0, 0.5 * rng.normal(size=model.nv), 0.6, audit=1e-4, rtol=1e-7)
    assert trajectory.complete
    # no penetration at or between samples
    for t in np.linspace(0.0, 0.6, 200):
        pin.framesForwardKinematics(model, data, trajectory.at(t)[0])
        heights = [data.oMf[model.getFrameId(foot)].translation[2] for foot in feet]
        assert min(heights) - lowest + 0.05 > -1e-7


@pytest.mark.filterwarnings("ignore::pinimpact.SteppedWarning")
@pytest.mark.parametrize(
    "seed", [31000334, 31001224, 31001820, 71000554, 72000253, 72000435, 72000798, 72000900]
)
def test_jamming_feet_dissipate_energy(seed):
    """Neither friction nor impacts increase the energy."""
    _, scene, q, v, rtol = draw(seed)
    trajectory = simulate(scene, q, v, 1.0, rtol=rtol, atol=1e-2 * rtol)
    assert trajectory.complete
    energy = trajectory.energy
    assert relative_energy_residual(trajectory) < 300 * rtol
    for work in (energy.friction, energy.impacts):
        assert np.diff(work).max() < 100 * rtol * (energy.kinetic.max() + 1.0)


def test_slip_that_ends_just_before_singularity_does_not_jam():
    """Forces grow to 10⁵ times the weight and end the slip; errors decrease with the tolerance."""
    _, scene, q, v, _ = draw(92000043)
    runs = [simulate(scene, q, v, 0.2215, rtol=rtol, atol=1e-2 * rtol) for rtol in (1e-6, 1e-7, 1e-9)]
    errors = [np.abs(run.v[-1] - runs[-1].v[-1]).max() for run in runs]
    assert errors[0] < 1e-4
    assert errors[1] < 0.2 * errors[0]
    assert not any("jam" in note.text for run in runs[:2] for note in run.notes)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::pinimpact.SteppedWarning")
@pytest.mark.parametrize(
    "seed",
    [3000072, 3000170, 5000621, *range(4000001, 4000004)]
    + [pytest.param(seed, marks=pytest.mark.exhaustive) for seed in range(4000004, 4000013)],
)
def test_randomly_dropped_robots_satisfy_energy_balance(seed):
    _, scene, q, v, rtol = draw(seed)
    trajectory = simulate(scene, q, v, 1.0, rtol=rtol, atol=1e-2 * rtol)
    assert trajectory.complete
    assert relative_energy_residual(trajectory) < 300 * rtol
    assert trajectory.statistics["steps"] < 5000


def test_one_of_two_oscillating_contacts_jams_and_lifts_the_other():
    """Compare with the integrated motion of unilateral springs below two corners of a sole."""
    rng = np.random.default_rng(4)
    found = 0
    for _ in range(4000):
        factor = rng.standard_normal((6, 7))
        delassus, friction, stiffness = factor @ factor.T, np.full(2, 1.2), rng.uniform(0.5, 2.0, 2)
        velocity = np.column_stack([rng.standard_normal((2, 2)), np.zeros(2)])
        slip = velocity[:, :2] / np.linalg.norm(velocity[:, :2], axis=1)[:, None]
        pressed = np.empty((2, 2))  # normal accelerations per normal force, including its friction
        for i, j in np.ndindex(2, 2):
            row = delassus[3 * i + 2, 3 * j : 3 * j + 3]
            pressed[i, j] = row[2] - 1.2 * row[:2] @ slip[j]
        if np.isreal(np.linalg.eigvals(stiffness[:, None] * pressed)).all():
            continue
        grown = growing_indentations(delassus, velocity, friction, np.full(2, True), stiffness)

        def springs(_, y, pressed=pressed, stiffness=stiffness):
            return [*y[2:], *(-pressed @ (stiffness * np.maximum(y[:2], 0.0)))]

        alone = [i for i in range(2) if pressed[i, i] < 0.0 <= pressed[1 - i, i]]
        assert (grown is not None) == bool(alone)
        if grown is None:
            continue
        found += 1
        end = solve_ivp(springs, (0.0, 12.0), [*(1e-9 * grown), 0.0, 0.0], rtol=1e-9, atol=1e-30).y[:2, -1]
        assert end.argmax() == grown.argmax() == alone[0]
        assert end.max() > 1e-8
        assert end.min() <= 0.0
        # the result is the same beside eight uncoupled contacts
        among = growing_indentations(
            block_diag(delassus, np.eye(24)),
            np.vstack([velocity, np.zeros((8, 3))]),
            np.append(friction, np.zeros(8)),
            np.arange(10) < 2,
            np.append(stiffness, np.ones(8)),
        )
        assert among == pytest.approx(np.append(grown, np.zeros(8)), abs=1e-9)
    assert found > 10


@numba.njit
def velocity_after_spring_contact(delassus, velocity, loads, friction, softness, step, steps):
    """Return velocities after contact with springs of restitution `softness`, by small implicit steps."""
    count = len(velocity) // 3
    depth, deepest, force = np.zeros(count), np.zeros(count), np.zeros(3 * count)
    for _ in range(steps):
        for j in range(count):
            back = (deepest[j] - depth[j]) / softness**2
            force[3 * j + 2] = max(0.0, deepest[j] - back) if depth[j] < deepest[j] else max(0.0, depth[j])
        for _ in range(200):
            change = 0.0
            for j in range(count):
                b, limit = 3 * j, friction * force[3 * j + 2]
                pace = step * (delassus[b, b] + delassus[b + 1, b + 1])
                x, y = force[b], force[b + 1]
                ends = velocity[b : b + 2] + step * (loads[b : b + 2] + delassus[b : b + 2] @ force)
                force[b : b + 2] -= ends / pace
                size = np.hypot(force[b], force[b + 1])
                if size > limit:
                    force[b : b + 2] *= limit / size
                change = max(change, abs(force[b] - x), abs(force[b + 1] - y))
            if change < 1e-16:
                break
        velocity = velocity + step * (loads + delassus @ force)
        for j in range(count):
            depth[j] -= step * velocity[3 * j + 2]
            deepest[j] = max(deepest[j], depth[j]) if depth[j] > 0.0 else 0.0
    return velocity


@pytest.mark.slow
@pytest.mark.parametrize("seed", [pytest.param(262, marks=pytest.mark.exhaustive), 2030, 4621])
def test_sticking_contact_may_slip_in_impact_without_collision(seed):
    """A body rotates about a tip at rest; the other tip jams only after the first one slips.

    Compare with springs under the tips that are compressed by the loads.
    """
    rng = np.random.default_rng(seed)
    inertia = np.diag(10.0 ** rng.uniform(-1.5, 0.0, 3))
    points, normals = rng.normal(size=(2, 3)), rng.normal(size=(2, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    rows = [
        contact_axes(n) @ np.hstack([np.eye(3), -pin.skew(p)]) for p, n in zip(points, normals, strict=True)
    ]
    jacobian, speed = np.vstack(rows), 1e-3
    v = np.linalg.svd(jacobian[[0, 1, 2, 5]])[2][4:].T @ rng.normal(size=2)
    v *= speed / np.linalg.norm((jacobian @ v)[3:5])
    gravity = rng.normal(size=3)
    gravity *= G / np.linalg.norm(gravity)

    model = free_body(pin.Inertia(1.0, np.zeros(3), inertia), points)
    model.gravity.linear = gravity
    contacts = [
        Contact(f"tip{k}", Plane(tuple(points[k]), tuple(normals[k])), friction=1.0) for k in range(2)
    ]
    trajectory = simulate(Scene(model, contacts), pin.neutral(model), v, 1e-9, rtol=1e-9, atol=1e-11)
    assert "without collision" in trajectory.notes[0].text
    after = jacobian @ trajectory.impacts[-1].v_after

    response = np.diag([1.0, 1.0, 1.0, *1.0 / inertia.diagonal()])
    loads, before = jacobian[:, :3] @ gravity, jacobian @ v / speed
    before[[0, 1, 2, 5]] = 0.0
    delassus = jacobian @ response @ jacobian.T
    soft, softer = (
        velocity_after_spring_contact(
            delassus, before, 1e-8 * loads, 1.0, softness, 0.1 * softness, int(4e3 / softness)
        )
        for softness in (0.02, 0.04)
    )
    assert np.abs(soft - softer).max() < 0.02
    assert after / speed == pytest.approx(2.0 * soft - softer, abs=3e-3)


def test_loaded_contact_stays_active_though_it_could_separate():
    """A rod pushed up and ahead strikes the floor and sticks, although its tip could also rise from it."""
    about, angle, falls = 0.1, np.pi / 3.0, 0.05
    push = np.array([10.0, 1.0])
    model = planar_rod(about)
    floor = Contact("tip", Plane(), friction=1.2, restitution=0.0, name="tip")
    scene = Scene(model, [floor], control=lambda t, q, v: [push[0], push[1] + G, 0.0])
    trajectory = run(scene, [0.0, np.sin(angle), angle], [0.0, -falls, 0.0], 0.1, rtol=1e-10, atol=1e-12)

    def rates(t, y):  # rotation about the tip, which sticks
        return [y[1], (push[0] * np.sin(y[0]) + push[1] * np.cos(y[0])) / (about + 1.0)]

    start = [angle, -falls * np.cos(angle) / (about + 1.0)]
    times = np.linspace(0.01, 0.1, 10)
    turn, rate = solve_ivp(rates, (0.0, 0.1), start, "DOP853", times, rtol=1e-12, atol=1e-13).y
    s, c = np.sin(turn), np.cos(turn)
    turns = (push[0] * s + push[1] * c) / (about + 1.0)
    assert len(trajectory.impacts) == 1
    q = np.array([trajectory.at(t)[0] for t in times])
    np.testing.assert_allclose(q, np.transpose([np.cos(angle) - c, s, turn]), atol=1e-9)
    force = trajectory.forces_world("tip", times)[:, ::2]
    expected = np.transpose([s * turns + c * rate**2, c * turns - s * rate**2]) - push
    np.testing.assert_allclose(force, expected, atol=1e-8)
    assert expected[:, 1].min() > 1.0


def test_unloaded_contact_separates_though_it_could_stay_active():
    model = planar_rod(0.1)
    floor = Contact("tip", Plane(), friction=1.2, restitution=0.0)
    scene = Scene(model, [floor], control=lambda t, q, v: [10.0, 1.0 + G, 0.0])
    angle = np.pi / 3.0
    trajectory = run(scene, [0.0, np.sin(angle), angle], np.zeros(3), 0.1)
    np.testing.assert_allclose(trajectory.q[-1], [0.05, np.sin(angle) + 0.005, angle], atol=1e-9)


@pytest.mark.filterwarnings("ignore::pinimpact.SteppedWarning")
@pytest.mark.parametrize(
    ("scheme", "reason"), [("event-driven", "contradict each other"), ("auto", "contact problem")]
)
def test_held_contacts_that_begin_to_contradict_each_other_raise_an_error(scheme, reason):
    """A belt carries one point on, while a turntable, at first as fast, carries another about its axis."""
    model = free_body(pin.Inertia(1.0, np.zeros(3), 0.1 * np.eye(3)), [(0, 0, 0), (0.5, 0, 0)])
    turntable = Plane(point=(0.5, -1.0, 0.0), angular_velocity=(0.0, 0.0, -1.0))
    held = [Contact("tip0", Plane(velocity=(1.0, 0.0, 0.0))), Contact("tip1", turntable)]
    with pytest.raises(IrregularMotionError, match=reason):
        simulate(Scene(model, held=held), pin.neutral(model), [1.0, 0, 0, 0, 0, 0], 0.1, scheme=scheme)


def test_impacts_without_collision_that_do_not_end_raise_an_error(monkeypatch):
    """No motion is known in which they do not end: here modes are never found, and impacts change nothing."""
    monkeypatch.setattr(Instant, "_set_modes", lambda *_: (-1, False))
    monkeypatch.setattr(Instant, "_without_forces", lambda *_: [{"source": "tip"}])
    scene = Scene(planar_rod(), [Contact("tip", Plane(), friction=MU)])
    with pytest.raises(IrregularMotionError, match="10 impacts without collision at t = 0 s do not end"):
        simulate(scene, *pushed_rod(0.3, 3.0), 0.1, scheme="event-driven")
