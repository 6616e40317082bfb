"""Step-by-step simulation with forces that are constant during each step, for control loops and learning."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any
from weakref import WeakKeyDictionary, finalize

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array
from ..checks import finite_array
from ..errors import InputError, PinimpactError, SimulationError
from ._kernels.tolerances import ATOL, DT, RTOL
from .integrator import Integrator
from .options import Options, check_numbers
from .scene import Scene
from .sensitivities import Linearization, MotionSlopes, Sensitivities, check_supported
from .simulation import integrator_of, stop
from .trajectory import Trajectory

_SLOPES: WeakKeyDictionary[Integrator, MotionSlopes] = WeakKeyDictionary()


@contextmanager
def _restored(integrator: Integrator) -> Iterator[None]:
    """Restore the present state and record of a motion on exit."""
    record, value, reached = integrator.record, integrator.value(), integrator.reached
    mark, warned = record.mark(), (record.bound_reached, record.stepping_warned)
    try:
        yield
    finally:
        record.cut(mark)
        record.bound_reached, record.stepping_warned = warned
        integrator.set_value(value)
        integrator.reached = reached


class _Spares(list[Integrator]):
    """Integrators of copies that no longer exist, for new copies: a new integrator takes a millisecond."""

    def __reduce__(self) -> tuple[type[_Spares], tuple[()]]:
        return _Spares, ()


class Stepper:
    """Simulate a scene step by step, with generalized forces that are constant during each step.

    The motion is that of `simulate` with a control that is sampled at the starts of the steps. Steps can have
    different lengths. Impacts, changes of contact modes and user events are located at their exact times
    within a step, as far as the scheme locates them. A terminal event ends a step early, at the time `t`; the
    next step continues from there.

    Args:
        scene: The scene, without a control.
        q0: (nq,) initial configuration, with no contact below its surface.
        v0: (nv,) initial velocity.
        rtol: As in `simulate`.
        atol: As in `simulate`.
        max_step: As in `simulate`.
        max_impacts: Largest number of instants with impacts in one step.
        scheme: As in `simulate`.
        dt: Length of the time steps of the scheme [s], as in `simulate`; not that of `step`.

    Raises:
        UnknownNameError: Unknown scheme.
        InputError: As in `simulate`, or a scene with a control.
        ModelError: A joint that cannot be integrated.
    """

    def __init__(
        self,
        scene: Scene,
        q0: ArrayLike,
        v0: ArrayLike,
        *,
        rtol: float = RTOL,
        atol: float = ATOL,
        max_step: float | None = None,
        max_impacts: int = 100_000,
        scheme: str = "auto",
        dt: float = DT,
    ) -> None:
        if isinstance(scene, Scene) and scene.control is not None:
            raise InputError(
                "scene: it has a control, but a Stepper applies the forces of step(tau, dt); remove control=",
                value=scene,
            )
        self._scene = scene
        self._scheme, self._options = scheme, Options(rtol, atol, max_step, max_impacts, dt)
        self._spares = _Spares()
        self.reset(q0, v0)

    def reset(self, q0: ArrayLike, v0: ArrayLike) -> None:
        """Restart at t = 0 in another state; the trajectory up to now is discarded.

        Raises:
            InputError: As in `simulate`; the stepper is then unchanged.
        """
        self._integrator = integrator_of(self._scheme, self._scene, q0, v0, self._options)
        self._begun = self._failed = False

    def copy(self) -> Stepper:
        """Return an independent stepper in the same state."""
        twin, spare = object.__new__(Stepper), None
        with suppress(IndexError):
            spare = self._spares.pop()
        integrator = self._integrator.copy(spare)
        vars(twin).update(vars(self) | {"_integrator": integrator})
        finalize(twin, self._spares.append, integrator).atexit = False
        return twin

    __copy__ = copy

    def __deepcopy__(self, memo: dict[int, Any]) -> Stepper:
        """Return `copy()`: a scene does not change, so that both steppers may share it."""
        return self.copy()

    def step(self, tau: ArrayLike, dt: float) -> tuple[Array, Array]:
        """Advance by a time under constant forces, and return q (nq,) and v (nv,) at its end.

        Args:
            tau: (nv,) generalized forces [N, N m].
            dt: The time [s], above zero.

        Raises:
            InputError: Forces of the wrong shape or not finite, a time that is not above zero or too small to
                change `t`; the state is then unchanged.
            SimulationError: The motion cannot continue; ``partial`` is the trajectory up to then.
        """
        integrator = self._integrator
        tau = finite_array("tau", tau, (integrator.model.nv,))
        check_numbers(dt=dt)
        until = integrator.state.t + float(dt)
        if not until > integrator.state.t:
            raise InputError(
                f"dt: {dt!r} given, which is too small to change t = {integrator.state.t:.6g} s", value=dt
            )
        if self._failed:
            raise SimulationError(
                f"scene: the motion has stopped at t = {integrator.state.t:.6g} s; reset(q, v) restarts"
            )
        self._failed = True
        try:
            if not self._begun:
                integrator.begin(tau)
                self._begun = True
                integrator.advance(until)
            else:
                integrator.resume()
                integrator.advance(until, tau=tau)
        except PinimpactError as error:
            stop(integrator, error)
        self._failed = False
        return self.q, self.v

    def linearize(self, tau: ArrayLike, dt: float) -> Linearization:
        """Return A = ∂x⁺/∂x and B = ∂x⁺/∂τ of `step`, through all modes and events; the state stays as it is.

        x = (q, v), with changes of q in the tangent space. (derivatives.md, 9) Time steps depend on
        impulses of the step before too, which count as given: products of A over several calls are right to
        order h² of their length only, sensitivities of `simulate` to rounding. (derivatives.md, 12)

        Raises:
            InputError: As in `step`; a terminal event in the step; what has no known derivative, see
                derivatives.md, 9 and 12.
            SimulationError: As in `step`.
        """
        slopes, integrator, before = self._slopes(), self._integrator, (self._begun, self._failed)
        record = integrator.record
        steps, impacts, events = len(record.dense_steps), len(record.impacts), len(record.events)
        try:
            with _restored(integrator):
                record.keeps_steps = True
                self.step(tau, dt)
                if integrator.state.ended_by is not None:
                    name = integrator.state.ended_by
                    raise InputError(
                        f"dt: the event {name!r} ends the step at t = {self.t:.6g} s; steps that end earlier "
                        "than asked have no derivatives",
                        value=dt,
                    )
                slopes.saltation.slopes.tau[:] = tau
                taken = record.dense_steps[steps:], record.impacts[impacts:], record.events[events:]
                found = Sensitivities(slopes, ("state",), *taken)
                x, boundary = found.changes(len(taken[0]) - 1, integrator.state.t)
        finally:
            self._begun, self._failed = before
            record.keeps_steps = False
        n = len(x)
        return Linearization(x[:, :n], x[:, n:], boundary)

    def _slopes(self) -> MotionSlopes:
        """Return the derivatives of the motion's equations; they are created once per integrator."""
        integrator = self._integrator
        found = _SLOPES.get(integrator)
        if found is None:
            check_supported(integrator.scene)
            given = integrator.scene, integrator.dynamics, integrator.model, (), np.zeros(integrator.model.nv)
            found = _SLOPES[integrator] = MotionSlopes(*given, self._options.rtol)
        return found

    def __repr__(self) -> str:
        return f"Stepper({self._scene!r} at t = {self.t:.6g} s)"

    @property
    def t(self) -> float:
        """The time [s]."""
        return self._integrator.state.t

    @property
    def q(self) -> Array:
        """(nq,) the configuration."""
        return self._integrator.state.q.copy()

    @property
    def v(self) -> Array:
        """(nv,) the velocity."""
        return self._integrator.state.v.copy()

    @property
    def trajectory(self) -> Trajectory:
        """The motion from the start until now; it grows by some kilobytes per step until `reset`."""
        return self._integrator.trajectory(f"Stepped until t = {self.t:.6g} s.", True)
