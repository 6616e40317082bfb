"""Frequencies of the faces of a fair die, and of one whose centre of mass is not at its centre.

python examples/die.py

Each toss starts from a random orientation, with random velocities. The faces of the fair die have equal
frequencies within confidence intervals of 99 %. The plot is die.png.
"""

import itertools

import matplotlib.pyplot as plt
import numpy as np
import pinocchio as pin
from scipy import stats
from scipy.spatial.transform import Rotation

import pinimpact

HALF, MASS = 0.008, 0.005
FACES = {
    "+x": (1, 0, 0),
    "-x": (-1, 0, 0),
    "+y": (0, 1, 0),
    "-y": (0, -1, 0),
    "+z": (0, 0, 1),
    "-z": (0, 0, -1),
}
START = np.array([0, 0, 0.04, 0, 0, 0, 1])


class Turned:
    """Distribution of changes of the initial configuration: uniform rotations without displacement."""

    def rvs(self, random_state):
        turn = Rotation.random(rng=random_state)
        return np.concatenate([np.zeros(3), turn.as_rotvec()])


SPEED = stats.multivariate_normal(np.zeros(6), np.diag([0.1**2] * 3 + [20.0**2] * 3))


def die(centre=(0.0, 0.0, 0.0)):
    """Return a scene of a die above a table, with its corners rounded."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "die")
    cube = pin.Inertia.FromBox(MASS, 2 * HALF, 2 * HALF, 2 * HALF)
    model.appendBodyToJoint(joint, pin.Inertia(MASS, np.array(centre), cube.inertia), pin.SE3.Identity())
    model.addBodyFrame("die", joint, pin.SE3.Identity(), 0)
    corner = {"friction": 0.3, "restitution": 0.3, "radius": 0.001}
    contacts = [
        pinimpact.Contact("die", pinimpact.Plane(), offset=0.007 * np.array(o), name=f"corner {k}", **corner)
        for k, o in enumerate(itertools.product((-1.0, 1.0), repeat=3))
    ]
    return pinimpact.Scene(model, contacts)


def top(trajectory):
    """Return the row of a toss: the face on top at the end."""
    up = Rotation.from_quat(trajectory.q[-1, 3:]).inv().apply([0.0, 0.0, 1.0])
    return {"top": max(FACES, key=lambda face: up @ FACES[face]), "height": float(trajectory.q[-1, 2])}


def toss(scene, samples, seed=0, executor=None):
    """Return the ensemble of tosses."""
    over = {"q0": Turned(), "v0": SPEED}
    return pinimpact.ensemble(
        scene, START, np.zeros(6), 0.6, over=over, samples=samples, seed=seed, reduce=top, executor=executor
    )


def main(samples=600):
    """Print and plot the frequencies of the faces on top."""
    _, axes = plt.subplots(figsize=(7, 4), layout="constrained")
    for shift, (label, z) in enumerate({"fair": 0.0, "heavy at -z": -0.25 * HALF}.items()):
        found = toss(die((0.0, 0.0, z)), samples, seed=1)
        shares = found.frequencies("top", 0.99)
        print(f"{label}: {found.frequencies()['OK'].value:.0%} of the tosses ended")
        for k, face in enumerate(FACES):
            value, low, high = shares.get(face, (0.0, 0.0, 0.0))
            print(f"  {face} on top: {value:.3f}, 99 % from {low:.3f} to {high:.3f}")
            place, error = k + 0.4 * shift - 0.2, [[value - low], [high - value]]
            axes.bar(place, value, 0.38, yerr=error, color=f"C{shift}", label=label if k == 0 else None)
    axes.axhline(1 / 6, color="black", lw=0.8, ls="--", label="1/6")
    axes.set_xticks(range(len(FACES)), FACES)
    axes.set(xlabel="face on top", ylabel="frequency")
    axes.legend()
    axes.figure.savefig("die.png", dpi=120)
    print("die.png")


if __name__ == "__main__":
    main()
