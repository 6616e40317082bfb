"""Ropes of spherical joints, whose articulated inertias lose their digits."""

from __future__ import annotations

import warnings

import numpy as np
import pinocchio as pin
import pytest

from pinimpact import Scene, simulate
from pinimpact.robot.articulated_bodies import is_accurate
from pinimpact.robot.forest import inverse_mass
from pinimpact.robot.pinocchio_bridge import robot_dynamics
from pinimpact.scene.dense_step import WORKS, DenseStep
from pinimpact.scene.integrator import Integrator
from pinimpact.scene.mode_slopes import SlopesOfModes
from pinimpact.scene.options import Options

from .drawing import one_of_each
from .scene_models import unbounded


def rope(links, joint=pin.JointModelSpherical, length=0.05, radius=0.01):
    """Return a free rope of capsules along x, with a frame at the end of each."""
    model, parent, end = pin.Model(), 0, pin.SE3(np.eye(3), np.array([length, 0.0, 0.0]))
    along = pin.SE3(pin.utils.rotate("y", 0.5 * np.pi), np.array([0.5 * length, 0.0, 0.0]))
    for k in range(links):
        kind = joint() if k else pin.JointModelFreeFlyer()
        parent = model.addJoint(parent, kind, end if k else pin.SE3.Identity(), f"link {k}")
        model.appendBodyToJoint(
            parent, along.act(pin.Inertia.FromCapsule(0.02, radius, length)), pin.SE3.Identity()
        )
        model.addFrame(pin.Frame(f"end {k}", parent, end, pin.FrameType.OP_FRAME))
    unbounded(model)
    return model


def moving(model, seed):
    rng = np.random.default_rng(seed)
    q = pin.integrate(model, pin.neutral(model), 0.3 * rng.normal(size=model.nv))
    return q, *rng.normal(size=(2, model.nv))


@pytest.mark.parametrize(
    ("links", "joint"),
    one_of_each([2, 5, 10, 40], [pin.JointModelSpherical, pin.JointModelSphericalZYX, pin.JointModelPlanar]),
)
def test_accelerations_are_those_that_the_forces_were_made_from(links, joint):
    model = rope(links, joint)
    for seed in range(3):
        q, v, acceleration = moving(model, seed)
        tau = pin.rnea(model, model.createData(), q, v, acceleration)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            dynamics = robot_dynamics(model)
        dynamics.q[:], dynamics.v[:], dynamics.tau[:] = q, v, tau
        for one in (dynamics.forward_dynamics, dynamics.inverse_mass):
            one.function(*one.arguments)
        upper = np.triu(pin.crba(model, model.createData(), q))
        mass = upper + np.triu(upper, 1).T
        rounding = 1e-13 * np.linalg.cond(mass)
        assert dynamics.acceleration == pytest.approx(acceleration, abs=rounding)
        assert np.abs(dynamics.minverse @ mass - np.eye(model.nv)).max() < rounding
        assert np.abs(inverse_mass(model, model.createData(), q) @ mass - np.eye(model.nv)).max() < rounding


@pytest.mark.parametrize("scheme", ["event-driven", "time-stepping"])
def test_free_rope_keeps_its_energy_and_momentum(scheme):
    """By the accelerations of `aba`, ten links took thousands of steps, and fifteen did not end."""
    model = rope(15)
    q, v, _ = moving(model, 0)
    run = simulate(Scene(model), q, v, 0.1, scheme=scheme)
    size = 1e-8 if scheme == "event-driven" else 1e-5
    assert np.abs(run.energy.residual).max() < size * run.energy.total[0]
    assert run.statistics["steps"] <= 100
    data, momenta = model.createData(), []
    for k in (0, -1):
        pin.computeCentroidalMomentum(model, data, run.q[k], run.v[k])
        momenta.append(data.hg.linear - [0.0, 0.0, 0.3 * model.gravity.linear[2] * run.t[k]])
    assert momenta[1] == pytest.approx(momenta[0], abs=10.0 * size)


def test_derivatives_of_accelerations():
    model = rope(20)
    assert not is_accurate(model)
    q, v, tau = moving(model, 1)
    tau = 1e-3 * tau
    motion = Integrator(Scene(model), q, v, Options())
    still = np.zeros(WORKS), np.zeros((7, 2 * model.nv + WORKS)), motion.work.joint_charts
    slopes = SlopesOfModes(motion.dynamics, motion.model, (), tau)
    by_state = slopes.within(DenseStep(0.0, 1.0, q, v, *still), np.zeros(1)).by_state[0]

    def acceleration(q, v):
        upper, data = np.triu(pin.crba(model, model.createData(), q)), model.createData()
        return np.linalg.solve(upper + np.triu(upper, 1).T, tau - pin.rnea(model, data, q, v, 0.0 * v))

    along = np.random.default_rng(2).normal(size=model.nv)
    e = 1e-5
    by_q = acceleration(pin.integrate(model, q, e * along), v)
    by_q = (by_q - acceleration(pin.integrate(model, q, -e * along), v)) / (2.0 * e)
    by_v = (acceleration(q, v + e * along) - acceleration(q, v - e * along)) / (2.0 * e)
    assert by_state[:, : model.nv] @ along == pytest.approx(by_q, abs=1e-5 * np.abs(by_q).max())
    assert by_state[:, model.nv :] @ along == pytest.approx(by_v, abs=1e-5 * np.abs(by_v).max())
