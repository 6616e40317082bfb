"""Your robot strikes an inclined wall: the impact as a function of the tilt of the wall.

python examples/inclined_wall.py [robot.urdf [tip_frame]]

The default is the arm next to this script. Posture and velocity are the same for all tilts; the plot
inclined_wall.png shows impulse, work and contact modes.
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pinocchio as pin

import pinimpact

FRICTION, RESTITUTION = 0.3, 0.4
VELOCITY = np.array([0.8, 0.15, 0.1])  # of the tip at impact, in world axes [m/s]
TILTS = np.radians(np.linspace(-60.0, 60.0, 241))  # 0 is a vertical wall that faces the robot
MODES = ("slips", "sticks", "stops and slips again")


def strike(robot, frame, tilt):
    """Return the impact of a frame on a tilted wall."""
    model, data = robot.model, robot.data
    q = robot.q0 if model.nq != 4 else np.array([0.3, 0.6, 1.2, 0.5])
    jacobian = pin.computeFrameJacobian(model, data, q, model.getFrameId(frame), pin.LOCAL_WORLD_ALIGNED)
    v = np.linalg.pinv(jacobian[:3], rcond=1e-3) @ VELOCITY
    normal = (-np.cos(tilt), 0.0, np.sin(tilt))
    contact = pinimpact.Contact(frame, pinimpact.Plane(normal=normal), FRICTION, RESTITUTION)
    return pinimpact.impact(model, data, q, v, contact)


def mode(solution):
    """Return the contact mode at the end, as an index in `MODES`."""
    if pinimpact.Flag.SLIP_RESUMED in solution.flags:
        return 2
    return int(pinimpact.Flag.STICK in solution.flags)


def main(urdf=Path(__file__).parent / "arm.urdf", frame="tip"):
    """Vary the tilt, print where the contact mode changes, and plot."""
    robot = pinimpact.load_robot(urdf)
    solutions = [strike(robot, frame, tilt).solution for tilt in TILTS]
    degrees = np.degrees(TILTS)
    modes = np.array([mode(solution) for solution in solutions])
    touching = np.array([solution.status != pinimpact.Status.NO_IMPACT for solution in solutions])
    print(f"strikes from {degrees[touching][0]:.0f} to {degrees[touching][-1]:.0f} degrees")
    for i in np.flatnonzero((np.diff(modes) != 0) & touching[1:] & touching[:-1]):
        print(f"at {degrees[i + 1]:.1f} degrees: {MODES[modes[i]]}, then {MODES[modes[i + 1]]}")

    figure, (above, below) = plt.subplots(2, 1, sharex=True, figsize=(7, 6), layout="constrained")
    impulses = np.array([solution.impulse for solution in solutions])
    above.plot(degrees, impulses[:, 2], "k", label="normal")
    above.plot(degrees, np.hypot(*impulses[:, :2].T), "C0", label="friction")
    above.set(ylabel="impulse [N s]", title=f"{robot.model.name}: μ = {FRICTION}, e = {RESTITUTION}")
    for name in ("compression", "restitution", "friction"):
        below.plot(degrees, [getattr(solution.work, name) for solution in solutions], label=name)
    below.set(xlabel="tilt of the wall [degrees]", ylabel="work [J]")
    for axes in (above, below):
        for number, color in ((1, "C8"), (2, "C3")):
            shaded = (modes == number) & touching
            axes.fill_between(
                degrees, 0, 1, shaded, transform=axes.get_xaxis_transform(), color=color, alpha=0.25, lw=0,
                label=MODES[number] if shaded.any() else None,
            )  # fmt: skip
        axes.legend(fontsize="small")
    figure.savefig("inclined_wall.png", dpi=120)
    print("inclined_wall.png")


if __name__ == "__main__":
    main(*sys.argv[1:3])
