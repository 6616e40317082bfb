"""Passes of a spinning ball that bounce once and reach a target, found by gradients of PyTorch.

python examples/bounce_pass.py  (needs PyTorch: pip install 'pinimpact[torch]')

After the bounce the top of the path is to be at TARGET. Newton's method finds the start velocities for many
friction coefficients at once, by the gradient of `pinimpact.integrations.torch.impact`. They are compared
with a closed form, as a homogeneous ball either slips through the bounce or rolls at its end, and one pass
is simulated. The plot is bounce_pass.png.
"""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pinocchio as pin
import torch

import pinimpact
from pinimpact.integrations.torch import impact

MASS, RADIUS, RESTITUTION, GRAVITY = 0.2, 0.1, 0.8, 9.81
START, TARGET = np.array([0.0, 0.0, 1.2]), np.array([3.0, 0.0, 1.0])  # of the centre [m]
SPIN = np.array([40.0, 0.0, 0.0])  # about the direction of the target [rad/s]
FRICTION = np.linspace(0.02, 0.5, 25)


def ball():
    """Return the model of the ball and its contact with the floor."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "free")
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(MASS, RADIUS), pin.SE3.Identity())
    model.addFrame(pin.Frame("ball", joint, pin.SE3.Identity(), pin.OP_FRAME))
    return model, pinimpact.Contact("ball", pinimpact.Plane(), restitution=RESTITUTION, radius=RADIUS)


def play(v0, friction):
    """Return positions of the bounces (n, 3), tops of the paths after them (n, 3), and times of the tops."""
    model, contact = ball()
    speed = torch.sqrt(v0[:, 2:] ** 2 + 2 * GRAVITY * (START[2] - RADIUS))
    down, time = torch.cat([v0[:, :2], -speed], dim=1), (v0[:, 2:] + speed) / GRAVITY
    bounce = torch.tensor(START) + (v0 + down) / 2 * time
    q = torch.tensor([0, 0, RADIUS, 0, 0, 0, 1]).double()  # position and orientation do not matter
    v = torch.cat([down, torch.tensor(SPIN).expand_as(down)], dim=1)
    after = impact(model, model.createData(), q, v, contact, friction)[:, :3]
    rise = after[:, 2:] / GRAVITY
    return bounce, bounce + after * torch.tensor([1, 1, 0.5]) * rise, time + rise


def aim(friction):
    """Return start velocities (n, 3) for n friction coefficients."""
    v0 = torch.tensor([3.0, 0, -1]).double().repeat(len(friction), 1)
    for _ in range(10):
        v0.requires_grad_()
        miss = play(v0, torch.tensor(friction))[1] - torch.tensor(TARGET)
        rows = [torch.autograd.grad(miss[:, k].sum(), v0, retain_graph=True)[0] for k in range(3)]
        v0 = v0.detach() - torch.linalg.solve(torch.stack(rows, dim=1), miss.detach())
    return v0


def closed_form(friction):
    """Return start velocities in closed form; the ball slips through the bounce, or rolls at its end."""
    up = np.sqrt(2 * GRAVITY * (TARGET[2] - RADIUS))
    down = up / RESTITUTION
    start = -np.sqrt(down**2 - 2 * GRAVITY * (START[2] - RADIUS))
    time, rise = (start + down + up) / GRAVITY, up / GRAVITY
    surface = RADIUS * np.array([-SPIN[1], SPIN[0]])  # velocity of the lowest point due to the spin
    path = (TARGET - START)[:2] + surface * time  # of the contact point without friction
    far = np.linalg.norm(path)
    slip = np.minimum((far + friction * (down + up) * rise) / time, far / (time - 2 / 7 * rise))
    return np.column_stack([slip[:, None] * path / far - surface, np.full(len(friction), start)])


def main():
    """Print the errors of passes, and plot them."""
    found, exact = aim(FRICTION), closed_form(FRICTION)
    bounces, _, times = play(found, torch.tensor(FRICTION))
    print(f"largest difference from the closed form: {np.abs(found.numpy() - exact).max():.0e} m/s")
    model, contact = ball()
    scene = pinimpact.Scene(model, [replace(contact, friction=FRICTION[5])])
    q0, v0 = [*START, 0, 0, 0, 1], [*found[5], *SPIN]
    end = pinimpact.simulate(scene, q0, v0, times[5].item(), rtol=1e-11).q[-1]
    print(f"a simulated pass misses the target by {np.linalg.norm(end[:3] - TARGET):.0e} m")
    _, (left, right) = plt.subplots(1, 2, figsize=(11, 4), layout="constrained")
    for k in (0, 3, 6, 12):
        x, y = np.array([START, bounces[k], TARGET]).T[:2]
        left.plot(x, y, "o-", ms=3, label=f"μ = {FRICTION[k]:.2f}")
    left.set(xlabel="x [m]", ylabel="y [m]", title="paths from above")
    right.plot(FRICTION, found, "o", ms=3, label=["$v_x$", "$v_y$", "$v_z$"])
    right.plot(FRICTION, exact, lw=0.8, color="black")
    right.set(xlabel="friction coefficient μ", ylabel="start velocity [m/s]")
    right.set_title("by gradients (dots) and in closed form (lines)")
    for axes in (left, right):
        axes.legend(frameon=False)
    left.figure.savefig("bounce_pass.png", dpi=120)
    print("bounce_pass.png")


if __name__ == "__main__":
    main()
