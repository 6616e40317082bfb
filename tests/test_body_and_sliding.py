"""Identification of inertia, sliding friction and gravity from recorded motions; errors of predictions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import pinimpact
from pinimpact import InputError, Scene, UnknownNameError, load_robot, simulate, studies
from pinimpact.robot.matrices import contact_geometry

from .test_identification import CUBES, cube_scene, cube_states, names_of
from .test_recorded_impacts import box_scene, cube_motions, recorded, toss


def struck_boxes(rng: np.random.Generator, count: int = 60) -> studies.FoundImpacts:
    """Return exact impacts of the box at its lowest corner, with random orientations."""
    scene = box_scene(0.3, 0.4)
    model, data = scene.model, scene.model.createData()
    q, v = np.zeros((count, 7)), rng.normal(size=(count, 6)) * [1, 1, 1, 5, 5, 5]
    after, names = np.empty_like(v), []
    for i in range(count):
        rotation = Rotation.random(rng=rng)
        q[i, 3:] = rotation.as_quat()
        v[i, :3] = rotation.inv().apply([*rng.normal(size=2), -2.0])
        gaps = [one.gap(model, data, q[i]) for one in scene.contacts]
        contact = scene.contacts[int(np.argmin(gaps))]
        after[i] = pinimpact.impact(model, data, q[i], v[i], contact).v
        names.append(contact.label)
    return studies.FoundImpacts(
        q, v, after, np.array(names), np.repeat(np.arange(count // 2), 2), scene=scene
    )


def wrong(scene: Scene) -> Scene:
    """Return the scene with wrong inertia and radii."""
    model = scene.model.copy()
    model.inertias[1] = pin.Inertia(0.4, np.zeros(3), np.diag([7e-4, 7e-4, 7e-4]))
    return Scene(model, [replace(one, radius=0.0) for one in scene.contacts])


def test_inertia_from_impacts_without_restitution_law() -> None:
    exact = struck_boxes(np.random.default_rng(0))
    fit = studies.identify_body(replace(exact, scene=wrong(exact.scene)))
    assert fit.law is None
    truth = [0.004, -0.003, 0.006, 9e-4 / 0.4, 8e-4 / 0.4, 6e-4 / 0.4, 0, 0, 0, 0.002]
    assert fit.x == pytest.approx(truth, abs=1e-8)
    found = fit.apply(wrong(exact.scene))
    inertia, expected = found.model.inertias[1], exact.scene.model.inertias[1]
    assert np.array(inertia.inertia) == pytest.approx(np.array(expected.inertia), abs=1e-8)
    assert [contact.radius for contact in found.contacts] == pytest.approx([0.002] * 8, abs=1e-7)


def test_fit_of_centre_of_mass_alone() -> None:
    exact = struck_boxes(np.random.default_rng(1))
    fit = studies.identify_body(exact, "com", loss="linear")
    assert fit.names == ("com:x", "com:y", "com:z")
    assert fit.x == pytest.approx([0.004, -0.003, 0.006], abs=1e-8)


def framed(scene: Scene) -> Scene:
    """Return the same scene, with contacts at frames of their own."""
    model, contacts = scene.model.copy(), []
    for k, one in enumerate(scene.contacts):
        turn, offset = Rotation.from_rotvec([k, 1.0, -0.5]).as_matrix(), np.array([1e-3, 2e-3, -3e-3])
        place = pin.SE3(turn, np.array(one.offset) - turn @ offset)
        model.addFrame(pin.Frame(f"corner {k}", 1, place, pin.OP_FRAME))
        contacts.append(replace(one, frame=f"corner {k}", offset=tuple(offset), name=one.label))
    return Scene(model, contacts)


def test_fit_of_body_does_not_depend_on_the_frames_of_contacts() -> None:
    exact = struck_boxes(np.random.default_rng(0))
    fits = [
        studies.identify_body(replace(exact, scene=scene)) for scene in (exact.scene, framed(exact.scene))
    ]
    assert fits[1].x == pytest.approx(fits[0].x, abs=1e-9)


def test_centre_of_mass_and_inertia_from_impacts_on_a_rim() -> None:
    model, rng = pin.Model(), np.random.default_rng(4)
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "coin")
    truth = [0.002, -0.001, 0.003, 4e-3, 5e-3, 7e-3, 0, 0, 0]
    mass = 0.3
    inertia = pin.Inertia(mass, np.array(truth[:3]), mass * np.diag(truth[3:6]))
    model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    model.addJointFrame(joint)
    rim = pinimpact.Contact("coin", pinimpact.Plane(), 0.3, 0.4, rim=0.1, axis=(0.0, 0.1, 1.0))
    data, states = model.createData(), []
    for _ in range(30):
        rotation = Rotation.random(rng=rng)
        q = np.r_[0, 0, 0, rotation.as_quat()]
        v = np.r_[rotation.inv().apply([*rng.normal(size=2), -2.0]), 3.0 * rng.normal(size=3)]
        if pinimpact.contact_matrices(model, data, q, rim).velocity(v)[2] > 0.0:
            v *= -1.0
        states.append((q, v, pinimpact.impact(model, data, q, v, rim).v))
    q, v, after = (np.array(column) for column in zip(*states, strict=True))
    guess = model.copy()
    guess.inertias[1] = pin.Inertia(mass, np.zeros(3), mass * np.diag([5e-3, 5e-3, 5e-3]))
    names = np.full(len(q), rim.label)
    found = studies.FoundImpacts(q, v, after, names, np.arange(len(q)), scene=Scene(guess, [rim]))
    assert studies.identify_body(found, ("com", "inertia")).x == pytest.approx(truth, abs=1e-8)


def test_standard_errors_of_centre_of_mass() -> None:
    rng = np.random.default_rng(2)
    exact, scores = struck_boxes(rng), []
    truth = np.array([0.004, -0.003, 0.006])
    for _ in range(60):
        noise = rng.normal(size=exact.v_after.shape) * [2e-3, 2e-3, 2e-3, 0.03, 0.03, 0.03]
        fit = studies.identify_body(replace(exact, v_after=exact.v_after + noise), "com")
        scores.append((fit.x - truth) / fit.standard_errors)
    assert np.sqrt(np.mean(np.square(scores))) == pytest.approx(1.0, abs=0.25)


def sliding_scene() -> Scene:
    """Return a scene of the box with separate sliding friction and gravity not along the normal."""
    scene = box_scene(0.2, 0.0)
    scene.model.gravity.linear = np.array([0.15, -0.1, -9.8])
    return replace(scene, contacts=[replace(one, sliding_friction=0.3) for one in scene.contacts])


@pytest.mark.slow
def test_sliding_friction_and_gravity_of_simulated_slides() -> None:
    rng, scene, motions = np.random.default_rng(3), sliding_scene(), []
    for k in range(16):
        turn = Rotation.from_euler("z", rng.uniform(0, 2 * np.pi))
        direction = rng.uniform(0, 2 * np.pi)
        velocity = turn.inv().apply([np.cos(direction), np.sin(direction), 0.0])
        v0 = np.concatenate([velocity, [0, 0, rng.uniform(-3, 3)]])
        run = simulate(scene, np.concatenate([[0, 0, 0.062], turn.as_quat()]), v0, 0.35)
        motions.append(recorded(run, rng, (2e-5, 1e-4), group=k))
    model = scene.model.copy()
    model.gravity.linear = np.array([0.0, 0.0, -np.linalg.norm(scene.model.gravity.linear)])
    level = replace(scene, model=model)
    fit = studies.identify_sliding(motions, level)
    assert fit.names == ("sliding_friction", "gravity:t1", "gravity:t2")
    assert np.all(np.abs(fit.x - [0.3, 0.15, -0.1]) < np.maximum(4 * fit.standard_errors, [2e-3, 0.02, 0.02]))
    applied = fit.apply(level)
    assert np.array(applied.model.gravity.linear) == pytest.approx([0.15, -0.1, -9.8], abs=0.05)
    assert applied.contacts[0].sliding_friction == fit.x[0]
    assert applied.contacts[0].friction == 0.2
    assert studies.identify_sliding(motions, framed(level)).x == pytest.approx(fit.x, abs=1e-9)
    alone = studies.identify_sliding(motions, scene, ("sliding_friction",))
    assert alone.x == pytest.approx([0.3], abs=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("tilt", [0.0, 40.0, 70.0])
def test_sliding_along_slopes(tilt: float) -> None:
    """Straight down a slope, and up, boxes move at the constant acceleration g sin ± μ g cos."""
    turn = Rotation.from_euler("y", tilt, degrees=True)
    normal, down = turn.apply([0.0, 0.0, 1.0]), turn.apply([1.0, 0.0, 0.0])
    scene, mu, g = box_scene(0.2, 0.0), 0.3, 9.81
    scene = replace_planes(scene, pinimpact.Plane(normal=tuple(normal)))
    fall, press = g * np.sin(np.radians(tilt)), g * np.cos(np.radians(tilt))
    motions, t = [], np.arange(0.0, 0.2, 1 / 150)
    for k, speed in enumerate((3.0, 2.0, -3.0)):
        path = speed * t + 0.5 * (fall - np.sign(speed) * mu * press) * t**2
        position = 0.062 * normal + path[:, None] * down
        q = np.hstack([position, np.tile(turn.as_quat(), (len(t), 1))])
        motions.append(studies.Motion(t, q, group=k))
    fit = studies.identify_sliding(motions, scene)
    axes = contact_geometry(scene.model, scene.model.createData(), q[0], scene.contacts[0]).axes
    expected = [mu, *(axes[:2] @ scene.model.gravity.linear)]
    assert fit.x == pytest.approx(expected, abs=1e-8)
    applied = fit.apply(scene).model.gravity.linear
    assert applied == pytest.approx(np.array(scene.model.gravity.linear), abs=1e-7)


def block() -> Scene:
    """Return a scene of a cube of 1 kg, 0.1 m wide, on a plane with gravity of −3 m/s² along it, on x."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "block")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), 0.002 * np.eye(3)), pin.SE3.Identity())
    model.addBodyFrame("block", joint, pin.SE3.Identity(), 0)
    model.gravity.linear = np.array([-3.0, 0.0, -9.3])
    corners = [(x, y, z) for x in (-0.05, 0.05) for y in (-0.05, 0.05) for z in (-0.05, 0.05)]
    contacts = [
        pinimpact.Contact("block", pinimpact.Plane(), offset=corner, name=f"corner {k}")
        for k, corner in enumerate(corners)
    ]
    return Scene(model, contacts)


@pytest.mark.parametrize("rate", [30, 60, 200])
def test_slides_that_reverse_between_two_frames(rate: int) -> None:
    """A block slides up a slope with the acceleration −3 − μ g_n, and back with −3 + μ g_n."""
    rng, motions, mu = np.random.default_rng(0), [], 0.2
    up, down = -3.0 - mu * 9.3, -3.0 + mu * 9.3
    for k, speed in enumerate(rng.uniform(0.8, 1.6, 20)):
        t = (np.arange(int(0.8 * rate)) + rng.uniform()) / rate
        before, after = np.minimum(t, -speed / up), np.maximum(t + speed / up, 0.0)
        q = np.tile([0, 0, 0.05, 0, 0, 0, 1.0], (len(t), 1))
        q[:, 0] = speed * before + 0.5 * up * before**2 + 0.5 * down * after**2
        motions.append(studies.Motion(t, q, group=k))
    fit = studies.identify_sliding(motions, block())
    assert fit.x == pytest.approx([mu, -3.0, 0.0], abs=1e-6)


@pytest.mark.parametrize(
    ("sideways", "spin", "slope", "allowed"),
    [(0.2, 0.0, -3.0, 2e-3), (0.5, 0.0, -3.0, 1e-3), (1.57, 0.0, -3.0, 1e-3), (0.0, 5.0, 0.0, 1e-3),
     (0.0, 15.0, 0.0, 1e-3), (0.0, 20.0, 0.0, 1e-3), (0.0, 40.0, 0.0, 1e-3)],
)  # fmt: skip
def test_slides_that_turn(sideways: float, spin: float, slope: float, allowed: float) -> None:
    """Blocks that turn on a slope, or spin by more than a turn, by integration with equal loads."""
    rng, motions, mu = np.random.default_rng(2), [], 0.2 if slope else 0.3
    arms = np.array([[x, y] for x in (-0.05, 0.05) for y in (-0.05, 0.05)])
    t = np.arange(0.0, 0.8 if slope else 0.3, 1 / 200)

    def rates(_: float, y: np.ndarray) -> np.ndarray:
        c, s = np.cos(y[2]), np.sin(y[2])
        arm = arms @ [[c, s], [-s, c]]
        slip = y[3:5] + y[5] * np.column_stack([-arm[:, 1], arm[:, 0]])
        force = -mu * 9.3 / 4 * slip / np.linalg.norm(slip, axis=1)[:, None]
        torque = (arm[:, 0] * force[:, 1] - arm[:, 1] * force[:, 0]).sum()
        return np.concatenate([y[3:], force.sum(axis=0) + np.array([slope, 0.0]), [torque / 0.002]])

    for k, speed in enumerate(rng.uniform(1.0, 1.5, 12)):
        angle = sideways * rng.choice([-1, 1]) if slope else rng.uniform(0, 2 * np.pi)
        start = [0, 0, 0, speed * np.cos(angle), speed * np.sin(angle), spin * rng.choice([-1, 1])]
        y = solve_ivp(rates, (0.0, t[-1]), start, t_eval=t, max_step=2e-3, rtol=1e-8, atol=1e-10).y
        q = np.tile([0, 0, 0.05, 0, 0, 0, 1.0], (len(t), 1))
        q[:, :2], q[:, 5], q[:, 6] = y[:2].T, np.sin(0.5 * y[2]), np.cos(0.5 * y[2])
        motions.append(studies.Motion(t, q, group=k))
    scene = block()
    scene.model.gravity.linear = np.array([slope, 0.0, -9.3])
    assert studies.identify_sliding(motions, scene).x[0] == pytest.approx(mu, rel=allowed)


def test_gravity_that_cannot_be_fitted_raises() -> None:
    wall = replace_planes(box_scene(), pinimpact.Plane(normal=(1.0, 0.0, 0.0)))
    t = np.arange(0.0, 0.2, 1 / 150)
    q = np.tile([0.042, 0, 0, 0, 0, 0, 1.0], (len(t), 1))
    q[:, 1] = 2.0 * t
    motions = [studies.Motion(t, q, group=k) for k in range(2)]
    for free in ("gravity", "sliding_friction"):
        with pytest.raises(InputError, match=r"scene: gravity has \+0 m/s² along the normal of the plane"):
            studies.identify_sliding(motions, wall, free)


def test_planes_that_no_body_can_slide_on_raise() -> None:
    """The recorded box slides on z = 0; it cannot slide below a plane, nor 1 m above or below one."""
    t = np.arange(0.0, 0.2, 1 / 150)
    q = np.tile([0, 0, 0.062, 0, 0, 0, 1.0], (len(t), 1))
    motions = []
    for k, speed in enumerate((2.0, -3.0)):
        path = q.copy()
        path[:, 0] = speed * t - 0.5 * np.sign(speed) * 0.3 * 9.81 * t**2
        motions.append(studies.Motion(t, path, group=k))
    scene, only = box_scene(), ("sliding_friction",)
    fit = studies.identify_sliding(motions, scene)
    assert fit.x[0] == pytest.approx(0.3, abs=1e-8)
    up = scene.model.copy()
    up.gravity.linear = np.array([0.0, 0.0, 9.81])
    lifted, ceiling = (
        Scene(up, scene.contacts), replace_planes(scene, pinimpact.Plane(normal=(0.0, 0.0, -1.0))),
    )  # fmt: skip
    for impossible in (lifted, ceiling):
        with pytest.raises(
            InputError, match=r"gravity has \+9.81 m/s² along the normal .* -9.81 for a level"
        ):
            studies.identify_sliding(motions, impossible, only)
    with pytest.raises(InputError, match="give the scene of the fit"):
        fit.apply(lifted)
    for height in (1.0, -1.0):
        shelf = replace_planes(scene, pinimpact.Plane(point=(0.0, 0.0, height)))
        with pytest.raises(InputError, match=f"the third smallest is {-height:.0f} m to {-height:.0f} m"):
            studies.identify_sliding(motions, shelf, only)


def replace_planes(scene: Scene, plane: pinimpact.Plane) -> Scene:
    return Scene(scene.model, [replace(one, plane=plane) for one in scene.contacts])


def test_rollouts_of_true_and_other_model() -> None:
    rng, scene = np.random.default_rng(4), box_scene()
    motions = [recorded(toss(scene, rng, 0.2), rng, group=k) for k in range(6)]
    true = studies.rollouts(scene, motions)
    # states of flights have the accuracy of rotations
    assert true.at_end()[:, 0].max() < 1e-5
    assert [len(t) for t in true.time] == [30] * 6
    other = studies.rollouts(
        Scene(scene.model, [replace(one, restitution=0.2) for one in scene.contacts]), motions
    )
    difference = studies.compare(other, true)
    assert difference.groups == 6
    low, high = difference.interval[0]
    assert 0.0 < low < difference.difference[0] < high
    assert studies.compare(true, true).interval == pytest.approx(np.zeros((2, 2)))
    apart = studies.compare(other, true, paired=False)
    assert np.diff(apart.interval[0]) > 0.0
    again = studies.rollouts(scene, motions, restart=True)
    assert len(again) >= 4
    assert again.at_end()[:, 0].max() < 1e-3
    moved = [studies.Motion(one.t, one.q + np.eye(7)[0], group=one.group) for one in motions]
    permuted = [motions[k] for k in (1, 0, 2, 3, 4, 5)]
    unlike = [again, *(studies.rollouts(scene, some) for some in (moved, permuted))]
    for one in unlike:
        with pytest.raises(InputError, match="its errors belong to data other than those of test"):
            studies.compare(true, one)
    assert studies.compare(other, unlike[1], paired=False).difference[0] > 0.0


def test_rounded_quaternions() -> None:
    """A box slides by v t − μ g t²/2 until it stops at t = v/(μ g); its quaternions have three digits."""
    motions, t = [], np.arange(0.0, 0.5, 1 / 150)
    for k, v in enumerate((0.8, 1.0, 1.2)):
        s = np.minimum(t, v / (0.25 * 9.81))
        x = v * s - 0.5 * 0.25 * 9.81 * s**2
        q = np.column_stack([x, 0 * x, 0 * x + 0.062, 0 * x, 0 * x, 0 * x + 0.387, 0 * x + 0.922])
        motions.append(studies.Motion(t, q, group=k))
    fit = studies.identify_sliding(motions, box_scene(), ("sliding_friction",))
    assert fit.x == pytest.approx([0.25], rel=1e-9)


def test_bad_input_is_named() -> None:
    exact = struck_boxes(np.random.default_rng(5), 4)
    with pytest.raises(InputError, match=r"the result of studies\.impacts is expected"):
        studies.identify_body((exact.q, exact.v_before, exact.v_after))
    with pytest.raises(UnknownNameError, match="free: 'mass' is not a parameter"):
        studies.identify_body(exact, ("mass",))
    t = np.arange(12) / 150
    still = studies.Motion(t, np.tile([0.0, 0, 0.062, 0, 0, 0, 1], (12, 1)))
    with pytest.raises(InputError, match="no body slides on a face for 7 frames"):
        studies.identify_sliding([still], box_scene())
    for kind, effect in (("gravity", "gravity"), ("sliding_friction", "contact friction")):
        with pytest.raises(InputError, match=f"free: {kind} is free, but the scene is without {effect}"):
            studies.identify_sliding([still], replace(box_scene(), without=[effect]), (kind,))
    with pytest.raises(InputError, match="at least three contacts with one plane"):
        studies.identify_sliding([still], Scene(box_scene().model, box_scene().contacts[:2]))
    with pytest.raises(InputError, match="rollouts is for one free body"):
        studies.rollouts(Scene(load_robot("panda")), [still])
    belt = replace_planes(box_scene(), pinimpact.Plane(velocity=(0.5, 0.0, 0.0)))
    with pytest.raises(InputError, match="its plane moves; identify_sliding needs one at rest"):
        studies.identify_sliding([still], belt)
    rims = [replace(one, rim=0.01, radius=0.0) for one in box_scene().contacts]
    with pytest.raises(InputError, match=r"scene: the rim '.*' has no fixed point"):
        studies.identify_sliding([still], Scene(box_scene().model, rims))
    rotated = box_scene().model.copy()
    rotated.jointPlacements[1] = pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, 0.5 * np.pi), np.zeros(3))
    with pytest.raises(InputError, match="is rotated relative to the world; identify_sliding needs"):
        studies.identify_sliding([still], Scene(rotated, box_scene().contacts))
    for twice_or_none in ((), ("gravity", "gravity")):
        with pytest.raises(InputError, match=r"free: .* one or more of .*, 'gravity', each once"):
            studies.identify_sliding([still], box_scene(), twice_or_none)
    with pytest.raises(InputError, match="motions: no recordings given, at least one expected"):
        studies.identify_sliding([], box_scene())
    for twice_or_none in ((), ("com", "com")):
        with pytest.raises(InputError, match=r"free: .* one or more of 'com', .*, each once"):
            studies.identify_body(exact, twice_or_none)
    with pytest.raises(InputError, match="held_out: no recordings given, at least one expected"):
        studies.rollouts(box_scene(), [])
    with pytest.raises(InputError, match="trajectories: no recordings given, at least one expected"):
        studies.identify(scene=box_scene(), trajectories=[])
    noise = (1e-5, 1e-4)
    with pytest.raises(InputError, match="motion 0 has no flight of 5 frames"):
        studies.rollouts(box_scene(), [studies.Motion(t, still.q, sigma=noise)])
    with pytest.raises(InputError, match="test: 3 given; roll-outs or a fit of two or more groups"):
        studies.compare(3, 4)


@pytest.fixture(scope="module")
def cubes():
    if not CUBES.is_file():
        pytest.skip(f"the recorded tosses are not in {CUBES.parent}")
    return dict(np.load(CUBES))


def test_inertia_of_recorded_cube(cubes) -> None:
    """Compare with the published inertia from free flight and momentum balance."""
    scene = cube_scene(cubes)
    found = studies.FoundImpacts(*cube_states(cubes), names_of(cubes), cubes["toss"], scene=scene)
    fit = studies.identify_body(found)
    diagonal = cubes["inertia_over_mass_body"].diagonal()
    expected = np.array([0, 0, 0, *diagonal, 0, 0, 0, 0.0044])
    assert np.all(np.abs(fit.x - expected) < 4.0 * fit.standard_errors)
    assert np.all(fit.standard_errors[3:6] < 0.002 * diagonal)


@pytest.mark.slow
def test_sliding_of_recorded_cube(cubes) -> None:
    scene = cube_scene(cubes)
    scene.model.gravity.linear = np.array([0.0, 0.0, -9.81 / 1.0215])
    motions = cube_motions(cubes, dict(np.load(CUBES.with_name("trajectories.npz"))), 284)
    fit = studies.identify_sliding(motions, scene)
    assert fit.x[0] == pytest.approx(0.218, abs=0.002)
    assert np.all(np.abs(fit.x[1:]) < 3.0 * fit.standard_errors[1:])  # the board is level
