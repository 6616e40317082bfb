"""Optimal control through impacts by gradients, against known optima. (arXiv 2207.05060 and 2305.00092)

Forces u push ball a from rest so that it strikes ball b, of the same mass, elastically and without friction.
The cost is |x_b(1)|² + ε ∫ |u|² dt. With the time s, the normal n and the velocity at impact given, the
optimal forces have least norm, so the problem reduces to a minimum over four numbers.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import minimize

from pinimpact import Contact, Plane, Scene, Sphere, Stepper

RADIUS, END, WALL = 0.2, 1.0, 1.0

# initial positions of a and b, ε, and whether there is a wall; initial guesses of u and of the four numbers;
# published minimum of the cost
HEAD_ON = ((-2.0, -2.0), (-1.0, -1.0), 0.1, False), (3.0, 3.0), (0.7, 0.8, 2.5, 0.0), 1.3965421601
OBLIQUE = ((-1.0, -2.0), (-1.0, -1.0), 0.01, False), (0.0, 3.0), (0.5, 0.9, 2.3, 2.0), 0.3114168704
BY_THE_WALL = ((0.25, -0.3), (-0.5, 0.6), 0.01, True), (-3.5, 3.0), (0.55, 4.9, 2.0, -2.5), 0.3736363502


def balls(wall):
    model = pin.Model()
    for name in "ab":
        joint = 0
        for kind in (pin.JointModelPX(), pin.JointModelPY()):
            joint = model.addJoint(joint, kind, pin.SE3.Identity(), f"{name}{kind.shortname()}")
        model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, RADIUS), pin.SE3.Identity())
        model.addFrame(pin.Frame(name, joint, pin.SE3.Identity(), pin.OP_FRAME))
    contacts = [Contact("a", Sphere(radius=RADIUS, body="b"), restitution=1.0, radius=RADIUS)]
    if wall:
        contacts.append(Contact("b", Plane((0, WALL, 0), (0, -1, 0)), restitution=1.0, radius=RADIUS))
    return Scene(model, contacts, without=["gravity"])


def optimum(task, start, steps=None, until=END):
    """Return the minimal cost and the time of impact for forces constant in `steps`, or for any forces."""
    a, b, weight, wall = task
    # with a wall, positions are mirrored in it
    a, b = (np.array([x, 2 * (WALL - RADIUS) - y] if wall else [x, y]) for x, y in (a, b))

    def gram(s):
        """Return the Gramian of the effects of forces on position and velocity at time s."""
        if steps is None:
            return np.array([[s**3 / 3, s**2 / 2], [s**2 / 2, s]])
        h = until / steps
        begins = np.arange(steps) * h
        lasts = np.clip(s - begins, 0.0, h)
        effect = np.array([lasts * (s - begins - lasts / 2), lasts])
        return effect @ effect.T / h

    def cost(numbers):
        s, angle, along, across = numbers
        n = np.array([np.cos(angle), np.sin(angle)])
        reached = np.array([b - a - 2 * RADIUS * n, along * n + across * np.array([-n[1], n[0]])])
        effort = np.trace(reached.T @ np.linalg.solve(gram(s), reached))
        return ((b + (END - s) * along * n) ** 2).sum() + weight * effort

    tight = {"xatol": 1e-12, "fatol": 1e-15, "maxiter": 10**4, "maxfev": 10**4}
    found = minimize(cost, start, method="Nelder-Mead", options=tight)
    found = minimize(cost, found.x, method="Nelder-Mead", options=tight)
    return found.fun, found.x[0]


def by_gradients(task, guess, steps, until):
    """Return the minimal cost by BFGS, and the trajectory."""
    a, b, weight, wall = task
    stepper, h = Stepper(balls(wall), [*a, *b], np.zeros(4), rtol=1e-10), until / steps
    coast = [END - until] if until < END else []

    def cost(u):
        stepper.reset([*a, *b], np.zeros(4))
        slope = np.zeros((8, 2 * steps))
        for k, dt in enumerate([h] * steps + coast):
            tau, own = np.zeros(4), slice(2 * k, 2 * k + 2)
            tau[:2] = u[own] if k < steps else 0.0
            A, B = stepper.linearize(tau, dt)
            slope = A @ slope
            if k < steps:
                slope[:, own] += B[:, :2]
            stepper.step(tau, dt)
        x = stepper.q[2:]
        return x @ x + weight * h * u @ u, 2 * x @ slope[2:4] + 2 * weight * h * u

    found = minimize(cost, np.tile(guess, steps), jac=True, method="BFGS", options={"gtol": 1e-9})
    cost(found.x)
    return found.fun, stepper.trajectory


@pytest.mark.parametrize(("task", "guess", "start", "published"), [HEAD_ON, OBLIQUE, BY_THE_WALL])
def test_reduction_to_four_numbers_has_the_published_optimum(task, guess, start, published):
    # minima of the published formulas on finer grids
    assert optimum(task, start)[0] == pytest.approx(published, abs=1e-9)
    assert optimum(task, start, 480)[0] == pytest.approx(published, rel=2e-4)


# the cost has a kink if an impact is at the end of a step; in the last two tasks forces end before the impact
@pytest.mark.parametrize(
    ("case", "steps", "until"),
    [(HEAD_ON, 9, 1.0), (HEAD_ON, 20, 1.0), (OBLIQUE, 8, 0.4), (BY_THE_WALL, 8, 0.4)],
)
def test_gradient_descent_reaches_the_optimum(case, steps, until):
    task, guess, start, _ = case
    least, s = optimum(task, start, steps, until)
    found, trajectory = by_gradients(task, guess, steps, until)
    assert found == pytest.approx(least, rel=1e-12)
    assert trajectory.impacts[0].time == pytest.approx(s, abs=1e-6)
    assert [record.source for record in trajectory.impacts] == ["a on b", "b on plane"][: 1 + task[3]]
