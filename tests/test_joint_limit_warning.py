"""A configuration beyond joint limits, as one in degrees, is told of, once for each Data."""

import warnings

import numpy as np
import pytest

import pinimpact
from pinimpact import JointLimitWarning

TABLE = pinimpact.Plane(point=(0, 0, 0.5))
HAND = pinimpact.Contact("panda_hand_tcp", TABLE, friction=0.3, restitution=0.5)
V = [0.4, 2.0, 0.4, -0.8, 0.25, 1.0, 0, 0, 0]


@pytest.fixture
def panda():
    model = pinimpact.load_robot("panda").model
    return model, model.createData()


def degrees():
    q = np.degrees(pinimpact.load_robot("panda").q0)
    q[-2:] = 0.02
    return q


@pytest.mark.parametrize(
    ("contact", "keep"), [(HAND, {}), (HAND, {"locked": ["panda_joint7"]}), ([HAND], {})]
)
def test_degrees_are_told_of_once(panda, contact, keep):
    model, data = panda
    with pytest.warns(
        JointLimitWarning, match=r"'panda_joint4' is at -135,.* -3\.07\d* to -0\.0698.*degrees"
    ) as told:
        pinimpact.impact(model, data, degrees(), V, contact, **keep)
    assert told[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        pinimpact.impact(model, data, degrees(), V, contact, **keep)
    with pytest.warns(JointLimitWarning):
        pinimpact.impact(model, model.createData(), degrees(), V, contact, **keep)


def test_a_joint_a_little_beyond_is_told_of_without_a_word_on_degrees(panda):
    q = pinimpact.load_robot("panda").q0.copy()
    q[7] = 0.0401
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        pinimpact.impact(*panda, q, V, HAND)  # as far as a stop gives
    q[7] = 0.05
    with pytest.warns(JointLimitWarning, match=r"'panda_finger_joint1' is at 0\.05, .* 0 to 0\.04$"):
        pinimpact.impact(*panda, q, V, HAND)


def test_rows_beyond_are_counted(panda):
    q = np.array([pinimpact.load_robot("panda").q0, degrees(), degrees()])
    with pytest.warns(JointLimitWarning, match=r"\(row 1; 2 rows in all\)") as told:
        pinimpact.impacts(*panda, q, V, HAND)
    assert told[0].filename == __file__


def test_scenes_without_joint_limits_do_not_mind(panda):
    model, _ = panda
    low = pinimpact.Contact("panda_hand_tcp", pinimpact.Plane(point=(0, 0, 0.4)))
    scene = pinimpact.Scene(model, [low], without=["joint limits"])
    q = pinimpact.load_robot("panda").q0.copy()
    q[7] = 0.05
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        trajectory = pinimpact.simulate(scene, q, V, 0.2)
    assert trajectory.impacts


def test_a_contact_by_geometry_is_told_of_where_it_is_called():
    robot = pinimpact.load_robot("panda")
    contact = pinimpact.Contact(geometry="panda_hand_0", plane=TABLE)
    with pytest.warns(JointLimitWarning) as told:
        pinimpact.impact(robot, robot.model.createData(), degrees(), V, contact)
    assert [warning.filename for warning in told] == [__file__]
