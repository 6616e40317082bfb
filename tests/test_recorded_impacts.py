"""Flights fitted to recorded poses, and impacts between flights."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

from pinimpact import Contact, InputError, Plane, Scene, load_robot, simulate, studies
from pinimpact.studies.flights import Body, fit_flight, torque_free

from .test_identification import CUBES, cube_scene, cube_states, names_of

RATE = 150.0


def box_scene(friction: float = 0.2, restitution: float = 0.5) -> Scene:
    """Return a scene of a box of unequal edges whose centre of mass is not at its origin."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "box")
    inertia = pin.Inertia(0.4, np.array([0.004, -0.003, 0.006]), np.diag([9e-4, 8e-4, 6e-4]))
    model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    model.addBodyFrame("box", joint, pin.SE3.Identity(), 0)
    corners = itertools.product((-0.04, 0.04), (-0.05, 0.05), (-0.06, 0.06))
    return Scene(
        model,
        [
            Contact("box", Plane(), friction, restitution, offset=corner, radius=0.002, name=f"corner {i}")
            for i, corner in enumerate(corners)
        ],
    )


def toss(scene: Scene, rng: np.random.Generator, duration: float = 0.4):
    """Return the trajectory of a random toss."""
    q0 = np.concatenate([[0, 0, 0.25], Rotation.random(rng=rng).as_quat()])
    v0 = np.concatenate([rng.normal(size=3), 6.0 * rng.normal(size=3)])
    v0[:3] = Rotation.from_quat(q0[3:]).inv().apply([*rng.normal(size=2), -1.0])
    return simulate(scene, q0, v0, duration)


def recorded(trajectory, rng: np.random.Generator, sigma=(0.0, 0.0), **options) -> studies.Motion:
    """Return frames of a trajectory at `RATE`, with noise of positions [m] and rotations [rad]."""
    t = np.arange(0.0, trajectory.duration, 1.0 / RATE)
    q = np.array([trajectory.at(time)[0] for time in t.tolist()])
    q[:, :3] += sigma[0] * rng.normal(size=(len(t), 3))
    turn = Rotation.from_rotvec(sigma[1] * rng.normal(size=(len(t), 3)))
    q[:, 3:] = (turn * Rotation.from_quat(q[:, 3:])).as_quat()
    return studies.Motion(t, q, **options)


def test_precession_of_symmetric_top() -> None:
    """The transverse spin turns at (C − A) w₃/A in body axes, and the axis about L at |L|/A in the world."""
    A, C = 2.0, 0.7
    inertia, w = np.diag([A, A, C]), np.array([0.3, 0.0, 4.0])
    R = Rotation.from_rotvec([0.1, 0.5, -0.3])
    times = np.array([0.4, -0.7, 0.0, 1.3])
    found, spins = torque_free(R.as_matrix()[None], w[None], inertia, times)
    turn = (C - A) / A * w[2] * times
    assert spins[:, 0] == pytest.approx(
        np.column_stack([w[0] * np.cos(turn), -w[0] * -np.sin(turn), np.full(4, w[2])]), abs=1e-8
    )
    momentum = R.apply(inertia @ w)
    precession = Rotation.from_rotvec(np.outer(times, momentum / A))
    spin = Rotation.from_rotvec(np.outer(times, [0, 0, w[2] * (1.0 - C / A)]))
    assert found[:, 0] == pytest.approx((precession * R * spin).as_matrix(), abs=1e-8)


def test_fit_of_fast_rotation() -> None:
    """The body turns by 40° between frames, about an axis that precesses: the first guess is far off."""
    A, C = 2.0, 0.7
    inertia, w, R = np.diag([A, A, C]), np.array([80.0, 0.0, 60.0]), Rotation.from_rotvec([0.1, 0.5, -0.3])
    t = np.arange(12) / 150
    precession = Rotation.from_rotvec(np.outer(t, R.apply(inertia @ w) / A))
    spin = Rotation.from_rotvec(np.outer(t, [0, 0, w[2] * (1.0 - C / A)]))
    body = Body(np.zeros(3), inertia, np.array([0.0, 0.0, -9.81]))
    flight = fit_flight(t, np.outer(t**2, [0.0, 0.0, -4.905]), precession * R * spin, 0.0, body)
    assert flight.spin == pytest.approx(w, abs=1e-5)
    assert np.abs(flight.residuals).max() < 1e-7


def test_fit_of_flight_and_its_covariance() -> None:
    rng = np.random.default_rng(0)
    body = Body(np.zeros(3), np.diag([1.0, 2.0, 2.5]), np.array([0.0, 0.0, -9.81]))
    R, w, v = Rotation.random(rng=rng), np.array([4.0, -5.0, 6.0]), np.array([1.0, 0.2, -2.0])
    times = np.arange(12) / RATE
    matrices, _ = torque_free(R.as_matrix()[None], w[None], body.inertia, times - 0.1)
    dt = times - 0.1
    com = np.outer(dt, v) + np.outer(0.5 * dt**2, body.gravity)
    exact = fit_flight(times, com, Rotation.from_matrix(matrices[:, 0]), 0.1, body)
    assert exact.velocity == pytest.approx(v, abs=1e-10)
    assert exact.spin == pytest.approx(w, abs=1e-7)
    assert np.abs(exact.residuals).max() < 1e-8
    sigma, errors = np.array([1e-4, 1e-3]), []
    for _ in range(200):
        noisy = Rotation.from_rotvec(sigma[1] * rng.normal(size=(12, 3))) * Rotation.from_matrix(
            matrices[:, 0]
        )
        flight = fit_flight(times, com + sigma[0] * rng.normal(size=(12, 3)), noisy, 0.1, body)
        errors.append(np.concatenate([flight.velocity - v, flight.spin - w]))
    predicted = np.sqrt(np.diag(exact.covariance)) * np.repeat(sigma, 3)
    assert np.std(errors, axis=0) == pytest.approx(predicted, rel=0.2)  # four standard errors


@pytest.mark.slow
def test_impacts_of_simulated_tosses() -> None:
    """States at impacts agree with the simulation within the covariances of the fits."""
    rng, scene, sigma = np.random.default_rng(1), box_scene(), (5e-5, 5e-4)
    runs = [toss(scene, rng) for _ in range(12)]
    motions = [recorded(run, rng, sigma, group=f"toss {k}") for k, run in enumerate(runs)]
    found = studies.impacts(scene, motions)
    assert len(found) >= 12
    scores = []
    for i in range(len(found)):
        run = runs[int(found.group[i].split()[1])]
        (hit,) = [one for one in run.impacts if abs(one.time - found.time[i]) < 1e-3]
        assert hit.source == found.contact[i]
        assert found.q[i, :3] == pytest.approx(hit.q[:3], abs=3e-4)
        error = np.concatenate([found.v_before[i] - hit.v_before, found.v_after[i] - hit.v_after])
        scores.append(error @ np.linalg.solve(found.covariance[i], error))
    # χ² of 12 numbers, but with estimated noise and without its effect on the time of impact
    assert 8.0 < np.mean(scores) < 18.0
    fit = studies.identify(found, scene)
    assert fit.groups == len(set(found.group.tolist()))
    assert np.abs(fit.x - [0.2, 0.5]).max() < 4.0 * fit.standard_errors.max() < 0.03


def test_impacts_of_scene_without_gravity() -> None:
    rng, scene = np.random.default_rng(4), replace(box_scene(), without=["gravity"])
    run = toss(scene, rng, 0.5)
    found = studies.impacts(scene, [recorded(run, rng, sigma=(1e-6, 1e-6))])
    assert len(found) > 0
    for time, before, after in zip(found.time, found.v_before, found.v_after, strict=True):
        hit = min(run.impacts, key=lambda one: abs(one.time - time))
        assert before == pytest.approx(hit.v_before, abs=1e-3)
        assert after == pytest.approx(hit.v_after, abs=1e-3)


@pytest.mark.slow
def test_other_than_single_impacts_are_dropped_with_a_reason() -> None:
    rng, scene = np.random.default_rng(2), box_scene(restitution=0.2)
    run = toss(scene, rng, 0.6)
    found = studies.impacts(scene, [recorded(run, rng, sigma=(1e-4, 1e-3), group="a")], clearance=0.01)
    reasons = " ".join(found.dropped)
    assert "frames lie between two flights" in reasons or "a second contact" in reasons
    assert all(reason.startswith("a, 0.") for reason in found.dropped)
    assert len(found[:0]) == 0


def test_recording_without_impacts() -> None:
    scene = box_scene()
    run = simulate(scene, np.array([0, 0, 3.0, 0, 0, 0, 1.0]), np.array([0, 0, 0, 1.0, 2.0, 3.0]), 0.2)
    found = studies.impacts(scene, [recorded(run, np.random.default_rng(3))])
    assert (len(found), found.dropped, found.q.shape) == (0, (), (0, 7))


def ball_scene() -> Scene:
    """Return a scene of a ball of radius 5 cm above a floor."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "ball")
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(0.2, 0.05), pin.SE3.Identity())
    model.addBodyFrame("ball", joint, pin.SE3.Identity(), 0)
    return Scene(model, [Contact("ball", Plane(), 0.1, 0.5, radius=0.05)])


def bouncing_ball(t, fall: float, e: float, rng: np.random.Generator, **options):
    """Return a recording of a ball that falls a height [m], rebounds with e times its speed, and rests."""
    g, before, start, height = 9.81, np.sqrt(2.0 * 9.81 * fall), np.sqrt(2.0 * fall / 9.81), np.zeros_like(t)
    height[t < start] = fall - 0.5 * g * t[t < start] ** 2
    while before > 0.01 and start < t[-1]:
        before *= e
        later = t - start
        flies = (later >= 0.0) & (later < 2.0 * before / g)
        height[flies] = before * later[flies] - 0.5 * g * later[flies] ** 2
        start += 2.0 * before / g
    q = np.column_stack([np.zeros((len(t), 2)), 0.05 + height, np.zeros((len(t), 3)), np.ones(len(t))])
    q[:, :3] += 1e-4 * rng.normal(size=(len(t), 3))
    return studies.Motion(t, q, **options)


def test_recordings_of_ball_without_rotation() -> None:
    """A ball falls h = 0.3 m and rebounds with e times its speed; its rotations have no noise."""
    rng, e, scene = np.random.default_rng(0), 0.7, ball_scene()
    frames = np.arange(0.0, 0.5, 1.0 / RATE)
    motions = [bouncing_ball(rng.uniform(0.0, 0.005) + frames, 0.3, e, rng, group=k) for k in range(8)]
    found = studies.impacts(scene, motions)
    assert len(found) == 8
    fit = studies.identify(found, scene, free={"restitution": (0, 1)})
    low, high = fit.interval(0.999)[0]
    assert low < e < high
    assert high - low < 0.02
    with pytest.raises(InputError, match="found: no impacts"):
        studies.identify(found[:0], scene)


@pytest.mark.parametrize("rate", [100.0, 200.0, 1000.0])
@pytest.mark.parametrize("sigma", [None, (1e-4, 1e-4)])
def test_body_at_rest_has_no_impacts(rate: float, sigma) -> None:
    """Short parabolas are within the noise of a body that lies still after it has landed."""
    rng, scene, t = np.random.default_rng(0), ball_scene(), np.arange(0.0, 1.5, 1.0 / rate)
    motions = [bouncing_ball(t, 0.3, 0.0, rng, sigma=sigma) for _ in range(3)]
    assert len(studies.impacts(scene, motions)) == 0
    found = studies.impacts(scene, [bouncing_ball(t, 0.3, 0.3, rng, sigma=sigma) for _ in range(3)])
    assert len(found) >= 3
    assert found.v_after[:, 2] == pytest.approx(-0.3 * found.v_before[:, 2], abs=0.03)


def test_noise_of_fast_body_that_hits_the_floor_between_two_frames() -> None:
    """At 5.4 m/s a ball moves by 54 mm between frames, past the gaps at which it is close to the floor."""
    rng, scene, t = np.random.default_rng(1), ball_scene(), np.arange(0.0, 1.0, 0.01)
    motions = [bouncing_ball(t + 0.001 * k, 1.5, 0.5, rng) for k in range(10)]
    found = studies.impacts(scene, motions)
    assert len(found) >= 10
    deviations = np.sqrt(found.covariance[:, 2, 2])
    assert deviations.max() < 0.01  # of v⁻, for flights of more than ten frames with noise of 0.1 mm
    fit = studies.identify(found, scene, free={"restitution": (0, 1)})
    low, high = fit.interval(0.999)[0]
    assert low < 0.5 < high
    assert high - low < 0.01


T, Q = np.arange(12) / RATE, np.tile([0.0, 0, 1, 0, 0, 0, 1], (12, 1))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((T[[0, 1, 3, 2, *range(4, 12)]], Q), r"times do not rise at frame 3: 0.0133333333 s after 0.02 s"),
        ((T * 0.0, Q), "times do not rise at frame 1"),
        ((T[:6], Q[:6]), "6 frames given; two flights need 10 at least"),
        ((T, Q[:6]), r"q: shape \(6, 7\) given, \(12, nq\) expected"),
        ((T, Q.T), r"q: shape \(7, 12\) given, \(12, nq\) expected"),
        ((T, Q * [1, 1, np.nan, 1, 1, 1, 1]), r"q: nan at \[0, 2\]; 12 of 84 numbers are not finite"),
        ((T, Q, None, (1e-3, 0.0)), "sigma: 0.0 given; it must be above 0"),
        ((T, Q, None, 1e-3), "sigma: shape"),
    ],
)
def test_invalid_recordings_raise(arguments, message: str) -> None:
    with pytest.raises(InputError, match=message):
        studies.Motion(*arguments)


def test_invalid_scenes_and_recordings_for_impacts_raise() -> None:
    motion = studies.Motion(T, Q)
    with pytest.raises(InputError, match="impacts is for one free body; 'panda' has 9 joints"):
        studies.impacts(Scene(load_robot("panda")), [motion])
    with pytest.raises(InputError, match="it has no contacts"):
        studies.impacts(Scene(box_scene().model), [motion])
    with pytest.raises(InputError, match=r"Motions with q \(n, 7\) expected"):
        studies.impacts(box_scene(), [studies.Motion(T, Q[:, :6])])
    with pytest.raises(InputError, match=r"the quaternion of frame 0 .* is zero"):
        studies.impacts(box_scene(), [studies.Motion(T, Q * [1, 1, 1, 0, 0, 0, 0])])
    resting = studies.Motion(T, Q * [1, 1, 0, 1, 1, 1, 1])
    with pytest.raises(InputError, match="none begins with 5 frames clear"):
        studies.impacts(box_scene(), [resting])


@pytest.mark.slow
def test_impacts_of_recorded_cubes() -> None:
    """Compare with published impacts of these recordings by independent fits."""
    if not CUBES.is_file():
        pytest.skip(f"the recorded tosses are not in {CUBES.parent}")
    d, recordings = dict(np.load(CUBES)), dict(np.load(CUBES.with_name("trajectories.npz")))
    scene = cube_scene(d)
    scene.model.gravity.linear = np.array([0.0, 0.0, -9.81 / 1.0215])
    motions = cube_motions(d, recordings, 25)
    found = studies.impacts(scene, motions)
    q, before, after = cube_states(d)
    pairs = [
        (i, j)
        for i in range(len(found))
        for j in np.flatnonzero((d["toss"] == found.group[i]) & (np.abs(d["time"] - found.time[i]) < 2e-3))
    ]
    assert len(pairs) >= 15
    mine, theirs = np.array(pairs).T
    assert np.array_equal(found.contact[mine], names_of(d)[theirs])
    assert np.abs(found.q[mine, :3] - q[theirs, :3]).max() < 1e-3
    for ours, given, side in ((found.v_before, before, "before"), (found.v_after, after, "after")):
        change = np.abs(ours[mine] - given[theirs])
        assert np.median(change[:, :3] / d[f"sigma_v_{side}"][theirs, None]) < 6.0  # theirs neglect drag
        assert np.median(change[:, 3:] / d[f"sigma_w_{side}"][theirs, None]) < 2.0
    fit = studies.identify(found, scene)
    assert np.all(np.abs(fit.x - [0.1606, 0.2696]) < 3.0 * fit.standard_errors)


def cube_motions(d, recordings, count: int) -> list[studies.Motion]:
    """Return the first `count` recordings of the cube."""
    motions = []
    for k in range(count):
        rows = slice(*recordings["start"][k : k + 2])
        rotation = Rotation.from_quat(recordings["quaternion_wxyz"][rows], scalar_first=True)
        com = recordings["position"][rows] - rotation.apply(d["tracked_centre_from_com_body"])
        q = np.hstack([com, rotation.as_quat()])
        motions.append(studies.Motion(recordings["t"][rows], q, group=int(recordings["toss"][k])))
    return motions
