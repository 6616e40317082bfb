"""Contact axes against the definition of their rotation in multiple precision, in particular near n = ±z."""

import mpmath
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

import pinimpact
from pinimpact.geometry.surfaces import contact_axes


def rotated_axes(normal):
    """Return the axes rotated by the smallest rotation from z to n, by Rodrigues' formula."""
    with mpmath.workdps(700):  # 1 + nz is resolved even for components of 1e-300
        n = mpmath.matrix([mpmath.mpf(float(x)) for x in normal])
        n /= mpmath.sqrt(sum(x * x for x in n))
        if n[0] == n[1] == 0 and n[2] < 0:
            return np.diag([1.0, -1.0, -1.0])
        skew = mpmath.matrix([[0, 0, n[0]], [0, 0, n[1]], [-n[0], -n[1], 0]])  # matrix of z × n
        rotation = mpmath.eye(3) + skew + skew * skew / (1 + n[2])
        return np.array([[float(rotation[i, j]) for i in range(3)] for j in range(3)])


tilt = st.tuples(st.floats(-150, 0), st.floats(0, 2 * np.pi)).map(
    lambda p: (10 ** p[0] * np.cos(p[1]), 10 ** p[0] * np.sin(p[1]))
)


@given(tilt, st.sampled_from([-1.0, 1.0]), st.floats(1e-3, 1e3))
@example((1e-12, 0.0), -1.0, 1.0)
@example((0.0, -1e-12), -1.0, 1.0)
@example((3e-13, -4e-13), -1.0, 1.0)
@example((1e-150, 1e-150), -1.0, 1.0)
@example((1e-9, 2e-9), 1.0, 1.0)
@example((2.225e-311, 2.225e-311), -1.0, 1.0)
def test_axes_are_those_of_the_smallest_rotation(xy, z, length):
    normal = length * np.array([*xy, z])
    assert np.abs(contact_axes(normal) - rotated_axes(normal)).max() < 1e-15


@given(st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda n: max(map(abs, n)) > 1e-3))
def test_axes_of_any_normal_are_orthonormal_and_right_handed(normal):
    axes = contact_axes(normal)
    assert np.abs(axes @ axes.T - np.eye(3)).max() < 1e-15
    assert np.linalg.det(axes) == pytest.approx(1.0, abs=1e-14)
    assert np.abs(axes - rotated_axes(normal)).max() < 1e-15


def test_axes_for_z_and_minus_z():
    assert contact_axes((0, 0, 2)).tolist() == np.eye(3).tolist()
    assert contact_axes((0, 0, -1)).tolist() == np.diag([1.0, -1.0, -1.0]).tolist()


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("normal", (0, 0, 0)),
        ("normal", (0, np.nan, 1)),
        ("normal", (0, 1)),
        ("point", (np.inf, 0, 0)),
        ("velocity", "fast"),
        ("angular_velocity", (0, 0, 0, 1)),
        ("body", 1.5),
        ("body", True),
    ],
)
def test_invalid_plane_raises(field, value):
    with pytest.raises(pinimpact.InputError, match=field) as caught:
        pinimpact.Plane(**{field: value})
    assert caught.value.field == field


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("center", (0, 0)),
        ("center", (0, np.nan, 1)),
        ("radius", 0.0),
        ("radius", -1.0),
        ("radius", np.inf),
        ("radius", "big"),
        ("velocity", "fast"),
        ("angular_velocity", (0, 0, 0, 1)),
        ("body", 1.5),
    ],
)
def test_invalid_sphere_raises(field, value):
    with pytest.raises(pinimpact.InputError, match=field) as caught:
        pinimpact.Sphere(**({"radius": 1.0} | {field: value}))
    assert caught.value.field == field


def test_sphere_without_radius_raises():
    with pytest.raises(pinimpact.InputError, match="radius"):
        pinimpact.Sphere((0, 0, 1))


@pytest.mark.parametrize("scale", [1e-200, 1e200])
def test_normal_of_any_length(scale):
    assert pinimpact.Plane(normal=(0, 3 * scale, 4 * scale)).normal == pytest.approx((0, 0.6, 0.8))


def test_surfaces_are_compared_by_value():
    assert pinimpact.Plane(point=[1, 2, 3]) == pinimpact.Plane(point=np.array([1.0, 2.0, 3.0]))
    assert len({pinimpact.Plane(), pinimpact.Plane(normal=(0, 0, 5))}) == 1
    assert len({pinimpact.Sphere([0, 0, 1], 2), pinimpact.Sphere(np.array([0.0, 0.0, 1.0]), 2.0)}) == 1
    assert pinimpact.Sphere(radius=1.0) != pinimpact.Plane()


def test_distances_from_surfaces():
    plane = pinimpact.Plane(point=(0, 0, 2), normal=(0, 0, -3))
    assert [plane.distance((5, 5, z)) for z in (0, 2, 3)] == [2.0, 0.0, -1.0]
    sphere = pinimpact.Sphere(center=(1, 0, 0), radius=2)
    assert [sphere.distance(p) for p in ((4, 4, 0), (1, 0, 2), (1, 1, 0))] == [3.0, 0.0, -1.0]
