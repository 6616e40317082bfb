"""The simulation of a scene from a state, for a time: events, time steps, or both in turn."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NoReturn

from numpy.typing import ArrayLike

from ..checks import choice, function, in_short
from ..errors import InputError, PinimpactError, SimulationError
from ._kernels.tolerances import ATOL, DT, RTOL
from .alternating import Alternating
from .control_slopes import HeldForces, jacobian_of
from .integrator import Integrator, Report
from .options import Options, check_numbers
from .scene import Scene
from .sensitivities import MotionSlopes, Sensitivities, parse
from .time_stepping import TimeStepping
from .trajectory import Trajectory

SCHEMES = "event-driven", "time-stepping", "auto"

INTERRUPTED = "Interrupted from the keyboard."
"""How a run ends by Ctrl-C."""


def simulate(
    scene: Scene,
    q0: ArrayLike,
    v0: ArrayLike,
    duration: float,
    *,
    rtol: float = RTOL,
    atol: float = ATOL,
    max_step: float | None = None,
    max_impacts: int = 100_000,
    progress: Report | None = None,
    scheme: str = "auto",
    dt: float = DT,
    sensitivities: Sequence[str] = (),
) -> Trajectory:
    """Simulate a scene. (scenes.md)

    Between events the motion is integrated on the configuration manifold to the tolerances; events are
    located to rounding, and none is missed between steps. Impacts are solved exactly. Intervals in which this
    is impossible are crossed by time steps. Ctrl-C ends the run early; the trajectory up to then is returned.

    Args:
        scene: The robot, its contacts and its control.
        q0: (nq,) initial configuration, with no contact below its surface, but for what time steps leave: a
            state of a trajectory is a valid start, except for "event-driven". (theory.md, 16)
        v0: (nv,) initial velocity.
        duration: Time to simulate [s].
        rtol: Relative tolerance of each step, from 3e-14, which rounding allows, to 0.1.
        atol: Absolute tolerance of each step, on coordinates [m, rad] and velocities.
        max_step: Longest step [s]. None: with a continuous control a quarter of `Scene.time_scale`, so that a
            force that starts after a long rest is detected; else no bound.
        max_impacts: Largest number of instants with impacts.
        progress: Called with the current time and the duration after every step.
        scheme: "event-driven": events are located one by one; a motion for which this is impossible raises
            an error. "time-stepping": steps of fixed length that resolve sustained contact, friction and
            limits at once, for scenes of many or aligned contacts with many events. It is of first order in
            `dt`; tolerances do not apply. (theory.md, 16) "auto": event-driven, with time steps in intervals
            whose events cannot be located one by one; `Trajectory.stepped` lists them, with estimates of
            their error, and a `SteppedWarning` reports the first one.
        dt: Length of the time steps [s]; with "auto" the longest one. Not for "event-driven".
        sensitivities: What `Trajectory.sensitivity` differentiates by: "state" for the initial state, and
            "friction:CONTACT", "restitution:CONTACT" with names of contacts. A control that is a function
            needs an attribute ``jacobian``, a function of t, q and v that returns the derivative (nv, 2 nv)
            of the forces by q, in the tangent space, and v; in time steps it needs a `period` too. Not for
            callbacks of events without `jacobian`.

    Raises:
        UnknownNameError: Unknown scheme, or a contact in `sensitivities`.
        InputError: A start below a surface or beyond a joint limit, a held contact that moves or is further
            from its surface than a thousandth of the robot's size, numbers of the wrong shape or range.
        ModelError: A joint that cannot be integrated.
        SimulationError: The run cannot continue; ``partial`` is the trajectory up to then. Reasons: a
            control, guard or callback that fails or returns invalid values, more than `max_impacts`
            instants with impacts, an impact without a solution.
    """
    check_numbers(duration=duration)
    if progress is not None:
        function("progress", progress, "a function of the time and the duration")
    names = parse(scene, sensitivities) if sensitivities else ()
    options = Options(rtol, atol, max_step, max_impacts, dt)
    integrator = integrator_of(scheme, scene, q0, v0, options)
    integrator.record.keeps_steps = bool(names)
    trajectory = _run(integrator, float(duration), progress)
    if names:
        scene = integrator.scene
        own = Integrator(scene, q0, v0, options)
        parameters = [name for name in names if name != "state"]
        slopes = MotionSlopes(scene, own.dynamics, own.model, parameters, None, rtol)
        jacobian, sampled = jacobian_of(scene), integrator.sampled
        held = None if jacobian is None or sampled is None else HeldForces(sampled, jacobian)
        trajectory.sensitivities = Sensitivities(
            *(slopes, names, trajectory._segments, trajectory.impacts, trajectory.events, held)
        )
    return trajectory


def integrator_of(scheme: str, scene: Scene, q0: ArrayLike, v0: ArrayLike, options: Options) -> Integrator:
    """Return the integrator of a scheme; arguments and errors as of `simulate`."""
    choice("scheme", scheme, SCHEMES, "a scheme")
    if isinstance(scene, Scene) and "sustained contact" in scene.without:
        if scheme == "time-stepping":
            raise InputError(
                'scheme: "time-stepping" given for a scene without "sustained contact", which time steps '
                'compute; use "event-driven"',
                value=scheme,
            )
        scheme = "event-driven"
    if scheme == "event-driven":
        if options.dt != DT:
            raise InputError(
                f'dt: {in_short(options.dt)} given, but scheme="event-driven" has no time steps; '
                'use "time-stepping" or "auto", or leave dt out (max_step= bounds the steps)',
                value=options.dt,
            )
        integrator = Integrator(scene, q0, v0, options)
        if integrator.state.overlap is not None:
            raise InputError(
                f"{integrator.state.overlap}; start with every contact on or above its surface and every "
                'joint within its limits, or use scheme="auto", which removes small penetrations',
                field="q0",
                value=q0,
            )
        return integrator
    if scheme == "auto":
        return Alternating(scene, q0, v0, options)
    options.checked()  # also those that time steps do not use
    return TimeStepping(scene, q0, v0, Options(max_impacts=options.max_impacts, dt=options.dt))


def _run(integrator: Integrator, duration: float, report: Report | None) -> Trajectory:
    """Run to the end; return the trajectory, or raise with what there is of it."""
    try:
        integrator.begin()
        integrator.advance(duration, report)
    except KeyboardInterrupt:
        return integrator.trajectory(INTERRUPTED, False)
    except PinimpactError as error:
        stop(integrator, error)
    ended_by = integrator.state.ended_by
    if ended_by is not None:
        return integrator.trajectory(f"The event {ended_by!r} ended the run.", False)
    return integrator.trajectory("The duration is covered.", True)


def stop(integrator: Integrator, error: PinimpactError) -> NoReturn:
    """Raise what stops the motion, with what there is of it until then."""
    reached = integrator.trajectory(f"Stopped: {error}", False)
    if isinstance(error, SimulationError):
        error.partial = reached
        raise error
    raise SimulationError(
        f"{error.field}: the simulation stops at t = {reached.t[-1]:.6g} s: {type(error).__name__}: {error}",
        partial=reached,
        value=error.value,
    ) from error
