"""Two convex shapes: gap, contact points and time of contact."""

from __future__ import annotations

import math
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest

from pinimpact.errors import InputError
from pinimpact.geometry import touch_time as touch_time_module
from pinimpact.geometry.convex_pair import Touch, follow, gap, touches
from pinimpact.geometry.convex_shape import ConvexShape, box, capsule, hull, of_collision_geometry, sphere
from pinimpact.geometry.meeting_edges import normal_of_meeting
from pinimpact.geometry.touch_time import PairState, first_touch
from pinimpact.scene.shape_watch import bend_of_heights

FALL = np.array([0.0, 0.0, -9.81])
STRAIGHT = np.eye(3)


class Flight:
    """A body in free flight with an initial velocity of its origin and a constant angular velocity."""

    def __init__(
        self,
        shape: ConvexShape,
        origin: Any,
        velocity: Any = (0.0, 0.0, 0.0),
        spin: Any = (0.0, 0.0, 0.0),
        rotation: Any = STRAIGHT,
        gravity: Any = (0.0, 0.0, 0.0),
    ) -> None:
        self.shape, self.rotation = shape, np.array(rotation)
        self.origin, self.velocity, self.spin, self.gravity = map(np.array, (origin, velocity, spin, gravity))

    def at(self, t: float) -> tuple[Any, np.ndarray, np.ndarray]:
        rotation = pin.exp3(self.spin * t) @ self.rotation
        origin = self.origin + self.velocity * t + 0.5 * self.gravity * t * t
        velocity = self.velocity + self.gravity * t - np.cross(self.spin, origin)
        acceleration = self.gravity - np.cross(self.spin, self.velocity + self.gravity * t)
        return (
            self.shape.at(rotation, origin),
            np.concatenate([velocity, self.spin]),
            np.concatenate([acceleration, np.zeros(3)]),
        )

    @property
    def bend(self) -> float:
        return float(self.spin @ self.spin) * (float(np.linalg.norm(self.shape.center)) + self.shape.reach)


def state_of(a: Flight, b: Flight, t: float) -> PairState:
    return PairState(*(one for pair in zip(a.at(t), b.at(t), strict=True) for one in pair))


def touch_time(a: Flight, b: Flight, end: float = 2.0, room: float = 0.0) -> float:
    """Return the time of first contact, or infinity; bounds of accelerations are increased by `room`."""

    def at(t: float) -> PairState:
        return state_of(a, b, t)

    bend = float(np.linalg.norm(a.gravity - b.gravity)) + a.bend + b.bend + room
    found = first_touch(at, 0.0, end, bend, 1e-13)
    assert found is not None
    return found.time if found.touches else math.inf


def coal_distance(a: Flight, b: Flight, t: float) -> float:
    request = coal.DistanceRequest()
    request.gjk_tolerance = 1e-12
    placed = [body.at(t)[0] for body in (a, b)]
    ends: list[Any] = []
    for one in placed:
        ends += [one.shape.collision, coal.Transform3s(one.rotation, one.translation)]
    return float(coal.distance(*ends, request, coal.DistanceResult()))


def shape_of(rng: np.random.Generator, kind: int) -> ConvexShape:
    makers = (
        lambda: hull(rng.normal(size=(30, 3)) * 0.3),
        lambda: box(rng.uniform(0.2, 1.0, 3)),
        lambda: sphere(rng.uniform(0.1, 0.4)),
        lambda: capsule(rng.uniform(0.1, 0.3), rng.uniform(0.1, 0.5)),
    )
    return makers[kind]()


@pytest.mark.parametrize("kinds", [(i, j) for i in range(4) for j in range(i, 4)])
def test_first_touch_of_random_bodies_is_the_root_of_coals_distance(kinds: tuple[int, int]) -> None:
    rng = np.random.default_rng([7, *kinds])
    hits = 0
    for _ in range(3):
        a = Flight(
            shape_of(rng, kinds[0]),
            np.array([2.0, 0.0, 0.0]) + 0.2 * rng.normal(size=3),
            np.array([-3.0, 0.0, 0.0]) + 0.3 * rng.normal(size=3),
            3.0 * rng.normal(size=3),
            pin.exp3(rng.normal(size=3)),
            FALL,
        )
        b = Flight(
            shape_of(rng, kinds[1]),
            0.1 * rng.normal(size=3),
            0.2 * rng.normal(size=3),
            3.0 * rng.normal(size=3),
            pin.exp3(rng.normal(size=3)),
            0.9 * FALL,
        )
        found = touch_time(a, b, 1.0)
        distances = [coal_distance(a, b, t) for t in np.linspace(0.0, 1.0, 201)]
        overlap = next((k for k, d in enumerate(distances) if d <= 0.0), None)
        if overlap is None:
            assert found == math.inf or coal_distance(a, b, found) < 1e-9
            continue
        hits += 1
        low, high = (overlap - 1) / 200, overlap / 200
        for _ in range(40):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if coal_distance(a, b, middle) > 0.0 else (low, middle)
        assert found == pytest.approx(high, abs=2e-9)  # coal's boxes are larger by 1e-10
    assert hits > 0


def test_separation_with_vanishing_acceleration_takes_few_advances(monkeypatch: pytest.MonkeyPatch) -> None:
    """A ball orbits another one while the gap grows like t³, as third derivatives of the gap show."""
    monkeypatch.setattr(touch_time_module, "MAX_ADVANCES", 200)
    a, b, turn = sphere(0.1), sphere(0.2), 8.0

    def at(t: float) -> PairState:
        away = 0.3 + 5.0 * t**3
        rates = np.array([away, 15.0 * t * t, 30.0 * t])
        c, s = math.cos(turn * t), math.sin(turn * t)
        outward, along = np.array([c, s, 0.0]), np.array([-s, c, 0.0])
        velocity = rates[1] * outward + turn * away * along
        acceleration = (rates[2] - turn**2 * away) * outward + 2.0 * turn * rates[1] * along
        still = np.zeros(3)
        return PairState(
            a.at(np.eye(3), away * outward),
            b.at(np.eye(3), still),
            np.concatenate([velocity, still]),
            np.zeros(6),
            np.concatenate([acceleration, still]),
            np.zeros(6),
        )

    bend = 1.5 * (turn**2 * 0.3 + 30.0)
    found = first_touch(at, 0.0, 0.1, bend, 1e-13)
    assert found is not None
    assert not found.touches


@pytest.mark.parametrize("lean", [0.0, 0.4])
def test_box_that_spins_onto_level_one_takes_few_advances(
    lean: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The gap is zero up to rounding while the faces slide over each other: the points move along them."""
    monkeypatch.setattr(touch_time_module, "MAX_ADVANCES", 15)
    turn = pin.utils.rotate("y", lean)
    cube = Flight(
        box((0.2, 0.2, 0.2)),
        turn @ np.array([-0.2, 0.0, 0.1]),
        turn @ np.array([0.6, 0.0, 0.0]),
        turn @ np.array([0.0, 0.0, 5.0]),
        turn,
    )
    floor = Flight(box((2.0, 2.0, 0.2)), turn @ np.array([1.0, 0.0, -0.1]), rotation=turn)
    assert touch_time(cube, floor, 0.35) == math.inf


def test_touch_of_balls_and_capsules_in_closed_form() -> None:
    small, large = (
        Flight(sphere(0.1), (3.0, 0.1, 0.0), (-2.0, 0.0, 0.0)),
        Flight(sphere(0.2), (0.0, 0.0, 0.0)),
    )
    assert touch_time(small, large) == pytest.approx((3.0 - math.sqrt(0.09 - 0.01)) / 2.0, rel=1e-14)
    crossed = Flight(capsule(0.05, 1.0), (0.3, 0.2, 2.0), rotation=pin.utils.rotate("x", 1.2), gravity=FALL)
    lying = Flight(capsule(0.1, 1.0), (0.0, 0.0, 0.0), rotation=pin.utils.rotate("y", math.pi / 2))
    # the distance of the axes is z, with z = 2 + 0.2 tan(π/2 − 1.2) as they pass at right angles
    axis = np.array([0.0, -math.sin(1.2), math.cos(1.2)])
    normal = np.cross(np.array([1.0, 0.0, 0.0]), axis)
    height = abs(normal @ (0.3, 0.2, 2.0))
    fall = (height - 0.15) / abs(normal[2])
    assert touch_time(crossed, lying) == pytest.approx(math.sqrt(2.0 * fall / 9.81), rel=1e-13)


@pytest.mark.parametrize("size", [1e-4, 1e-2, 1.0])
@pytest.mark.parametrize("angle", [0.0, 1e-6, 1e-4, 1e-2, 1.0])
def test_gap_of_crossing_capsules_is_distance_of_axes_minus_radii(size, angle):
    rod, turned = capsule(0.05 * size, 0.5 * size), pin.exp3(np.array([angle, 0.0, 0.0]))
    there = np.array([0.3 * size, 0.0, 0.0])
    for along in (0.0, 0.2 * size):  # position of the crossing relative to both centres
        beside = there + (np.eye(3)[2] - turned[:, 2]) * along
        found = gap(rod.at(np.eye(3), np.zeros(3)), rod.at(turned, beside))
        assert found.value == pytest.approx(0.2 * size, abs=1e-9 * size)
        assert found.normal == pytest.approx([-1.0, 0.0, 0.0], abs=1e-6)


@pytest.mark.parametrize("turned", [0, 1, 2])
def test_box_falls_on_a_box_with_face_edge_or_corner(turned: int) -> None:
    tilt = STRAIGHT
    if turned > 0:
        tilt = pin.utils.rotate("x", math.pi / 4)
    if turned > 1:
        tilt = pin.utils.rotate("y", math.atan(math.sqrt(0.5))) @ tilt
    low = 0.5 * math.sqrt(turned + 1.0)
    a = Flight(box((1.0, 1.0, 1.0)), (0.1, 0.2, 3.0), (0.3, 0.0, 0.0), rotation=tilt, gravity=FALL)
    b = Flight(box((4.0, 4.0, 1.0)), (0.0, 0.0, 0.0))
    time = touch_time(a, b)
    assert time == pytest.approx(math.sqrt(2.0 * (2.5 - low) / 9.81), rel=1e-13)
    found = touches(a.at(time)[0], b.at(time)[0], np.array([0.0, 0.0, 1.0]), 1e-12)
    assert [touch.kind for touch in found] == ["vertex-face"] * (4, 2, 1)[turned]
    assert all(touch.other[2] == pytest.approx(0.5, abs=1e-15) for touch in found)


def test_crossing_edges_touch_at_their_crossing() -> None:
    a = Flight(
        box((2.0, 0.2, 0.2)), (0.1, 0.0, 1.0), (0.0, 0.0, -1.0), rotation=pin.utils.rotate("x", math.pi / 4)
    )
    b = Flight(box((0.2, 2.0, 0.2)), (0.0, 0.3, 0.0), rotation=pin.utils.rotate("y", math.pi / 4))
    time = touch_time(a, b)
    assert time == pytest.approx(1.0 - 0.2 * math.sqrt(2.0), rel=1e-13)
    placed = a.at(time)[0], b.at(time)[0]
    normal = gap(*placed).normal
    np.testing.assert_allclose(normal, (0.0, 0.0, 1.0), atol=1e-14)
    (touch,) = touches(*placed, normal, 1e-12)
    assert touch.kind == "edge-edge"
    np.testing.assert_allclose(touch.point, (0.0, 0.0, 0.1 * math.sqrt(2.0)), atol=1e-13)


def test_patch_of_partly_overlapping_faces() -> None:
    a, b = (
        box((1.0, 1.0, 1.0)).at(STRAIGHT, np.array([0.3, 0.2, 1.0])),
        box((1.0, 1.0, 1.0)).at(STRAIGHT, np.zeros(3)),
    )
    found = {touch.kind: touch.point for touch in touches(a, b, np.array([0.0, 0.0, 1.0]), 1e-12)}
    corners = sorted(
        tuple(np.round(t.point, 12).tolist()) for t in touches(a, b, np.array([0.0, 0.0, 1.0]), 1e-12)
    )
    assert corners == [(-0.2, -0.3, 0.5), (-0.2, 0.5, 0.5), (0.5, -0.3, 0.5), (0.5, 0.5, 0.5)]
    assert sorted(found) == ["edge-edge", "face-vertex", "vertex-face"]


@pytest.mark.parametrize(("offset", "hits"), [(-1e-9, True), (1e-9, False), (-1e-7, True)])
def test_grazing_and_missing_passes(offset: float, hits: bool) -> None:
    miss = 0.3 + offset
    a = Flight(sphere(0.1), (2.0, miss, 0.0), (-2.0, 0.0, 0.0))
    expected = (2.0 - math.sqrt(max(0.09 - miss**2, 0.0))) / 2.0 if hits else math.inf
    assert touch_time(a, Flight(sphere(0.2), (0.0, 0.0, 0.0))) == pytest.approx(expected, abs=1e-10)
    # a corner of a rotating cube passes a face
    spin = 1.0
    reach = math.sqrt(0.5)
    b = Flight(box((0.2, 4.0, 4.0)), (reach + 0.1 + offset, 0.0, 0.0))
    turning = Flight(box((1.0, 1.0, 1.0)), (0.0, 0.0, 0.0), spin=(0.0, 0.0, spin))
    expected = math.pi / 4 - math.acos((reach + offset) / reach) if hits else math.inf
    # the grazing corner is slow, so rounding errors of its position matter
    assert touch_time(turning, b, 1.5) == pytest.approx(expected, abs=1e-8)


@pytest.mark.parametrize("seed", range(8))
def test_bound_of_gap_acceleration_of_two_edges(seed: int) -> None:
    rng = np.random.default_rng(seed)
    flights = [
        Flight(box((0.4, 0.3, 0.2)), rng.normal(size=3), spin=rng.normal(size=3), rotation=pin.exp3(turn))
        for turn in rng.normal(size=(2, 3))
    ]

    def at(t: float) -> PairState:
        return state_of(*flights, t)

    spins = [float(np.linalg.norm(one.spin)) for one in flights]
    spin, faster = sum(spins), sum(s * s for s in spins) + sum(spins) ** 2
    for edges in ((0, 0), (0, 5), (3, 7), (9, 4)):
        touch = Touch("edge-edge", np.zeros(3), np.zeros(3), edges)
        bend, until = bend_of_heights(touch, at(0.0), spin, faster)
        last = normal = np.array([0.0, 0.0, 1.0])
        heights = []
        h = min(1e-3, 0.5 * until)
        for t in (0.0, h, 2.0 * h):
            state = at(t)
            u, w = (
                np.subtract(*placed.vertices[placed.shape.edges[k]])
                for placed, k in zip(state[:2], edges, strict=True)
            )
            normal = np.cross(u, w)
            normal = math.copysign(1.0, normal @ last) * normal / np.linalg.norm(normal)
            last = normal
            heights.append(
                [
                    (p.vertices - p.vertices[p.shape.edges[k][0]]) @ normal
                    for p, k in zip(state[:2], edges, strict=True)
                ]
            )
        second = np.abs(np.array(heights[0]) - 2.0 * np.array(heights[1]) + heights[2]).max() / h**2
        assert 1e-3 * bend < second <= bend


@pytest.mark.slow
def test_slow_separation_with_large_bounds_is_detected() -> None:
    lower = Flight(box((0.2, 0.2, 0.2)), (0.0, 0.0, 0.0))
    upper = Flight(box((0.2, 0.2, 0.2)), (0.0, 0.0, 0.2), gravity=(0.0, 0.0, 0.02))
    assert touch_time(upper, lower, 1e-3, room=2700.0) == math.inf


def test_gap_is_exact_when_small_and_never_more_than_the_distance() -> None:
    rng = np.random.default_rng(3)
    for kind in range(4):
        shape, block = shape_of(rng, kind), box((1.0, 1.0, 1.0)).at(STRAIGHT, np.zeros(3))
        rotation = pin.exp3(rng.normal(size=3))
        lowest = (shape.vertices @ rotation.T)[:, 2].min() - shape.radius
        for height in (1e-12, 1e-9, 1e-6, 1e-3, 1.0):
            inside = shape.vertices @ rotation.T
            foremost = inside[inside[:, 2].argmin()]
            place = np.array([-foremost[0], -foremost[1], 0.5 - lowest + height])
            found = gap(shape.at(rotation, place), block)
            assert found.value == pytest.approx(height, abs=1e-15 if height < 1e-7 else 1e-9)
            assert found.value <= height + 4e-16
    deep = gap(box((1.0, 1.0, 1.0)).at(STRAIGHT, np.array([0.9, 0.1, 0.0])), block)
    assert deep.value == pytest.approx(-0.1, rel=1e-14)


@pytest.mark.parametrize("size", [1.0, 1e-2, 1e-4])
def test_gap_of_box_over_face_is_height_of_lowest_corner_at_all_sizes(size: float) -> None:
    rng, missed = np.random.default_rng(3), []
    for _ in range(1000):
        block = box(size * np.array([2.0, 2.0, 1.0])).at(STRAIGHT, np.zeros(3))
        rotation = pin.exp3(rng.normal(size=3) * rng.choice([1e-4, 0.03, 1.0]))
        over = box(size * rng.uniform(0.05, 0.6, 3)).at(rotation, np.zeros(3))
        height = size * 10.0 ** rng.uniform(-9.0, -3.0)
        across = size * rng.uniform(-0.4, 0.4, 2)  # so that all corners stay above the face
        place = np.array([*across, 0.5 * size + height - over.vertices[:, 2].min()])
        missed.append(gap(over.shape.at(rotation, place), block).value - height)
    assert np.abs(missed).max() < 1e-9 * size  # ten times coal's error for boxes


def test_shapes_from_coal_geometries() -> None:
    made = of_collision_geometry(coal.Box(1.0, 2.0, 3.0), "b")
    assert made.reach == pytest.approx(math.sqrt(14.0) / 2.0)
    assert (len(made.vertices), len(made.faces), len(made.edges)) == (8, 6, 12)
    cube = hull([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)] + [[0.5, 0.5, 1.0]])
    assert (len(cube.vertices), len(cube.faces), len(cube.edges)) == (8, 6, 12)
    with pytest.raises(InputError, match="'c' is a Cone"):
        of_collision_geometry(coal.Cone(1.0, 2.0), "c")
    with pytest.raises(InputError, match="no convex hull with a volume"):
        hull([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])


def test_non_convex_mesh_is_replaced_by_its_hull_with_warning() -> None:
    mesh = coal.BVHModelOBBRSS()
    corners = [[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)]
    mesh.beginModel(2, 9)
    mesh.addVertices(np.array([*corners, [0.5, 0.5, 0.7]]))
    mesh.addTriangles(np.array([[0, 1, 2], [6, 7, 8]]))
    mesh.endModel()
    with pytest.warns(UserWarning, match=r"mesh of 'm' is not convex: its convex hull is used.*0\.3 m"):
        assert len(of_collision_geometry(mesh, "m").vertices) == 8


def test_edges_that_become_parallel_are_abandoned():
    cube = box((1.0, 1.0, 1.0))
    a, b = cube.at(STRAIGHT, np.zeros(3)), cube.at(STRAIGHT, np.array([1.0, 2.0, 3.0]))
    normal = np.array([0.0, 0.0, -1.0])
    found = follow(Touch("edge-edge", np.zeros(3), np.zeros(3), (0, 0)), a, b, normal)
    assert found.beyond > 0.0
    assert np.array_equal(found.normal, normal)
    start, end = a.vertices[cube.edges[0]]
    assert (found.touch.other - found.touch.point) @ (end - start) == pytest.approx(0.0, abs=1e-15)


def test_edge_that_approaches_another_along_a_different_direction_at_each_end():
    """One end approaches the side of the other box, the other its top: the mirror image exchanges both."""
    cube = box((0.2, 0.2, 0.2))
    placed = [cube.at(np.eye(3), np.array([x, 0.0, x])) for x in (0.2, 0.0)]
    ends = np.array([[1.0, 0.0, -2.0], [-2.0, 0.0, 1.0]])
    normal, apart = normal_of_meeting(*placed, np.array([1.0, 0.0, 0.0]), lambda: ends, 1e-3, 1e-9, 0.0)
    assert not apart
    assert normal == pytest.approx(np.array([1.0, 0.0, 1.0]) / np.sqrt(2.0))
