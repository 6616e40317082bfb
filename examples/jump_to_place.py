"""A quadruped jumps to a target: torques by Newton's method, with derivatives through impacts.

python examples/jump_to_place.py

Constant torques push for 0.1 s, then a PD control holds the joints in a landing pose. Newton's method finds
five torques for which the trunk is level at a target position, first at a time in flight, then at a time at
which all feet have bounced on the floor. The legs differ slightly in that pose, so that the feet land one
after the other. The jump is repeated by `simulate`. The plot is jump_to_place.png.
"""

import matplotlib.pyplot as plt
import numpy as np
import pinocchio as pin

import pinimpact

DT, PUSH, KP, KD = 4e-3, 0.1, 4.0, 0.1  # period of the control, duration of the push [s], gains
ASKED = ((0.3, (0.087, 0.044, 0.28)), (0.344, (0.1, 0.05, 0.2385)))  # times [s], positions of the trunk [m]
LEGS = np.array([0.700, 0.705, 0.710, 0.715])  # in the landing pose [rad]
SIDEWAYS, HIPS, KNEES = (np.tile(axis, 4) for axis in np.eye(3))
FRONT, LEFT = np.repeat([1, 1, -1, -1], 3), np.repeat([1, -1, 1, -1], 3)
PUSHES = np.column_stack([KNEES, HIPS, SIDEWAYS, FRONT * KNEES, LEFT * KNEES])
GUESS = np.array([2.0, 0.4, -0.1, -0.3, -0.1])  # [N m]

robot = pinimpact.load_robot("solo12")
feet = [pinimpact.Contact(name, pinimpact.Plane(), friction=0.8, restitution=0.7, name=name)
        for name in ("FL_FOOT", "FR_FOOT", "HL_FOOT", "HR_FOOT")]  # fmt: skip
q0, v0 = pin.neutral(robot.model), np.zeros(18)
q0[7:] = np.tile([0, 1.1, -2.2], 4)  # crouching
q0[2] = -min(foot.gap(robot.model, robot.data, q0) for foot in feet)


def control(push, t, q, v):
    """Return the forces of the joints, and their derivatives by the five torques and by the state."""
    tau, by_push, by_state = np.zeros(18), np.zeros((18, 5)), np.zeros((18, 36))
    if t < PUSH:
        by_push[6:] = PUSHES
        return by_push @ push, by_push, by_state
    tau[6:] = KP * (np.column_stack([0 * LEGS, LEGS, -2 * LEGS]).ravel() - q[7:]) - KD * v[6:]
    by_state[6:, 6:18], by_state[6:, 24:] = -KP * np.eye(12), -KD * np.eye(12)
    return tau, by_push, by_state


def jump(push, end):
    """Return final position (3,) and tilt (2,) of the trunk, and their derivatives (5, 5) by the torques."""
    stepper = pinimpact.Stepper(pinimpact.Scene(robot, feet), q0, v0, rtol=1e-9)
    slope = np.zeros((36, 5))
    for k in range(round(end / DT)):
        tau, by_push, by_state = control(push, k * DT, stepper.q, stepper.v)
        A, B = stepper.linearize(tau, DT)
        slope = A @ slope + B @ (by_push + by_state @ slope)
        stepper.step(tau, DT)
    turn = pin.Quaternion(stepper.q[3:7]).matrix()  # changes of q are in the axes of the trunk
    tilt = turn @ np.cross(slope[3:6], [0, 0, 1], axis=0)
    return np.r_[stepper.q[:3], turn[:2, 2]], np.vstack([turn @ slope[:3], tilt[:2]])


def aim(push=GUESS):
    """Return the torques, and the errors of the trunk in each iteration, in flight and after impacts."""
    errors = []
    for end, place in ASKED:
        errors.append([])
        for _ in range(6):
            found, slope = jump(push, end)
            error = found - [*place, 0, 0]
            errors[-1].append(np.abs(error).max())
            push = push - np.linalg.solve(slope, error)
    return push, errors


def replay(push, duration):
    """Return the trajectory of the jump."""
    law = pinimpact.Scene(robot, feet, control=lambda t, q, v: control(push, t, q, v)[0], period=DT)
    return pinimpact.simulate(law, q0, v0, duration, rtol=1e-9)


def main():
    """Print the torques, and plot the jump and how the iterations converge."""
    push, errors = aim()
    motion, (end, place) = replay(push, 0.6), ASKED[1]
    struck = [impact.source for impact in motion.impacts if impact.time < end]
    print(f"torques {push.round(4)} N m; {len(struck)} impacts of {len(set(struck))} feet")
    print(f"the replay is {np.linalg.norm(motion.at(end)[0][:3] - place):.0e} m from the target")
    _, (left, right) = plt.subplots(1, 2, figsize=(11, 4), layout="constrained")
    left.plot(motion.t, motion.q[:, :3], label=["x", "y", "z"])
    left.plot([end] * 3, place, "ko", ms=4, label="asked")
    left.set(xlabel="time [s]", ylabel="place of the trunk [m]")
    right.semilogy(np.transpose(errors), "o-", label=["in flight", "after the impacts"])
    right.set(xlabel="iteration of Newton's method", ylabel="distance from the asked place and tilt [m, rad]")
    for axes in (left, right):
        axes.legend(frameon=False)
    left.figure.savefig("jump_to_place.png", dpi=120)
    print("jump_to_place.png")


if __name__ == "__main__":
    main()
