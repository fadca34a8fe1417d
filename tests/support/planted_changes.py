"""Elements that a run is said to test, confirmed: they show when they are changed by 10 %, and no others do.

By a path that shares nothing with `crosscheck.compare.coverage`: another engine gets a scene with the
change, injected as in `crosscheck faults`, and its run is compared with newton_euler's of the
scene as any two engines' are. A joint shows if any tilt of its axes or any shift of its point does. Model
files are excited.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from crosscheck.compare.check import Check
from crosscheck.compare.coverage import Coverage, coverage
from crosscheck.compare.runs import compare_runs
from crosscheck.engines.engine import Engine
from crosscheck.engines.registry import ENGINES
from crosscheck.library import load
from crosscheck.library.model_files import is_model_file
from crosscheck.studies.faults import injection
from crosscheck.studies.faults.injection import Injection
from crosscheck.support.errors import CrosscheckError
from newton_euler.errors import NewtonEulerError
from newton_euler.model.compound_joint import Compound
from newton_euler.model.control import PD
from newton_euler.model.couplings import Gear, JointCoupling, LinearCoupling, PolynomialCoupling
from newton_euler.model.joint import Joint
from newton_euler.model.motions import Sum, TimeFunction
from newton_euler.model.scene import Scene
from newton_euler.model.smooth_functions import Polynomial, Sine
from newton_euler.model.spanning_tree import SpanningTree
from newton_euler.runs.assemble import assemble, initial_state
from newton_euler.scalars import Array

SIZE = 0.1
"""Of changes: relative, in rad, and in sizes of the longest body."""


@dataclass(frozen=True)
class Checked:
    """Elements of a scene, confirmed and not.

    Attributes:
        coverage: what the run is said to test.
        wrong: elements that are tested and do not show, or the other way around, and which of the two.
    """

    coverage: Coverage
    wrong: tuple[str, ...]

    def __str__(self) -> str:
        untested, total = len(self.coverage.untested), len(self.coverage.elements)
        found = f"{self.coverage}; {total - untested} tested and {untested} untested"
        return f"{found}, WRONG: {'; '.join(self.wrong)}" if self.wrong else f"{found}, all confirmed"


def check(scene: Scene, engine: str = "pinocchio") -> Checked:
    """Change each element of a scene in one engine and see whether comparison finds what coverage says."""
    own, other = ENGINES["newton_euler"], ENGINES[engine]
    rows = list(_trajectories(scene, own, other, scene))
    runs = {"newton_euler": own.simulate(scene)}
    said = coverage(scene, runs, rows)
    if said is None or not all(row.agrees for row in rows):
        raise CrosscheckError(f"newton_euler and {engine} differ on {scene.name!r} as it is")
    tested = {covered.element: covered.tested for covered in said.elements}
    wrong = []
    for name, plants in _changes(scene):
        shows = any(_shows(scene, own, other, change) for change in plants)
        if name not in tested or shows != tested.pop(name):
            wrong.append(f"{name} {'shows' if shows else 'does not show'}")
    return Checked(said, (*wrong, *(f"{name} was not changed" for name in tested)))


def _trajectories(scene: Scene, own: Engine, other: Engine, planted: Scene) -> Iterator[Check]:
    """The level of trajectories between two engines, the other one of which has another scene."""
    name = "changed"
    engines = [
        own,
        replace(
            other,
            name=name,
            simulate=lambda _: other.simulate(planted),
            refined=lambda _: other.refined(planted),
        ),
    ]
    runs = {engine.name: engine.simulate(scene) for engine in engines}
    for row in compare_runs(scene, engines, runs, energy=1.0):
        if row.level != "trajectories":
            return
        yield row


def _shows(scene: Scene, own: Engine, other: Engine, change: Injection) -> bool:
    try:
        planted = change(scene)
        planted = replace(planted, initial_state=assemble(planted, initial_state(scene)))
        return not all(row.agrees for row in _trajectories(scene, own, other, planted))
    except NewtonEulerError:
        return True  # an engine that says it cannot run is no engine that agrees


def _changes(scene: Scene) -> Iterator[tuple[str, list[Injection]]]:
    """Names of all elements, and changes of each."""
    more = 1.0 + SIZE
    for body in scene.mechanism.body_names[1:]:
        yield f"mass of body {body!r}", [injection.mass(body, SIZE)]
        heavier: dict[str, Callable[[Any], dict[str, Any]]] = {body: lambda b: {"inertia": more * b.inertia}}
        yield f"inertia of body {body!r}", [injection.change_bodies(heavier)]
    for k, law in enumerate(scene.control):
        assert isinstance(law, PD)
        push = law.feedforward
        changed = {name: more * getattr(law, name) for name in ("stiffness", "damping")}
        changed["feedforward"] = _more(push) if isinstance(push, TimeFunction) else more * push
        yield f"actuator {law.where}", [injection.entry_values("control", k, **changed)]
    for field in ("forces", "armatures"):
        for k, acting in enumerate(getattr(scene, field)):
            for what, attributes in acting.strengths.items():
                values = {attribute: getattr(acting, attribute) for attribute in attributes}
                if any(np.any(value) for value in values.values()):
                    larger = {attribute: more * value for attribute, value in values.items()}
                    yield f"{what} {acting.where}", [injection.entry_values(field, k, **larger)]
    yield from _constraints(scene)


def _constraints(scene: Scene) -> Iterator[tuple[str, list[Injection]]]:
    mechanism = scene.mechanism
    cuts = SpanningTree(mechanism).cuts
    loaded = {each.joint for each in (*scene.joint_forces, *scene.armatures, *scene.motions)}
    loaded |= {key[0] for coupling in mechanism.couplings for key in coupling.factors()}
    for number, joint in enumerate(mechanism.joints):
        if joint.kind != "fixed" and (mechanism.equations[number].count or joint.name in loaded):
            shifts = SIZE * mechanism.largest_extent * np.eye(3)
            plants = [injection.joint_point(joint.name, shift) for shift in shifts]
            plants += injection.tilted_axes(joint, SIZE).values()
            if isinstance(joint, Compound):
                plants += [_tilted_row(joint, axis) for axis in np.eye(3)]
            yield f"{'loop' if number in cuts else 'joint'} {joint.name!r}", plants
    for number, coupling in enumerate(mechanism.couplings):
        yield f"{coupling.kind} {coupling.name!r}", [injection.coupling(number, _regeared(coupling))]
    for number, motion in enumerate(scene.motions):
        start = Polynomial((-SIZE * float(motion.function.value(0.0)),))
        farther = Sum((_more(motion.function), start))
        where = motion.where
        yield f"motion {where}", [injection.entry_values("motions", number, function=farther)]


def _tilted_row(joint: Compound, about: Array) -> Injection:
    """All axes of a compound joint turned."""
    turn = injection.turned_about(about, SIZE)

    def tilt(own: Any) -> Joint:
        second = own.point + turn @ (own.point_on_second - own.point)
        rows = {name: getattr(own, name) @ turn.T for name in ("slides", "hinges", "offsets")}
        return replace(own, point_on_second=second, **rows)

    return injection.change_joint(joint.name, tilt)


def _regeared(own: JointCoupling) -> JointCoupling:
    """A gear or coupling whose factors but the first are larger."""
    if isinstance(own, Gear):
        return replace(own, ratio=(1.0 + SIZE) * own.ratio)
    if isinstance(own, PolynomialCoupling):
        return replace(own, coefficients=tuple((1.0 + SIZE) * c for c in own.coefficients))
    assert isinstance(own, LinearCoupling)
    first, *others = own.terms
    return replace(own, terms=(first, *((a, k, (1.0 + SIZE) * x) for a, k, x in others)))


def _more(function: TimeFunction) -> TimeFunction:
    """The function and `SIZE` of it."""
    if isinstance(function, Sum):
        return Sum(tuple(_more(term) for term in function.terms))
    if isinstance(function, Sine):
        wave = replace(function, amplitude=SIZE * function.amplitude, offset=SIZE * function.offset)
        return Sum((function, wave))
    return Sum((function, Polynomial(tuple(SIZE * c for c in function.coefficients))))


def shortened(source: str, duration: float) -> Scene:
    """A scene by name or file, excited, of so many s at most."""
    options = {"excitation": "on"} if is_model_file(source) else {}
    scene = load(source, **options)
    return replace(scene, duration=min(scene.duration, duration))
