"""(g) Start poses that are off the constraints: what assembly makes of them, and what each engine does."""

from __future__ import annotations

import copy
from dataclasses import replace
from functools import partial

import numpy as np

from crosscheck.scenes import load
from crosscheck.studies.stress.cases import REFUSAL, Bound, Case, Curve, Measured
from crosscheck.studies.stress.runs import (
    FORMULATIONS,
    Setting,
    lasting,
    mujoco,
    newton_euler,
    pinocchio,
)
from newton_euler.assemble import CHECKED, assemble, initial_state
from newton_euler.integrators.projection import joint_violations
from newton_euler.model.euler_parameters import from_rotation_vector
from newton_euler.model.euler_parameters import product as quaternion_product
from newton_euler.model.mechanism import CLOSURE_TOLERANCE
from newton_euler.model.scene import Scene
from newton_euler.model.state import State

OFFSETS = (1e-12, 1e-10, 1e-8, 1e-6, 1e-4, 1e-2)
"""m and rad, of each body in a direction of its own."""

DURATION = 5.0
OUTPUTS = 50

ASSEMBLED = Bound(1e-14, CLOSURE_TOLERANCE, "round-off of residuals on a machine of 0.1 m")

SETTINGS: tuple[Setting, ...] = (
    *(
        newton_euler(formulation, s)
        for formulation in FORMULATIONS
        for s in ("projection", "baumgarte", "none")
    ),
    mujoco(),
    mujoco("implicitfast"),
    pinocchio(),
    pinocchio(stabilization="projection"),
    pinocchio(stabilization="none"),
)


def cases(full: bool) -> list[Case]:
    """All of (g)."""
    made = []
    for offset in OFFSETS if full else OFFSETS[1::2]:
        what = f"tracker, bodies {offset:.0e} m and rad off"
        made.append(
            Case("g", what, "newton_euler", "assemble", "open after assembly", "m or rad", ASSEMBLED,
                 partial(measure_assembly, offset))
        )  # fmt: skip
        if offset > CLOSURE_TOLERANCE:
            made.append(
                Case("g", what, "all", "Scene(initial_state=...)", "open at start", "m or rad", REFUSAL,
                     partial(measure_scene, offset), names=("joint", "initial state"))
            )  # fmt: skip
        closed = Bound(
            CLOSURE_TOLERANCE,
            10.0 * max(offset, CLOSURE_TOLERANCE),
            "closes again, or at least does not open",
        )
        made.extend(
            Case("g", f"{what}, unchecked, {DURATION:g} s", setting.engine, str(setting), "open at the end",
                 "m or rad", closed, partial(measure_run, offset, setting), limit=40.0)
            for setting in SETTINGS
        )  # fmt: skip
    return made


def off_state(scene: Scene, offset: float) -> State:
    """The initial state with each moving body shifted and turned that far, m and rad; same each time."""
    rng = np.random.default_rng(0)
    state = copy.deepcopy(initial_state(scene))
    for body in range(1, len(state.position)):
        shift, turn = (offset * d / np.linalg.norm(d) for d in rng.standard_normal((2, 3)))
        state.position[body] += shift
        state.quaternion[body] = quaternion_product(from_rotation_vector(turn), state.quaternion[body])
    return state


def measure_assembly(offset: float) -> Measured:
    """What stays open of the joints; in words how far bodies are moved."""
    scene = load("tracker")
    guess = off_state(scene, offset)
    state = assemble(scene, guess)
    moved = float(np.max(np.linalg.norm(state.position - guess.position, axis=1)))
    figure = float(np.max(joint_violations(scene.mechanism, state)))
    return Measured(
        figure, f"bodies moved by {moved:.1e} m, {moved / offset:.1f} times as far as they were off"
    )


def measure_scene(offset: float) -> Measured:
    """What a scene with that state is open by, if it can be made."""
    scene = load("tracker")
    changed = replace(scene, initial_state=off_state(scene, offset))
    return Measured(float(np.max(joint_violations(scene.mechanism, initial_state(changed)))))


def measure_run(offset: float, setting: Setting) -> Measured:
    """What is open at the end of a run that begins there."""
    scene = lasting(load("tracker"), DURATION, OUTPUTS, "violation")
    # past the check of initial states, to see what engines do by themselves
    state = off_state(scene, offset)
    scene = replace(scene, initial_state=state)
    CHECKED[scene] = state
    run = setting.simulate(scene)
    assert run.constraint_violation is not None
    openings = np.max(run.constraint_violation, axis=1)
    figure = float(openings[-1])
    curve = Curve(
        "start off the constraints",
        "bodies off, m and rad",
        f"open after {DURATION:g} s, m or rad",
        f"{setting.engine}, {setting}",
        (offset,),
        (max(figure, 1e-18),),
    )
    return Measured(figure, f"at most {np.max(openings):.1e} in between", (curve,))
