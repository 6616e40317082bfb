"""Bundled models against matrices derived from the motion of material points."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.polynomial.legendre import leggauss

import pinimpact
from pinimpact.robot.loading import bundled_models

from .drawing import examples

angle = st.floats(-3.0, 3.0)
relaxed = examples(40)


def derivative(position, q):
    """Return ∂position/∂q (3, n) by complex steps, exact to rounding."""
    step = 1e-40
    return np.column_stack([np.imag(position(q + 1j * step * unit)) / step for unit in np.eye(len(q))])


def rod_mass(points, q):
    """Return M of a slender uniform rod of unit mass, the mean over s ∈ [0, 1] of (∂r/∂q)ᵀ(∂r/∂q)."""
    nodes, weights = leggauss(2)  # exact for the quadratic integrand
    return sum(
        0.5 * weight * jacobian.T @ jacobian
        for node, weight in zip(nodes, weights, strict=True)
        for jacobian in [derivative(lambda x, s=0.5 * (1 + node): points(x, s), np.asarray(q))]
    )


def rod_points(q, s):
    """Return a point of the rod of Zhao and Liu, 4.2, from the free end (s = 0) to the tip (s = 1); l = 1."""
    x, y, z, psi, theta = q
    along = np.array([np.sin(psi) * np.cos(theta), -np.cos(psi) * np.cos(theta), -np.sin(theta)])
    return np.array([x, y, z]) + (2 * s - 1) * along


def pendulum_points(q, s):
    """Return a point of the pendulum of Zhao and Liu, 4.3, from the pivot to the tip; l = 1."""
    psi, theta = q
    return s * np.array([np.cos(psi) * np.cos(theta), np.sin(psi) * np.cos(theta), -np.sin(theta)])


def hanging(angle):
    return np.array([np.sin(angle), 0 * angle, -np.cos(angle)])


def lying(angle):
    return np.array([np.cos(angle), 0 * angle, np.sin(angle)])


def two_rods(direction):
    def upper(q, s):
        return s * direction(q[0])

    def lower(q, s):
        return direction(q[0]) + s * direction(q[0] + q[1])

    return upper, lower


MODELS = {
    "rod": [rod_points],
    "spherical_pendulum": [pendulum_points],
    "kane_double_pendulum": [*two_rods(hanging)],
    "two_link_arm": [*two_rods(lying)],
}


def matrices_of(name, q):
    robot = pinimpact.load_robot(name)
    contact = pinimpact.Contact("tip", pinimpact.Plane())
    return pinimpact.contact_matrices(robot.model, robot.data, q, contact)


@pytest.mark.parametrize("name", MODELS)
@relaxed
@given(data=st.data())
def test_mass_k_and_h_follow_from_the_points_of_the_rods(name, data):
    rods = MODELS[name]
    q = np.array(data.draw(st.lists(angle, min_size=(n := 5 if name == "rod" else 2), max_size=n)))
    if name in ("rod", "spherical_pendulum"):
        q[-1] = data.draw(st.floats(-1.4, 1.4))  # at θ = ±π/2 turning about z moves nothing
    matrices = matrices_of(name, q)
    jacobian = derivative(lambda x: rods[-1](x, 1.0), q)
    assert np.abs(matrices.mass - sum(rod_mass(rod, q) for rod in rods)).max() < 1e-14
    assert np.abs(matrices.K - jacobian[:2].T).max() < 1e-14
    assert np.abs(matrices.h - jacobian[2]).max() < 1e-14
    assert np.abs(matrices.point - rods[-1](q, 1.0)).max() < 1e-14


@relaxed
@given(angle, st.floats(-1.4, 1.4))
def test_rod_has_the_matrices_of_section_4_2(psi, theta):
    matrices = matrices_of("rod", np.array([0.3, -0.2, 0.9, psi, theta]))
    sp, cp, s, c = np.sin(psi), np.cos(psi), np.sin(theta), np.cos(theta)
    assert np.abs(matrices.mass - np.diag([1, 1, 1, c * c / 3, 1 / 3])).max() < 1e-14
    k = np.array([[1, 0, 0, cp * c, -sp * s], [0, 1, 0, sp * c, cp * s]]).T
    assert np.abs(matrices.K - k).max() < 1e-14
    assert np.abs(matrices.h - [0, 0, 1, 0, -c]).max() < 1e-14


@relaxed
@given(st.floats(-1.4, 1.4))
def test_rod_obeys_equation_34(theta):
    s, c = np.sin(theta), np.cos(theta)
    w = np.array([[4, 0, 0], [0, 1 + 3 * s * s, -3 * s * c], [0, -3 * s * c, 1 + 3 * c * c]])
    assert np.abs(matrices_of("rod", np.array([0, 0, 0, 0, theta])).delassus - w).max() < 1e-13


@relaxed
@given(angle, st.floats(-1.4, 1.4))
def test_pendulum_has_the_matrices_of_section_4_3(psi, theta):
    matrices = matrices_of("spherical_pendulum", np.array([psi, theta]))
    sp, cp, s, c = np.sin(psi), np.cos(psi), np.sin(theta), np.cos(theta)
    assert np.abs(matrices.mass - np.diag([c * c / 3, 1 / 3])).max() < 1e-14
    assert np.abs(matrices.K - [[-sp * c, cp * c], [-cp * s, -sp * s]]).max() < 1e-14
    assert np.abs(matrices.h - [0, -c]).max() < 1e-14


@relaxed
@given(st.floats(-1.4, 1.4))
def test_pendulum_obeys_the_corrected_equation_39(theta):
    s, c = np.sin(theta), np.cos(theta)
    w = 3 * np.array([[s * s, 0, s * c], [0, 1, 0], [s * c, 0, c * c]])
    assert np.abs(matrices_of("spherical_pendulum", np.array([0, theta])).delassus - w).max() < 1e-13


def test_ellipsoid_has_the_corrected_matrices_of_section_4_1():
    robot = pinimpact.load_robot("ellipsoid")
    matrices = pinimpact.contact_matrices(
        robot.model, robot.data, robot.q0, pinimpact.Contact("tip", pinimpact.Plane())
    )
    semi_axes = np.array([2.0, 1.0, 1.0])
    squares = semi_axes**2 / 5  # ∫x² dm of a homogeneous ellipsoid of unit mass
    inertia = np.diag([squares[1] + squares[2], squares[2] + squares[0], squares[0] + squares[1]])
    assert (
        np.abs(matrices.mass - np.block([[np.eye(3), np.zeros((3, 3))], [np.zeros((3, 3)), inertia]])).max()
        < 1e-15
    )
    assert np.abs(matrices.K.T - [[1, 0, 0, 0, -1, 0], [0, 1, 0, 1, 0, 0]]).max() < 1e-15
    assert np.abs(matrices.h - [0, 0, 1, 0, 0, 0]).max() < 1e-15
    assert np.abs(matrices.delassus - np.diag([2, 3.5, 1])).max() < 1e-15


def test_visual_spheres_of_ellipsoid_are_inside_it_and_reach_its_ends():
    shapes = pinimpact.load_robot("ellipsoid").visual_model.geometryObjects
    spheres = [(shape.placement.translation[0], shape.geometry.radius) for shape in shapes]
    angles = np.linspace(0, 2 * np.pi, 400)
    for centre, radius in spheres:
        x, y = centre + radius * np.cos(angles), radius * np.sin(angles)
        assert ((x / 2) ** 2 + y**2).max() < 1 + 1e-6
    assert max(centre + radius for centre, radius in spheres) == pytest.approx(2)
    assert max(radius for _, radius in spheres) == 1


@pytest.mark.parametrize("name", bundled_models())
def test_bundled_models_have_visual_shapes_and_a_tip(name):
    robot = pinimpact.load_robot(name)
    assert robot.visual_model.ngeoms >= 1
    assert robot.model.existFrame("tip")
    assert isinstance(robot, pin.RobotWrapper)
