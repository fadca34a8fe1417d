"""Helpers of all stress tests: engine settings, error measures of runs, and two exact reference motions.

A stress test measures the errors of engines in demanding runs. A setting is an engine with options of its
simulation function. A case is one test of one engine at one setting. The reference motions, each computed
independently of the engines, are those of a parallelogram linkage and of a free symmetric top.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from crosscheck.compare.run_differences import positions_apart
from crosscheck.engines.energy import Balance, energy_balance
from crosscheck.engines.engine import Engine
from crosscheck.engines.limits import require_expressed
from crosscheck.engines.registry import SOLVER, choose
from crosscheck.engines.stress import Options, StressSettings, Topic
from newton_euler.model.euler_parameters import angle_between, from_rotation_vector
from newton_euler.model.euler_parameters import product as quaternion_product
from newton_euler.model.joint_kinds import Free
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import OutputName, Scene
from newton_euler.model.state import State
from newton_euler.model.trajectory import Trajectory
from newton_euler.runs.assemble import initial_state
from newton_euler.scalars import Array

STANDARD_GRAVITY = 9.81
"""Acceleration of gravity, m/s^2, in the scenes of the stress tests: standard gravity, 9.80665, rounded."""


@dataclass(frozen=True)
class Setting:
    """An engine, and options of its simulation function.

    Attributes:
        engine: name of the engine. In cases without a simulation, such as invalid inputs, engine and options
            are only labels.
        options: keyword arguments of the simulation function, such as the integrator and its step.
    """

    engine: str
    options: Mapping[str, Any] = field(default_factory=dict)

    def simulate(self, scene: Scene) -> Trajectory:
        """Simulate a scene with the engine and the options; errors of the engine are passed on.

        Raises:
            CannotExpressError: for a scene that the engine cannot express.
        """
        (engine,) = choose([self.engine])
        require_expressed(engine.name, engine.limits(scene))
        return engine.simulate(scene, self.options)

    def __str__(self) -> str:
        texts = (
            value if isinstance(value, str) else f"{name} {value:.3g}" for name, value in self.options.items()
        )
        return ", ".join(texts) or "defaults"


def settings_of(engines: Sequence[Engine], topic: Topic | None = None) -> tuple[Setting, ...]:
    """Return the settings of engines for a topic; the typical ones without a topic."""
    return tuple(
        Setting(engine.name, options) for engine in engines for options in _options_of(engine.stress(), topic)
    )


def _options_of(settings: StressSettings, topic: Topic | None) -> tuple[Options, ...]:
    """Return the options of an engine for a topic."""
    return settings.typical if topic is None else settings.topics.get(topic, settings.typical)


def solver_setting(**options: Any) -> Setting:
    """Return a setting of newton_euler with options such as `formulation` and `integrator`.

    Formulation and stabilization are "relative" (joint coordinates) and "projection" by default.
    """
    return Setting(SOLVER.name, {"formulation": "relative", "stabilization": "projection", **options})


def steps_text(run: Trajectory) -> str:
    """Return the number of steps of a run as text; "" if the engine does not count its steps."""
    return f"{run.settings['steps']} steps" if "steps" in run.settings else ""


REFERENCE_SETTING = solver_setting(rtol=1e-13, atol=1e-15)
"""newton_euler's most accurate setting; its runs are references for other settings."""


def with_duration(scene: Scene, duration: float, periods: int, *names: OutputName) -> Scene:
    """Return the scene with another duration and other outputs.

    Args:
        scene: the scene.
        duration: new duration, s.
        periods: number of equal output periods in the duration.
        *names: optional quantities that runs save in addition to the positions, such as "energy".
    """
    return replace(scene, duration=duration, output_period=duration / periods, outputs=frozenset(names))


def balance_of(scene: Scene, run: Trajectory) -> Balance:
    """Return the energy balance of a run that saved energies and velocities.

    Its `residual` (n,) is the energy balance error, J. Its `scale` is the energy scale of the run, J: the
    largest change of the total energy plus the largest kinetic energy.
    """
    found = energy_balance(scene, run)
    assert found is not None
    return found


def largest_energy_error(scene: Scene, run: Trajectory) -> float:
    """Return the largest energy balance error in a run, divided by the energy scale of the run."""
    found = balance_of(scene, run)
    return float(np.max(np.abs(found.residual))) / found.scale


def largest_drift(run: Trajectory) -> float:
    """Return the largest constraint violation of a run, m or rad."""
    assert run.constraint_violation is not None
    return float(np.max(run.constraint_violation))


def largest_distance(first: Trajectory, second: Trajectory) -> float:
    """Return the largest distance between the positions of a body in two runs at the same time, m."""
    return float(np.max(positions_apart(first, second)))


def parallelogram_angle(scene: Scene) -> Array:
    """Compute the exact angle (n,) of the bars of the scene `four_bar` at its output times, rad.

    The scene has N parallelograms (windows) in a row: N + 1 parallel bars on hinges at their feet, and N
    couplers between the tops. The masses may differ from those of the scene library. The angle a of all bars
    is measured clockwise from upright. All bars are 1 m long; m is the total mass of the bars, c that of the
    couplers. The equation of motion (m / 3 + c) a'' = (m / 2 + c) g sin a is integrated from the initial
    state of the scene.
    """
    from scipy.integrate import solve_ivp

    # Coefficients of the equation. The order of the bodies is ground, N + 1 bars, N couplers
    bodies = scene.mechanism.bodies
    windows = (len(bodies) - 2) // 2
    bars, couplers = bodies[1 : windows + 2], bodies[windows + 2 :]
    inertia = sum(bar.mass for bar in bars) / 3.0 + sum(coupler.mass for coupler in couplers)  # m / 3 + c
    static_mass = sum(bar.mass for bar in bars) / 2.0 + sum(coupler.mass for coupler in couplers)  # m / 2 + c
    state = initial_state(scene)
    # The quaternions of a scene that starts with flat bars are not those of upright bars. The angle is
    # therefore computed from positions. Angular velocity about z is counterclockwise.
    start = [bar_angles(state.position[None, :2], bodies)[0], -state.angular_velocity[1, 2]]
    solution = solve_ivp(
        lambda t, y: [y[1], static_mass / inertia * STANDARD_GRAVITY * np.sin(y[0])],
        (0.0, scene.duration),
        start,
        method="DOP853",
        rtol=1e-13,
        atol=1e-14,
        t_eval=scene.times,
    )
    return np.asarray(solution.y[0])


def bar_angles(position: Array, bodies: tuple[Body, ...]) -> Array:
    """Compute the angle (n,) of the first bar of `four_bar`, rad in (-pi, pi], clockwise from upright.

    Args:
        position: positions (n, b, 3) of b bodies, or of the first ones, m.
        bodies: bodies of the mechanism.
    """
    # The bar stands upright along y on the x axis in the pose in which the mechanism is defined
    foot = bodies[1].center_of_mass * [1.0, 0.0, 0.0]
    foot_to_center = position[:, 1] - foot
    return np.asarray(np.arctan2(foot_to_center[:, 0], foot_to_center[:, 1]))


def parallelogram_error(scene: Scene, run: Trajectory) -> float:
    """Return the largest error of the bars' angle in a run of `four_bar`, rad; whole turns do not count."""
    error = bar_angles(run.position, scene.mechanism.bodies) - parallelogram_angle(scene)
    return float(np.max(np.abs(np.angle(np.exp(1j * error)))))


def symmetric_top(axial: float, transverse: float, spin: Array, duration: float, periods: int = 10) -> Scene:
    """Return the scene of a free symmetric top of 1 kg without gravity, its axis along x at first.

    Args:
        axial: moment of inertia about the axis of the top, kg m^2.
        transverse: moment of inertia about any line across the axis, kg m^2.
        spin: initial angular velocity (3,), rad/s.
        duration: duration, s.
        periods: number of equal output periods in the duration.
    """
    top = Body("top", 1.0, np.zeros(3), np.diag([axial, transverse, transverse]))
    mechanism = Mechanism([Body.ground(), top], [Free("floating", "ground", "top", np.zeros(3))])
    state = State.initial(mechanism)
    state.angular_velocity[1] = spin
    outputs: frozenset[OutputName] = frozenset({"velocities", "energy"})
    return Scene("top", mechanism, duration, duration / periods, initial_state=state, outputs=outputs)


def top_error(scene: Scene, run: Trajectory) -> float:
    """Return the largest error of the orientation in a run of `symmetric_top`, rad.

    The exact orientation is R(t) = exp(t L / I) exp(t w (1 - A / I) e), where exp is the rotation by a
    vector. A and I are the axial and transverse moments of inertia, L is the angular momentum, and w is the
    angular velocity about the axis e. L / I is the velocity of precession (Landau, Lifshitz, Mechanics,
    section 33).
    """
    axial, transverse = (float(scene.mechanism.bodies[1].inertia[k, k]) for k in (0, 1))
    spin = initial_state(scene).angular_velocity[1]
    precession = np.array([axial, transverse, transverse]) * spin / transverse
    spin_about_axis = np.array([spin[0] * (1.0 - axial / transverse), 0.0, 0.0])
    exact = [
        quaternion_product(from_rotation_vector(t * precession), from_rotation_vector(t * spin_about_axis))
        for t in scene.times
    ]
    return float(np.max(angle_between(np.array(exact), run.quaternion[:, 1])))
