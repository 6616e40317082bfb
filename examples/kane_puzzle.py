"""Kane's puzzle of dynamics: the same fall of a double pendulum under three restitution laws.

Friction reverses the slip during the impact. Newton's law, which relates only the normal velocities before
and after, creates energy; Poisson's and the energetic law do not.
"""

import numpy as np

import pinimpact


def main():
    """Print the energy after the impact for each law."""
    robot = pinimpact.load_robot("kane_double_pendulum")
    angles = np.deg2rad([20.0, 30.0])  # from the downward vertical
    q = np.array([angles[0], angles[1] - angles[0]])
    v = np.array([-0.1, -0.1])
    floor = pinimpact.Plane(point=(0.0, 0.0, -np.cos(angles).sum()))

    print("law        friction  energy after / before")
    for friction in (0.5, 0.7):
        for law in pinimpact.LAWS:
            contact = pinimpact.Contact("tip", floor, friction=friction, restitution=0.5, law=law)
            hit = pinimpact.impact(robot.model, robot.data, q, v, contact)
            mass = pinimpact.contact_matrices(robot.model, robot.data, q, contact).mass
            ratio = (hit.v @ mass @ hit.v) / (v @ mass @ v)
            note = "energy created" if pinimpact.Flag.ENERGY_CREATED in hit.solution.flags else ""
            print(f"{law:10} {friction:8} {ratio:10.4f}  {note}".rstrip())


if __name__ == "__main__":
    main()
