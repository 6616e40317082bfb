"""A control loop in plain Pinocchio that calls `impact` at touchdown.

python examples/control_loop.py

A UR5 follows a line down to a table by inverse kinematics, makes contact and slides along it. The loop has
fixed steps with `pin.aba`, and calls `impact` when the gap closes; while the tool stays on the table,
the same call with e = 0 prevents penetration.
"""

import numpy as np
import pinocchio as pin

import pinimpact

DT, STEPS = 1e-3, 1500
GOAL_VELOCITY = np.array([0.05, 0.0, -0.15])  # of the tool [m/s]


def command(model, data, q, v, frame):
    """Return torques that move the tool at the desired velocity, by damped inverse kinematics."""
    J = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL_WORLD_ALIGNED)
    twist = np.concatenate([GOAL_VELOCITY, np.zeros(3)])
    wanted = J.T @ np.linalg.solve(J @ J.T + 1e-4 * np.eye(6), twist)
    return pin.rnea(model, data, q, v, np.zeros(model.nv)) + 20.0 * (wanted - v)


def main():
    """Run the loop and print the touchdowns."""
    model = pinimpact.load_robot("ur5").model
    data = model.createData()
    frame = model.getFrameId("tool0")
    table = pinimpact.Plane()
    tool = pinimpact.Contact("tool0", table, friction=0.3, restitution=0.3)
    resting = pinimpact.Contact("tool0", table, friction=0.3, restitution=0.0)
    q, v = np.array([0.2, -1.0, 1.7, -2.3, -1.6, 0.0]), np.zeros(model.nv)
    impacts, on_table = 0, 0
    for step in range(STEPS):
        v = v + DT * pin.aba(model, data, q, v, command(model, data, q, v, frame))
        if tool.gap(model, data, q) <= 0.0:
            hit = pinimpact.impact(model, data, q, v, tool)
            approach = -hit.problem.velocity[2]
            if approach > 0.01:  # a touchdown
                impacts += 1
                print(
                    f"{step * DT:.3f} s: {approach:.3f} m/s, impulse {hit.impulse_world.round(3)} N s. "
                    f"{' '.join(hit.solution.flags.describe())}"
                )
            else:  # sustained contact
                hit = pinimpact.impact(model, data, q, v, resting)
                on_table += 1
            v = hit.v
        q = pin.integrate(model, q, DT * v)
    gap = tool.gap(model, data, q)
    print(f"{impacts} touchdowns, {on_table} steps on the table, gap {1e3 * gap:.0e} mm in the end")


if __name__ == "__main__":
    main()
