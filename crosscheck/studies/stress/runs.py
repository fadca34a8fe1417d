"""Engines with their settings, and scenes whose motion is known in closed form."""

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

GRAVITY = 9.81
"""m/s^2."""


@dataclass(frozen=True)
class Setting:
    """An engine with the options of its `simulate`."""

    engine: str
    options: Mapping[str, Any] = field(default_factory=dict)

    def simulate(self, scene: Scene) -> Trajectory:
        """Run a scene; raises what the engine does."""
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
"""newton_euler's formulations under all stabilizations, at its default tolerance."""

TIGHT = newton_euler("relative", rtol=1e-13, atol=1e-15)
"""The nearest to the answer that newton_euler comes."""

ONE_EACH = (newton_euler("relative"), newton_euler("cartesian"), mujoco(), pinocchio())
"""Each set of equations at its defaults."""


def formulations(**options: Any) -> tuple[Setting, ...]:
    """Return newton_euler in both formulations, projected, with the same other options."""
    return tuple(newton_euler(formulation, **options) for formulation in FORMULATIONS)


def lasting(scene: Scene, duration: float, outputs: int, *names: OutputName) -> Scene:
    """The scene for another time, s, with that many outputs after the first of these names."""
    return replace(scene, duration=duration, output_period=duration / outputs, outputs=frozenset(names))


def balance(scene: Scene, run: Trajectory) -> Balance:
    """Return the energy balance of a run that saved energies and velocities."""
    found = energy_balance(scene, run)
    assert found is not None
    return found


def largest_energy_error(scene: Scene, run: Trajectory) -> float:
    """The largest residual of the energy's balance, of the largest energy that was exchanged."""
    found = balance(scene, run)
    return float(np.max(np.abs(found.residual))) / found.exchanged


def largest_drift(run: Trajectory) -> float:
    """Measure the largest drift of joints, m or rad."""
    assert run.constraint_violation is not None
    return float(np.max(run.constraint_violation))


def distance(first: Trajectory, second: Trajectory) -> float:
    """The largest between positions of bodies at equal times, m."""
    return float(np.max(positions_apart(first, second)))


def parallelogram_angle(scene: Scene) -> Array:
    """(n,) rad, clockwise from upright: the bars of `four_bar` or one with other masses, in closed motion.

    With angle a, windows N, bars of mass m and couplers of mass c, all of length L,
    ((N + 1) m / 3 + N c) L a'' = ((N + 1) m / 2 + N c) g sin a, at first upright at the speed of the
    couplers or lying flat, whatever the scene's state is.
    """
    from scipy.integrate import solve_ivp

    bodies = scene.mechanism.bodies
    windows = (len(bodies) - 2) // 2
    bars, couplers = bodies[1 : windows + 2], bodies[windows + 2 :]
    inertia = sum(bar.mass for bar in bars) / 3.0 + sum(coupler.mass for coupler in couplers)
    weight = sum(bar.mass for bar in bars) / 2.0 + sum(coupler.mass for coupler in couplers)
    state = initial_state(scene)
    # a body's own frame is parallel to the world at the initial pose of the mechanism, not of the state
    start = [bar_angles(state.position[None, :2], bodies)[0], -state.angular_velocity[1, 2]]
    solution = solve_ivp(
        lambda t, y: [y[1], weight / inertia * GRAVITY * np.sin(y[0])],
        (0.0, scene.duration),
        start,
        method="DOP853",
        rtol=1e-13,
        atol=1e-14,
        t_eval=scene.times,
    )
    return np.asarray(solution.y[0])


def bar_angles(position: Array, bodies: tuple[Body, ...]) -> Array:
    """(n,) rad: clockwise from upright, within a turn, of the first bar by its center of mass (n, b, 3)."""
    foot = bodies[1].center_of_mass * [1.0, 0.0, 0.0]
    along = position[:, 1] - foot
    return np.asarray(np.arctan2(along[:, 0], along[:, 1]))


def parallelogram_error(scene: Scene, run: Trajectory) -> float:
    """The largest error of the bars' angle in a run of four-bar windows, rad."""
    off = bar_angles(run.position, scene.mechanism.bodies) - parallelogram_angle(scene)
    return float(np.max(np.abs(np.angle(np.exp(1j * off)))))


def symmetric_top(axial: float, transverse: float, spin: Array, duration: float, outputs: int = 10) -> Scene:
    """A free top of 1 kg with its axis along x, spinning at `spin` (3,) rad/s, without gravity."""
    top = Body("top", 1.0, np.zeros(3), np.diag([axial, transverse, transverse]))
    mechanism = Mechanism([Body.ground(), top], [Free("floating", "ground", "top", np.zeros(3))])
    state = State.initial(mechanism)
    state.angular_velocity[1] = spin
    wanted: frozenset[OutputName] = frozenset({"velocities", "energy"})
    return Scene("top", mechanism, duration, duration / outputs, initial_state=state, outputs=wanted)


def top_error(scene: Scene, run: Trajectory) -> float:
    """The largest error of a symmetric top's orientation, rad.

    R(t) = exp(t L / I) exp(t w (1 - A / I) e) with axial and transverse moments A and I, angular momentum
    L and spin w about the axis e (Landau, Lifshitz, Mechanics, section 33).
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
