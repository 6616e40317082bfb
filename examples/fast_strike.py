"""A Panda strikes a table as fast as the limits of its joints permit, for a range of friction coefficients.

python examples/fast_strike.py  (needs a solver: pip install 'qpsolvers[daqp]')

The hand moves along a slanted line. In each control period a quadratic program finds the joint accelerations
with the largest speed along the line for which torques and joint velocities are within their limits. If
`careful`, the velocities after an immediate impact are so too, by `impact_rows` at both ends of an interval
of friction coefficients. Impacts at coefficients between them show that this suffices. The plot is
fast_strike.png.
"""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pinocchio as pin
from qpsolvers import solve_qp

import pinimpact

DT = 1e-3  # control period [s]
MARGIN = 0.99  # of the limits, as the rows are linear and at the configuration before the period
LEAST, MOST = 0.1, 0.8  # friction coefficients
ALONG = np.array([0.6, 0.0, -0.8])


def panda():
    """Return a Panda with locked fingers, its configuration and its contact with the table."""
    robot = pinimpact.load_robot("panda")
    model, q = pin.buildReducedModel(robot.model, [8, 9], robot.q0), robot.q0[:7]
    return model, q, pinimpact.Contact("panda_hand_tcp", pinimpact.Plane((0, 0, 0.4)), restitution=0.5)


def rows(model, data, q, v, hand, careful):
    """Return G and h of G a <= h for the joint accelerations a."""
    limit = MARGIN * model.velocityLimit
    M, forces = pin.crba(model, data, q), pin.nle(model, data, q, v)
    found = [(M, forces, model.effortLimit), (DT * np.eye(7), v, limit)]
    for mu in (LEAST, MOST) if careful else ():
        A, b = pinimpact.impact_rows(model, data, q, v, replace(hand, friction=mu), DT)
        found.append((A[:7], b[:7], limit))
    G = [sign * A for A, _, _ in found for sign in (1, -1)]
    return np.vstack(G), np.concatenate([size - sign * b for _, b, size in found for sign in (1, -1)])


def strike(careful):
    """Return the speed of the hand in each control period, and q and v at the table."""
    model, q, hand = panda()
    data, frame = model.createData(), model.getFrameId(hand.frame)
    jacobian = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL_WORLD_ALIGNED)[:3]
    v = np.linalg.pinv(jacobian) @ (0.05 * ALONG)
    speeds = []
    while hand.gap(model, data, q) > 0:
        G, h = rows(model, data, q, v, hand, careful)
        jacobian = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL_WORLD_ALIGNED)[:3]
        speeds.append(ALONG @ jacobian @ v)
        # unknowns a and s with J (v + a dt) = s along, and s as close to 10 m/s as possible
        P, p = np.diag([1e-6] * 7 + [1.0]), np.array([0.0] * 7 + [-10.0])
        line = np.column_stack([DT * jacobian, -ALONG])
        found = solve_qp(P, p, np.pad(G, ((0, 0), (0, 1))), h, line, -jacobian @ v, solver="daqp")
        v = v + DT * found[:7]
        q = pin.integrate(model, q, DT * v)
    return np.array(speeds), q, v


def after(q, v, frictions):
    """Return the joint velocities after the impact relative to their limits, (n, 7)."""
    model, _, hand = panda()
    data = model.createData()
    hits = [pinimpact.impact(model, data, q, v, replace(hand, friction=mu)) for mu in frictions]
    return np.array([hit.v for hit in hits]) / model.velocityLimit


def main():
    """Print and plot the speeds, and the joint velocities after impacts."""
    frictions = np.linspace(LEAST, MOST, 141)
    _, (left, right) = plt.subplots(1, 2, figsize=(11, 4), layout="constrained")
    for careful, name, style in ((False, "without impact_rows", "--"), (True, "with impact_rows", "-")):
        speeds, q, v = strike(careful)
        ratios = after(q, v, frictions)
        print(
            f"{name}: the hand strikes at {speeds[-1]:.2f} m/s, then joint velocities are at most "
            f"{np.abs(ratios).max():.3f} of their limits"
        )
        left.plot(DT * np.arange(len(speeds)), speeds, style, color="black", label=name)
        right.plot(frictions, np.abs(ratios).max(axis=1), style, color="black")
    right.axhline(1.0, color="C3", lw=0.8)
    left.set(xlabel="time [s]", ylabel="speed of the hand [m/s]", ylim=(0, None))
    right.set(xlabel="friction coefficient μ", ylabel="largest joint velocity after the impact / limit")
    left.legend(frameon=False)
    left.figure.savefig("fast_strike.png", dpi=120)
    print("fast_strike.png")


if __name__ == "__main__":
    main()
