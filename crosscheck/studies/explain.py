"""Contents of a compiled scene: what was kept, what was left out, and what each term costs."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from crosscheck.report.table import Column, Lines, Part, Table
from newton_euler.assemble import initial_state
from newton_euler.codegen.expression import Expression, Graph, Node, operands
from newton_euler.equations.cartesian import Cartesian
from newton_euler.equations.formulation import Formulation
from newton_euler.equations.relative import Relative
from newton_euler.equations.sparse import Rows
from newton_euler.integrators.compiled import FORMULATIONS, PRODUCTS_PER_BODY, Code, cheaper_formulation
from newton_euler.integrators.outputs import time_function
from newton_euler.integrators.run import load
from newton_euler.model.scene import OUTPUTS, Scene
from newton_euler.model.spanning_tree import SpanningTree
from newton_euler.scalars import Array, Scalar, minimum

ARRAYS = {
    "poses": ("position", "quaternion"),
    "velocities": ("linear_velocity", "angular_velocity"),
    "reactions": ("reaction_force", "reaction_torque", "pivot_ratio"),
    "actuation": ("actuator_force",),
    "violation": ("phi",),
    "energy": ("kinetic_energy", "potential_energy"),
}
"""What native code computes for each thing that a scene may ask for."""

BATCH_OPERATIONS = 1_000_000
"""Operations that are timed together: a fraction of a millisecond."""

ROUNDS = 100
"""Timings; the quickest counts, as whatever else the machine does only adds."""

Progress = Callable[[str], None]

Cells = dict[str, str]
"""One column of a table: its lines by name."""


def explain(scene: Scene, progress: Progress) -> Iterator[Part]:
    """All that there is to say of a scene, table by table; `progress` is told each stage."""
    compiled = {}
    for name in FORMULATIONS:
        progress(f"compiling {name}")
        compiled[name] = Code(scene, name)
        load(compiled[name], "DOP853")
    title = f"{scene.name}: {scene.description}"
    yield _table(title, {name: structure(c) for name, c in compiled.items()})
    yield Lines("taken if none is asked for", [f"  {choice(scene)}"])
    terms = {name: _counts(operations_by_term(c)) for name, c in compiled.items()}
    yield _table("operations of a right-hand side, by term", terms)
    outputs = {name: _counts(operations_by_output(scene, name)) for name in FORMULATIONS}
    yield _table("operations of an output, by what is asked for beside poses", outputs)
    yield _table("native code", {name: native_code(c) for name, c in compiled.items()})
    yield Lines("left out, at no cost", [f"  {line}" for line in left_out(compiled["relative"])])


def _table(title: str, columns: Mapping[str, Cells]) -> Table:
    """A line for each name in any column."""
    names = dict.fromkeys(line for cells in columns.values() for line in cells)
    heads = [Column(""), *(Column(name, numeric=True) for name in columns)]
    return Table(
        title, heads, [[line, *(cells.get(line, "") for cells in columns.values())] for line in names]
    )


def _counts(operations: Mapping[str, int]) -> Cells:
    return {name: f"{count:,}" for name, count in operations.items()}


# What was kept


class Trace:
    """A formulation over traced scalars, to look at its terms one by one.

    Attributes:
        graph: of all that was computed so far.
        system: the formulation.
        q, v: (nq,) and (nv,) inputs of the graph.
    """

    def __init__(self, compiled: Code) -> None:
        self.graph = Graph()
        self.system: Formulation = copy.copy(compiled.system)
        self.system.in_use = compiled.rows
        x = self.graph.variables(compiled.size)
        self.q, self.v = x[: self.system.nq], x[self.system.nq :]

    def operations(self, scalars: Iterable[Scalar]) -> set[int]:
        """Operations that these scalars need."""
        return _needed(self.graph.nodes, (x.index for x in scalars if isinstance(x, Expression)))


def _needed(nodes: Sequence[Node], results: Iterable[int]) -> set[int]:
    """Operations that these nodes need; changes of sign do not count."""
    ahead, seen = list(results), set[int]()
    while ahead:
        index = ahead.pop()
        if index not in seen:
            seen.add(index)
            ahead.extend(operands(nodes[index]))
    return {index for index in seen if operands(nodes[index]) and nodes[index][0] != "neg"}


def structure(compiled: Code) -> Cells:
    """Bodies, joints, coordinates and constraint rows of a formulation."""
    system, mechanism = compiled.system, compiled.scene.mechanism
    trace = Trace(compiled)
    unmoved = sum(not row for row in system.phi_and_jacobian(trace.q)[1])
    kept = len(system.tree.joints) if isinstance(system, Relative) else 0
    rows = len(system.phi_units)
    return _counts(
        {
            "bodies that move": len(mechanism.bodies) - 1,
            "joints": len(mechanism.joints),
            "joints that carry coordinates": kept,
            "coordinates": system.work.start,
            "velocities": system.nv,
            "constraint rows": rows,
            "  that nothing can move": unmoved,
            "  that follow from others": rows - unmoved - len(compiled.rows.numbers),
            "  that are solved for": len(compiled.rows.numbers),
            "degrees of freedom": system.nv - len(compiled.rows.numbers),
        }
    )


def choice(scene: Scene) -> str:
    """Say which formulation runs of a scene take, and why."""
    mechanism = scene.mechanism
    products, most = SpanningTree(mechanism).products, PRODUCTS_PER_BODY * len(mechanism.bodies)
    compared = f"{products:,} products along paths of joint coordinates"
    return f"{cheaper_formulation(mechanism)}: {compared}; Cartesian elimination costs as much as {most:,}"


def operations_by_term(compiled: Code) -> dict[str, int]:
    """Operations of the derivative; one that several terms share counts for the first of them."""
    trace = Trace(compiled)
    system, q, v = trace.system, trace.q, trace.v
    acceleration, health = system.sparse_acceleration(q, v, compiled.rows)
    rate = system.rate(q, v)
    left = trace.operations([*rate, *acceleration, minimum(health, 1.0)])
    counts = {}
    for term, scalars in _terms(trace, compiled.rows.numbers):
        own = trace.operations(scalars) & left
        counts[term] = len(own)
        left -= own
    return counts | {"elimination": len(left), "all": sum(counts.values()) + len(left)}


def _terms(trace: Trace, rows: Iterable[int]) -> Iterator[tuple[str, list[Scalar]]]:
    """The terms of the equations of motion before they are solved, by name."""
    system, q, v = trace.system, trace.q, trace.v
    rate = system.rate(q, v)
    work, rate = rate[system.work], np.delete(rate, system.work)
    if isinstance(system, Relative):
        links = system.links(q, v)
        yield "kinematics", [*rate, *(x for link in links for x in _scalars(*link.frame))]
        mass, force = system.sparse_mass_and_force(q, v)
        yield "actuation", [*system.joint_forces(system.measured(q, v)), *system.actuation(q, v)]
        yield "mass matrix", _entries(mass)
        yield "forces", _scalars(force)
        jacobian, right = system.constraints(q, v)
        yield "constraints", [x for k in rows for x in (*jacobian[k].values(), right[k])]
    elif isinstance(system, Cartesian):
        frames = system.frames(q, v)
        yield "kinematics", [*rate, *(x for frame in frames for x in _scalars(*frame))]
        yield "actuation", [*system.joint_forces(system.measured(q, v)), *system.g(q, v)]
        jacobian, gamma = system.Phi_q_and_B(q, v)[1], system.gamma(q, v)
        of_joints = [k for k in rows if k < system.rows]  # the others are the norms of Euler parameters
        yield "constraints", [x for k in of_joints for x in (*jacobian[k].values(), gamma[k])]
    yield "work", list(work)


def _scalars(*arrays: Array) -> list[Scalar]:
    return [x for array in arrays for x in np.ravel(array)]


def _entries(rows: Rows) -> list[Scalar]:
    return [x for row in rows for x in row.values()]


def operations_by_output(scene: Scene, formulation: str) -> dict[str, int]:
    """Operations of one output: poses alone, with each thing that may be asked for, with the scene's own."""
    compiled = Code(replace(scene, outputs=frozenset(OUTPUTS)), formulation)
    program = compiled.program("output")

    def count(*outputs: str) -> int:
        arrays = [array for output in ("poses", *outputs) for array in ARRAYS[output]]
        results = [node for array in arrays for node in program.outputs[compiled.arrays[array][0]]]
        return len(_needed(program.nodes, results))

    counts = {"nothing": count()} | {output: count(output) for output in OUTPUTS}
    return counts | {"all of this scene's": count(*scene.outputs)}


def native_code(compiled: Code) -> Cells:
    """Sizes and times of the code of a formulation."""
    return {
        "object code, kB": f"{compiled.code_size / 1e3:,.1f}",
        "trace time, s": f"{compiled.trace_time:.2f}",
        "compile time, s": f"{compiled.compile_time:.2f}" + (" (cached)" if compiled.from_cache else ""),
    } | {f"{name}, us": f"{1e6 * duration(compiled, name):,.3f}" for name in sorted(compiled.functions)}


def duration(compiled: Code, name: str) -> float:
    """s that one call of a function takes, in the scene's initial state."""
    x = compiled.packed(*compiled.system.coordinates(initial_state(compiled.scene)))
    function = compiled.function(name)
    count = 1 + BATCH_OPERATIONS // (compiled.program(name).operations + 100)
    return min(time_function(function, x, count) for _ in range(ROUNDS)) / count


# What was left out


def left_out(compiled: Code) -> Iterator[str]:
    """List what a general program would compute and this one does not, in joint coordinates."""
    scene, system = compiled.scene, compiled.system
    assert isinstance(system, Relative)
    trace = Trace(compiled)
    links = system.links(trace.q, trace.v)
    if not np.any(scene.gravity):
        yield "gravity: zero"
    if not scene.control:
        yield "actuation: no control law"
    if not system.constrained:
        yield "constraints and their projection: no loops"
    moving = links[1:]
    still = sum(not _varying(link.frame.rotation) for link in moving)
    if still:
        yield f"rotation matrices of {still:,} of {len(moving):,} bodies: constant"
    rates = [x for link in moving for x in _scalars(link.frame.velocity, link.frame.angular_velocity)]
    yield f"body velocities: {sum(not _varying(x) for x in rates):,} of {len(rates):,} components are zero"
    mass, _ = system.sparse_mass_and_force(trace.q, trace.v)
    yield f"mass matrix: {system.nv**2 - len(_entries(mass)):,} of {system.nv**2:,} entries are zero"
    if system.row_owners:
        jacobian = system.phi_and_jacobian(trace.q)[1]
        idle = len(jacobian) - len(compiled.rows.numbers)
        size = len(jacobian) * system.nv
        yield f"constraint Jacobian: {size - len(_entries(jacobian)):,} of {size:,} entries are zero"
        if idle:
            yield f"constraint rows: {idle:,} of {len(jacobian):,} say nothing that others do not"
    missing = [output for output in OUTPUTS if output not in scene.outputs]
    if missing:
        yield f"outputs: {', '.join(missing)} not asked for"


def _varying(scalars: Any) -> bool:
    """True if anything among them depends on the state."""
    return any(isinstance(x, Expression) for x in np.ravel(scalars))
