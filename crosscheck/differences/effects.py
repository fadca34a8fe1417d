"""Effect of each differing number of two robot files on the motion.

In: common states of two robots, and rows of differences. Out: for each row, the relative change of
accelerations of the first robot if this row's numbers, and no others, are taken from the second file. The
equations are evaluated again for each row, at the states in which `crosscheck.differences.motion` compares.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TypeVar

from crosscheck.differences.causes import LENGTHS
from crosscheck.differences.common_states import CommonStates
from crosscheck.differences.difference import Difference, Quantity, Standing
from crosscheck.differences.merged_robot import Merged, merged
from crosscheck.differences.motion import relative_changes
from crosscheck.differences.springs import SPRING_NUMBERS
from newton_euler.reading.robot import FileBody, FileCoupling, FileLoop, FileSpring, Robot
from newton_euler.scalars import Array

Fields = Mapping[Quantity, tuple[str, ...]]
"""Names of fields of a description, by the quantity of a row."""

MASS_FIELDS: Fields = {
    Quantity.MASS: ("mass",),
    Quantity.CENTER: ("center",),
    Quantity.INERTIA: ("inertia",),
    Quantity.INERTIA_AXES: ("inertia",),
}
"""Fields of a body, by the quantity of a row."""

JOINT_FIELDS: Fields = {
    Quantity.JOINT_ORIGIN: ("point",),
    Quantity.JOINT_AXIS: ("axis",),
    Quantity.DAMPING: ("damping",),
    Quantity.ARMATURE: ("armature",),
    Quantity.STIFFNESS: ("stiffness",),
    Quantity.REST: ("rest",),
}
"""Fields of a joint, by the quantity of a row."""

PLACEMENT_FIELDS: Fields = {
    Quantity.JOINT_ORIGIN: ("position",),
    Quantity.JOINT_AXIS: ("rotation",),
    Quantity.JOINT_ORIENTATION: ("rotation",),
    Quantity.ZERO: ("rotation",),
    Quantity.BASE: ("position", "rotation"),
}
"""Fields of the placement of a joint's body in its parent, by the quantity of a row."""

DRIVE_FIELDS: Fields = {
    Quantity.PRESENCE: ("gears",),
    Quantity.TRANSMISSION: ("gears",),
    Quantity.GEAR: ("gears",),
    Quantity.GAIN: ("gain",),
    Quantity.KP: ("stiffness", "gain", "constant"),
    Quantity.KV: ("damping",),
    Quantity.CONSTANT: ("constant",),
}
"""Fields of a drive, by the quantity of a row."""

DRIVE_FIELDS_OF_JOINT: Fields = {Quantity.SIGN: ("gears", "constant"), Quantity.ZERO: ("constant",)}
"""Fields of the drives of a joint, by the quantity of a row of the joint."""

LOOP_FIELDS: Fields = {
    Quantity.LOOP_POINT: ("first_frame", "second_frame"),
    Quantity.LOOP_AXIS: ("first_frame", "second_frame"),
    Quantity.LOOP_LENGTH: ("length",),
}
"""Fields of a loop, by the quantity of a row."""

SPRING_FIELDS: Fields = {
    Quantity.SPRING_POINT: ("first_frame", "second_frame"),
    **{quantity: (field,) for quantity, (field, _) in SPRING_NUMBERS.items()},
}
"""Fields of a spring between points, by the quantity of a row."""

REPLACED = (Quantity.PRESENCE, Quantity.KIND)
"""Quantities of a loop, coupling or spring that is exchanged as a whole."""


def effects(states: CommonStates | None, rows: Sequence[Difference]) -> list[float | None]:
    """Return the effect of each row on the motion.

    Args:
        states: common states of both robots, see `crosscheck.differences.common_states.common_states`.
        rows: differences of the two files.

    Returns:
        for each row, the largest change of the acceleration of a body relative to its acceleration; 0 for a
        convention; None for numbers that are no part of the equations of motion, such as limits, and for
        joints that cannot be exchanged one by one.
    """
    found: list[float | None] = [0.0 if row.standing is Standing.CONVENTION else None for row in rows]
    if states is None or not states.is_closed:
        return found
    terms = merged(states.one.robot, states.two.robot, states.agreeing)
    before = states.of_first([terms.first])
    # the mass of a base that is held to compare has an effect that is not computed
    is_held = any(cut.base >= 0 for cut in states.cuts)
    moving = {pair.first for pair in states.pairs}
    first = states.files[0].robot
    held = {first.bodies[pair.first[0]].name for pair in states.agreeing.bodies if pair.first not in moving}
    # robots of one structure are evaluated at once
    groups: dict[tuple[object, ...], list[tuple[int, Robot]]] = defaultdict(list)
    for index, row in enumerate(rows):
        if row.standing is Standing.CONVENTION or (is_held and {*row.elements} <= held):
            continue
        changed = _changed(terms, row, rows)
        if changed is not None and row.consequences:
            changed = _with_consequences(terms, changed, {*row.consequences})
        if changed is not None:
            groups[_structure(changed)].append((index, changed))
        elif row.element_kind == "body" and row.quantity is Quantity.PRESENCE:
            found[index] = _effect_of_branches(states, row)
    for group in groups.values():
        after = states.of_first([robot for _, robot in group])
        for (index, _), change in zip(group, _largest(before, after), strict=True):
            found[index] = change
    return found


def _largest(before: Array, after: Array) -> list[float]:
    """Return the largest change of accelerations of each robot, over phases and bodies."""
    return [float(change.max()) for change in relative_changes(before, after)]


def _structure(robot: Robot) -> tuple[object, ...]:
    """Return a key that is equal for robots with the same constraints."""
    return (
        tuple((loop.kind, loop.first, loop.second) for loop in robot.loops),
        tuple((coupling.follower, coupling.leader) for coupling in robot.couplings),
        tuple((spring.first, spring.second) for spring in robot.springs),
    )


def _effect_of_branches(states: CommonStates, row: Difference) -> float | None:
    """Return the effect of the mass of bodies that only one file has, held in the pose of the file.

    Args:
        states: common states, from which such bodies are cut.
        row: the row of their presence.
    """
    for file, cut, robot, accelerations in (
        (states.files[0], states.cuts[0], states.one.robot, states.of_first),
        (states.files[1], states.cuts[1], states.two.robot, states.of_second),
    ):
        bodies = list(robot.bodies)
        restored = [index for index in cut.bodies if file.robot.bodies[index].name in row.elements]
        for index in restored:
            bodies[index] = replace(file.robot.bodies[index], joints=())
        if restored:
            before, after = (accelerations([each]) for each in (robot, replace(robot, bodies=tuple(bodies))))
            return _largest(before, after)[0]
    return None


def _changed(terms: Merged, row: Difference, rows: Sequence[Difference]) -> Robot | None:
    """Return the first robot with a row's numbers of the second; None if the row plays no part in motions.

    Args:
        terms: both robots.
        row: the row.
        rows: all rows.
    """
    names = {*row.elements, row.element}
    robot = terms.first
    if row.quantity is Quantity.GRAVITY:
        return replace(robot, gravity=terms.second.gravity)
    if row.element_kind == "model" or row.quantity is Quantity.SETTING:
        return None
    if row.element_kind == "loop":
        return _with_loops(terms, row.quantity, names)
    if row.element_kind == "spring":
        return _with_springs(terms, row.quantity, names)
    if row.element_kind == "coupling":
        return _with_couplings(terms, row.quantity, names)
    if row.element_kind == "drive":
        fields = DRIVE_FIELDS.get(row.quantity, ())
        drives = [
            _exchanged(own, other, fields) if own.name in names else own
            for own, other in zip(robot.drives, terms.second.drives, strict=True)
        ]
        has_part = bool(fields) and any(own.name in names for own in robot.drives)
        return replace(robot, drives=tuple(drives)) if has_part else None
    if row.quantity in LENGTHS and not names <= _names_of(robot, row.element_kind):
        return _with_bodies(terms, {*LENGTHS, *MASS_FIELDS}, names, names)
    quantities = _quantities(row, rows)
    if row.element_kind == "body":
        carriers = _carriers(robot, names)
        if not carriers <= names and row.quantity in MASS_FIELDS:
            # a part changes mass, center and inertia of all that it is fixed to
            names, quantities = carriers, {*MASS_FIELDS}
        return _with_bodies(terms, quantities, names, set())
    return _with_bodies(terms, quantities, set(), names)


def _carriers(robot: Robot, names: set[str]) -> set[str]:
    """Return the names of the bodies that bodies with some names are fixed to; a body with a joint itself."""
    found = set()
    for index, body in enumerate(robot.bodies):
        if body.name in names:
            while not robot.bodies[index].joints and robot.bodies[index].parent >= 0:
                index = robot.bodies[index].parent
            found.add(robot.bodies[index].name)
    return found


def _names_of(robot: Robot, kind: str) -> set[str]:
    """Return the names of all bodies, or of all joints, of a robot."""
    if kind == "body":
        return {body.name for body in robot.bodies}
    return {joint.name or body.name for body in robot.bodies for joint in body.joints}


def _quantities(row: Difference, rows: Sequence[Difference]) -> set[Quantity]:
    """Return the quantities of a body that a row stands for: its own, and those that no other row is about.

    One row may stand for several, such as that of a part that only one file has.
    """
    if row.standing is not Standing.DIFFERENT or row.quantity not in MASS_FIELDS:
        return {row.quantity}
    others = {
        other.quantity
        for other in rows
        if other is not row
        and other.standing is Standing.DIFFERENT
        and other.element_kind == "body"
        and {*other.elements} & {*row.elements}
    }
    return {row.quantity, *(quantity for quantity in MASS_FIELDS if quantity not in others)}


def _with_bodies(
    terms: Merged, quantities: set[Quantity], bodies: set[str], joints: set[str]
) -> Robot | None:
    """Return the first robot with quantities of some bodies and joints from the second.

    Args:
        terms: both robots.
        quantities: the quantities.
        bodies, joints: names; a joint without name has that of its body.
    """
    known = {*MASS_FIELDS, *JOINT_FIELDS, *PLACEMENT_FIELDS, *DRIVE_FIELDS_OF_JOINT}
    if not quantities & known:
        return None
    found: list[FileBody] = []
    of_joints: set[str] = set()
    for own, other in zip(terms.first.bodies, terms.second.bodies, strict=True):
        own_joints = list(own.joints)
        is_placed = own.name in bodies and Quantity.BASE in quantities
        for k, joint in enumerate(own_joints):
            if (joint.name or own.name) in joints:
                is_placed = True
                of_joints.add(joint.name)
                own_joints[k] = _exchanged(joint, other.joints[k], _fields(JOINT_FIELDS, quantities))
        placement = own.placement
        if is_placed:
            fields = _fields(PLACEMENT_FIELDS, quantities)
            placement = placement._replace(**{field: getattr(other.placement, field) for field in fields})
        changed = replace(own, joints=tuple(own_joints), placement=placement)
        found.append(
            _exchanged(changed, other, _fields(MASS_FIELDS, quantities) if own.name in bodies else ())
        )
    drives = [
        _exchanged(own, other, _fields(DRIVE_FIELDS_OF_JOINT, quantities) if {*own.gears} & of_joints else ())
        for own, other in zip(terms.first.drives, terms.second.drives, strict=True)
    ]
    return replace(terms.first, bodies=tuple(found), drives=tuple(drives))


def _fields(table: Fields, quantities: set[Quantity]) -> tuple[str, ...]:
    """Return the fields of all quantities of a table."""
    return tuple(field for quantity in table if quantity in quantities for field in table[quantity])


def _with_loops(terms: Merged, quantity: Quantity, names: set[str]) -> Robot | None:
    """Return the first robot with a quantity of loops of given names from the second."""
    robot = terms.first
    if quantity in REPLACED:
        kept = [loop for k, loop in enumerate(robot.loops) if k in terms.loops or loop.name not in names]
        ends = [{loop.first, loop.second} for loop in robot.loops if loop not in kept]
        added = [
            loop
            for loop in terms.other_loops
            if loop.name in names or (quantity is Quantity.KIND and {loop.first, loop.second} in ends)
        ]
        return replace(robot, loops=(*kept, *added))
    if quantity not in LOOP_FIELDS:
        return None
    return replace(robot, loops=_of_names(names, robot.loops, terms.second.loops, LOOP_FIELDS[quantity]))


def _with_springs(terms: Merged, quantity: Quantity, names: set[str]) -> Robot | None:
    """Return the first robot with a quantity of springs of given names from the second."""
    robot = terms.first
    if quantity in REPLACED:
        kept = [k for number, k in enumerate(robot.springs) if number in terms.springs or k.name not in names]
        added = [spring for spring in terms.other_springs if spring.name in names]
        return replace(robot, springs=(*kept, *added))
    fields = SPRING_FIELDS[quantity]
    return replace(robot, springs=_of_names(names, robot.springs, terms.second.springs, fields))


def _with_couplings(terms: Merged, quantity: Quantity, names: set[str]) -> Robot | None:
    """Return the first robot with a quantity of couplings of given names from the second."""
    robot = terms.first
    if quantity in REPLACED:
        kept = [c for k, c in enumerate(robot.couplings) if k in terms.couplings or c.name not in names]
        added = [coupling for coupling in terms.other_couplings if coupling.name in names]
        return replace(robot, couplings=(*kept, *added))
    if quantity is not Quantity.COUPLING:
        return None
    return replace(robot, couplings=_of_names(names, robot.couplings, terms.second.couplings, ("powers",)))


def _with_consequences(terms: Merged, robot: Robot, names: set[str]) -> Robot:
    """Return a robot with all numbers of loops and springs of given names from the second robot.

    Args:
        terms: both robots.
        robot: a robot with the loops and springs of the first one.
        names: names of loops and springs.
    """
    loop_fields = [field for fields in LOOP_FIELDS.values() for field in fields]
    spring_fields = [*SPRING_FIELDS[Quantity.SPRING_POINT], *SPRING_FIELDS[Quantity.REST]]
    return replace(
        robot,
        loops=_of_names(names, robot.loops, terms.second.loops, loop_fields),
        springs=_of_names(names, robot.springs, terms.second.springs, spring_fields),
    )


Constraint = TypeVar("Constraint", FileLoop, FileSpring, FileCoupling)
"""Element with a name and a partner at the same place of another sequence."""


def _of_names(
    names: set[str], own: Sequence[Constraint], others: Sequence[Constraint], fields: Sequence[str]
) -> tuple[Constraint, ...]:
    """Return elements, those of given names with some fields of their partners."""
    return tuple(
        _exchanged(each, other, fields if each.name in names else ())
        for each, other in zip(own, others, strict=True)
    )


Element = TypeVar("Element", bound=object)


def _exchanged(own: Element, other: Element, fields: Sequence[str]) -> Element:
    """Return a description with some fields of another one."""
    return replace(own, **{field: getattr(other, field) for field in fields})  # type: ignore[type-var]
