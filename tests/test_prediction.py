"""Predictions: draws of parameters, positions and rotations, faces of a body, errors."""

from dataclasses import replace

import coal
import numpy as np
import pinocchio as pin
import pytest
from scipy import stats
from scipy.spatial.transform import Rotation

from pinimpact import Contact, InputError, Plane, Scene, UnknownNameError
from pinimpact.studies import Identified, predict
from pinimpact.studies.estimate import set_coefficient
from pinimpact.studies.posterior import posterior
from pinimpact.studies.sampling import Sampling

from .test_replay import motion_of, needs_browser, numbers, open_in_browser, pictures_of

NEVER = 1e-9


def _set(scene, name, value):
    return replace(scene, contacts=[replace(contact, **{name: value}) for contact in scene.contacts])


def _body(contacts=(), placement=None):
    """Return a scene of a free ball."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), placement or pin.SE3.Identity(), "base")
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    model.addFrame(pin.Frame("tip", joint, pin.SE3.Identity(), pin.OP_FRAME))
    return Scene(model, list(contacts) or [Contact("tip", Plane())])


def _fitted(**change):
    given = {
        "x": np.array([0.3, 0.5]),
        "names": ("friction", "restitution"),
        "covariance": np.array([[4e-4, 1e-4], [1e-4, 9e-4]]),
        "bounds": np.array([[0.0, 0.0], [2.0, 1.0]]),
        "unidentified": [],
        "fun": np.zeros(4),
        "groups": 4,
        "law": "newton",
        "setters": {"friction": _set, "restitution": _set},
    }
    return Identified(given | change)


START = np.array([0, 0, 1.0, 0, 0, 0, 1])


def test_covariance_of_drawn_parameters_is_that_of_fit_and_scatter():
    found = predict(
        _body(), _fitted(), START, np.zeros(6), NEVER, scatter={"friction": 0.03}, samples=300, seed=3
    )
    drawn = np.array([found.ensemble.columns[n] for n in ("friction", "restitution")])
    expected = np.array([[4e-4 + 9e-4, 1e-4], [1e-4, 9e-4]])
    # the variance of entries of a sample covariance is (s_ii s_jj + s_ij²)/n
    allowed = 4 * np.sqrt((np.outer(np.diag(expected), np.diag(expected)) + expected**2) / 300)
    assert (np.abs(np.cov(drawn) - expected) < allowed).all()
    assert np.abs(drawn.mean(axis=1) - [0.3, 0.5]).max() < 4 * 0.04 / np.sqrt(300)


def test_draws_are_within_bounds():
    wide = _fitted(covariance=np.diag([1.0, 1.0]))
    columns = predict(_body(), wide, START, np.zeros(6), NEVER, samples=100).ensemble.columns
    assert columns["restitution"].min() >= 0.0
    assert columns["restitution"].max() <= 1.0
    assert set(columns["status"]) == {"OK"}


def test_positions_and_rotations_without_motion():
    spread = {"q0": np.diag([0.01, 0.01, 0.01, 0.04, 0.04, 0.04])}
    turned = np.r_[0, 0, 1.0, Rotation.from_rotvec([0.4, -1.0, 2.0]).as_quat()]
    found = predict(_body(), _fitted(), turned, np.zeros(6), NEVER, start=spread, samples=300)
    middle, radius = found.position(0.5)
    assert np.abs(middle - [0, 0, 1]).max() < 5 * 1.2533 * 0.1 / np.sqrt(300)
    expected = 0.1 * stats.chi(3).ppf(0.5)
    assert radius == pytest.approx(expected, rel=0.1)
    mean, angle = found.rotation(0.5)
    assert (mean.inv() * Rotation.from_quat(turned[3:])).magnitude() < 0.05
    assert angle == pytest.approx(0.2 * stats.chi(3).ppf(0.5), rel=0.1)


def test_faces_on_top():
    lying = np.r_[0, 0, 1.0, Rotation.from_euler("y", np.pi / 4).as_quat()]  # −x and +z equally high
    spread = {"q0": np.diag([0, 0, 0, 1e-4, 1e-4, 1e-4])}
    faces = predict(_body(), _fitted(), lying, np.zeros(6), NEVER, start=spread, samples=200).faces()
    assert set(faces) == {"-x", "+z"}
    assert sum(share.value for share in faces.values()) == pytest.approx(1.0)
    assert all(share.low < 0.5 < share.high or abs(share.value - 0.5) < 0.1 for share in faces.values())


def test_free_joint_whose_axes_are_not_those_of_the_world():
    """The pose of the body in the world does not depend on the axes in which its configuration is given."""
    placement = pin.SE3(Rotation.from_rotvec([1.0, 0.5, -2.0]).as_matrix(), np.array([0.3, -0.2, 0.1]))
    spread = {"q0": np.diag([1e-2, 1e-2, 1e-2, 0.2, 0.2, 0.2])}
    own = pin.SE3ToXYZQUAT(placement.inverse() * pin.XYZQUATToSE3(START))
    given = _fitted(), np.zeros(6), NEVER
    found, turned = (
        predict(scene, given[0], q0, *given[1:], start=spread, samples=50)
        for scene, q0 in ((_body(), START), (_body(placement=placement), own))
    )
    assert turned.position(0.5)[0] == pytest.approx(found.position(0.5)[0], abs=1e-12)
    assert (turned.rotation()[0].inv() * found.rotation()[0]).magnitude() < 1e-7
    assert turned.faces() == found.faces()
    assert turned._nearest() == found._nearest()


G = 9.81


def _inside(share, level, count):
    """Return whether an observed fraction is at a level, within four standard deviations."""
    return abs(share - level) < 4.0 * np.sqrt(level * (1.0 - level) / count)


def test_ball_that_bounces_once_against_closed_form():
    # z = r + e v τ − g τ²/2 at τ after a bounce at v, and x = ẋ T, have normal distributions of equal width
    height, time, radius = 0.5, 0.55, 0.1
    scene = _body([Contact("tip", Plane(), radius=radius)])
    fall = np.sqrt(2.0 * height / G)
    speed, after = G * fall, time - fall
    width = np.hypot(0.02, 0.03) * speed * after
    spread = {"v0": np.diag([(width / time) ** 2, 0, 0, 0, 0, 0])}
    fitted = _fitted(x=np.array([0.0, 0.5]), covariance=np.diag([1e-18, 0.02**2]))
    q0 = np.array([0, 0, radius + height, 0, 0, 0, 1])
    given = {"scatter": {"restitution": 0.03}, "start": spread, "samples": 400, "seed": 4, "rtol": 1e-8}
    found = predict(scene, fitted, q0, np.zeros(6), time, **given)
    ends = 0.5 * speed * after - 0.5 * G * after**2 + radius
    for name, middle in (("x", 0.0), ("z", ends)):
        truth = stats.norm(middle, width).ppf([0.05, 0.25, 0.5, 0.75, 0.95])
        for estimate, value in zip(
            found.ensemble.quantiles(f"q.base.{name}", [0.05, 0.25, 0.5, 0.75, 0.95], 0.9999),
            truth,
            strict=True,
        ):
            assert estimate.low < value < estimate.high
    for level in (0.5, 0.9):
        middle, away = found.position(level)
        assert np.abs(middle - [0, 0, ends]).max() < 5 * 1.2533 * width / np.sqrt(400)
        assert _inside(stats.chi(2).cdf(away / width), level, 400)


def test_block_that_slides_to_rest_against_closed_form():
    # the distance v²/(2 μ g) decreases with μ
    speed, half = 1.0, 0.05
    corners = [
        Contact("tip", Plane(), 0.3, offset=(x, y, -half), name=f"{x} {y}")
        for x in (-half, half)
        for y in (-half, half)
    ]
    fitted = _fitted(
        x=np.array([0.3]),
        names=("friction",),
        covariance=np.array([[0.03**2]]),
        bounds=np.array([[0.0], [2.0]]),
    )
    q0, v0 = np.array([0, 0, half, 0, 0, 0, 1]), np.array([speed, 0, 0, 0, 0, 0])
    found = predict(_body(corners), fitted, q0, v0, 0.8, samples=200, seed=2)
    friction = stats.norm(0.3, 0.03)
    assert np.abs(found.ensemble.columns["v.base.vx"]).max() < 1e-6
    levels = np.array([0.05, 0.25, 0.5, 0.75, 0.95])
    truth = speed**2 / (2 * G * friction.ppf(1 - levels))
    estimates = found.ensemble.quantiles("q.base.x", levels, 0.9999)
    assert all(e.low < value < e.high for e, value in zip(estimates, truth, strict=True))
    for level in (0.5, 0.9):
        middle, away = found.position(level)
        low, high = (speed**2 / (2 * G * (middle[0] + sign * away)) for sign in (1, -1))
        assert _inside(friction.cdf(high) - friction.cdf(low), level, 200)


def _gravity(scene, name, value):
    model = scene.model.copy()
    model.gravity.linear = np.array([value, 0.0, -G])
    return replace(scene, model=model)


def test_all_fitted_parameters_are_drawn_with_the_law_of_the_fit():
    fitted = _fitted(
        x=np.array([0.5, 0.1]),
        names=("restitution", "gravity:t1"),
        law="energetic",
        setters={"restitution": _set, "gravity": _gravity},
    )
    ends = predict(_body(), fitted, START, np.zeros(6), 0.1, samples=5, rtol=1e-9).ensemble
    tilts = ends.columns["gravity:t1"]
    assert len(set(tilts)) == 5
    np.testing.assert_allclose(ends.columns["q.base.x"], tilts * 0.1**2 / 2, rtol=1e-7)
    assert ends.trajectory(0).contacts[0].law == "energetic"
    assert ends.trajectory(0).contacts[0].restitution == ends.columns["restitution"][0]


@pytest.mark.parametrize("first", [0, 1])
@pytest.mark.parametrize("given", ["fits", "over"])
def test_parameters_of_single_contacts_override_general_ones_in_any_order(first, given):
    """The fits have no scatter, so that each contact has one known friction."""
    scene = _body([Contact("tip", Plane(), name=name) for name in ("floor", "wall")])
    known = {"friction": 0.5, "friction:floor": 0.2}
    setters = {"friction": set_coefficient}
    fits = {
        name: _fitted(
            x=np.array([mu]), names=(name,), covariance=np.zeros((1, 1)), bounds=np.array([[0.0], [1.0]]),
            setters=setters,
        )
        for name, mu in known.items()
    }  # fmt: skip
    one, other = list(known)[:: 1 - 2 * first]
    if given == "fits":
        over = {(name,): posterior(fits[name], np.zeros(1)) for name in (one, other)}
    else:
        over = {one: stats.uniform(known[one], 0.0), (other,): posterior(fits[other], np.zeros(1))}
    sampling = Sampling(scene, START, np.zeros(6), over, 1, 0, "random")
    contacts = sampling.apply(sampling.draw(0, 1)[0])[0].contacts
    assert [contact.friction for contact in contacts] == pytest.approx([0.2, 0.5])
    assert {contact.law for contact in contacts} == {"newton"}


def test_replay_of_cloud_around_sample_nearest_to_median(tmp_path):
    spread = {"v0": np.diag([0.04, 0.04, 0.01, 1.0, 1.0, 1.0])}
    found = predict(_body(), _fitted(), START, np.zeros(6), 0.2, start=spread, samples=20)
    shown = found.replay(_body().model, tmp_path / "cloud.html", samples=6)
    motion = motion_of(shown)
    columns = found.ensemble.columns
    ends = np.array([columns[f"q.base.{name}"] for name in ("x", "y", "z", "qx", "qy", "qz", "qw")]).T
    main = numbers(motion["joints"]["1"]).reshape(-1, 7)[-1]
    others = [numbers(robot["1"]).reshape(-1, 7) for robot in motion["cloud"]["robots"]]
    assert len(others) == 6
    for end in (main, *(poses[-1] for poses in others)):
        near = np.abs(ends[:, :3] - end[:3]).max(axis=1).argmin()
        np.testing.assert_allclose(ends[near, :3], end[:3], atol=1e-6)
        assert abs(ends[near, 3:] @ end[3:]) == pytest.approx(1.0, abs=1e-6)
    np.testing.assert_allclose([poses[0, :3] for poses in others], np.tile(START[:3], (6, 1)), atol=1e-6)
    middle = found.position(0.5)[0]
    away = np.linalg.norm(ends[:, :3] - middle, axis=1)
    assert np.linalg.norm(main[:3] - middle) <= np.median(away)
    assert not any(np.allclose(poses[-1], main, atol=1e-6) for poses in others)


@needs_browser
def test_cloud_in_browser(tmp_path):
    spread = {"v0": np.diag([0.04, 0.04, 0.01, 1.0, 1.0, 1.0])}
    found = predict(_body(), _fitted(), START, np.zeros(6), 0.2, start=spread, samples=9)
    ball = pin.GeometryModel()
    ball.addGeometryObject(pin.GeometryObject("ball", 1, pin.SE3.Identity(), coal.Sphere(0.02)))
    robot = pin.RobotWrapper(_body().model, ball, ball)
    few, many = (found.replay(robot, tmp_path / f"{count}.html", samples=count) for count in (1, 8))
    open_in_browser(many, "t=0.2")  # has no errors
    pictures = pictures_of([(few.path, "t=0.2"), (many.path, "t=0.2")], tmp_path, (480, 360))
    violet = [((picture[:, 200:, 2] - picture[:, 200:, 1]) > 0.1).sum() for picture in pictures]
    assert violet[1] > 2 * violet[0] > 0


OF_TWO_LAWS = [
    _fitted(
        x=np.array([0.5]), names=(name,), covariance=np.eye(1), bounds=np.array([[0.0], [1.0]]), law=law
    )
    for name, law in (("friction", "poisson"), ("restitution", "newton"))
]  # fmt: skip


@pytest.mark.parametrize(
    ("error", "match", "change"),
    [
        (InputError, "no body has a free joint", {"scene": "rail"}),
        (InputError, "fitted: not a covariance", {"fitted": _fitted(covariance=-np.eye(2))}),
        (InputError, "fitted: all impacts stick", {"fitted": _fitted(unidentified=["all impacts stick"])}),
        (InputError, "a result of identify", {"fitted": 3}),
        (UnknownNameError, "scatter: 'stiffness' was not fitted", {"scatter": {"stiffness": 0.1}}),
        (UnknownNameError, "start: 'x' given", {"start": {"x": np.eye(6)}}),
        (InputError, r"shape \(3, 3\) given, \(6, 6\) expected", {"start": {"q0": np.eye(3)}}),
        (InputError, "reduce: given", {"reduce": dict}),
        (InputError, "fits with the laws newton and poisson given", {"fitted": OF_TWO_LAWS}),
        (InputError, "no draws around", {"fitted": _fitted(x=np.array([50.0, 0.5]))}),
    ],
)  # fmt: skip
def test_bad_input_is_named(error, match, change):
    given = {"scene": _body(), "fitted": _fitted(), "samples": 2} | change
    if given["scene"] == "rail":
        model = pin.Model()
        joint = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "rail")
        model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
        given["scene"] = Scene(model)
    scene, fitted = given.pop("scene"), given.pop("fitted")
    with pytest.raises(error, match=match):
        predict(scene, fitted, START[: scene.model.nq], np.zeros(scene.model.nv), NEVER, **given)
