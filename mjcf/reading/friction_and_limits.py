"""Import or leave out the dry friction and the limits of MuJoCo's joints, for `mjcf.reader`.

MuJoCo simulates both by constraints with softness. The constraint force is D (a_ref - a), with the
acceleration a along the constraint and

    a_ref = -b v - k d r,    D = d / ((1 - d) w),

where v and r are rate and depth, w is the inverse inertia of the coordinate (`dof_invweight0`), and d, k and
b follow from `solimp` and `solref`
(https://mujoco.readthedocs.io/en/stable/modeling.html#solver-parameters). A scene has forces without inertia
instead:

- A joint that MuJoCo's friction holds creeps: D b v balances the other forces. Regularized friction creeps
  equally, if the friction F is reached at v = F / (D b).
- A joint that rests on a limit enters it until D k d r balances the other forces. A stop of stiffness D k d
  has the same depth. Its damping, which grows with the depth, is D b at the depth `DAMPED_DEPTH`.

`DEFAULT_SOFTNESS` replaces a `solref` without stiffness or damping.
"""

from __future__ import annotations

from collections.abc import Iterator

import mujoco

from mjcf.layout import element_name
from mjcf.reading.joints import Joints
from mjcf.reading.start import ModelAtStart
from newton_euler.model.source_file import Request
from newton_euler.model.switched_forces import SwitchedElement
from newton_euler.reading.activity import Bounds, FrictionWatch
from newton_euler.reading.approximations import (
    DAMPED_DEPTH,
    DEFAULT_SOFTNESS,
    JointInFile,
    Softness,
    compliant,
    regularized,
)
from newton_euler.reading.import_report import FRICTION, LIMITS, ImportReport
from newton_euler.scalars import Array

MIN_IMPEDANCE, MAX_IMPEDANCE = 1e-4, 0.9999
"""Range of MuJoCo's impedances d."""

DEFAULT_SOLREF = 0.02, 1.0
"""MuJoCo's default of `solref`: time constant, s, and damping ratio."""


def friction_and_limits(
    start: ModelAtStart, joints: Joints, request: Request, report: ImportReport
) -> Iterator[SwitchedElement]:
    """Yield dry friction and stops of all joints that the options ask for, and report all of them.

    Friction and limits that are not simulated get watches, which test a run of any engine.

    Args:
        start: MuJoCo's model and data at the start state.
        joints: imported joints of the tree.
        request: options of the scene.
        report: report that receives the entries.
    """
    for number in range(start.model.njnt):
        if start.model.jnt_limited[number]:
            yield from _limits(start, joints, number, request, report)
        if start.model.dof_frictionloss[start.model.jnt_dofadr[number]]:
            yield from _friction(start, joints, number, request, report)


def _friction(
    start: ModelAtStart, joints: Joints, number: int, request: Request, report: ImportReport
) -> Iterator[SwitchedElement]:
    """Yield the dry friction of MuJoCo's joint `number` if it is simulated, and report it."""
    model, element = start.model, element_name(start.model, "joint", number)
    friction = float(model.dof_frictionloss[model.jnt_dofadr[number]])
    switched_off, key = start.disabled("FRICTIONLOSS"), joints.coordinate_keys.get(number)
    if request.friction == "regularized" and key and not switched_off:
        yield from regularized(_joint_in_file(start, number, element, key), friction, report)
        return
    resting = [FrictionWatch((key,))] if key else []
    why = f"its dry friction {friction:g}"
    report.left_out(element, why, topic=FRICTION, switched_off=switched_off, watches=resting)


def _limits(
    start: ModelAtStart, joints: Joints, number: int, request: Request, report: ImportReport
) -> Iterator[SwitchedElement]:
    """Yield the stops of MuJoCo's joint `number` if they are simulated, and report its limits."""
    model, element = start.model, element_name(start.model, "joint", number)
    low, high = model.jnt_range[number]
    switched_off, key = start.disabled("LIMIT"), joints.coordinate_keys.get(number)
    if key is None:
        why = f"its limits {low:.4g} to {high:.4g}: limits are one-sided and not simulated"
        report.left_out(element, why, topic=LIMITS, switched_off=switched_off)
        return
    x = float(start.data.qpos[model.jnt_qposadr[number]])
    outside = "" if low <= x <= high else f"; the start is outside of them, at {x:.4g}"
    words = f"its limits {low:.4g} to {high:.4g}{outside}"
    # x at the start plus the scene's coordinate, which is zero at the start
    margin, unit = float(model.jnt_margin[number]), _unit(model, number)
    bounds = Bounds(((key, 1.0),), float(low) + margin, float(high) - margin, unit, constant=x)
    if request.limits == "compliant" and not switched_off:
        yield from compliant(_joint_in_file(start, number, element, key), bounds, words, report)
        return
    why = f"{words}: limits are one-sided and not simulated"
    report.left_out(element, why, topic=LIMITS, switched_off=switched_off, watches=[bounds])


def _unit(model: object, number: int) -> str:
    """Return the unit of the coordinate of a hinge or slide."""
    return "m" if model.jnt_type[number] == mujoco.mjtJoint.mjJNT_SLIDE else "rad"  # type: ignore[attr-defined]


def _joint_in_file(start: ModelAtStart, number: int, element: str, key: tuple[str, int]) -> JointInFile:
    """Return MuJoCo's joint `number`, a hinge or slide, with the softness of its friction and limits."""
    model, dof = start.model, int(start.model.jnt_dofadr[number])
    inverse_inertia = float(model.dof_invweight0[dof])
    # friction: impedance at depth 0, and no stiffness
    impedance, _ = _impedances(model.dof_solimp[dof])
    _, damping = _reference_rates(start, model.dof_solref[dof], model.dof_solimp[dof])
    stick_time = DEFAULT_SOFTNESS.stick_time
    if damping > 0.0:
        stick_time = (1.0 - impedance) / (impedance * damping)
    # limits: impedance at large depth
    _, impedance = _impedances(model.jnt_solimp[number])
    stiffness, damping = _reference_rates(start, model.jnt_solref[number], model.jnt_solimp[number])
    softness = DEFAULT_SOFTNESS._replace(stick_time=stick_time)
    if stiffness > 0.0:
        softness = Softness(
            stick_time=stick_time,
            stop_rate=impedance / (1.0 - impedance) * impedance * stiffness,
            stop_dissipation=damping / (impedance * stiffness * DAMPED_DEPTH),
        )
    inertia = 1.0 / inverse_inertia if inverse_inertia > 0.0 else 0.0
    return JointInFile(element, key, _unit(model, number), inertia, softness)


def _impedances(solimp: Array) -> tuple[float, float]:
    """Return the impedances d at depth 0 and at large depth."""
    at_zero, deep = (min(max(float(d), MIN_IMPEDANCE), MAX_IMPEDANCE) for d in solimp[:2])
    return at_zero, deep


def _reference_rates(start: ModelAtStart, solref: Array, solimp: Array) -> tuple[float, float]:
    """Return stiffness k, 1/s^2, and damping b, 1/s, of the reference acceleration of a constraint.

    `solref` is a time constant and a damping ratio, or, if none is positive, minus stiffness and damping.
    MuJoCo replaces a `solref` with only one positive number by `DEFAULT_SOLREF`.
    """
    _, deep = _impedances(solimp)
    first, second = (float(x) for x in solref[:2])
    if (first > 0.0) != (second > 0.0):
        first, second = DEFAULT_SOLREF
    if first <= 0.0:
        return -first / deep**2, -second / deep
    if not start.disabled("REFSAFE"):
        first = max(first, 2.0 * float(start.model.opt.timestep))
    return 1.0 / (deep * first * second) ** 2, 2.0 / (deep * first)
