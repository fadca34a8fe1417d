"""Import loop closures, couplings and mimics as joints and couplings."""

from __future__ import annotations

from collections.abc import Iterator

from newton_euler.model.couplings import Gear, JointCoupling, LinearCoupling, PolynomialCoupling
from newton_euler.model.joint import Joint, Key
from newton_euler.model.joint_kinds import Fixed, Revolute, Rod, Spherical
from newton_euler.reading.import_report import (
    ImportReport,
    unique_name,
)
from urdf.loops import REVOLUTE
from urdf.reading.bodies import Tree
from urdf.reading.start import RobotAtStart

CLOSURE_JOINTS: dict[str, type[Joint]] = {"3d": Spherical, "6d": Fixed}
"""Joints by type of closure, except rods and hinges."""


def closing_joints(start: RobotAtStart, tree: Tree, report: ImportReport) -> Iterator[Joint]:
    """Yield the joints that close loops."""
    taken, closed, loops = tree.joint_names, start.robot, start.loops
    frames, rods = iter(closed.frames), iter(closed.rods)
    for number, (pair, kind) in enumerate(zip(loops.closed_loop, loops.type, strict=True)):
        first, second = next(rods) if kind == "rod" else next(frames)
        along = next(frames)[0] if kind == REVOLUTE else first  # a second point on the axis
        (a, p), (b, q) = tree.end(first), tree.end(second)
        element = f"closed_loop {' and '.join(pair)}"
        if a == b:
            report.left_out(element, f"both frames are on {a!r}", moves_nothing=True)
            continue
        own, other = (frame.rpartition("_on_")[0] for frame in pair)  # frame names of `urdf.write`
        wanted = own if own and own == other else f"closure_{number + 1}"
        name = unique_name(wanted, "closure", taken)
        taken = [*taken, name]
        # one point for both bodies: the scene keeps the offset that the digits of the file leave
        joint: Joint
        if kind == "rod":
            joint = Rod(name, a, b, p, point_on_second=q)
        elif kind == REVOLUTE:
            joint = Revolute(name, a, b, p, axis=tree.end(along)[1] - p)
        else:
            joint = CLOSURE_JOINTS[kind](name, a, b, p)
        yield joint
        report.imported(element, f"{joint.kind} joint {name!r}")


def couplings(
    start: RobotAtStart, tree: Tree, taken: list[str], report: ImportReport
) -> Iterator[JointCoupling]:
    """Yield gears of mimics, and gears and other couplings of coupled joints."""
    pairs: list[tuple[str, Key, Key, float]] = []
    sums: list[LinearCoupling] = []
    bent: list[PolynomialCoupling] = []
    for mimic in start.mimics:
        element = f"mimic of joint {mimic.follower!r}"
        if mimic.follower in tree.keys and mimic.driver in tree.keys:
            follower, driver = tree.keys[mimic.follower], tree.keys[mimic.driver]
            pairs.append((element, follower, driver, mimic.multiplier))
        else:
            report.left_out(element, "one of its joints has no moving body")
    for coupling in start.loops.coupled:
        element = f"coupled {', '.join(coupling)}"
        if any(len(factors) > 1 for factors in coupling.values()):
            if polynomial := _polynomial(start, tree, coupling, f"polynomial_{len(bent) + 1}", taken):
                bent.append(polynomial)
                report.imported(element, f"polynomial coupling {polynomial.name!r}")
            else:
                why = "it couples joints by polynomials; needed: two joints, one with its first power only"
                report.left_out(element, why)
            continue
        terms = [(tree.keys[name], c) for name, (c,) in coupling.items() if c and name in tree.keys]
        if len(terms) > 2:
            name = unique_name(f"coupling_{len(sums) + 1}", "coupling", taken)
            sums.append(LinearCoupling(name, tuple((*key, factor) for key, factor in terms)))
            report.imported(element, f"coupling {name!r} of {len(terms)} joint coordinates")
            continue
        if len(terms) != 2:
            report.left_out(element, f"it couples {len(terms)} moving joints; needed: two or more")
            continue
        (follower, own), (driver, other) = terms
        pairs.append((element, follower, driver, -other / own))
    # name and yield gears, then the other couplings
    for number, (element, follower, driver, ratio) in enumerate(pairs):
        name = unique_name(f"gear_{number + 1}", "gear", taken)
        yield Gear(name, driver[0], follower[0], ratio, driver[1], follower[1])
        report.imported(element, f"gear {name!r} of ratio {ratio:.6g}")
    yield from sums
    yield from bent


def _polynomial(
    start: RobotAtStart, tree: Tree, coupling: dict[str, tuple[float, ...]], own: str, taken: list[str]
) -> PolynomialCoupling | None:
    """Return the coupling of two joints, one with its first power only, from the start; None for others."""
    moving = {name: factors for name, factors in coupling.items() if name in tree.keys and any(factors)}
    linear = [name for name, factors in moving.items() if not any(factors[1:])]
    if len(moving) != 2 or not linear:
        return None
    follower = linear[0]
    (driver,) = moving.keys() - {follower}
    coefficients = tuple(-factor / moving[follower][0] for factor in moving[driver])
    ends = (tree.keys[driver], tree.keys[follower])
    found = PolynomialCoupling(
        unique_name(own, "polynomial", taken), ends[0][0], ends[1][0], coefficients, ends[0][1], ends[1][1]
    )
    return found.from_zero(start.displacement(driver))
