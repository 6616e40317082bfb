"""An environment in the style of Gymnasium around a `Stepper`, with a random policy.

python examples/gym_style_loop.py

It does not need Gymnasium: `reset` and `step` return the same values as there, so a subclass of
``gymnasium.Env`` only adds its spaces. Impacts, slip and lift-off are located at their exact times within
the steps.
"""

import numpy as np
import pinocchio as pin

import pinimpact

FEET = ("FL_FOOT", "FR_FOOT", "HL_FOOT", "HR_FOOT")


class Hop:
    """A quadruped rewarded for jumping; half of the action, in [-1, 1], is added to its posture [rad]."""

    period, horizon = 0.02, 50  # period of the policy [s], number of periods

    def __init__(self):
        robot = pinimpact.load_robot("solo12")
        self.model = robot.model
        floor = pinimpact.Plane()
        contacts = [pinimpact.Contact(foot, floor, friction=0.8, name=foot) for foot in FEET]
        self.posture = pin.neutral(self.model)
        self.posture[7:] = np.tile([0.0, 0.7, -1.4], 4)
        gaps = [contact.gap(self.model, robot.data, self.posture) for contact in contacts]
        self.posture[2] += 1e-3 - min(gaps)
        self.scene = pinimpact.Scene(robot, contacts)
        self.stepper = pinimpact.Stepper(
            self.scene, self.posture, np.zeros(self.model.nv), rtol=1e-5, atol=1e-7
        )

    def reset(self, seed=None):
        """Restart with random joint positions; return observation and info."""
        random = np.random.default_rng(seed)
        v = np.zeros(self.model.nv)
        v[6:] = 0.1 * random.standard_normal(self.model.nv - 6)
        self.stepper.reset(self.posture, v)
        self.steps = 0
        return self._observation(), {}

    def step(self, action):
        """Hold a posture for a period; return observation, reward, terminated, truncated and info."""
        target = self.posture[7:] + 0.5 * np.clip(action, -1.0, 1.0)
        impacts = len(self.stepper.trajectory.impacts)
        tau = np.zeros(self.model.nv)
        for _ in range(20):
            q, v = self.stepper.q, self.stepper.v
            tau[6:] = np.clip(8.0 * (target - q[7:]) - 0.2 * v[6:], -2.5, 2.5)
            self.stepper.step(tau, self.period / 20)
        self.steps += 1
        trajectory, q = self.stepper.trajectory, self.stepper.q
        feet = [trajectory.mode_at(foot, self.stepper.t) for foot in FEET]
        upright = pin.Quaternion(q[3:7]).matrix()[2, 2]
        info = {"feet": feet, "impacts": len(trajectory.impacts) - impacts}
        terminated = bool(q[2] < 0.1 or upright < 0.5)
        return self._observation(), float(q[2]), terminated, self.steps >= self.horizon, info

    def _observation(self):
        return np.concatenate([self.stepper.q, self.stepper.v])


def main():
    """Run a random policy for one episode."""
    environment, random = Hop(), np.random.default_rng(0)
    environment.reset(seed=0)
    total, impacts, terminated, truncated = 0.0, 0, False, False
    while not (terminated or truncated):
        _, reward, terminated, truncated, info = environment.step(random.uniform(-1, 1, 12))
        total, impacts = total + reward, impacts + info["impacts"]
    modes = ", ".join(f"{foot} {mode}" for foot, mode in zip(FEET, info["feet"], strict=True))
    print(f"{environment.steps} steps, return {total:.2f}, {impacts} impacts; in the end {modes}")


if __name__ == "__main__":
    main()
