"""Stacks of boxes that slide on each other, against a closed form and implicit time steps."""

from __future__ import annotations

import math

import numba
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pinimpact import Contact, Plane, Scene, simulate

from .drawing import examples
from .scene_models import G

HEIGHT, HALF = 1e-3, 30.0
"""Half of the height and of the sides of a box [m]; boxes neither tip nor slide off the one below."""


def stack(frictions, order, load, place):
    """Return a scene of boxes of 1 kg, one on the other, of which one is pulled, and its configuration.

    Args:
        frictions: Coefficients of friction of the bottom faces, the lowest box first.
        order: Order of the contacts, the four corners of each box.
        load: Force along x as a function of time [N].
        place: Index of the box that is pulled.
    """
    model, contacts = pin.Model(), []
    for k, mu in enumerate(frictions):
        joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), f"box{k}")
        inertia = pin.Inertia.FromBox(1.0, 2.0 * HALF, 2.0 * HALF, 2.0 * HEIGHT)
        model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
        model.addBodyFrame(f"box{k}", joint, pin.SE3.Identity(), 0)
        below = Plane(point=(0.0, 0.0, HEIGHT), body=f"box{k - 1}") if k else Plane()
        for i, (x, y) in enumerate([(-HALF, -HALF), (HALF, -HALF), (HALF, HALF), (-HALF, HALF)]):
            corner = pin.SE3(np.eye(3), np.array([x, y, -HEIGHT]))
            model.addFrame(pin.Frame(f"{k}{i}", joint, 0, corner, pin.FrameType.OP_FRAME))
            contacts.append(Contact(f"{k}{i}", below, friction=mu))

    def control(t, q, v):
        force = np.zeros(model.nv)
        force[6 * place] = load(t)
        return force

    q = np.concatenate([[0.0, 0.0, (2 * k + 1) * HEIGHT, 0.0, 0.0, 0.0, 1.0] for k in range(len(frictions))])
    return Scene(model, [contacts[i] for i in order], control=control), q


@pytest.mark.parametrize("boxes", [2, 3, 4])
@pytest.mark.parametrize("mu", [0.2, 0.5])
@pytest.mark.parametrize("seed", [None, 1, 2])
@pytest.mark.filterwarnings("ignore::pinimpact.BoundReachedWarning")  # harmless at e = 0
def test_boxes_above_the_one_that_is_pulled_away_move_together(boxes, mu, seed):
    """When the lowest box starts to slide, all boxes above need their maximal friction at once, a tie."""
    rate, numbers = 20.0, np.arange(4 * boxes)
    order = numbers if seed is None else np.random.default_rng(seed).permutation(numbers)
    onset, separation = boxes * mu * G / rate, 2.0 * boxes * mu * G / rate
    end = separation + 0.25
    scene, q = stack([mu] * boxes, order, lambda t: rate * t, 0)
    trajectory = simulate(scene, q, np.zeros(6 * boxes), end)
    together = 0.5 * rate / boxes * (separation**2 - onset**2) - mu * G * (separation - onset)
    below = together + 0.5 * rate * (end**2 - separation**2) - mu * G * (2 * boxes - 1) * (end - separation)
    above = together + mu * G * (end - separation)
    assert trajectory.v[-1, ::6] == pytest.approx([below] + [above] * (boxes - 1), rel=1e-7)


@numba.njit
def time_stepping(limits, load, place, step):
    """Return the positions of masses of 1 kg, one on the other, after implicit steps under a load.

    The friction impulse p_k between box k and the one below is within ± limit · step, and at this bound if
    the two slide. Errors are of first order, where friction changes.

    Args:
        limits: Bounds of the friction forces [N].
        load: Impulses of the load in the steps [N s].
        place: Index of the mass that is pulled.
        step: Step size [s].
    """
    n = len(limits)
    x, v, p = np.zeros(n), np.zeros(n), np.zeros(n)
    for impulse in load:
        free = v.copy()
        free[place] += impulse
        change = 1.0
        while change > 1e-14:
            change = 0.0
            for k in range(n):
                moves = free[k] - p[k] + (p[k + 1] if k + 1 < n else 0.0)
                if k > 0:
                    moves -= free[k - 1] - p[k - 1] + p[k]
                bound = step * limits[k]
                new = min(max(p[k] + moves / (2.0 if k > 0 else 1.0), -bound), bound)
                change, p[k] = max(change, abs(new - p[k])), new
        for k in range(n):
            old = v[k]
            v[k] = free[k] - p[k] + (p[k + 1] if k + 1 < n else 0.0)
            x[k] += 0.5 * step * (old + v[k])
    return x


@examples(15)
@given(
    st.lists(st.sampled_from([0.3, 0.5]) | st.floats(0.1, 0.8), min_size=2, max_size=3),
    st.integers(0, 2),
    st.floats(0.3, 2.0),
    st.floats(0.0, 1.0).map(lambda x: 10.0**x),
    st.floats(0.0, 6.28),
    st.floats(-0.4, 0.4),
    st.randoms(use_true_random=False),
)
def test_boxes_slide_on_each_other_as_small_time_steps_have_it(mus, place, size, pace, phase, mean, random):
    boxes, duration, steps = len(mus), 2.0, 40_000
    place = min(place, boxes - 1)
    limits = np.array([mu * (boxes - k) * G for k, mu in enumerate(mus)])
    amplitude, mean = size * limits[place], mean * limits[place]

    def load(t):
        return amplitude * math.sin(pace * t + phase) + mean

    times = np.linspace(0.0, duration, steps + 1)
    swing = amplitude / pace * np.cos(pace * times + phase)
    exact = time_stepping(limits, mean * np.diff(times) - np.diff(swing), place, duration / steps)
    order = random.sample(range(4 * boxes), 4 * boxes)
    scene, q = stack(mus, order, load, place)
    trajectory = simulate(scene, q, np.zeros(6 * boxes), duration)
    assert trajectory.q[-1, ::7] == pytest.approx(exact, abs=3e-4)
    assert len(trajectory.notes) <= 1  # that forces are not unique
