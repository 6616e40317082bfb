"""Warnings about configurations beyond joint limits, such as in degrees, once for each Data."""

import warnings

import numpy as np
import pytest

import pinimpact
from pinimpact import JointLimitWarning

from .robot_cases import load, q0_of

TABLE = pinimpact.Plane(point=(0, 0, 0.5))
HAND = pinimpact.Contact("panda_hand_tcp", TABLE, friction=0.3, restitution=0.5)
V = [0.4, 2.0, 0.4, -0.8, 0.25, 1.0, 0, 0, 0]


@pytest.fixture
def panda():
    model = load("panda")[0]
    return model, model.createData()


def degrees():
    q = np.degrees(q0_of("panda"))
    q[-2:] = 0.02
    return q


@pytest.mark.parametrize(
    ("contact", "keep"), [(HAND, {}), (HAND, {"locked": ["panda_joint7"]}), ([HAND], {})]
)
def test_warning_appears_once_per_data(panda, contact, keep):
    model, data = panda
    with pytest.warns(
        JointLimitWarning, match=r"'panda_joint4' is at -135,.* -3\.07\d* to -0\.0698.*degrees"
    ) as warned:
        pinimpact.impact(model, data, degrees(), V, contact, **keep)
    assert warned[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        pinimpact.impact(model, data, degrees(), V, contact, **keep)
    with pytest.warns(JointLimitWarning):
        pinimpact.impact(model, model.createData(), degrees(), V, contact, **keep)


def test_warning_slightly_beyond_limit_does_not_mention_degrees(panda):
    q = q0_of("panda")
    q[7] = 0.0401
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        pinimpact.impact(*panda, q, V, HAND)  # within the tolerance of limits
    q[7] = 0.05
    with pytest.warns(JointLimitWarning, match=r"'panda_finger_joint1' is at 0\.05, .* 0 to 0\.04$"):
        pinimpact.impact(*panda, q, V, HAND)


def test_warning_counts_rows_beyond_limits(panda):
    q = np.array([q0_of("panda"), degrees(), degrees()])
    with pytest.warns(JointLimitWarning, match=r"\(row 1; 2 rows in all\)") as warned:
        pinimpact.impacts(*panda, q, V, HAND)
    assert warned[0].filename == __file__


def test_scenes_without_joint_limits_do_not_warn(panda):
    model, _ = panda
    low = pinimpact.Contact("panda_hand_tcp", pinimpact.Plane(point=(0, 0, 0.4)))
    scene = pinimpact.Scene(model, [low], without=["joint limits"])
    q = q0_of("panda")
    q[7] = 0.05
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        trajectory = pinimpact.simulate(scene, q, V, 0.2)
    assert trajectory.impacts


def test_warning_for_contact_by_geometry_points_to_the_caller():
    robot = pinimpact.load_robot("panda")
    contact = pinimpact.Contact(geometry="panda_hand_0", plane=TABLE)
    with pytest.warns(JointLimitWarning) as warned:
        pinimpact.impact(robot, robot.model.createData(), degrees(), V, contact)
    assert [warning.filename for warning in warned] == [__file__]
