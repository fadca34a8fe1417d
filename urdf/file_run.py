"""Simulate a URDF or a Pinocchio model in the kind of program loop that users of Pinocchio write.

Each step of the loop computes accelerations by `pinocchio.constraintDynamics`, or by `pinocchio.aba` for a
model without loop closures, and integrates them with a fixed step. Models with mimics (joints that follow
others) use the mass matrix, like Pinocchio's examples/mimic_dynamics.py. Generalized forces are those of the
springs and dampers of the file. Joint limits, limits of velocity and effort, dry friction and contacts do not
act in such a loop.

A scene is the mechanism with forces that `urdf.reader` imports from the model. crosscheck compares a run of
the loop with an accurate reference solution of the scene, to measure the error of the loop's settings and the
causes of the error. The run has the initial state of the scene.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin

from newton_euler.equations.dense import least_squares
from newton_euler.model.scene import Scene
from newton_euler.reading.file_run import Cause, CauseName, FileRun, FileSimulation, evaluations_per_step
from newton_euler.runs.assemble import initial_state
from newton_euler.scalars import Array
from urdf.loop_needs import loop_needs
from urdf.loops import REVOLUTE
from urdf.pinocchio_reference import PinocchioReference
from urdf.run_record import ENGINE, Recorder
from urdf.run_settings import (
    EXAMPLE_CLOSED,
    EXPLICIT,
    EXPLICIT_DAMPING,
    IMPLICIT_DAMPING,
    INTEGRATORS,
    KEYS,
    RK4,
    SEMI_IMPLICIT,
    PinocchioSettings,
)

FINE_STEP_DIVISORS = (10, 40)
"""Divisors of the time step in runs that show the error of the step: methods of order 1 leave a tenth of the
error, or a fortieth."""

GAIN_FACTORS = (1.0, 0.1)
"""Factors of `closing_gains` for gains that are tried. The factor 1 closes loops fastest, in about a step."""

CLOSING_FACTORS = {RK4: 0.1}
"""Factor of `closing_gains`, by integrator, if not 1, for runs that show the error of the time step.

The stages of an RK4 step would be disturbed by loops that close within the step."""

CONVERGED: dict[str, Any] = {"accuracy": 1e-12, "mu": 1e-10, "iterations": 100}
"""Settings of `constraintDynamics` with enough proximal iterations to remove the effect of mu."""

MAX_VELOCITY = 1e10
"""Largest velocity, m/s or rad/s, of a run that has not diverged; MuJoCo has the same limit."""

MAX_LOOP_EVALUATIONS = 20_000
"""Largest number of evaluations of accelerations in a run with the user's time step or a smaller one.

They take 0.2 s in Python."""

Acceleration = Callable[[Array, Array], Array]
"""Function that returns the accelerations (nv,) at a configuration (nq,) and velocities (nv,)."""


def closing_gains(timestep: float, integrator: str, factor: float = 1.0) -> tuple[float, float]:
    """Return Baumgarte's gains kp, 1/s^2, and kd, 1/s, that close a loop at a rate of factor / timestep.

    A constraint error e obeys d2e/dt2 = -kd de/dt - kp e. With factor 1, two steps of an Euler integrator
    remove a small error completely: both eigenvalues of a step are zero. Explicit Euler and RK4 get critical
    damping, kd = 2 sqrt(kp). Semi-implicit Euler would be unstable with these gains for factor 1, because its
    new velocity moves the configuration in the same step. Its kd is smaller by kp times the step.

    Args:
        timestep: s.
        integrator: one of `INTEGRATORS`.
        factor: rate of closing, as a multiple of 1 / timestep.
    """
    rate = factor / timestep
    damping = 2.0 * rate - (rate * rate * timestep if integrator == SEMI_IMPLICIT else 0.0)
    return rate * rate, damping


def unsupported(reference: PinocchioReference, scene: Scene) -> str:
    """Return the reason why a loop with Pinocchio cannot simulate a model; "" if the loop can.

    Args:
        reference: Pinocchio's model.
        scene: imported scene.
    """
    if any(closure.kind == "rod" for closure in reference.closures):
        return "constraintDynamics has no rods"
    if reference.has_nonlinear_couplings:
        return "Pinocchio has no couplings with powers of coordinates"
    if len(reference.couplings) and reference.closures:
        return "constraintDynamics has no mimics and couplings"
    if scene.switched_forces:
        return "a loop with constraintDynamics or aba has no dry friction and no limits, and the scene has"
    return ""


class PinocchioFile(FileSimulation[PinocchioSettings]):
    """URDF or Pinocchio model in a user's simulation loop, at the start of an imported scene.

    Attributes:
        scene: imported scene.
        settings: settings of the user's loop.
        needs: what a user's loop with Pinocchio's own reader lacks.
        settings_place: the file of the option `own_run`, as a URDF has no settings.
        has_all_elements: False, as the loop has no limits and no dry friction.
    """

    has_all_elements = False
    settings_place = "the file of --set own_run=FILE"

    max_evaluations = MAX_LOOP_EVALUATIONS
    engine = ENGINE

    def __init__(
        self,
        reference: PinocchioReference,
        scene: Scene,
        settings: PinocchioSettings,
        are_assumed: bool,
        gains: Sequence[tuple[float, float]] = (),
    ) -> None:
        """Take a reference model, which is not changed.

        Args:
            reference: Pinocchio's model with which the import of the scene is verified; `unsupported` is "".
            scene: imported scene.
            settings: settings of the loop.
            are_assumed: True if the user has given no settings, so that they are those of Pinocchio's
                examples.
            gains: Baumgarte's gains kp, 1/s^2, and kd, 1/s, of each closure of a model in memory.
        """
        self.scene, self.settings = scene, settings
        self._reference, self.are_assumed, self._gains = reference, are_assumed, gains
        self.needs = tuple(loop_needs(reference))
        self._start = np.array(reference.start)
        self._has_dampers = bool(np.any(reference.damping))
        # basis (nv, k) of the velocities that mimics and couplings allow
        self._free: Array | None = None
        if len(reference.couplings):
            rank = np.linalg.matrix_rank(reference.couplings)
            self._free = np.linalg.svd(reference.couplings)[2][rank:].T
        # joint velocities from the initial velocities of the scene's bodies
        state = initial_state(scene)
        bodies = [scene.mechanism.body_names.index(name) for name in reference.names]
        body_velocities = np.hstack([state.linear_velocity[bodies], state.angular_velocity[bodies]]).ravel()
        jacobian = reference.kinematics(self._start, np.zeros(reference.model.nv)).transformation
        jacobian = jacobian.reshape(-1, reference.model.nv)
        if self._free is None:
            self._velocity = least_squares(jacobian, body_velocities)
        else:
            self._velocity = self._free @ least_squares(jacobian @ self._free, body_velocities)

    def run_inputs(self, reduced: bool) -> dict[str, Any]:
        """Return the start of a run, as numbers for JSON, so that a user's loop can repeat the run.

        Args:
            reduced: has no effect, as the loop has no elements that the imported scene lacks.

        Returns:
            Initial "q" and "v" in Pinocchio's order; quaternions are (x, y, z, w) there.
        """
        return {"q": self._start.tolist(), "v": self._velocity.tolist()}

    def words(self) -> str:
        """Describe the settings of the loop in a few words, such as "RK4, 2 ms, kp 10, kd 6.32, mu 1e-10"."""
        settings = self.settings
        words = [settings.integrator, f"{1e3 * settings.timestep:g} ms"]
        if self._reference.closures:
            kp, kd = zip(*self._gains_of(settings), strict=True)
            words += [f"kp {_rounded(kp)}", f"kd {_rounded(kd)}"]
            words.append(f"mu {settings.mu:g}")
        if settings.damping != EXPLICIT_DAMPING:
            words.append(f"{settings.damping} damping")
        if self.are_assumed:
            words.append("assumed from Pinocchio's examples; give yours by --set own_run=FILE")
        return ", ".join(words)

    def changes(self, settings: PinocchioSettings) -> dict[str, str]:
        """Map the settings that differ from the user's settings to their values as text, by name."""
        of_user = vars(self.settings)
        return {name: _text(value) for name, value in vars(settings).items() if value != of_user[name]}

    def fragment(self, settings: PinocchioSettings) -> str:
        """Return the lines of a YAML file `own_run` (see `urdf.run_settings`) with these settings."""
        given = {name: value for name, value in vars(settings).items() if value is not None}
        if not self._reference.closures:  # the other settings have no effect
            given = {name: given[name] for name in ("timestep", "integrator", "damping")}
        if settings.damping == EXPLICIT_DAMPING:
            del given["damping"]
        return "\n".join(f"{name}: {_text(given[name])}" for name in KEYS if name in given)

    def causes(self) -> Iterator[Cause[PinocchioSettings]]:
        """Yield the properties of the user's settings that can cause an error.

        The contribution of a cause is the difference of two runs: with the settings `against`, and with the
        settings `without` the cause. By default, `against` are the user's settings. Causes that could hide a
        later cause are also removed from the settings `against` of the later one. For example, a small step
        hides bad gains, because a drift of the loops is an error of the integration. The step and the
        integrator are therefore examined with gains that keep loops closed.
        """
        # settings without the causes that were yielded before
        base = self.settings
        if self._has_dampers and base.integrator != RK4:
            base = replace(base, damping=IMPLICIT_DAMPING)
            yield Cause(CauseName.EXPLICIT_DAMPING, without=base, is_choice=True)
        if self._reference.closures:
            converged = replace(base, **CONVERGED)
            yield Cause(CauseName.PROXIMAL_ITERATIONS, without=converged, against=base)
            for factor in GAIN_FACTORS:
                closing = _closing(converged, factor)
                yield Cause(CauseName.BAUMGARTE, without=closing, against=converged, is_choice=True)
            base = _closing(converged, CLOSING_FACTORS.get(converged.integrator, 1.0))
        first_divisor, *_ = FINE_STEP_DIVISORS
        for divisor in FINE_STEP_DIVISORS:
            fine = self._scaled(base, base.timestep / divisor)
            is_cheap = self.evaluations(fine) * self.scene.duration <= MAX_LOOP_EVALUATIONS
            if is_cheap or divisor == first_divisor:
                yield Cause(CauseName.TIME_STEP, without=fine, against=base)
        for name in INTEGRATORS:
            if name != base.integrator:
                # a time step with equal cost per second of motion, and implicit damping if possible
                cost = evaluations_per_step(name) / evaluations_per_step(base.integrator)
                other = replace(base, integrator=name, timestep=base.timestep * cost)
                other = replace(other, damping=self._dampings(name)[-1])
                if not self._reference.closures:
                    yield Cause(CauseName.INTEGRATOR, without=other, against=base, is_choice=True)
                for factor in GAIN_FACTORS if self._reference.closures else ():
                    yield Cause(
                        CauseName.INTEGRATOR, without=_closing(other, factor), against=base, is_choice=True
                    )

    def alternatives(self, divisor: int) -> Iterator[PinocchioSettings]:
        """Yield other settings that may reduce the error, with the user's time step divided by `divisor`.

        They combine integrators, kinds of damping, the proximal settings of the user and of Pinocchio's
        example, and gains: those of the user, and those of `closing_gains`.
        """
        of_user = self.settings
        proximal_of_example: dict[str, Any] = {name: getattr(EXAMPLE_CLOSED, name) for name in CONVERGED}
        for integrator in dict.fromkeys([of_user.integrator, SEMI_IMPLICIT, RK4]):
            for damping in self._dampings(integrator):
                step = of_user.timestep / divisor
                changed = replace(of_user, timestep=step, integrator=integrator, damping=damping)
                if not self._reference.closures:
                    yield changed
                    continue
                for with_proximal in dict.fromkeys([changed, replace(changed, **proximal_of_example)]):
                    yield with_proximal
                    yield from (_closing(with_proximal, factor) for factor in GAIN_FACTORS)

    def _dampings(self, integrator: str) -> list[str]:
        """Return the kinds of damping to try with an integrator, that of the user first; RK4 has one kind."""
        if integrator == RK4 or not self._has_dampers:
            return [EXPLICIT_DAMPING]
        return list(dict.fromkeys([self.settings.damping, IMPLICIT_DAMPING]))

    def at_divisor(self, settings: PinocchioSettings, divisor: float) -> PinocchioSettings:
        """Return the same settings with the user's time step divided by `divisor`, see `_scaled`."""
        return self._scaled(settings, self.settings.timestep / divisor)

    def _scaled(self, settings: PinocchioSettings, timestep: float) -> PinocchioSettings:
        """Return settings with another time step, s.

        Gains of the user stay; other gains are scaled, so that they close loops in the same number of steps.
        """
        ratio = settings.timestep / timestep
        settings = replace(settings, timestep=timestep)
        if settings.kp is None or settings.kd is None:
            return settings
        if (settings.kp, settings.kd) == (self.settings.kp, self.settings.kd):
            return settings
        return replace(settings, kp=settings.kp * ratio**2, kd=settings.kd * ratio)

    def _gains_of(self, settings: PinocchioSettings) -> list[tuple[float, float]]:
        """Return the gains kp and kd of each closure: those of the settings, else those of the model."""
        count = len(self._reference.closures)
        of_model = self._gains or [(0.0, 0.0)] * count
        return [
            (kp if settings.kp is None else settings.kp, kd if settings.kd is None else settings.kd)
            for kp, kd in of_model
        ]

    def run(self, settings: PinocchioSettings, steps: int, every: int, reduced: bool = False) -> FileRun:
        """Simulate the model.

        Args:
            settings: settings of the run.
            steps: number of time steps.
            every: number of steps from one output to the next.
            reduced: no effect; a complete run has no elements that the scene does not have.
        """
        accelerations = self._accelerations(settings)
        step = STEPS[settings.integrator]
        q, v = self._start.copy(), self._velocity.copy()
        recorder = Recorder(self._reference)
        thread_time, stopped = 0.0, ""
        with np.errstate(all="ignore"):  # a diverged run is reported
            recorder.record(0.0, q, v)
            for output in range(1, steps // every + 1):
                start = time.thread_time()
                for _ in range(every):
                    q, v = step(self._reference.model, accelerations, q, v, settings.timestep)
                thread_time += time.thread_time() - start
                now = output * every * settings.timestep
                if not np.all(np.abs(v) <= MAX_VELOCITY) or not np.all(np.isfinite(q)):
                    stopped = f"velocities are not finite or exceed {MAX_VELOCITY:g} at {now:.4g} s"
                    break
                recorder.record(now, q, v)
        return recorder.run(self.scene, settings, thread_time, stopped)

    def _accelerations(self, settings: PinocchioSettings) -> Acceleration:
        """Return the function that computes accelerations with these settings."""
        reference, model = self._reference, self._reference.model
        if settings.damping == IMPLICIT_DAMPING:  # see `urdf.run_settings.DAMPINGS`
            model = model.copy()
            model.armature = model.armature + settings.timestep * reference.damping
        data = model.createData()
        zeros = np.zeros(model.nv)

        def applied(q: Array, v: Array) -> Array:
            """Return the generalized forces (nv,) of springs and dampers."""
            if not reference.has_springs_or_dampers:
                return zeros
            springs, dampers = reference.springs_and_dampers(q, v)
            return springs + dampers

        # mimics and couplings, but no closures
        if self._free is not None:
            free = self._free

            def by_mass_matrix(q: Array, v: Array) -> Array:
                """Return the accelerations (nv,) of the velocities that mimics and couplings allow."""
                upper = np.triu(pin.crba(model, data, q))
                mass = upper + np.triu(upper, 1).T
                force = applied(q, v) - pin.nonLinearEffects(model, data, q, v)
                return np.asarray(free @ np.linalg.solve(free.T @ mass @ free, free.T @ force))

            return by_mass_matrix
        if not reference.closures:
            return lambda q, v: pin.aba(model, data, q, v, applied(q, v))
        # loop closures
        constraints = _rigid_constraints(reference, self._gains_of(settings))
        constraint_data = pin.StdVec_RigidConstraintData([each.createData() for each in constraints])
        pin.initConstraintDynamics(model, data, constraints, constraint_data)
        proximal = pin.ProximalSettings(settings.accuracy, settings.mu, settings.iterations)
        return lambda q, v: pin.constraintDynamics(
            model, data, q, v, applied(q, v), constraints, constraint_data, proximal
        )


def _closing(settings: PinocchioSettings, factor: float) -> PinocchioSettings:
    """Return settings with gains of `closing_gains`, rounded to the digits that are printed."""
    kp, kd = closing_gains(settings.timestep, settings.integrator, factor)
    return replace(settings, kp=float(f"{kp:.4g}"), kd=float(f"{kd:.4g}"))


def _text(value: object) -> str:
    """Write a value of settings; numbers with at most six digits."""
    return f"{value:g}" if isinstance(value, float) else str(value)


def _rounded(values: Sequence[float]) -> str:
    """Write the values that differ in three digits, ascending, joined by "and"."""
    return " and ".join(f"{value:g}" for value in sorted({float(f"{value:.3g}") for value in values}))


def _rigid_constraints(reference: PinocchioReference, gains: Sequence[tuple[float, float]]) -> Any:
    """Return `pinocchio.StdVec_RigidConstraintModel` of all loop closures, with gains kp and kd.

    A hinge is two points on its axis, the x axis of the frames, whose distance is the size of the mechanism.
    """
    model, constraints = reference.model, pin.StdVec_RigidConstraintModel()
    for closure, (kp, kd) in zip(reference.closures, gains, strict=True):
        offsets = [0.0, reference.size] if closure.kind == REVOLUTE else [0.0]
        for offset in offsets:
            along_x = pin.SE3(np.eye(3), np.array([offset, 0.0, 0.0]))
            first, second = (model.frames[frame] for frame in (closure.first, closure.second))
            constraint = pin.RigidConstraintModel(
                pin.ContactType.CONTACT_6D if closure.kind == "6d" else pin.ContactType.CONTACT_3D,
                model,
                first.parentJoint,
                first.placement * along_x,
                second.parentJoint,
                second.placement * along_x,
                pin.ReferenceFrame.LOCAL,
            )
            constraint.setBaumgarteCorrectorParameters(pin.BaumgarteCorrectorParameters(kp, kd))
            constraints.append(constraint)
    return constraints


def _semi_implicit_step(
    model: Any, accelerations: Acceleration, q: Array, v: Array, timestep: float
) -> tuple[Array, Array]:
    """Return configuration and velocities after a step; the new velocities move the configuration."""
    v = v + accelerations(q, v) * timestep
    return pin.integrate(model, q, v * timestep), v


def _explicit_step(
    model: Any, accelerations: Acceleration, q: Array, v: Array, timestep: float
) -> tuple[Array, Array]:
    """Return configuration and velocities after a step; the old velocities move the configuration."""
    return pin.integrate(model, q, v * timestep), v + accelerations(q, v) * timestep


def _runge_kutta_step(
    model: Any, accelerations: Acceleration, q: Array, v: Array, timestep: float
) -> tuple[Array, Array]:
    """Return configuration and velocities after a step of the classical Runge-Kutta method of order 4.

    Stages are reached by `pinocchio.integrate` from the start of the step. Rotations of balls and free joints
    have a lower order, because velocities of different stages are added although their frames differ.
    """
    half = 0.5 * timestep
    a1 = np.array(accelerations(q, v))
    v2 = v + half * a1
    a2 = np.array(accelerations(pin.integrate(model, q, half * v), v2))
    v3 = v + half * a2
    a3 = np.array(accelerations(pin.integrate(model, q, half * v2), v3))
    v4 = v + timestep * a3
    a4 = np.array(accelerations(pin.integrate(model, q, timestep * v3), v4))
    sixth = timestep / 6.0
    return (
        pin.integrate(model, q, sixth * (v + 2.0 * v2 + 2.0 * v3 + v4)),
        v + sixth * (a1 + 2.0 * a2 + 2.0 * a3 + a4),
    )


STEPS = {SEMI_IMPLICIT: _semi_implicit_step, EXPLICIT: _explicit_step, RK4: _runge_kutta_step}
"""Function of one step, by integrator."""
