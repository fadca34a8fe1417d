"""Random mechanisms through all engines: accelerations and reactions at a random consistent state.

Each engine's rigid equations of motion are held against newton_euler's joint coordinates in floats:
accelerations of all bodies; what all joints together do to each body, J^T lambda, which is unique whatever
is redundant; and where nothing is, the reaction of each joint. Now and then native code is held against its
float form.

Round-off in a linear system is magnified by its condition number, at most (N. J. Higham, Accuracy and
Stability of Numerical Algorithms, 2nd ed., 2002, section 7.1). So where a figure exceeds the tolerance, the
condition number of the mechanism's own equations of motion says whether round-off alone can do that.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from crosscheck.studies.random.scenes import GRAVITY, random_scene
from crosscheck.studies.stress.cases import PROCESSES, Progress, Row, Verdict
from crosscheck.workers import LostError, in_processes
from newton_euler.assemble import initial_state
from newton_euler.equations.cartesian import Cartesian
from newton_euler.equations.dense import independent_rows, singular_values
from newton_euler.equations.relative import Relative
from newton_euler.equations.sparse import to_array
from newton_euler.equations.system import Evaluation, System
from newton_euler.errors import NewtonEulerError
from newton_euler.integrators.compiled import FORMULATIONS, Code
from newton_euler.model.scene import Scene
from newton_euler.scalars import Array, cross

TOLERANCE = 1e-8
"""Relative to the largest acceleration or force of a mechanism, of gravity and weight at least."""

TOLERANCE_REASON = "round-off of 1e-16 times condition numbers up to 1e7"

WORST_FIRST: tuple[Verdict, ...] = ("fails", "refuses", "degrades", "survives")

ROUND_OFF = 16.0 * np.finfo(float).eps
"""What a figure may be times the condition number to be explained by it: a few roundings an entry, each of
half an epsilon, on either side of a comparison."""

COMPILED_EVERY = 50
"""Native code of every so manieth mechanism is compared; compiling takes ten times as long as the rest."""

CHUNK = 20
"""Mechanisms that a process does at a time."""

SYSTEMS = {
    "relative": ("newton_euler", "relative, floats"),
    "cartesian": ("newton_euler", "cartesian, floats"),
    "compiled relative": ("newton_euler", "relative, native"),
    "compiled cartesian": ("newton_euler", "cartesian, native"),
    "pinocchio": ("pinocchio", "constraintDynamics"),
    "mujoco_rigid": ("mujoco", "rigid constraints"),
}
"""Engine and setting of all systems that are compared."""


@dataclass(frozen=True)
class Comparison:
    """One random mechanism.

    Attributes:
        seed, number: which `random_scene` it is.
        content: what it is, for people.
        condition: number of the dimensionless matrix of the equations of motion, in the 2-norm; not a number
            where it has none, which explains nothing.
        redundant: how many equations of joints and couplings are.
        gaps: relative difference by the system that is compared and the quantity; infinite for no answer.
        refusals: by system, why it has no answer.
        left: forms of native code that leave this state to their float form, near a singularity.
    """

    seed: int
    number: int
    content: str
    condition: float
    redundant: int
    gaps: dict[tuple[str, str], float]
    refusals: dict[str, str]
    left: tuple[str, ...] = ()

    def gap(self, system: str) -> float:
        """The largest of a system; NaN counts as infinite."""
        found = [gap for (name, _), gap in self.gaps.items() if name == system]
        return max(np.inf if np.isnan(gap) else gap for gap in found)

    @property
    def name(self) -> str:
        return f"random_scene({self.seed}, {self.number})"

    @property
    def bound(self) -> float:
        """Return the tolerance that its condition number allows."""
        return ROUND_OFF * self.condition

    @property
    def systems(self) -> tuple[str, ...]:
        """All that are compared."""
        return tuple(dict.fromkeys(name for name, _ in self.gaps))

    def verdict(self, system: str) -> Verdict:
        """Within the tolerance; explained by the condition number; neither; without an answer."""
        if system in self.refusals:
            return "refuses"
        gap = self.gap(system)
        return "survives" if gap <= TOLERANCE else "degrades" if gap <= self.bound else "fails"


def equations_of_motion(scene: Scene) -> tuple[Array, int]:
    """The dimensionless matrix [[M, B^T], [B, 0]] at a scene's initial state, and its redundant rows.

    Those of `newton_euler.equations.cartesian`, angular accelerations in place of Euler parameters and
    rows of B combined into independent ones; lengths in units of the mechanism's size, masses of its mass.
    """
    system = Cartesian(scene)
    q, v = system.coordinates(initial_state(scene))
    size, mass = scene.mechanism.size, sum(body.mass for body in system.bodies)
    n = 6 * len(system.bodies)
    units = np.tile([size] * 3 + [1.0] * 3, len(system.bodies))
    rows = to_array(system.Phi_q_and_B(q, v)[1], n)
    independent = independent_rows(rows, system.phi_units[: system.rows], units).T @ rows * units
    matrix = np.zeros((n + len(independent),) * 2)
    for k, body in enumerate(system.bodies):
        linear, angular = slice(6 * k, 6 * k + 3), slice(6 * k + 3, 6 * k + 6)
        matrix[linear, linear] = body.mass / mass * np.eye(3)
        matrix[angular, angular] = body.inertia / (mass * size**2)
    matrix[n:, :n], matrix[:n, n:] = independent, independent.T
    return matrix, len(rows) - len(independent)


def joint_wrenches(scene: Scene, evaluation: Evaluation) -> Array:
    """(b, 6) J^T lambda: N and N m about the center of mass that all joints put on each moving body."""
    mechanism, frames = scene.mechanism, initial_state(scene).frames()
    total = np.zeros((len(frames), 6))
    for number, joint in enumerate(mechanism.joints):
        first, second = mechanism.body_index(joint.first), mechanism.body_index(joint.second)
        arm = mechanism.bodies[second].pose.point_to_body(joint.reaction_point)
        point = frames[second].position + frames[second].rotation @ arm
        force, torque = evaluation.reaction_force[number], evaluation.reaction_torque[number]
        for body, sign in ((first, -1.0), (second, 1.0)):
            moment = torque + cross(point - frames[body].position, force)
            total[body] += sign * np.concatenate([force, moment])
    return total[1:]


def _quantities(scene: Scene, evaluation: Evaluation) -> dict[str, Array]:
    """Collect what is compared, (n, 6) each: m/s^2, and N; angular parts count at the mechanism's size."""
    size = scene.mechanism.size
    units = np.array([1.0] * 3 + [size] * 3)
    motion = np.hstack([evaluation.linear_acceleration, evaluation.angular_acceleration])
    reactions = np.hstack([evaluation.reaction_force, evaluation.reaction_torque])
    return {
        "accelerations": motion * units,
        "forces of joints on bodies": joint_wrenches(scene, evaluation) / units,
        "reactions": reactions / units,
    }


def _gaps(scene: Scene, redundant: int, found: Evaluation, wanted: Evaluation) -> dict[str, float]:
    """Relative differences by quantity."""
    weight = GRAVITY * sum(body.mass for body in scene.mechanism.bodies[1:])
    reference, gaps = _quantities(scene, wanted), {}
    for name, x in _quantities(scene, found).items():
        if name != "reactions" or redundant == 0:
            least = GRAVITY if name == "accelerations" else weight
            scale = max(float(np.max(np.abs(reference[name]))), least)
            gaps[name] = float(np.max(np.abs(x - reference[name]))) / scale
    return gaps


def _compiled_gap(scene: Scene, formulation: str) -> float | None:
    """Native accelerations against their float form, relative; None where native code leaves them to that."""
    code = Code(scene, formulation)
    system = code.system
    x = code.packed(*system.coordinates(initial_state(scene)))
    found = code.function("derivative")(x)
    if not found[-1] > 0.0:
        return None
    units, size = system.velocity_units, scene.mechanism.size
    wanted = system.acceleration(x[: system.nq], x[system.nq : code.size]) / units
    scale = max(float(np.max(np.abs(wanted))), GRAVITY / size)
    return float(np.max(np.abs(found[system.nq : -1] / units - wanted))) / scale


def compare_random(seed: int, number: int, compiled: bool = False) -> Comparison:
    """One random mechanism through all engines; `compiled`: native code against its float form too."""
    scene = random_scene(seed, number)
    condition, redundant = _condition(scene)
    gaps, refusals = dict[tuple[str, str], float](), dict[str, str]()
    evaluations = dict[str, Evaluation]()
    for name, build in _systems().items():
        try:
            system = build(scene)
            evaluations[name] = system.evaluate(*system.coordinates(initial_state(scene)))
        except (NewtonEulerError, np.linalg.LinAlgError) as error:
            refusals[name], gaps[name, "no answer"] = str(error), np.inf
    wanted = evaluations.pop(Relative.name, None)
    if wanted is not None:
        for name, found in evaluations.items():
            for quantity, gap in _gaps(scene, redundant, found, wanted).items():
                gaps[name, quantity] = gap
    left = []
    for formulation in FORMULATIONS if compiled else ():
        native = _compiled_gap(scene, formulation)
        if native is None:
            left.append(formulation)
        else:
            gaps[f"compiled {formulation}", "accelerations"] = native
    kinds = " ".join(joint.kind for joint in scene.mechanism.joints)
    content = f"{len(scene.mechanism.bodies) - 1} bodies, {redundant} redundant, {kinds}"
    return Comparison(seed, number, content, condition, redundant, gaps, refusals, tuple(left))


def _condition(scene: Scene) -> tuple[float, int]:
    """The condition number of the equations of motion, and their redundant rows."""
    try:
        matrix, redundant = equations_of_motion(scene)
        _, values, _ = singular_values(matrix)
    except np.linalg.LinAlgError:
        return np.nan, 0
    return float(values[0] / values[-1]) if values[-1] > 0.0 else np.nan, redundant


def _systems() -> dict[str, Callable[[Scene], System]]:
    """By name, the reference among them."""
    from mjcf.rigid import RigidMuJoCo
    from urdf.dynamics import PinocchioSystem

    kinds: tuple[type[Relative | Cartesian | PinocchioSystem | RigidMuJoCo], ...]
    kinds = Relative, Cartesian, PinocchioSystem, RigidMuJoCo
    return {kind.name: kind for kind in kinds}


def compare_some(seed: int, numbers: range) -> list[Comparison]:
    """Some random mechanisms of a seed, native code of every `COMPILED_EVERY`th."""
    return [compare_random(seed, number, number % COMPILED_EVERY == 0) for number in numbers]


def stress_random(count: int, seed: int, progress: Progress) -> list[Row]:
    """Do engines agree on random mechanisms 0 to count - 1 of a seed? See `rows_of`."""
    chunks = [range(start, min(start + CHUNK, count)) for start in range(0, count, CHUNK)]
    start = time.perf_counter()
    results = in_processes(
        partial(compare_some, seed),
        chunks,
        PROCESSES,
        lambda done, _: progress(f"{min(done * CHUNK, count)} of {count} random mechanisms"),
    )
    found = list[Comparison]()
    for chunk, result in zip(chunks, results, strict=True):
        found += [_lost(seed, k, result) for k in chunk] if isinstance(result, LostError) else result
    return rows_of(found, time.perf_counter() - start)


def _lost(seed: int, number: int, error: LostError) -> Comparison:
    """Return the record of a mechanism of a process that native code took along."""
    gaps = {("relative", "no answer"): np.inf}
    return Comparison(seed, number, "not looked at", 1.0, 0, gaps, {"relative": str(error)})


def rows_of(comparisons: Sequence[Comparison], wall_time: float) -> list[Row]:
    """Return rows of a stress report: one per system, and one per mechanism it does not agree on.

    A system passes if it has an answer for all, each within the tolerance or explained by the condition
    number, which the row of that mechanism states.
    """
    summaries, exceptions = [], []
    for system, (engine, setting) in SYSTEMS.items():
        found = [c for c in comparisons if system in c.systems]
        if not found:
            continue
        verdicts = Counter(c.verdict(system) for c in found)
        worst = max(found, key=lambda c: c.gap(system))
        words = [f"{verdicts['survives']} of {len(found)} agree"]
        if verdicts["degrades"]:
            words.append(f"{verdicts['degrades']} explained by their condition numbers")
        if left := sum(system == f"compiled {form}" for c in comparisons for form in c.left):
            words.append(f"{left} left to floats")
        worst_of_all = f"{', '.join(words)}; worst: {worst.name}"
        blank = Row(
            topic="j",
            name="random mechanisms",
            engine=engine,
            setting=setting,
            quantity="accelerations, reactions",
            unit="rel",
            figure=_finite(worst.gap(system)),
            bound=f"<= {TOLERANCE:.0e}",
            bound_reason=TOLERANCE_REASON,
            verdict=next(v for v in WORST_FIRST if verdicts[v]),
            reason=worst_of_all,
            passes=not (verdicts["fails"] or verdicts["refuses"]),
            wall_time=wall_time,
        )
        summaries.append(blank)
        exceptions += [
            replace(
                blank,
                name=c.name,
                figure=_finite(c.gap(system)),
                bound=f"<= {c.bound:.0e}",
                bound_reason=f"{ROUND_OFF:.1e} times condition number {c.condition:.1e}",
                verdict=c.verdict(system),
                reason="; ".join(filter(None, [c.refusals.get(system), c.content])),
                passes=c.verdict(system) == "degrades",
                wall_time=0.0,
            )
            for c in found
            if c.verdict(system) != "survives"
        ]
    return summaries + exceptions


def _finite(figure: float) -> float | None:
    return figure if np.isfinite(figure) else None
