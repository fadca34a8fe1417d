"""Dry friction that grows with the reaction of its joint: closed forms, and all engines."""

from dataclasses import replace

import numpy as np
import pytest
from simulations import SIMULATIONS

import newton_euler
from newton_euler import PD, Body, Digital, JointFriction, Mechanism, Prismatic, Revolute, Scene, State
from newton_euler.compiled.formulations import formulate
from newton_euler.errors import MechanismError
from newton_euler.model.trajectory import StoppedError

MASS, GRAVITY, TRANSITION = 2.0, 9.81, 1e-6


def scene_of(body: Body, joint: Prismatic | Revolute, friction: JointFriction, **start: np.ndarray) -> Scene:
    """One body on one joint, with velocities at the start."""
    mechanism = Mechanism([Body.ground(), body], [joint])
    velocities = {name: np.array([np.zeros(3), value]) for name, value in start.items()}
    state = replace(State.initial(mechanism), **velocities)
    return Scene(
        "loaded", mechanism, 0.5, 0.05, [0.0, 0.0, -GRAVITY], initial_state=state, forces=(friction,)
    )


@pytest.mark.parametrize("engine", ["relative", "cartesian", "mujoco", "pinocchio"])
def test_a_block_slides_down_an_incline(engine):
    """g (sin - mu cos), with the coefficient of friction mu."""
    angle, mu, speed = 0.6, 0.3, 1.0
    along = np.array([np.cos(angle), 0.0, np.sin(angle)])
    rail = Prismatic("rail", "ground", "block", np.zeros(3), axis=along)
    friction = JointFriction("rail", 0.0, transition_speed=TRANSITION, load_coefficient=mu)
    body = Body("block", MASS, np.zeros(3), np.eye(3))
    run = SIMULATIONS[engine](scene_of(body, rail, friction, linear_velocity=-speed * along))
    exact = -speed * run.time - 0.5 * GRAVITY * (np.sin(angle) - mu * np.cos(angle)) * run.time**2
    assert np.abs(run.position[:, 1] @ along - exact).max() < 1e-13  # parabolas, exact in all engines


def test_an_eccentric_wheel_slows_down_in_its_bearing():
    """m r (w^2 e cos, w^2 e sin) and the weight load the bearing; the equation of the angle by SciPy."""
    from scipy.integrate import solve_ivp

    eccentricity, inertia, coefficient, speed = 0.05, 0.02, 0.004, 20.0
    about = inertia + MASS * eccentricity**2
    body = Body("wheel", MASS, [eccentricity, 0.0, 0.0], inertia * np.eye(3))
    hinge = Revolute("bearing", "ground", "wheel", np.zeros(3), axis=[0.0, 1.0, 0.0])
    friction = JointFriction("bearing", 0.0, transition_speed=TRANSITION, load_coefficient=coefficient)
    start = {"angular_velocity": [0.0, speed, 0.0], "linear_velocity": [0.0, 0.0, -speed * eccentricity]}
    scene = scene_of(body, hinge, friction, **start)
    run = newton_euler.simulate(scene, rtol=1e-11, atol=1e-13)

    def rates(_: float, y: np.ndarray) -> list[float]:
        """Angle phi about -y, from x towards z below; the reaction by Newton's equation, by iteration."""
        phi, w = y
        out, down = np.array([np.cos(phi), 0.0, -np.sin(phi)]), np.array([-np.sin(phi), 0.0, -np.cos(phi)])
        torque, alpha = 0.0, 0.0
        for _ in range(60):
            alpha = (MASS * GRAVITY * eccentricity * np.cos(phi) + torque) / about
            acceleration = eccentricity * (alpha * down - w**2 * out)
            torque = -coefficient * np.linalg.norm(MASS * (acceleration + np.array([0.0, 0.0, GRAVITY])))
        return [w, alpha]

    exact = solve_ivp(rates, (0.0, 0.5), [0.0, speed], "DOP853", rtol=1e-12, atol=1e-12, t_eval=run.time)
    assert np.abs(run.joint("bearing").coordinates[:, 0] - exact.y[0]).max() < 1e-9
    assert speed - exact.y[1, -1] > 0.1  # the friction shows


def test_an_undetermined_reaction_is_refused():
    """Two hinges on one axis: each may carry what the other does not."""
    body = Body("door", 1.0, [0.5, 0.0, 0.0], np.eye(3))
    hinges = [
        Revolute(name, "ground", "door", [0.0, 0.0, z], axis=[0.0, 0.0, 1.0])
        for name, z in (("low", 0.0), ("high", 1.0))
    ]
    mechanism = Mechanism([Body.ground(), body], hinges)
    scene = Scene("door", mechanism, 0.1, 0.1, forces=(JointFriction("low", 0.0, load_coefficient=0.01),))
    with pytest.raises(MechanismError, match="friction of joint 'low'"):
        newton_euler.simulate(scene)


@pytest.mark.parametrize("engine", ["mujoco", "pinocchio"])
def test_loads_of_a_sampled_controller_count(engine):
    """An arm on a cart, whose digital controller loads the rail: other forces in each of its periods."""
    cart, arm = Body("cart", 1.0, np.zeros(3), np.eye(3)), Body("arm", 0.5, [0.3, 0.0, 0.0], 0.01 * np.eye(3))
    joints = [
        Prismatic("rail", "ground", "cart", np.zeros(3), axis=[1.0, 0.0, 0.0]),
        Revolute("elbow", "cart", "arm", np.zeros(3), axis=[0.0, 1.0, 0.0], actuated=True),
    ]
    scene = Scene(
        "digital",
        Mechanism([Body.ground(), cart, arm], joints),
        0.2,
        0.02,
        [0.0, 0.0, -GRAVITY],
        control=(Digital(PD("elbow", 30.0, 0.5, 0.8), period=0.02),),
        forces=(JointFriction("rail", 0.0, transition_speed=0.02, load_coefficient=0.3),),
    )
    wanted, found = newton_euler.simulate(scene), SIMULATIONS[engine](scene)
    assert np.abs(wanted.position[-1, 1, 0]) > 1e-3
    # derivatives of friction jump within MuJoCo's steps of 1 ms; forces of another period change 1e-3
    assert np.abs(found.position - wanted.position).max() < 2e-5


def leaning_rod(coefficient: float) -> Scene:
    """A rod on a light cart that slides backwards: 1 kg, 1 m long, with the tangent 2 of its angle."""
    angle, half, mass, cart_mass = np.arctan(2.0), 0.5, 1.0, 1e-3
    center = half * np.array([np.cos(angle), 0.0, np.sin(angle)])
    cart = Body("cart", cart_mass, np.zeros(3), 1e-3 * np.eye(3))
    rod = Body("rod", mass, center, mass * half**2 / 3.0 * np.eye(3))
    joints = [
        Prismatic("rail", "ground", "cart", np.zeros(3), axis=[1.0, 0.0, 0.0]),
        Revolute("pin", "cart", "rod", np.zeros(3), axis=[0.0, 1.0, 0.0]),
    ]
    mechanism = Mechanism([Body.ground(), cart, rod], joints)
    velocity = np.array([np.zeros(3), [-1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])
    state = replace(State.initial(mechanism), linear_velocity=velocity)
    friction = JointFriction("rail", 0.0, transition_speed=1e-3, load_coefficient=coefficient)
    gravity = [0.0, 0.0, -GRAVITY]
    return Scene("rod", mechanism, 0.01, 0.01, gravity, initial_state=state, forces=(friction,))


def sliding_rod(coefficient: float) -> np.ndarray:
    """Acceleration of the cart and of the angle, and normal force, of `leaning_rod`, if it slides."""
    sine, cosine, half, mass, total = np.sin(np.arctan(2.0)), np.cos(np.arctan(2.0)), 0.5, 1.0, 1.001
    equations = [
        [total, -mass * half * sine, -coefficient],
        [-mass * half * sine, 4.0 / 3.0 * mass * half**2, 0.0],
        [0.0, -mass * half * cosine, 1.0],
    ]
    return np.linalg.solve(equations, [0.0, -mass * GRAVITY * half * cosine, total * GRAVITY])


def test_a_rod_slides_below_the_coefficient_at_which_it_jams():
    """Painleve's rod jams above 4/3, with the tangent 2; a light cart changes this little."""
    scene = leaning_rod(1.3)
    system = formulate(scene, "relative")
    acceleration = system.acceleration(*system.coordinates(scene.initial_state))
    wanted = sliding_rod(1.3)
    assert wanted[2] > 0.0
    assert acceleration[0] == pytest.approx(wanted[0], rel=1e-9)
    assert abs(acceleration[1]) == pytest.approx(abs(wanted[1]), rel=1e-9)


RUNS_OF_RODS = SIMULATIONS | {
    "Radau": lambda scene: newton_euler.simulate(scene, integrator="Radau"),
    "RK4": lambda scene: newton_euler.simulate(scene, integrator="RK4", step=1e-3),
}


@pytest.mark.parametrize("engine", ["relative", "cartesian", "Radau", "RK4", "mujoco", "pinocchio"])
def test_a_friction_that_jams_ends_a_run_at_once(engine):
    """A normal force of a sliding rod would be negative."""
    assert sliding_rod(1.37)[2] < 0.0
    with pytest.raises(StoppedError, match=r"'rail' \(load_coefficient 1.37\) jams") as caught:
        RUNS_OF_RODS[engine](leaning_rod(1.37))
    assert caught.value.time == 0.0


def test_a_run_whose_friction_jams_leaves_the_others_of_a_batch():
    values = [1.0, 1.37, 1.2, 1.3]
    batch = newton_euler.simulate_batch(
        leaning_rod(1.0), parameters={"rail.friction.load_coefficient": values}
    )
    assert set(batch.errors) == {1}
    assert "jams" in str(batch.errors[1])
    assert np.all(np.isfinite([batch[k].position for k in (0, 2, 3)]))


def arm_in_a_loaded_bearing() -> Scene:
    """An arm of 2 kg, whose center is 0.5 m from its bearing."""
    arm = Body("arm", MASS, [0.5, 0.0, 0.0], 0.1 * np.eye(3))
    bearing = Revolute("bearing", "ground", "arm", np.zeros(3), axis=[0.0, 1.0, 0.0], actuated=True)
    return scene_of(arm, bearing, JointFriction("bearing", 0.3, load_coefficient=0.01))


def test_statics_have_no_friction_that_grows_with_reactions():
    """Friction is zero at rest: the torque is m g l, and the bearing carries the weight."""
    held = newton_euler.statics(arm_in_a_loaded_bearing(), actuators=["bearing"])
    assert abs(held.actuator_force[0]) == pytest.approx(MASS * GRAVITY * 0.5)
    assert np.linalg.norm(held.reaction_force[0]) == pytest.approx(MASS * GRAVITY)


def test_inverse_dynamics_refuse_friction_that_grows_with_reactions():
    scene = arm_in_a_loaded_bearing()
    with pytest.raises(MechanismError) as caught:
        newton_euler.inverse_dynamics(scene, scene.initial_state, {"bearing": 1.0})
    assert caught.value.element == scene.forces[0].element
