"""Compiled scenes against their float form."""

from __future__ import annotations

import os
import signal
import threading
from dataclasses import replace

import numpy as np
import pytest
from ball_scenes import SCENES as BALLS
from constrained_motion import moving
from elements import COUPLED, FORCES
from mechanisms import GRAVITY, REGULAR, bar, bolted, planar_four_bar

import newton_euler
from crosscheck.library import SCENES, load
from newton_euler import compile_scene
from newton_euler.compiled.equations import CompiledEquations
from newton_euler.compiled.formulations import FORMULATIONS, formulate
from newton_euler.equations.relative import Relative
from newton_euler.equations.system import constraint_rate
from newton_euler.integrators.options import Options
from newton_euler.model.compound_joint import Compound
from newton_euler.model.euler_parameters import from_rotation_vector, rotation
from newton_euler.model.joint_kinds import Fixed, Free, Revolute, Spherical
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.reading.excitation import random_states
from newton_euler.runs.assemble import initial_state
from newton_euler.runs.simulate import run

LIBRARY = {name: lambda name=name: load(name) for name in SCENES if not name.startswith("tracker_")}


def skew_hinges() -> Scene:
    """An arm on three hinges that are not perpendicular, whose end a body without other joints hangs on.

    In their mass matrix some numbers are zero, and others nothing but round-off.
    """
    end = [0.2, 0.0, 0.0]
    bodies = [
        Body.ground(),
        Body("arm", 0.3, [0.1, 0.0, 0.0], np.diag([6e-5, 1.2e-3, 1.2e-3])),
        Body("box", 0.2, end, np.diag([1.7e-4, 1.3e-4, 9e-5])),
    ]
    joints = [
        Compound("shoulder", "ground", "arm", [0.0, 0.0, 0.0], hinges=[[3, 1, 0], [0, 3, 1], [1, 0, 3]]),
        Free("free", "ground", "box", end),
        Spherical("hand", "arm", "box", end),
    ]
    return Scene("skew_hinges", Mechanism(bodies, joints), 1.0, 0.01, GRAVITY)


BUILDS = (
    LIBRARY
    | {build.__name__: build for build in REGULAR}
    | {build.__name__: build for build in (planar_four_bar, skew_hinges)}
    | {f"a second {kind.kind} bolt": lambda kind=kind: bolted(kind) for kind in (Fixed, Spherical)}
)

CONDITION = {"slider_tree": 10.0, "andrews": 10.0, "excavator": 10.0}
"""Scenes whose accelerations differ by more than 1e-12 between any two forms, floats included. One unit in
the last place of all coordinates and velocities changes those of `excavator` by 1.4e-12 in one of 1000
states."""

STIFFEST = {"excavator": 8e7}
"""Stiffness of control laws, N/m, that magnifies the round-off of lengths of a meter in their forces."""


@pytest.mark.parametrize("count", [20, pytest.param(1000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("name", BUILDS)
def test_accelerations_are_the_float_forms(name, formulation, count):
    scene = BUILDS[name]()
    system = formulate(scene, formulation)
    compiled = CompiledEquations(scene, formulation)
    tolerance = 1e-12 * CONDITION.get(name, 1.0)
    for state in random_states(scene, count):
        q, v = system.coordinates(state)
        found = compiled.function("derivative")(compiled.packed(q, v))
        wanted = system.acceleration(q, v)
        assert found[-1] > 0.0
        assert np.abs(found[system.nq : -1] - wanted).max() < tolerance * max(np.abs(wanted).max(), 1.0)
        rate = system.rate(q, v)
        power = 1e-16 * STIFFEST.get(name, 0.0) * np.abs(v).max()  # error of forces times rates, W
        least = np.full(system.nq, 1e-14)
        least[-1] += power
        assert np.all(np.abs(found[: system.nq] - rate) <= np.maximum(1e-13 * np.abs(rate), least))


BEYOND = COUPLED | {name: FORCES[f"forces, {name}"] for name in ("ball_loop", "seven_hinges", "slider_tree")}
BEYOND |= {name: BALLS[name] for name in ("ball in a loop", "compound, reversed")}
"""Scenes with couplings, motions, springs and rotors."""

FORMS = [(name, "relative") for name in BEYOND] + [
    (name, "cartesian") for name in BEYOND if "cut" not in name
]
"""Where loops are cut makes no difference to the Cartesian form."""


@pytest.mark.parametrize(("name", "formulation"), FORMS)
def test_rates_powers_and_projections_are_the_float_forms(name, formulation):
    """At several times, in states that projection brings back to round-off."""
    code = CompiledEquations(BEYOND[name], formulation)
    largest_error = 1e-11 if name in ("slider_tree", *BALLS) else 1e-12  # conditions of 1e4, and of 1e3
    for seed, t in enumerate((0.0, 0.1, 0.4)):
        now, q, v = moving(code.system, t, seed)
        found = code.function("derivative")(code.packed(q, v, t))
        wanted = np.concatenate([now.rate(q, v), now.acceleration(q, v)])
        assert found[-1] > 0.0
        assert np.abs(found[:-1] - wanted).max() < largest_error * np.abs(wanted).max()
        assert found[now.work] == pytest.approx(wanted[now.work], rel=1e-11)  # power
        if not len(now.phi(q)):
            continue
        closed = code.function("velocity")(code.packed(q, v + 0.1 * now.velocity_units, t))
        assert np.abs(constraint_rate(now, closed[: now.nq], closed[now.nq : code.size])).max() < 1e-12
        moved = now.retract(q, 1e-4 * now.velocity_units * np.cos(np.arange(now.nv)))
        for _ in range(4):
            moved = code.function("position")(code.packed(moved, v, t))[: now.nq]
        assert np.abs(now.phi(moved)).max() < 1e-13


@pytest.mark.parametrize("formulation", ["relative", "cartesian"])
def test_runs_are_the_float_forms(tracker, formulation):
    """The same steps, so the same trajectory to the growth of round-off; scipy takes them in floats."""
    scene = replace(tracker, duration=0.2)
    compiled = newton_euler.simulate(scene, formulation, rtol=1e-10, atol=1e-12)
    floats = run(formulate(scene, formulation), "newton_euler", Options(rtol=1e-10, atol=1e-12), {})
    for name, tolerance in (
        ("position", 1e-11),  # round-off shifts a step size, and errors are 1e-12 a step
        ("quaternion", 2e-10),
        ("linear_velocity", 2e-10),  # of motions that end within 0.05 s
        ("reaction_force", 1e-8),
        ("reaction_torque", 1e-9),
        ("actuator_force", 5e-9),  # 25 N s/m of such velocities
    ):
        assert np.abs(getattr(compiled, name) - getattr(floats, name)).max() < tolerance, name
    assert compiled.kinetic_energy == pytest.approx(floats.kinetic_energy, abs=1e-10)
    assert compiled.constraint_violation.max() < 1e-14


def test_operations_of_the_tracker(tracker):
    """No more than the limit study's 1,867; and 6,043, with a step of refinement on top."""
    assert CompiledEquations(tracker).program("derivative").operation_count <= 1867
    assert CompiledEquations(tracker, "cartesian").program("derivative").operation_count <= 7450


def test_gravity_costs_nothing_when_there_is_none(tracker):
    heavy = replace(tracker, gravity=(0.0, 0.0, -9.81), initial_state=None)
    light, with_gravity = (
        CompiledEquations(scene).program("derivative").operation_count for scene in (tracker, heavy)
    )
    assert light < with_gravity


def test_outputs_that_are_not_asked_for_are_not_computed(tracker):
    everything = CompiledEquations(tracker).program("output").operation_count
    poses = CompiledEquations(replace(tracker, outputs=frozenset())).program("output").operation_count
    assert poses < 0.25 * everything


def test_a_singular_configuration_takes_the_dense_path():
    """Started flat, the planar loop has two freedoms in place of one; the float form knows how to go on."""
    scene = flat_four_bar()
    compiled = CompiledEquations(scene)
    system = compiled.system
    x = compiled.packed(*system.coordinates(initial_state(scene)))
    assert compiled.function("derivative")(x)[-1] <= 0.0
    # under gravity its way out is not determined; with nothing that pulls it stays
    resting = compile_scene(replace(scene, gravity=(0.0, 0.0, 0.0)), stabilization="none").simulate()
    assert resting.settings["dense"] > 0
    assert np.array_equal(resting.position[-1], resting.position[0])


def flat_four_bar():
    """A parallelogram with all four bars on one line."""
    points = {"a": [0.0, 0.0, 0.0], "b": [0.5, 0.0, 0.0], "c": [1.5, 0.0, 0.0], "d": [1.0, 0.0, 0.0]}
    bodies = [Body.ground()]
    bodies += [bar(f"{i}{j}", points[i], points[j]) for i, j in ("ab", "bc", "dc")]
    names = {"a": ("ground", "ab"), "b": ("ab", "bc"), "c": ("bc", "dc"), "d": ("ground", "dc")}
    joints = [Revolute(p, *names[p], points[p], axis=[0.0, 1.0, 0.0]) for p in "abcd"]
    return Scene("flat", Mechanism(bodies, joints), 0.01, 0.01, (0.0, 0.0, -9.81))


def tilted(scene):
    """The same scene turned as a whole, so that nothing is zero but in exact arithmetic."""
    a = rotation(from_rotation_vector(np.array([0.4, -0.7, 1.1])))
    bodies = [
        replace(body, center_of_mass=a @ body.center_of_mass, inertia=a @ body.inertia @ a.T)
        for body in replace_frames(scene.mechanism.bodies)
    ]
    joints = [
        replace(joint, point=a @ joint.point, point_on_second=a @ joint.point_on_second, axis=a @ joint.axis)
        for joint in scene.mechanism.joints
    ]
    mechanism = newton_euler.Mechanism(bodies, joints)
    return replace(scene, mechanism=mechanism, gravity=a @ scene.gravity, initial_state=None)


def replace_frames(bodies):
    """The same bodies, their frames parallel to the world."""
    turns = [rotation(body.quaternion) for body in bodies]
    return [
        replace(body, inertia=r @ body.inertia @ r.T, quaternion=np.array([1.0, 0.0, 0.0, 0.0]))
        for body, r in zip(bodies, turns, strict=True)
    ]


@pytest.mark.parametrize(
    ("formulation", "stabilization"),
    [
        *(("relative", stabilization) for stabilization in ("none", "projection", "baumgarte")),
        ("cartesian", "projection"),
        pytest.param("cartesian", "none", marks=pytest.mark.slow),
        pytest.param("cartesian", "baumgarte", marks=pytest.mark.slow),
    ],
)
def test_a_flat_loop_out_of_the_axes_moves_as_one_along_them(formulation, stabilization):
    """Its redundant rows are round-off, which must be taken neither for constraints nor for motion."""
    flat = replace(planar_four_bar(), duration=0.5)
    straight, turned = (compile_scene(scene, formulation, stabilization) for scene in (flat, tilted(flat)))
    system = turned.system
    assert system.nv - len(turned.rows.numbers) == 1
    assert turned.redundant
    runs = [compiled.simulate(rtol=1e-9, atol=1e-11) for compiled in (straight, turned)]
    heights = [-run.potential_energy / 9.81 for run in runs]
    # tolerance 1e-9 a step, some forty steps; Baumgarte's decay and drift without it are of that size
    assert np.abs(heights[0] - heights[1]).max() < 1e-6
    assert np.ptp(heights[0]) > 0.05  # it does move
    forces = [np.linalg.norm(run.reaction_force[0], axis=1) for run in runs]
    assert forces[0] == pytest.approx(forces[1], rel=1e-8)
    assert runs[1].settings["dense"] == 0


@pytest.mark.parametrize("integrator", ["DOP853", "Radau"])
@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_a_scene_in_which_nothing_can_move(formulation, integrator):
    bodies = [newton_euler.Body.ground(), bar("post", [0.0, 0.0, 0.0], [0.0, 0.0, 1.0])]
    mechanism = newton_euler.Mechanism(bodies, [Fixed("bolt", "ground", "post", [0.0, 0.0, 0.0])])
    scene = newton_euler.Scene("post", mechanism, 0.1, 0.1, gravity=(0.0, 0.0, -9.81))
    run = newton_euler.simulate(scene, formulation, integrator)
    assert run.position[-1, 1] == pytest.approx([0.0, 0.0, 0.5], abs=1e-12)
    assert run.reaction_force[-1, 0] == pytest.approx([0.0, 0.0, 9.81], abs=1e-9)


def test_what_the_dense_path_raises_is_not_lost(monkeypatch):
    """Python may fail inside native code; the run must not go on as if it had not."""

    def broken(self, q, v):
        raise ZeroDivisionError("by design")

    monkeypatch.setattr(Relative, "acceleration", broken)
    with pytest.raises(ZeroDivisionError, match="by design"):
        newton_euler.simulate(flat_four_bar(), stabilization="none")


def test_an_interrupt_stops_native_code(tracker):
    compiled = compile_scene(replace(tracker, duration=1e5, output_period=1e3, outputs=frozenset()))
    threading.Timer(0.3, lambda: os.kill(os.getpid(), signal.SIGINT)).start()
    with pytest.raises(KeyboardInterrupt):
        compiled.simulate("RK4", step=1e-4, most_steps=10**9)  # minutes
