"""Trajectories: modes at any time, pickles and files."""

from __future__ import annotations

import math
import pickle

import numpy as np
import pytest

import pinimpact
from pinimpact import Contact, Plane, Scene, SimulationError, Trajectory, simulate

from .scene_models import UP, G, ball, pendulum, slider

MU, V0 = 0.3, 2.0


def sliding_ball(**options):
    """Return scene, q and v of a ball that slides until 2 v₀/(7 μ g) and then rolls."""
    contact = Contact("center", Plane(), friction=MU, radius=0.1, name="ball")
    far = Contact("center", Plane(point=(0, 0, -5.0)), radius=0.1, name="cellar")
    return Scene(ball(), [contact, far], **options), [0, 0, 0.1, *UP], [V0, 0, 0, 0, 0, 0]


ROLLS = 2 * V0 / (7 * MU * G)


@pytest.fixture(scope="module")
def trajectory():
    return simulate(*sliding_ball(), 1.0)


def test_modes_at_any_time(trajectory) -> None:
    assert trajectory.mode_at("ball", 0.0) == "slip"
    assert trajectory.mode_at("ball", ROLLS - 1e-4) == "slip"
    assert trajectory.mode_at("ball", ROLLS + 1e-4) == "stick"
    change = trajectory.modes[0].end
    assert trajectory.mode_at("ball", change) == "stick"
    assert trajectory.mode_at("ball", math.nextafter(change, 0.0)) == "slip"


def test_mode_at_the_end_is_the_last_one(trajectory) -> None:
    assert trajectory.mode_at("ball", 1.0) == "stick"
    halfway = simulate(*sliding_ball(), 0.5 * ROLLS)
    assert halfway.mode_at("ball", halfway.t[-1]) == "slip"
    flying = simulate(Scene(slider()), np.zeros(3), np.zeros(3), 0.1)
    assert flying.mode_at("x", 0.1) == "free"


def test_open_contacts_and_limits_are_free(trajectory) -> None:
    assert trajectory.mode_at("cellar", 0.5) == "free"
    assert trajectory.mode_at("body", 0.5) == "free"
    model = pendulum()
    model.upperPositionLimit = np.array([0.5])
    stopped = simulate(Scene(model, without=["gravity"]), [0.4], [1.0], 0.5)
    assert [stopped.mode_at("hinge upper", t) for t in (0.05, 0.2, 0.5)] == ["free", "closed", "closed"]


def test_unknown_names_and_times_outside_raise(trajectory) -> None:
    with pytest.raises(pinimpact.UnknownNameError, match=r"source: .*'bal'.*'ball'") as caught:
        trajectory.mode_at("bal", 0.5)
    assert caught.value.field == "source"
    with pytest.raises(pinimpact.InputError, match=r"t: .soon. given"):
        trajectory.mode_at("ball", "soon")
    for t in (-1e-9, 1.0 + 1e-9, math.nan):
        with pytest.raises(pinimpact.InputError, match=r"t: .*outside the trajectory") as caught:
            trajectory.mode_at("ball", t)
        assert caught.value.field == "t"


def test_times_outside_by_rounding_errors_are_the_ends(trajectory) -> None:
    end = 1.0 + 4e-16  # two ulps above 1
    assert end > 1.0
    np.testing.assert_array_equal(trajectory.at(end)[0], trajectory.q[-1])
    np.testing.assert_array_equal(trajectory.at(-1e-16)[0], trajectory.q[0])
    assert trajectory.mode_at("ball", end) == trajectory.mode_at("ball", 1.0)


def test_names_are_saved(trajectory, tmp_path) -> None:
    path = tmp_path / "ball.npz"
    trajectory.save(path)
    again = Trajectory.load(path)
    assert again.sources == trajectory.sources == ("ball", "cellar", "body")
    with pytest.raises(pinimpact.UnknownNameError, match="'bal'"):
        again.mode_at("bal", 0.5)


def same(a: Trajectory, b: Trajectory) -> None:
    for t in np.linspace(a.t[0], a.t[-1], 7):
        for side in ("left", "right"):
            for x, y in zip(a.at(t, side), b.at(t, side), strict=True):
                assert np.array_equal(x, y)
    assert (a.modes, a.notes, a.sources, a.termination) == (b.modes, b.notes, b.sources, b.termination)
    for x, y in zip(a.impacts, b.impacts, strict=True):
        assert (x.time, x.source, x.resting) == (y.time, y.source, y.resting)
        assert np.array_equal(x.v_after, y.v_after)
        assert np.array_equal(x.impulse_world, y.impulse_world)
        assert np.array_equal(x.problem.delassus, y.problem.delassus)
        assert x.problem.velocity_scale == y.problem.velocity_scale
        assert (x.problem.factor is None) == (y.problem.factor is None)
        assert x.problem.factor is None or np.array_equal(x.problem.factor, y.problem.factor)
        assert x.problem.factor_scale == y.problem.factor_scale
        assert np.array_equal(x.solution.velocity, y.solution.velocity)
        assert x.solution.segments == y.solution.segments
        assert (x.solution.path is None) == (y.solution.path is None)


@pytest.mark.parametrize("asked", [False, True])
def test_trajectories_can_be_pickled_and_saved(asked: bool, tmp_path) -> None:
    model = pendulum()
    model.lowerPositionLimit = np.array([-0.5])
    wall = Contact("tip", Plane(point=(-0.5, 0, 0), normal=(1, 0, 0)), friction=0.2, restitution=0.9)
    scene = Scene(model, [wall], limit_restitution=0.9, record=True)
    trajectory = simulate(scene, [0.0], [4.0], 0.5)
    assert {impact.source for impact in trajectory.impacts} == {"tip on plane", "hinge lower"}
    if asked:  # after solutions have been computed
        assert all(impact.solution.flags is not None for impact in trajectory.impacts)
    same(trajectory, pickle.loads(pickle.dumps(trajectory)))
    trajectory.save(tmp_path / "pendulum.npz")
    same(trajectory, Trajectory.load(tmp_path / "pendulum.npz"))
    scales = {impact.source: impact.problem.velocity_scale for impact in trajectory.impacts}
    assert scales["tip on plane"] > 0.0
    assert scales["hinge lower"] is None


def test_damaged_files_raise(trajectory, tmp_path) -> None:
    path = tmp_path / "whole.npz"
    trajectory.save(path)
    with np.load(path) as file:
        arrays = dict(file)
    for name in ("meta", "t", "segment_q", "force_rows"):
        part = tmp_path / "part.npz"
        np.savez_compressed(part, **{key: value for key, value in arrays.items() if key != name})
        with pytest.raises(
            pinimpact.InputError, match=f"part.npz' is not a readable trajectory .it lacks '{name}"
        ):
            Trajectory.load(part)
    raw, rng = path.read_bytes(), np.random.default_rng(0)
    damaged = tmp_path / "damaged.npz"
    for place in rng.integers(0, len(raw), 60).tolist():
        damaged.write_bytes(raw[:place] + bytes([raw[place] ^ 0x55]) + raw[place + 1 :])
        try:
            found = Trajectory.load(damaged)
        except pinimpact.InputError:
            continue
        assert np.array_equal(found.q, trajectory.q)  # the byte is not one of the numbers


def test_partial_trajectory_of_failed_run_can_be_pickled() -> None:
    contact = Contact("center", Plane(), restitution=0.9, radius=0.1)
    with pytest.raises(SimulationError) as caught:
        simulate(Scene(ball(), [contact]), [0, 0, 0.2, *UP], np.zeros(6), 2.0, max_impacts=2)
    again = pickle.loads(pickle.dumps(caught.value))
    assert str(again) == str(caught.value)
    same(caught.value.partial, again.partial)


def test_impacts_without_collision_can_be_pickled() -> None:
    # Painlevé's rod; the record of such an impact is not made from a `Hit`
    import pinocchio as pin

    from .scene_models import free_body

    rod = free_body(pin.Inertia(1.0, np.zeros(3), np.diag([1e-3, 1 / 12, 1 / 12])), [(-0.5, 0, 0)])
    tilt = np.radians(30.0)
    turn = pin.utils.rotate("y", -tilt)
    tip = turn @ [-0.5, 0.0, 0.0]
    start = [0, 0, -tip[2], *pin.Quaternion(turn).coeffs()]
    v0 = np.concatenate([turn.T @ [-1.0, 0, 0], np.zeros(3)])
    mu = 1.1 * (1 + 3 * np.cos(tilt) ** 2) / (3 * np.cos(tilt) * np.sin(tilt))
    trajectory = simulate(Scene(rod, [Contact("tip0", Plane(), friction=mu)]), start, v0, 0.02)
    assert any("without collision" in note.text for note in trajectory.notes)
    same(trajectory, pickle.loads(pickle.dumps(trajectory)))


def test_scenes_can_be_pickled() -> None:
    scene, q0, v0 = sliding_ball()
    same(simulate(scene, q0, v0, 0.1), simulate(pickle.loads(pickle.dumps(scene)), q0, v0, 0.1))
