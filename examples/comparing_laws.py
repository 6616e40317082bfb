"""Compare the three restitution laws: energy and rebound as functions of e, with slip that turns.

python examples/comparing_laws.py

The hand of a Panda strikes a table, and Kane's double pendulum a rough floor. The laws agree if slip keeps
its direction; if it reverses, Newton's law can create energy. The plot is comparing_laws.png.
"""

import matplotlib.pyplot as plt
import numpy as np

import pinimpact

PANDA_V = (0.4, 2.1, 0.4, -0.6, 0.25, 1.2, 0, 0, 0)
ANGLES = np.radians([20.0, 30.0])
CASES = {
    "Panda, μ = 0.3": ("panda", "panda_hand_tcp", None, PANDA_V, 0.3),
    "Kane's pendulum, μ = 0.7": (
        "kane_double_pendulum", "tip", (ANGLES[0], ANGLES[1] - ANGLES[0]), (-0.1, -0.1), 0.7,
    ),
}  # fmt: skip
E_GRID = np.linspace(0.0, 1.0, 101)


def sweep(robot, frame, q, v, friction, law):
    """Return the ratio of energies after and before, and the normal velocity after, for each e."""
    model, data = robot.model, robot.data
    contact = pinimpact.Contact(frame, pinimpact.Plane(), friction, law=law)
    hits = pinimpact.impacts(model, data, q, v, contact, restitution=E_GRID)
    matrices = pinimpact.contact_matrices(model, data, q, contact)
    energy = np.einsum("ni,ij,nj->n", hits.v, matrices.mass, hits.v) / (v @ matrices.mass @ v)
    return energy, hits.v @ matrices.h


def main():
    """Print the energies at e = 0.5, and plot energies and velocities."""
    figure, rows = plt.subplots(2, 2, sharex=True, figsize=(9, 6.5), layout="constrained")
    for row, (title, (name, frame, q, v, friction)) in zip(rows, CASES.items(), strict=True):
        robot = pinimpact.load_robot(name)
        q, v = np.array(robot.q0 if q is None else q), np.array(v)
        for law in pinimpact.LAWS:
            energy, bounce = sweep(robot, frame, q, v, friction, law)
            row[0].plot(E_GRID, energy, label=law)
            row[1].plot(E_GRID, bounce, label=law)
            print(f"{title}: {law:10} keeps {100 * energy[50]:.1f} % of the energy at e = 0.5")
        row[0].axhline(1.0, color="black", lw=0.5)
        row[0].set(title=title, ylabel="energy after / before")
        row[1].set(ylabel="normal velocity after [m/s]")
        row[0].legend(fontsize="small")
    for axes in rows[1]:
        axes.set(xlabel="e")
    figure.savefig("comparing_laws.png", dpi=120)
    print("comparing_laws.png")


if __name__ == "__main__":
    main()
