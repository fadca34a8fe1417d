"""Convert loop closures, coupled joints and mimics of a URDF to joints and couplings of a scene.

Loop closures and coupled joints come from the loop file of the URDF (`urdf.loops`), or from elements that
tools such as Gazebo add to a URDF. A mimic makes one joint follow another by a constant factor. The import
report receives one entry for each of these elements.

Loops close between two frames of Pinocchio's model (`RobotAtStart.closed_model`). Points are the origins of
such frames, (3,) m, in the world at the start.
"""

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
"""Joint class by type of loop closure; the types "rod" and `REVOLUTE` need more than one point."""


def closing_joints(start: RobotAtStart, tree: Tree, report: ImportReport) -> Iterator[Joint]:
    """Yield a joint for each loop closure between two bodies, and report all loop closures.

    Args:
        start: Pinocchio's model and the loop file, with data at the start state.
        tree: imported bodies and joints of the tree.
        report: report that receives the entries.
    """
    used_names, closed_model, loops = tree.joint_names, start.closed_model, start.loops
    # pairs of frames: one for each closure, and a second one for a revolute joint, at another point of its
    # axis; the pairs of rods are separate
    frames, rods = iter(closed_model.frames), iter(closed_model.rods)
    for number, (frame_names, kind) in enumerate(zip(loops.closed_loop, loops.type, strict=True)):
        first_frame, second_frame = next(rods) if kind == "rod" else next(frames)
        axis_frame, _ = next(frames) if kind == REVOLUTE else (first_frame, second_frame)
        first_body, point_on_first = tree.body_and_point(first_frame)
        second_body, point_on_second = tree.body_and_point(second_frame)
        element = f"closed_loop {' and '.join(frame_names)}"
        if first_body == second_body:
            report.left_out(element, f"both frames are on {first_body!r}", moves_nothing=True)
            continue
        # `urdf.write` names both frames "<joint>_on_<body>"
        first_name, second_name = (frame.rpartition("_on_")[0] for frame in frame_names)
        has_joint_name = first_name and first_name == second_name
        name = unique_name(first_name if has_joint_name else f"closure_{number + 1}", "closure", used_names)
        used_names = [*used_names, name]
        # All joints but rods use the point on the first body for both bodies. The point on the second body
        # differs from it by the rounding of the file, and the bodies stay where the file has them.
        joint: Joint
        if kind == "rod":
            joint = Rod(name, first_body, second_body, point_on_first, point_on_second=point_on_second)
        elif kind == REVOLUTE:
            _, point_on_axis = tree.body_and_point(axis_frame)
            axis = point_on_axis - point_on_first
            joint = Revolute(name, first_body, second_body, point_on_first, axis=axis)
        else:
            joint = CLOSURE_JOINTS[kind](name, first_body, second_body, point_on_first)
        yield joint
        report.imported(element, f"{joint.kind} joint {name!r}")


def couplings(
    start: RobotAtStart, tree: Tree, used_names: list[str], report: ImportReport
) -> Iterator[JointCoupling]:
    """Yield a gear for each mimic, and a gear or another coupling for each entry of `coupled`.

    A coupling of the loop file maps names of joints to the factors of the powers 1, 2, ... of their
    coordinates. The sum of the factors times the powers is constant.

    Args:
        start: Pinocchio's model, the loop file and the mimics, with data at the start state.
        tree: imported bodies and joints of the tree.
        used_names: names of the scene's joints, which couplings must not have.
        report: report that receives the entries.
    """
    gears: list[tuple[str, Key, Key, float]] = []  # element, follower, driver, ratio
    linear_couplings: list[LinearCoupling] = []
    polynomial_couplings: list[PolynomialCoupling] = []
    coordinate_of = tree.coordinate_keys  # contains moving hinges and slides only
    for mimic in start.mimics:
        element = f"mimic of joint {mimic.follower!r}"
        if mimic.follower in coordinate_of and mimic.driver in coordinate_of:
            follower, driver = coordinate_of[mimic.follower], coordinate_of[mimic.driver]
            gears.append((element, follower, driver, mimic.multiplier))
        else:
            report.left_out(element, "one of its joints has no moving body")
    for coupling in start.loops.coupled:
        element = f"coupled {', '.join(coupling)}"
        # powers higher than 1
        if any(len(factors) > 1 for factors in coupling.values()):
            wanted_name = f"polynomial_{len(polynomial_couplings) + 1}"
            if polynomial := _polynomial_coupling(start, tree, coupling, wanted_name, used_names):
                polynomial_couplings.append(polynomial)
                report.imported(element, f"polynomial coupling {polynomial.name!r}")
            else:
                why = "it couples joints by polynomials; needed: two joints, one with its first power only"
                report.left_out(element, why)
            continue
        # first powers: a linear coupling of three or more coordinates, a gear of two
        terms = [
            (coordinate_of[name], factor)
            for name, (factor,) in coupling.items()
            if factor and name in coordinate_of
        ]
        if len(terms) > 2:
            name = unique_name(f"coupling_{len(linear_couplings) + 1}", "coupling", used_names)
            joint_number_factor = tuple((*key, factor) for key, factor in terms)
            linear_couplings.append(LinearCoupling(name, joint_number_factor))
            report.imported(element, f"coupling {name!r} of {len(terms)} joint coordinates")
            continue
        if len(terms) != 2:
            report.left_out(element, f"it couples {len(terms)} moving joints; needed: two or more")
            continue
        # follower_factor x_follower + driver_factor x_driver is constant
        (follower, follower_factor), (driver, driver_factor) = terms
        gears.append((element, follower, driver, -driver_factor / follower_factor))
    # name and yield gears, then the other couplings
    for number, (element, follower, driver, ratio) in enumerate(gears):
        name = unique_name(f"gear_{number + 1}", "gear", used_names)
        (driver_joint, driver_coordinate), (follower_joint, follower_coordinate) = driver, follower
        yield Gear(name, driver_joint, follower_joint, ratio, driver_coordinate, follower_coordinate)
        report.imported(element, f"gear {name!r} of ratio {ratio:.6g}")
    yield from linear_couplings
    yield from polynomial_couplings


def _polynomial_coupling(
    start: RobotAtStart,
    tree: Tree,
    coupling: dict[str, tuple[float, ...]],
    wanted_name: str,
    used_names: list[str],
) -> PolynomialCoupling | None:
    """Return the polynomial coupling of two moving joints, one of which has its first power only.

    Args:
        start: Pinocchio's model with data at the start state.
        tree: imported bodies and joints of the tree.
        coupling: factors of the powers 1, 2, ... of coordinates, by name of the joint.
        wanted_name: name of the coupling, if no joint has it.
        used_names: names of joints.

    Returns:
        The coupling; None for a coupling of another form.
    """
    coordinate_of = tree.coordinate_keys
    moving = {name: factors for name, factors in coupling.items() if name in coordinate_of and any(factors)}
    linear = [name for name, factors in moving.items() if not any(factors[1:])]
    if len(moving) != 2 or not linear:
        return None
    follower = linear[0]
    (driver,) = moving.keys() - {follower}
    # x_follower = sum_k coefficients_k x_driver^k, up to a constant
    coefficients = tuple(-factor / moving[follower][0] for factor in moving[driver])
    (driver_joint, driver_coordinate), (follower_joint, follower_coordinate) = (
        coordinate_of[driver],
        coordinate_of[follower],
    )
    name = unique_name(wanted_name, "polynomial", used_names)
    in_file_coordinates = PolynomialCoupling(
        name, driver_joint, follower_joint, coefficients, driver_coordinate, follower_coordinate
    )
    # the file counts coordinates from its zero pose, the scene from the start
    return in_file_coordinates.from_zero(start.displacement(driver))
