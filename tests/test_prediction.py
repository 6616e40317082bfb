"""Predictions: draws of the posterior, poses as such, faces of a body, errors."""

import numpy as np
import pinocchio as pin
import pytest
from scipy import stats
from scipy.spatial.transform import Rotation

from pinimpact import Contact, InputError, Plane, Scene, UnknownNameError
from pinimpact.studies import Identified, predict

NEVER = 1e-9


def _body(contacts=()):
    """Return a free ball, out of reach of its plane."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
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
    }
    return Identified(given | change)


START = np.array([0, 0, 1.0, 0, 0, 0, 1])


def test_parameters_have_the_covariance_of_the_fit_and_the_scatter():
    found = predict(
        _body(), _fitted(), START, np.zeros(6), NEVER, scatter={"friction": 0.03}, samples=600, seed=3
    )
    drawn = np.array([found.ensemble.columns[n] for n in ("friction", "restitution")])
    expected = np.array([[4e-4 + 9e-4, 1e-4], [1e-4, 9e-4]])
    # entries of a sample covariance scatter by (s_ii s_jj + s_ij²) / n
    allowed = 4 * np.sqrt((np.outer(np.diag(expected), np.diag(expected)) + expected**2) / 600)
    assert (np.abs(np.cov(drawn) - expected) < allowed).all()
    assert np.abs(drawn.mean(axis=1) - [0.3, 0.5]).max() < 4 * 0.04 / np.sqrt(600)


def test_draws_stay_within_bounds():
    wide = _fitted(covariance=np.diag([1.0, 1.0]))
    columns = predict(_body(), wide, START, np.zeros(6), NEVER, samples=200).ensemble.columns
    assert columns["restitution"].min() >= 0.0
    assert columns["restitution"].max() <= 1.0
    assert set(columns["status"]) == {"OK"}


def test_poses_are_those_of_the_start():
    spread = {"q0": np.diag([0.01, 0.01, 0.01, 0.04, 0.04, 0.04])}
    turned = np.r_[0, 0, 1.0, Rotation.from_rotvec([0.4, -1.0, 2.0]).as_quat()]
    found = predict(_body(), _fitted(), turned, np.zeros(6), NEVER, start=spread, samples=600)
    middle, radius = found.position(0.5)
    assert np.abs(middle - [0, 0, 1]).max() < 5 * 1.2533 * 0.1 / np.sqrt(600)
    expected = 0.1 * stats.chi(3).ppf(0.5)
    assert radius == pytest.approx(expected, rel=0.1)
    mean, angle = found.rotation(0.5)
    assert (mean.inv() * Rotation.from_quat(turned[3:])).magnitude() < 0.05
    assert angle == pytest.approx(0.2 * stats.chi(3).ppf(0.5), rel=0.1)


def test_faces_on_top():
    lying = np.r_[0, 0, 1.0, Rotation.from_euler("y", np.pi / 4).as_quat()]  # −x and +z alike
    spread = {"q0": np.diag([0, 0, 0, 1e-4, 1e-4, 1e-4])}
    faces = predict(_body(), _fitted(), lying, np.zeros(6), NEVER, start=spread, samples=400).faces()
    assert set(faces) == {"-x", "+z"}
    assert sum(share.value for share in faces.values()) == pytest.approx(1.0)
    assert all(share.low < 0.5 < share.high or abs(share.value - 0.5) < 0.1 for share in faces.values())


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
        (InputError, "no draws about", {"fitted": _fitted(x=np.array([50.0, 0.5]))}),
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
