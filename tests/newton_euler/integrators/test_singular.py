"""Runs through configurations where the constraints lose rank: right or refused, never another motion."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from finite_difference import derivative
from mechanisms import bar, pendulum, seven_hinges
from scipy.integrate import solve_ivp

import newton_euler
import urdf
from crosscheck.compare.check import LEVELS_OF_EQUATIONS
from crosscheck.compare.crosscheck import crosscheck
from crosscheck.compare.outcome import Outcome
from crosscheck.engines.registry import ENGINES, choose
from newton_euler.compiled.equations import OPEN_TOLERANCE
from newton_euler.equations.parameters import parameter_values
from newton_euler.equations.system import MassProperties
from newton_euler.errors import NewtonEulerError
from newton_euler.integrators.constraint_ratio import no_ratio
from newton_euler.integrators.projection import MAX_NATIVE_ITERATIONS, check_still_closed, project
from newton_euler.integrators.row_exchange import no_exchange
from newton_euler.integrators.singular import CROSSING_TARGET, ENDS_SINGULAR_RATIO, crossing_factor
from newton_euler.integrators.status import Status
from newton_euler.integrators.stepper import COUNTS, Equations
from newton_euler.integrators.switches import no_switches
from newton_euler.model.control import PD
from newton_euler.model.joint_kinds import Revolute
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.splines import Steps
from newton_euler.model.state import State
from newton_euler.model.trajectory import IntegrationError, UndeterminedStartError
from newton_euler.runs.assemble import initial_state

Y = np.array([0.0, 1.0, 0.0])
MASSES = (1.0, 2.0, 1.5)


def parallelogram(angle, speed, masses=MASSES, stretch=0.0):
    """Cranks of 1 m on a base of 2 m, unequal bars, from an angle above the base (rad) at a speed (rad/s).

    The coupler is longer than the base by `stretch`, m, the rocker is longer than the crank by about this.
    """
    a, d = np.zeros(3), np.array([2.0, 0.0, 0.0])
    along = np.array([np.cos(angle), 0.0, np.sin(angle)])
    b, c = a + along, d + along + [stretch, 0.0, 0.0]
    ends = (("crank", a, b), ("coupler", b, c), ("rocker", d, c))
    bodies = [bar(name, *pair, mass) for (name, *pair), mass in zip(ends, masses, strict=True)]
    joints = [
        Revolute("A", "ground", "crank", a, axis=Y),
        Revolute("B", "crank", "coupler", b, axis=Y),
        Revolute("C", "coupler", "rocker", c, axis=Y),
        Revolute("D", "ground", "rocker", d, axis=Y),
    ]
    mechanism = Mechanism([Body.ground(), *bodies], joints)
    state, turning = State.initial(mechanism), -speed * Y
    tip = np.cross(turning, along)
    state.linear_velocity[1:] = [0.5 * tip, tip, 0.5 * tip]
    state.angular_velocity[[1, 3]] = turning
    gravity = np.array([0.0, 0.0, -9.81])
    return Scene("parallelogram", mechanism, 2.0, 0.1, gravity, initial_state=state)


def crank(scene):
    """(n, 3) center of the crank: one angle describes it all."""
    about_y = [float(Y @ inertia @ Y) for inertia in MassProperties.of(scene.mechanism).inertia]
    first, middle, last = (body.mass for body in scene.mechanism.bodies[1:])
    inertia = about_y[1] + about_y[3] + 0.25 * (first + last) + middle
    weight = 9.81 * (0.5 * (first + last) + middle)
    x, _, z = scene.mechanism.bodies[1].center_of_mass
    start = [np.arctan2(z, x), -initial_state(scene).angular_velocity[1, 1]]
    angle = solve_ivp(
        lambda t, y: [y[1], -weight / inertia * np.cos(y[0])],
        (0.0, scene.duration), start, method="DOP853", rtol=1e-13, atol=1e-14, t_eval=scene.times,
    ).y[0]  # fmt: skip
    return 0.5 * np.column_stack([np.cos(angle), 0.0 * angle, np.sin(angle)])


STARTS = [(0.01273512508226915, 0.9629523373408642), (0.0331005, 6.3064917), (-0.0946231, 7.5090199)]


def refusal(scene, tolerance, **options):
    """Why a run stopped; empty if it went through, and then it is right."""
    try:
        run = newton_euler.simulate(scene, **options)
    except IntegrationError as caught:
        return str(caught)
    assert np.abs(run.position[:, 1] - crank(scene)).max() < tolerance  # another branch is off by 1
    return ""


@pytest.mark.parametrize("rtol", [1e-9, 1e-10, 1e-11, 1e-12, 1e-13])
@pytest.mark.parametrize(("angle", "speed"), STARTS)
def test_projection_passes_or_refuses(angle, speed, rtol):
    """From a few hundredths of a radian off flat, where the other branch is a meter away."""
    reason = refusal(parallelogram(angle, speed), 1e-6, rtol=rtol, atol=1e-2 * rtol)
    assert not reason or "near a singular configuration" in reason
    assert not reason or rtol < 1e-10  # tighter than round-off allows there


def near_miss(stretch, duration=1.0):
    """The parallelogram from rest at 1 rad; with `stretch` its lengths miss the flat configuration."""
    return replace(parallelogram(1.0, 0.0, stretch=stretch), duration=duration)


@pytest.mark.parametrize(
    ("simulate", "options"),
    [
        (newton_euler.simulate, {}),
        (newton_euler.simulate, {"rtol": 1e-8, "atol": 1e-10}),
        (urdf.simulate, {"rtol": 1e-8, "atol": 1e-10}),
    ],
)
def test_lengths_that_miss_a_singular_configuration_are_to_be_changed(simulate, options):
    """Lengths that miss it by 1e-9 can neither pass nor turn, whatever the tolerance; nothing is stiff."""
    with pytest.raises(IntegrationError, match="near a singular configuration") as caught:
        simulate(near_miss(1e-9, 0.6), **options)
    assert caught.value.time == pytest.approx(0.52394, abs=1e-4)
    for text, is_in in (
        ("all digits", True),
        ("1e-7", True),
        ("rtol=1e-08 in P", not options),
        ("Radau", False),
    ):
        assert (text in caught.value.reason) is is_in


def test_lengths_with_all_digits_pass_and_those_that_differ_enough_turn():
    """The advice of the message above."""
    exact, turned = (
        newton_euler.simulate(near_miss(stretch), rtol=1e-8, atol=1e-10) for stretch in (0.0, 2e-7)
    )
    assert np.abs(exact.position[:, 1] - crank(near_miss(0.0))).max() < 1e-6
    assert np.abs(turned.position - exact.position).max() > 0.1


FORMULATIONS = ("relative", "cartesian")


@pytest.mark.parametrize(
    "options",
    [
        {"stabilization": "baumgarte"},
        {"stabilization": "none"},
        {"integrator": "Radau", "rtol": 1e-8, "atol": 1e-10},
        {"integrator": "Radau", "rtol": 1e-6, "atol": 1e-8},
    ],
)
@pytest.mark.parametrize(("angle", "speed"), [*STARTS, (-1.0, -5.0)])
@pytest.mark.parametrize("light", [None, 1e-3, 1e-6])
def test_what_cannot_pass_says_so(angle, speed, light, options):
    """Also with light cranks: accelerations lose more digits there, and the other branch is as near."""
    masses = MASSES if light is None else (light, 1.0, light)
    reason = refusal(parallelogram(angle, speed, masses), 1e-3, **options)
    assert not reason or (
        "near a singular configuration" in reason and "use DOP853 with projection" in reason
    )


@pytest.mark.parametrize("step", [1e-2, 1e-3, 3e-4])
@pytest.mark.parametrize("stabilization", ["projection", "baumgarte"])
@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize(("angle", "speed"), STARTS[::2])
def test_fixed_steps_pass_or_refuse(angle, speed, formulation, stabilization, step):
    """Of what goes over to the other branch, a meter away, nothing passes for a result."""
    options = {"integrator": "RK4", "step": step, "stabilization": stabilization}
    reason = refusal(parallelogram(angle, speed), 1e-4, formulation=formulation, **options)
    assert not reason or "contradict each other near a singular configuration, where joint" in reason
    # with projection they lose their digits only within 1e-4 rad, where few of these steps end
    assert not reason or stabilization == "baumgarte" or step < 1e-3


@pytest.mark.parametrize("step", [1e-2, 1e-3])
@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize(("angle", "speed"), [STARTS[0], (0.008725, 6.961159), (-0.0934, 7.4808)])
def test_fixed_steps_without_stabilization_pass_or_refuse(angle, speed, formulation, step):
    """What is not seen near by, with long steps, is seen by joints that it opens."""
    options = {"integrator": "RK4", "step": step, "stabilization": "none"}
    # joints that are open by less than 0.01 of the size move the crank by as much
    reason = refusal(parallelogram(angle, speed), 2e-2, formulation=formulation, **options)
    assert not reason or "near a singular configuration" in reason or "drifted by" in reason


def test_a_joint_that_comes_open_ends_a_run_where_it_does():
    """A bar in Cartesian coordinates that nothing holds to its pivot, and what was closed enough before."""
    scene = replace(pendulum(), duration=20.0, outputs=frozenset({"violation"}))
    with pytest.raises(IntegrationError, match=r"joint .pivot. drifted by 0\.\d+ ") as caught:
        newton_euler.simulate(scene, "cartesian", "RK4", step=5e-2, stabilization="none")
    found = caught.value.partial
    rows = len(found.time)
    assert 1 < rows < len(scene.times)
    assert caught.value.time == scene.times[rows]
    assert found.constraint_violation.max() <= 1e-2 * max(1.0, scene.mechanism.largest_extent)
    with pytest.raises(IntegrationError) as unasked:  # for its violation
        newton_euler.simulate(
            replace(scene, outputs=frozenset()), "cartesian", "RK4", step=5e-2, stabilization="none"
        )
    assert unasked.value.time == caught.value.time


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize(("angle", "speed"), STARTS)
def test_steps_of_order_1_stay_on_their_branch(angle, speed, formulation):
    """Their error halves with the step: no digits are lost, and none are there to lose."""
    scene = parallelogram(angle, speed)
    errors = []
    for step in (2e-4, 1e-4):
        run = newton_euler.simulate(scene, formulation, "Euler", step=step)
        errors.append(np.abs(run.position[:, 1] - crank(scene)).max())
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.2)


@pytest.mark.parametrize(
    ("gaps", "stops"),
    [
        ([0.0, 0.005, 0.009], None),
        ([0.0, 0.005, 0.02], 2.0),
        ([0.0, 0.02, 0.0], 1.0),
        ([0.1, 0.15, 0.001], None),  # a start that gains close
        ([0.1, 0.15, 0.21], 2.0),
    ],
)
def test_what_is_open_and_what_has_come_open(gaps, stops):
    scene = pendulum()
    longest = scene.mechanism.largest_extent  # the first residuals of a hinge are lengths
    phi = np.zeros((3, 5))
    phi[:, 1] = longest * np.array(gaps) * [1.0, -1.0, 1.0]
    if stops is None:
        check_still_closed(scene, np.arange(3.0), phi)
        return
    with pytest.raises(IntegrationError, match="joint 'pivot' drifted by") as caught:
        check_still_closed(scene, np.arange(3.0), phi)
    assert caught.value.time == stops


def test_the_joint_that_has_come_open_is_named():
    scene = seven_hinges()
    for k, joint in enumerate(scene.mechanism.joint_names):
        phi = np.zeros((2, 35))
        phi[1, 5 * k] = 0.02 * scene.mechanism.largest_extent
        with pytest.raises(IntegrationError, match=f"joint '{joint}' drifted by"):
            check_still_closed(scene, np.arange(2.0), phi)


def test_a_wheel_on_its_axle_is_as_long_as_its_mass_goes():
    wheel = Body("wheel", 1e-9, np.zeros(3), 1e-21 * np.diag([0.25, 0.5, 0.25]))  # a disk of 1e-6 m
    mechanism = Mechanism([Body.ground(), wheel], [Revolute("axle", "ground", "wheel", np.zeros(3), axis=Y)])
    assert mechanism.largest_extent == pytest.approx(1e-6 / np.sqrt(2.0))  # of its mass, r^2 / 2 on average
    phi = np.array([[0.0] * 5, [2e-8, 0.0, 0.0, 0.0, 0.0]])
    with pytest.raises(IntegrationError, match="joint 'axle' drifted by 2e-08"):
        check_still_closed(Scene("wheel", mechanism, 1.0, 1.0), np.arange(2.0), phi)


@pytest.mark.parametrize(("steps", "status"), [(9.5, Status.DONE), (10.5, Status.OPEN)])
def test_what_the_last_newton_step_leaves_counts(steps, status):
    """Steps that leave a fifth of the residual squared, of a start so many away from the tolerance."""
    assert MAX_NATIVE_ITERATIONS == 10

    def position(x, scratch):
        scratch[:] = [0.2 * x[0], x[0], 1.0]  # the residual squared stands for the state

    x = np.array([OPEN_TOLERANCE**2 * 5.0**steps, 0.0])
    begun = x[0]
    system = Equations(
        n=1,
        nq=1,
        inputs=2,
        flags=0,
        derivative=None,
        dense=None,
        loses_rank=1,
        ratio=no_ratio(),
        projecting=1,
        tolerance=1e-16,
        open_tolerance=OPEN_TOLERANCE,
        lanes=1,
        position=position,
        velocity=None,
        closing=None,
        exchange=no_exchange(2),
        switches=no_switches(),
        projection_work=np.zeros(5),
        pause=None,
        marks=np.zeros(1),
        groups=0,
        members=np.zeros(0),
        counts=np.zeros(COUNTS),
    )
    assert project(system, 0, x) == status
    assert x[0] == pytest.approx(begun * 0.2**10)


@pytest.mark.parametrize("middle", [0.16, 0.4, 0.9])
def test_a_step_that_would_end_in_a_singular_configuration_passes_it(middle):
    """However far away it begins, where the pivot ratio says nothing of the distance."""
    assert crossing_factor(0.98, middle, 4e-6, 1.0) == pytest.approx(
        1.0 - CROSSING_TARGET, abs=ENDS_SINGULAR_RATIO
    )


FLAT = 0.756998197475393
"""s, when parallelogram(1.0, 1.0) first lies flat, by `crank`."""


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("later", [-1e-5, -1e-8, 0.0, 1e-6])
def test_a_run_may_end_in_a_singular_configuration(later, formulation):
    """No step can end there; one goes past it, and is interpolated."""
    scene = replace(parallelogram(1.0, 1.0), duration=FLAT + later, output_period=0.25 * (FLAT + later))
    options = {"formulation": formulation, "rtol": 1e-12, "atol": 1e-12}
    assert not refusal(scene, 1e-10, **options)  # a hundred tolerances: accelerations lose digits there
    (run,) = newton_euler.simulate_batch(scene, [scene.initial_state], **options)
    assert np.array_equal(run.position, newton_euler.simulate(scene, **options).position)


EARLIER = (1e-2, 1e-3, 1e-4, 3e-5, 1e-5, 3e-6, 1e-6, 1e-8, -1e-5)
"""Times of starts before a singular configuration, s."""


@pytest.mark.parametrize(
    ("earlier", "formulation"),
    [
        *((earlier, "relative") for earlier in EARLIER),
        *((earlier, "cartesian") for earlier in (1e-3, 1e-5, -1e-5)),
        *(
            pytest.param(earlier, "cartesian", marks=pytest.mark.slow)
            for earlier in EARLIER
            if earlier not in (1e-3, 1e-5, -1e-5)
        ),
    ],
)
def test_a_start_next_to_a_singular_configuration_is_right_or_refused(earlier, formulation):
    """So many seconds before it: steps may not creep up to it, and leave on another branch."""
    scene = replace(parallelogram(4.5 * earlier, -4.5), duration=0.5, output_period=0.05)
    for rtol in (1e-8, 1e-10, 1e-12):
        reason = refusal(scene, 1e-6, formulation=formulation, rtol=rtol, atol=rtol)
        assert not reason or "near a singular configuration" in reason
        assert not reason or rtol < 1e-10  # tighter than round-off allows there


def with_knot(time):
    """The parallelogram with a law that hardly pushes, whose set-point jumps at a time, s."""
    scene = parallelogram(1.0, 1.0)
    first, *others = scene.mechanism.joints
    mechanism = Mechanism(scene.mechanism.bodies, [replace(first, actuated=True), *others])
    law = PD("A", 1e-12, 1e-12, Steps([0.0, time], [0.3, 0.4]))
    return replace(scene, mechanism=mechanism, control=(law,), duration=1.0)


def test_a_run_goes_on_from_a_knot_near_a_singular_configuration():
    assert not refusal(with_knot(FLAT - 1e-3), 1e-8, rtol=1e-10, atol=1e-10)  # a hundred tolerances


def test_a_knot_next_to_a_singular_configuration_is_refused():
    """The part of a run that begins there could leave on another branch."""
    with pytest.raises(IntegrationError, match=r"singular configuration, where joint '\w+'") as refused:
        newton_euler.simulate(with_knot(FLAT - 1e-5))
    assert refused.value.time == FLAT - 1e-5


# Starting flat


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize(
    "options", [{}, {"integrator": "RK4", "step": 1e-3}, {"integrator": "Euler", "step": 1e-3}], ids=str
)
def test_a_flat_start_in_motion_goes_on(formulation, options):
    scene = parallelogram(0.0, 2.0)
    run = newton_euler.simulate(scene, formulation, **options)
    # 1e-3 of a radian a step: of order 1, and of order 4 but for the digits lost at passages
    tolerance = {"RK4": 1e-3, "Euler": 1e-2}.get(options.get("integrator"), 1e-8)
    assert np.abs(run.position[:, 1] - crank(scene)).max() < tolerance


INTEGRATORS = [
    {},
    {"integrator": "Radau", "rtol": 1e-7, "atol": 1e-9},
    {"integrator": "RK4", "step": 1e-3},
    {"integrator": "Euler", "step": 1e-3},
]

SLOW = ("Radau", "cartesian")
"""Whose Jacobian takes seconds to compile."""

BOTH_FORMULATIONS = [
    pytest.param(
        options,
        formulation,
        marks=[pytest.mark.slow] * ((options.get("integrator"), formulation) == SLOW),
        id=f"{options}-{formulation}",
    )
    for options in INTEGRATORS
    for formulation in FORMULATIONS
]


@pytest.mark.parametrize(("options", "formulation"), BOTH_FORMULATIONS)
def test_a_flat_start_at_rest_is_refused(formulation, options):
    """Both branches begin with the same velocities, none; no equation tells them apart."""
    with pytest.raises(UndeterminedStartError) as caught:
        newton_euler.simulate(parallelogram(0.0, 0.0), formulation, **options)
    assert caught.value.time == 0.0
    message = (
        r"the run starts at rest at a singular configuration, where joint '[A-D]' loses rank, "
        r"and the direction of motion is undetermined"
    )
    assert re.search(message, caught.value.reason)


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_a_flat_start_between_the_branches_is_refused(formulation):
    """Of a flat parallelogram the cranks turn alike, or as long as they lie flat the other way.

    Velocities of both cranks at once, other than these, meet the constraints, and no motion has them.
    """
    scene = parallelogram(0.0, 1.0)
    assert newton_euler.simulate(scene, formulation).settings["steps"] > 0
    other = parallelogram(0.0, 0.0)
    state = scene.initial_state
    start = newton_euler.start(other, A=(0.0, 1.0))
    assert not np.allclose(start.initial_state.angular_velocity, state.angular_velocity)
    with pytest.raises(UndeterminedStartError, match="between the branches") as caught:
        newton_euler.simulate(start, formulation)
    assert caught.value.time == 0.0


def test_runs_of_an_undetermined_start_are_not_compared():
    """Engines may take either branch; their equations are compared at regular states."""
    found = crosscheck(parallelogram(0.0, 0.0), choose([*ENGINES]), lambda _: None, "x", {})
    assert found.outcome is Outcome.UNFINISHED
    # round-off decides whether another engine leaves the singular configuration or stops there
    assert [stop.what for stop in found.unfinished if stop.undetermined] == ["newton_euler"]
    assert (found.diagnosis, found.notes, found.run_errors) == ((), (), {})
    levels = {row.level for row in found.checks}
    assert levels >= set(LEVELS_OF_EQUATIONS)
    assert not levels & {"trajectories", "drift"}


@pytest.mark.parametrize("stabilization", ["projection", "none"])
@pytest.mark.parametrize(("options", "formulation"), BOTH_FORMULATIONS)
def test_flat_bars_that_nothing_pulls_at_stay(formulation, options, stabilization):
    scene = replace(parallelogram(0.0, 0.0), gravity=np.zeros(3))
    if "step" in options:
        options = options | {"step": 0.1}  # in Python, where the dense path is
    run = newton_euler.simulate(scene, formulation, stabilization=stabilization, **options)
    assert np.ptp(run.position, axis=0).max() < 1e-12
    assert run.kinetic_energy.max() < 1e-24


@pytest.mark.parametrize("stabilization", ["baumgarte", "none"])
@pytest.mark.parametrize("options", INTEGRATORS[:3], ids=str)
def test_a_flat_start_without_projection_is_refused(options, stabilization):
    with pytest.raises(
        IntegrationError, match="starts without projection at a singular configuration"
    ) as caught:
        newton_euler.simulate(parallelogram(0.0, 2.0), stabilization=stabilization, **options)
    assert caught.value.time == 0.0


@pytest.mark.parametrize("duration", [1.0, FLAT])
@pytest.mark.parametrize("name", ["gravity.z", "crank.center_of_mass.x"])
def test_derivatives_past_singular_configurations_are_right(name, duration):
    """Passing one, or ending there, loses digits alone, where parameters move no closed configurations."""
    start = STARTS[0] if duration == 1.0 else (1.0, 1.0)
    scene = replace(parallelogram(*start), duration=duration, output_period=0.1 * duration)
    options = {"rtol": 1e-12, "atol": 1e-14}
    found = newton_euler.sensitivities(scene, [name], **options)
    (own,) = parameter_values(scene, [name]).values()

    def moved(s):
        return newton_euler.simulate_batch(scene, parameters={name: [own + s]}, **options)[0].quaternion

    # of the two runs' error, 1e-10 near the singular configuration, over a difference of 1e-2
    assert np.abs(found.quaternion[..., 0] - derivative(moved, 1e-2)).max() < 1e-7


def test_a_start_in_a_singular_configuration_has_no_derivatives():
    with pytest.raises(NewtonEulerError, match="too near to a singular configuration"):
        newton_euler.sensitivities(parallelogram(0.0, 2.0), ["gravity.z"])


@pytest.mark.parametrize("rtol", [1e-4, 1e-6, 1e-9, 1e-12])
@pytest.mark.parametrize(("angle", "speed"), STARTS)
def test_geometry_has_no_derivatives_past_singular_configurations(angle, speed, rtol):
    """Wherever steps end: a joint point that is off has the loop open there.

    Where rtol is that of round-off the run itself may stop there, one of six by the last bits of its start.
    """
    scene = replace(parallelogram(angle, speed), duration=1.0)
    with pytest.raises(NewtonEulerError, match=r"near (to )?a singular configuration"):
        newton_euler.sensitivities(scene, ["B.point.x"], rtol=rtol, atol=1e-2 * rtol)
