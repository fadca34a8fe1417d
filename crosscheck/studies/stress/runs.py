"""Settings of engines, scenes whose motion has a closed form, and errors of runs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any

import numpy as np

import mjcf
import urdf
from crosscheck.compare.energy import Balance, energy_balance
from crosscheck.compare.runs import positions_apart
from newton_euler.compiled.formulations import FORMULATIONS
from newton_euler.model.euler_parameters import angle_between, from_rotation_vector
from newton_euler.model.euler_parameters import product as quaternion_product
from newton_euler.model.joint_kinds import Free
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import OutputName, Scene
from newton_euler.model.state import State
from newton_euler.model.trajectory import Trajectory
from newton_euler.runs.assemble import initial_state
from newton_euler.runs.simulate import simulate
from newton_euler.scalars import Array

STANDARD_GRAVITY = 9.81
"""m/s^2."""


@dataclass(frozen=True)
class Setting:
    """An engine and options of its `simulate`."""

    engine: str
    options: Mapping[str, Any] = field(default_factory=dict)

    def simulate(self, scene: Scene) -> Trajectory:
        """Simulate a scene; raises the errors of the engine."""
        return SIMULATE[self.engine](scene, **self.options)

    def __str__(self) -> str:
        texts = (
            value if isinstance(value, str) else f"{name} {value:.3g}" for name, value in self.options.items()
        )
        return ", ".join(texts) or "defaults"


SIMULATE: dict[str, Callable[..., Trajectory]] = {
    "newton_euler": simulate,
    "mujoco": mjcf.simulate,
    "pinocchio": urdf.simulate,
}


def newton_euler(formulation: str = "relative", stabilization: str = "projection", **more: Any) -> Setting:
    """Return a setting of newton_euler."""
    return Setting("newton_euler", {"formulation": formulation, "stabilization": stabilization, **more})


def mujoco(integrator: str = "RK4", timestep: float = 1e-3, **more: Any) -> Setting:
    """Return a setting of MuJoCo."""
    return Setting("mujoco", {"integrator": integrator, "timestep": timestep, **more})


def pinocchio(**options: Any) -> Setting:
    """Return a setting of Pinocchio."""
    return Setting("pinocchio", options)


COMBINATIONS = tuple(
    newton_euler(formulation, stabilization)
    for formulation, stabilization in product(FORMULATIONS, ("projection", "baumgarte", "none"))
)
"""newton_euler's formulations with each stabilization, at the default tolerance."""

TIGHT = newton_euler("relative", rtol=1e-13, atol=1e-15)
"""newton_euler's most accurate setting, used as reference."""

ONE_EACH = (newton_euler("relative"), newton_euler("cartesian"), mujoco(), pinocchio())
"""Each engine at its default setting, newton_euler in both formulations."""


def formulations(**options: Any) -> tuple[Setting, ...]:
    """Return settings of newton_euler in both formulations with projection and the given options."""
    return tuple(newton_euler(formulation, **options) for formulation in FORMULATIONS)


def lasting(scene: Scene, duration: float, outputs: int, *names: OutputName) -> Scene:
    """Return the scene with another duration, s, and so many equal output periods of the named outputs."""
    return replace(scene, duration=duration, output_period=duration / outputs, outputs=frozenset(names))


def balance(scene: Scene, run: Trajectory) -> Balance:
    """Return the energy balance of a run that saved energies and velocities."""
    found = energy_balance(scene, run)
    assert found is not None
    return found


def largest_energy_error(scene: Scene, run: Trajectory) -> float:
    """Return the largest energy balance error divided by the largest energy that was exchanged."""
    found = balance(scene, run)
    return float(np.max(np.abs(found.residual))) / found.exchanged


def largest_drift(run: Trajectory) -> float:
    """Return the largest constraint violation of a run, m or rad."""
    assert run.constraint_violation is not None
    return float(np.max(run.constraint_violation))


def distance(first: Trajectory, second: Trajectory) -> float:
    """Return the largest distance between positions of bodies at equal times, m."""
    return float(np.max(positions_apart(first, second)))


def parallelogram_angle(scene: Scene) -> Array:
    """Compute the angle (n,) of the bars of the scene `four_bar`, rad, clockwise from upright.

    The masses may differ from the library's. With angle a, N windows, bars of mass m and couplers of mass c,
    all of length L, the equation of motion is ((N + 1) m / 3 + N c) L a'' = ((N + 1) m / 2 + N c) g sin a.
    The start is the initial state of the scene.
    """
    from scipy.integrate import solve_ivp

    bodies = scene.mechanism.bodies
    windows = (len(bodies) - 2) // 2
    bars, couplers = bodies[1 : windows + 2], bodies[windows + 2 :]
    inertia = sum(bar.mass for bar in bars) / 3.0 + sum(coupler.mass for coupler in couplers)
    weight = sum(bar.mass for bar in bars) / 2.0 + sum(coupler.mass for coupler in couplers)
    state = initial_state(scene)
    # body frames are parallel to the world frame in the initial pose of the mechanism, not in the initial
    # state
    start = [bar_angles(state.position[None, :2], bodies)[0], -state.angular_velocity[1, 2]]
    solution = solve_ivp(
        lambda t, y: [y[1], weight / inertia * STANDARD_GRAVITY * np.sin(y[0])],
        (0.0, scene.duration),
        start,
        method="DOP853",
        rtol=1e-13,
        atol=1e-14,
        t_eval=scene.times,
    )
    return np.asarray(solution.y[0])


def bar_angles(position: Array, bodies: tuple[Body, ...]) -> Array:
    """Compute the angle (n,) of the first bar, rad in (-pi, pi], clockwise from upright, from positions (n,
    b, 3)."""
    foot = bodies[1].center_of_mass * [1.0, 0.0, 0.0]
    along = position[:, 1] - foot
    return np.asarray(np.arctan2(along[:, 0], along[:, 1]))


def parallelogram_error(scene: Scene, run: Trajectory) -> float:
    """Return the largest error of the bars' angle in a run of `four_bar`, rad."""
    off = bar_angles(run.position, scene.mechanism.bodies) - parallelogram_angle(scene)
    return float(np.max(np.abs(np.angle(np.exp(1j * off)))))


def symmetric_top(axial: float, transverse: float, spin: Array, duration: float, outputs: int = 10) -> Scene:
    """Return a free symmetric top of 1 kg with its axis along x and the angular velocity `spin` (3,), rad/s.

    `axial` and `transverse` are moments of inertia, kg m^2. There is no gravity.
    """
    top = Body("top", 1.0, np.zeros(3), np.diag([axial, transverse, transverse]))
    mechanism = Mechanism([Body.ground(), top], [Free("floating", "ground", "top", np.zeros(3))])
    state = State.initial(mechanism)
    state.angular_velocity[1] = spin
    wanted: frozenset[OutputName] = frozenset({"velocities", "energy"})
    return Scene("top", mechanism, duration, duration / outputs, initial_state=state, outputs=wanted)


def top_error(scene: Scene, run: Trajectory) -> float:
    """Return the largest error of the orientation of a free symmetric top, rad.

    The orientation is R(t) = exp(t L / I) exp(t w (1 - A / I) e). A and I are the axial and transverse
    moments of inertia, L is the angular momentum, and w is the angular velocity about the axis e (Landau,
    Lifshitz, Mechanics, section 33).
    """
    axial, transverse = (float(scene.mechanism.bodies[1].inertia[k, k]) for k in (0, 1))
    spin = initial_state(scene).angular_velocity[1]
    nutation = np.array([axial, transverse, transverse]) * spin / transverse
    own = np.array([spin[0] * (1.0 - axial / transverse), 0.0, 0.0])
    turned = [
        quaternion_product(from_rotation_vector(t * nutation), from_rotation_vector(t * own))
        for t in scene.times
    ]
    return float(np.max(angle_between(np.array(turned), run.quaternion[:, 1])))
