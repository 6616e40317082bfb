"""Identify a tossed box: its centre of mass and inertia, friction and restitution, with intervals.

python examples/identify_box.py

A loaded box is tossed 40 times and recorded at 150 Hz, here by simulation with noise. Its centre of mass and
inertia follow from the momentum balance of its impacts, friction and restitution from its impacts, the
friction of sliding from its slides. The plot is identify_box.png.
"""

import itertools
from dataclasses import replace

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

import pinimpact
from pinimpact import studies

MASS, CENTRE, INERTIA = 0.4, np.array([0.004, -0.003, 0.006]), np.diag([9e-4, 8e-4, 6e-4])
FRICTION, RESTITUTION, SLIDING, LAW = 0.2, 0.4, 0.25, "energetic"
NOISE = 5e-5, 5e-4  # of recorded positions [m] and rotations [rad]


def box(centre, inertia, friction=0.0, restitution=0.0, sliding=None):
    """Return a scene of a box above the floor."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "box")
    model.appendBodyToJoint(joint, pin.Inertia(MASS, centre, inertia), pin.SE3.Identity())
    model.addBodyFrame("box", joint, pin.SE3.Identity(), 0)
    corners = itertools.product((-0.04, 0.04), (-0.05, 0.05), (-0.06, 0.06))
    contact = pinimpact.Contact(
        "box", pinimpact.Plane(), friction, restitution, LAW, radius=0.002, sliding_friction=sliding
    )
    contacts = [replace(contact, offset=o, name=f"corner {i}") for i, o in enumerate(corners)]
    return pinimpact.Scene(model, contacts)


def record(scene, rng, group, duration=0.7):
    """Return the noisy recording of a simulated toss."""
    turn = Rotation.random(rng=rng)
    v0 = np.concatenate([turn.inv().apply([*rng.normal(size=2), -1.0]), 5.0 * rng.normal(size=3)])
    run = pinimpact.simulate(scene, np.array([0, 0, 0.25, *turn.as_quat()]), v0, duration, rtol=1e-7)
    t = np.arange(0.0, duration, 1 / 150)
    q = np.array([run.at(time)[0] for time in t.tolist()])
    q[:, :3] += NOISE[0] * rng.normal(size=(len(t), 3))
    q[:, 3:] = (
        Rotation.from_rotvec(NOISE[1] * rng.normal(size=(len(t), 3))) * Rotation.from_quat(q[:, 3:])
    ).as_quat()
    return studies.Motion(t, q, group=group)


def show(fit, truth):
    """Print parameters, intervals and true values."""
    for name, value, (low, high), true in zip(fit.names, fit.x, fit.interval(), truth, strict=True):
        print(f"  {name:18} {value:10.4g}  95 % from {low:10.4g} to {high:10.4g}, true {true:.4g}")
    print(*fit.unidentified, sep="\n", end="\n" if fit.unidentified else "")


def main(tosses=40):
    """Identify the box from all tosses but the last ten, and predict those."""
    rng = np.random.default_rng(0)
    true = box(CENTRE, INERTIA, FRICTION, RESTITUTION, SLIDING)
    motions = [record(true, rng, group=f"toss {k}") for k in range(tosses)]
    known, held_out = motions[:-10], motions[-10:]

    guess = box(np.zeros(3), np.diag([8e-4, 7e-4, 5e-4]))
    for _ in range(4):  # flights depend on the centre of mass; each iteration divides its error by four
        found = studies.impacts(guess, known)
        body = studies.identify_body(found, free=("com", "inertia"))
        guess = body.apply(guess)
    print(f"{len(found)} impacts; {len(found.dropped)} left out, as the first:\n  {found.dropped[0]}")
    show(body, [*CENTRE, *np.diag(INERTIA) / MASS, 0, 0, 0])

    pair = studies.identify(found, guess, law=LAW)
    show(pair, [FRICTION, RESTITUTION])
    slid = studies.identify_sliding(known, pair.apply(guess), free=("sliding_friction",))
    show(slid, [SLIDING])

    fitted = slid.apply(pair.apply(guess))
    test = studies.rollouts(fitted, held_out)
    other = studies.rollouts(pair.apply(box(np.zeros(3), INERTIA)), held_out)
    print(f"predicted: {test}\nwith the mass in the middle: {other}")
    low, high = 1e3 * studies.compare(test, other).interval[0]
    print(f"difference of position, 95 % from {low:.1f} to {high:.1f} mm")
    pair.plot().savefig("identify_box.png", dpi=120)
    print("identify_box.png")


if __name__ == "__main__":
    main()
