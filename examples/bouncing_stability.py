"""Stability of a bouncing motion, from its derivative over one period.

python examples/bouncing_stability.py

A foot bounces elastically on the top of a round stone, held sideways by a spring. Without the spring each
bounce increases its distance from the top. The multipliers of a period, from apex to apex, are the
eigenvalues of `trajectory.sensitivity`. Their product is 1, so the motion is stable if the trace is between
-2 and 2. The plot, with the multipliers in closed form, is bouncing_stability.png.
"""

import matplotlib.pyplot as plt
import numpy as np
import pinocchio as pin

import pinimpact

HEIGHT, STONE = 0.1, 0.5
GRAVITY = 9.81
SPEED = np.sqrt(2 * GRAVITY * HEIGHT)
PERIOD = 2 * SPEED / GRAVITY


def bouncer(stiffness):
    """Return a scene: 1 kg that moves along x and z over a sphere, with a spring along x."""
    model, joint = pin.Model(), 0
    for kind, name in ((pin.JointModelPX(), "x"), (pin.JointModelPZ(), "z")):
        joint = model.addJoint(joint, kind, pin.SE3.Identity(), name)
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.05), pin.SE3.Identity())
    model.addFrame(pin.Frame("foot", joint, pin.SE3.Identity(), pin.OP_FRAME))
    stone = pinimpact.Sphere(center=(0, 0, -STONE), radius=STONE, name="stone")
    spring = pinimpact.JointPD([stiffness, 0.0], 0.0, [0.0, 0.0]) if stiffness > 0 else None
    return pinimpact.Scene(model, [pinimpact.Contact("foot", stone, restitution=1.0)], control=spring)


def trace(stiffness):
    """Return the trace of the derivative of a period from apex to apex, for motions along x."""
    motion = pinimpact.simulate(
        bouncer(stiffness), [0.0, HEIGHT], [0.0, 0.0], PERIOD, rtol=1e-11, sensitivities=("state",)
    )
    return np.trace(motion.sensitivity(PERIOD).state[np.ix_([0, 2], [0, 2])])


def closed_form(stiffness):
    """Return the trace in closed form, 2 cos ωT + 2v/R sin ωT/ω."""
    w = np.sqrt(stiffness)
    return 2 * np.cos(w * PERIOD) + 2 * SPEED / STONE * PERIOD * np.sinc(w * PERIOD / np.pi)


def multiplier(trace):
    """Return the larger absolute value of two multipliers whose product is 1."""
    half = abs(trace) / 2
    return half + np.sqrt(half**2 - 1) if half > 1 else 1.0


def main():
    """Print the range of stable stiffnesses, and plot the multipliers."""
    grid = np.linspace(0.0, 300.0, 61)
    found, exact = (np.array([of(k) for k in grid]) for of in (trace, closed_form))
    print(f"largest difference of the traces from the closed form: {np.abs(found - exact).max():.0e}")
    stable = grid[np.abs(found) < 2.0]
    print(f"stable at {len(stable)} of {len(grid)} stiffnesses, from {stable.min():.0f} N/m on")
    _, ax = plt.subplots(figsize=(7, 4), layout="constrained")
    ax.plot(grid, list(map(multiplier, found)), "o", ms=3, label="trajectory.sensitivity")
    ax.plot(grid, list(map(multiplier, exact)), lw=0.8, label="closed form")
    ax.set(xlabel="stiffness of the spring [N/m]", ylabel="largest multiplier of a bounce")
    ax.legend()
    ax.figure.savefig("bouncing_stability.png", dpi=120)
    print("bouncing_stability.png")


if __name__ == "__main__":
    main()
