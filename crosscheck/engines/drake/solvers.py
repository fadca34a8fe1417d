"""Simulate a scene by Drake's own solvers.

- "SAP": the discrete solver of a `MultibodyPlant`, of order 1. It closes loops by Drake's ball, weld and
  distance constraints, which are nearly rigid.
- "runge_kutta5": an integrator with error control, of a continuous plant, which Drake refuses to derive with
  constraints. Only trees can run.

Springs on joint coordinates and between points are Drake's; other forces come from a `LeafSystem` that calls
`DrakeSystem`, whose state is their work. Neither solver computes the forces of constraints: the reactions of
a run are those of `DrakeSystem` at its states.
"""

from __future__ import annotations

import time
from typing import Any, Literal, get_args

import numpy as np
from pydrake.common.value import Value
from pydrake.multibody.plant import DiscreteContactApproximation, ExternallyAppliedSpatialForce
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from crosscheck.engines.applied import coordinate_elements
from crosscheck.engines.drake.equations import DrakeSystem
from crosscheck.engines.drake.placed import spatial_forces
from crosscheck.engines.drake.plant import NAME, Anchors, Plant, build
from crosscheck.engines.drake.turned_balls import TurnedBalls
from crosscheck.engines.engine import Settings
from crosscheck.engines.limits import Limit, require_expressed
from newton_euler.arguments import checked
from newton_euler.equations.couplings import couplings
from newton_euler.errors import NewtonEulerError, OptionError, UnknownNameError
from newton_euler.integrators.options import MAX_FIXED_STEPS
from newton_euler.model.scene import Scene
from newton_euler.model.spanning_tree import SpanningTree
from newton_euler.model.trajectory import IntegrationError, Trajectory
from newton_euler.runs.assemble import initial_state
from newton_euler.runs.simulate import IntegratedStates, OutputState, trajectory_of_states
from newton_euler.scalars import Array

SolverName = Literal["SAP", "runge_kutta5"]
"""Name of a solver of Drake."""

SOLVERS: tuple[SolverName, ...] = get_args(SolverName)

DEFAULT_STEP = 1e-3
"""Step of SAP, s."""

DEFAULT_ACCURACY = 1e-9
"""Relative accuracy that the error control of `runge_kutta5` aims at."""

MIN_ACCURACY = 1e-13
"""Smallest accuracy; round-off makes the steps of smaller ones too short for Drake."""

MAX_TURN = 0.3
"""Largest rotation of a ball, rad, between two looks at its angles."""

MAX_SPIN = 1e5
"""Angular velocity of a ball, rad/s, at which a run has diverged."""


def limits_of_solver(scene: Scene, solver: SolverName) -> list[Limit]:
    """List what a solver of Drake cannot run of a scene that Drake's equations express."""
    mechanism, reason = scene.mechanism, f"only runs by Drake's equations have it, not {solver}"
    found = [Limit(f"{each.what} {each.name!r}", reason) for each in couplings(scene)]
    found += [
        Limit(f"armature at joint {each.joint!r}", "Drake has no rotors on balls")
        for each in scene.armatures
        if each.on_ball
    ]
    if scene.sampled:
        found.append(Limit("sampled controllers", reason))
    if scene.jumps:
        found.append(Limit("jumps of functions of time", reason))
    if solver != "SAP":
        reason = "a continuous plant of Drake does not support constraints"
        cuts = SpanningTree(mechanism, loaded=scene.loaded_balls).cuts
        found += [Limit(f"loop at joint {mechanism.joint_names[cut]!r}", reason) for cut in cuts]
    return found


@checked
def simulate_with(
    scene: Scene, solver: SolverName, step: float | None = None, accuracy: float | None = None
) -> Trajectory:
    """Simulate a scene with a solver of Drake.

    Args:
        scene: the scene.
        solver: "SAP" or "runge_kutta5".
        step: largest step of SAP, s; the step divides the time between outputs. None for `DEFAULT_STEP`.
        accuracy: relative accuracy of "runge_kutta5"; None for `DEFAULT_ACCURACY`.

    Raises:
        CannotExpressError: for a scene that the solver cannot run.
        NewtonEulerError: for an unknown solver, an impossible option, or a run that stops early, with the
            trajectory so far.
    """
    if solver not in SOLVERS:
        raise UnknownNameError("solver", solver, SOLVERS)
    settings: dict[str, Any] = {"solver": solver}
    if solver == "SAP":
        if accuracy is not None:
            raise OptionError("accuracy", accuracy, "none: SAP has a step")
        settings["step"] = _step(scene, DEFAULT_STEP if step is None else step)
    else:
        if step is not None:
            raise OptionError("step", step, f"none: the steps of {solver} follow from its accuracy")
        settings["accuracy"] = DEFAULT_ACCURACY if accuracy is None else accuracy
        if not MIN_ACCURACY <= settings["accuracy"] < 1.0:
            raise OptionError("accuracy", accuracy, f"at least {MIN_ACCURACY:g} and below 1")
    require_expressed(NAME, limits_of_solver(scene, solver))
    found = integrate_with(scene, settings)
    settings |= {"steps": found.steps, "evaluations": found.evaluations}
    return trajectory_of_states(scene, NAME, settings, found)


def integrate_with(scene: Scene, settings: Settings) -> IntegratedStates:
    """Integrate a scene with a solver of Drake that can run it.

    Args:
        scene: the scene.
        settings: `step` of SAP, s, which divides the time between outputs, or `accuracy` of "runge_kutta5".

    Returns:
        The states: tree coordinates with the work, J, and tree velocities.
    """
    return _Run(DrakeSystem(scene), settings.get("step", 0.0), settings.get("accuracy", 0.0)).run()


def _step(scene: Scene, step: float) -> float:
    """Return the largest step, s, that is not above the given one and that divides all output intervals."""
    if not 0.0 < step < np.inf:
        raise OptionError("step", step, "a positive number of seconds")
    times = np.array(scene.times)
    period, last = float(times[1] - times[0]), float(times[-1] - times[-2])
    fewest = int(np.ceil(period / step * (1.0 - 1e-9)))
    if scene.duration / period * fewest > MAX_FIXED_STEPS:
        raise OptionError("step", step, f"at least {scene.duration / MAX_FIXED_STEPS:.3g} s")
    for count in range(fewest, 100 * fewest):
        in_last = last / period * count
        if abs(in_last - round(in_last)) < 1e-9 * count and round(in_last) > 0:
            return period / count
    raise OptionError("duration", scene.duration, f"a multiple of the output period, {period:g} s, for SAP")


class _Run:
    """A diagram of Drake with the plant and its forces, at the start of a run."""

    def __init__(self, equations: DrakeSystem, step: float, accuracy: float) -> None:
        """Build the diagram; a step, s, above 0 selects SAP."""
        self._equations, self._scene, self._step = equations, equations.scene, step
        built = build(self._scene, equations.placed.built.welded, step)
        plant = self._plant = built.plant
        if step:
            plant.set_discrete_contact_approximation(DiscreteContactApproximation.kSap)
            for loop in built.anchors:
                _close(plant, loop)
        plant.Finalize()
        self._balls = TurnedBalls(built)
        builder = DiagramBuilder()
        builder.AddSystem(plant)
        self._forces: _Forces | None = None
        native, elements = built.springs, (*coordinate_elements(self._scene), *self._scene.body_forces)
        if self._scene.tracks_work or not all(any(each is spring for spring in native) for each in elements):
            self._forces = builder.AddSystem(_Forces(equations, built, self._balls))
            builder.Connect(plant.get_state_output_port(), self._forces.GetInputPort("state"))
            builder.Connect(
                self._forces.GetOutputPort("along"), plant.get_applied_generalized_force_input_port()
            )
            builder.Connect(
                self._forces.GetOutputPort("wrenches"), plant.get_applied_spatial_force_input_port()
            )
        self._simulator = Simulator(builder.Build())
        self._context = self._simulator.get_mutable_context()
        self._in_plant = plant.GetMyMutableContextFromRoot(self._context)
        # SAP steps the plant; the explicit Euler method, of the same order, integrates the work beside it
        name = "explicit_euler" if step else "runge_kutta5"
        ResetIntegratorFromFlags(self._simulator, name, step or self._scene.duration)
        self._integrator = self._simulator.get_mutable_integrator()
        self._steps, self._evaluations = 0, 0
        if not step:
            self._integrator.set_fixed_step_mode(False)
            self._integrator.set_target_accuracy(accuracy)
            self._integrator.set_throw_on_minimum_step_size_violation(True)

    def run(self) -> IntegratedStates:
        """Simulate the scene, and return the states at its output times."""
        q, v = self._equations.coordinates(initial_state(self._scene))
        positions, to_drake = self._equations.placed.positions(q)
        self._plant.SetPositionsAndVelocities(self._in_plant, np.concatenate([positions, to_drake @ v]))
        rows, stopped = list[OutputState](), None
        start = time.perf_counter()
        try:
            self._simulator.Initialize()
            for at in self._scene.times:
                self._advance(float(at))
                rows.append(OutputState(self._equations, float(at), *self._tree_state()))
        except IntegrationError as error:
            stopped = error
        except (RuntimeError, NewtonEulerError) as error:  # of Drake, and of forces at a state without any
            stopped = IntegrationError(self._now(), f"Drake: {str(error).splitlines()[0]}")
        seconds = time.perf_counter() - start
        if self._step:
            steps = round(self._now() / self._step)
            return IntegratedStates(rows, seconds, steps, evaluations=steps, stopped=stopped)
        self._count()
        return IntegratedStates(rows, seconds, self._steps, self._evaluations, stopped)

    def _count(self) -> None:
        """Add the counts of the integrator, which begins anew at each initialization."""
        self._steps += self._integrator.get_num_steps_taken()
        self._evaluations += self._integrator.get_num_derivative_evaluations()

    def _now(self) -> float:
        """Return the time, s."""
        return float(self._context.get_time())

    def _tree_state(self) -> tuple[Array, Array]:
        """Return tree coordinates, with the work, and tree velocities.

        Raises:
            IntegrationError: for a state that is not finite.
        """
        x = self._plant.GetPositionsAndVelocities(self._in_plant)
        if not np.isfinite(x).all():
            raise IntegrationError(self._now(), "Drake's state is not finite")
        q, v, _ = self._balls.tree_state(x)
        if self._scene.tracks_work and self._forces is not None:
            q = np.append(q, self._forces.work(self._context))
        return q, v

    def _advance(self, end: float) -> None:
        """Advance to a time, s, and keep the angles of balls away from their singular pitch of 90 degrees."""
        while self._now() < end * (1.0 - 1e-12):
            now = self._now()
            x = self._plant.GetPositionsAndVelocities(self._in_plant)
            spin = self._balls.fastest(x) if np.isfinite(x).all() else np.inf
            if not spin <= MAX_SPIN:
                raise IntegrationError(now, "Drake's state is not finite, or a ball turns too fast")
            until = end
            if spin > 0.0 and now + MAX_TURN / spin < end:
                until = now + MAX_TURN / spin
                if self._step:  # SAP's states belong to its steps
                    until = min(end, (round(now / self._step) + 1) * self._step)
            self._simulator.AdvanceTo(until)
            if self._balls.turn_frames(self._plant, self._in_plant):
                self._count()
                self._simulator.Initialize()


def _close(plant: Any, loop: Anchors) -> None:
    """Add Drake's constraint of a joint that closes a loop."""
    first, second = loop.first, loop.second
    ends = [(frame.body(), frame.GetFixedPoseInBodyFrame()) for frame in (first, second)]
    (body, pose), (other, other_pose) = ends
    match loop.kind:
        case "ball":
            plant.AddBallConstraint(body, pose.translation(), other, other_pose.translation())
        case "weld":
            plant.AddWeldConstraint(body, pose, other, other_pose)
        case "rod":
            # a distance from the world itself would end the process (Drake 1.51)
            on_world = [each for each in (body, other) if each.index() == plant.world_body().index()]
            if on_world:
                fixed = plant.AddRigidBody(f"world at {first.name()}", SpatialInertia.Zero())
                plant.WeldFrames(plant.world_frame(), fixed.body_frame())
                body, other = (fixed if each in on_world else each for each in (body, other))
            points = body, pose.translation(), other, other_pose.translation()
            plant.AddDistanceConstraint(*points, loop.length)
        case _:
            raise ValueError(f"loop of kind {loop.kind!r}")


class _Forces(LeafSystem):  # type: ignore[misc]
    """Forces of a scene that are no elements of the plant; its continuous state is the work, J, of all forces
    without potential energy."""

    def __init__(self, equations: DrakeSystem, built: Plant, balls: TurnedBalls) -> None:
        """Declare the ports: the state of the plant, forces on its velocities, and wrenches on its bodies."""
        super().__init__()
        self._equations, self._bodies, self._balls = equations, built.bodies, balls
        self.DeclareVectorInputPort("state", built.plant.num_multibody_states())
        self.DeclareVectorOutputPort("along", built.plant.num_velocities(), self._along)
        self.DeclareAbstractOutputPort(
            "wrenches", lambda: Value[list[ExternallyAppliedSpatialForce]](), self._wrenches
        )
        self.DeclareContinuousState(1)

    def _at(self, context: Any) -> tuple[Array, Array, Array]:
        """Return tree coordinates, tree velocities, and the matrix from these to Drake's velocities.

        Raises:
            RuntimeError: for a trial stage that is not finite, at which Drake's own calls would end the
                process.
        """
        x = self.GetInputPort("state").Eval(context)
        if not np.isfinite(x).all():
            raise RuntimeError("a stage of the integrator is not finite")
        q, v, to_drake = self._balls.tree_state(x)
        self._equations.time = context.get_time()
        return np.append(q, np.zeros(self._equations.nq - len(q))), v, to_drake

    def _along(self, context: Any, output: Any) -> None:
        """Set the forces on Drake's velocities."""
        q, v, to_drake = self._at(context)
        output.SetFromVector(to_drake @ self._equations.forces(q, v).along)

    def _wrenches(self, context: Any, output: Any) -> None:
        """Set the wrenches on the bodies."""
        q, v, _ = self._at(context)
        output.set_value(spatial_forces(self._bodies, self._equations.forces(q, v).wrenches).get_value())

    def DoCalcTimeDerivatives(self, context: Any, derivatives: Any) -> None:
        """Set the rate of the work, W."""
        q, v, _ = self._at(context)
        derivatives.get_mutable_vector().SetFromVector([self._equations.power(q, v)])

    def work(self, root: Any) -> float:
        """Return the work, J, in a context of the diagram."""
        return float(self.GetMyContextFromRoot(root).get_continuous_state_vector().GetAtIndex(0))
