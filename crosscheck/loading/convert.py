"""Write a scene as a scene file (YAML, JSON), an MJCF or a URDF, and report what the format cannot hold.

A scene is a mechanism with its forces, control laws, inputs, initial state and duration. What is lost is
added to the import report of the scene: the report lists how each element of a model was converted.
"""

from __future__ import annotations

from pathlib import Path
from typing import assert_never

from crosscheck.support.errors import CrosscheckError
from newton_euler.model.control import PD
from newton_euler.model.forces import JointSpring
from newton_euler.model.scene import Scene
from newton_euler.model.switched_forces import ElasticGear, JointFriction, JointStop, acting_stops
from newton_euler.model.wind import WindLoad
from newton_euler.reading.import_report import CONTROL, FORCE, FRICTION, LIMITS, ROTOR, ImportReport
from urdf.write import loops_path

SCENE_SUFFIXES = (".yaml", ".yml", ".json")
MJCF_SUFFIXES = (".xml", ".mjcf")


def check_target(path: Path) -> None:
    """Raise `CrosscheckError` unless the suffix of a path to write selects a known format."""
    known = (*MJCF_SUFFIXES, ".urdf", *SCENE_SUFFIXES)
    if path.suffix not in known:
        raise CrosscheckError(f"cannot convert to {path}; choose a name that ends in {', '.join(known)}")


def files_written(path: Path) -> list[Path]:
    """List the files that `write_as` writes: the path, and for a URDF also the file of its loop closures."""
    return [path, loops_path(path)] if path.suffix == ".urdf" else [path]


def write_as(scene: Scene, path: Path, report: ImportReport) -> list[Path]:
    """Write a scene in the format that the suffix of the path selects.

    Args:
        scene: the scene to write.
        path: file to write.
        report: import report of the scene, which is changed: every element that the format cannot hold is
            added as left out.

    Returns:
        The files that were written.

    Raises:
        CrosscheckError, newton_euler.NewtonEulerError: if the scene cannot be written.
    """
    check_target(path)
    if path.suffix in SCENE_SUFFIXES:
        from crosscheck.library.scene_file import write_scene

        write_scene(scene, path)
        return files_written(path)
    for body in scene.mechanism.bodies:
        if body.meshes:
            report.left_out(f"meshes of body {body.name!r}", "for viewers; its shapes are written")
    if path.suffix in MJCF_SUFFIXES:
        import mjcf

        mjcf.write(scene, path)
        _leave_out_of_mjcf(scene, report)
    else:
        import urdf

        urdf.write(scene, path)
        _leave_out_of_urdf(scene, report)
    return files_written(path)


def _leave_out_of_mjcf(scene: Scene, report: ImportReport) -> None:
    """Add to the report the elements of a scene that an MJCF cannot hold."""
    for motion in scene.motions:
        report.left_out(
            f"motion of joint {motion.joint!r}", "MJCF has none; the joint is held where it begins"
        )
    for law in scene.control:  # `element` is the text for a report, such as "controller of joint 'pivot'"
        if not isinstance(law, PD):
            report.left_out(law.element, "MJCF has PD laws alone; a motor with the force of the start")
        elif law.uses_model:
            report.left_out(law.element, "MJCF has no gravity compensation; its control is that of the start")
        elif law.depends_on_time:
            report.left_out(law.element, "MJCF has no function of time; its control is that of the start")
    for force in scene.forces:
        if isinstance(force, WindLoad):
            report.left_out(force.element, "MJCF has none; motors hold that of the start")
    _approximate(
        scene,
        report,
        friction="frictionloss, with the creep of the scene by solreffriction",
        stop="range, with the stiffness of the scene by solreflimit, and its damping at 1 mm or 1 mrad",
    )
    for key, sides in acting_stops(scene.switched_forces).items():
        if len({(stop.stiffness, stop.dissipation) for stop in sides}) > 1:
            stiffest = max(sides, key=lambda stop: stop.stiffness)
            for stop in sides:
                if stop is not stiffest:
                    why = f"its stiffness: joint {key[0]!r} has one for both limits, that of the stiffer stop"
                    report.left_out(stop.element, why, topic="stiffness")
    for force in scene.switched_forces:
        if isinstance(force, ElasticGear):
            report.left_out(force.element, "MJCF has no stiffness and no play of couplings")
    report.left_out("duration and outputs", "an MJCF has none")


def _leave_out_of_urdf(scene: Scene, report: ImportReport) -> None:
    """Add to the report the elements of a scene that a URDF cannot hold."""
    _leave_out_kind(report, CONTROL, "a URDF has no control laws", [law.element for law in scene.control])
    forces = [
        force.element
        for force in scene.forces
        if not (isinstance(force, JointSpring) and force.stiffness == 0.0)  # a pure damper
        and not isinstance(force, JointFriction | JointStop)
    ]
    why = "a URDF has no forces but friction, limits and damping of hinges and slides, which are written"
    _leave_out_kind(report, FORCE, why, forces)
    _approximate(
        scene, report, friction="friction, which is ideal", stop="limit, without stiffness and damping"
    )
    # rotor inertias of several elements of a file add up at one joint coordinate: report the scene's sums
    report.entries = [entry for entry in report.entries if entry.became != ROTOR]
    for armature in scene.armatures:
        report.left_out(armature.element, "a URDF has no rotors")
    for motion in scene.motions:
        report.left_out(f"motion of joint {motion.joint!r}", "a URDF has none")
    report.left_out("gravity, initial state, duration and outputs", "a URDF has none")


def _approximate(scene: Scene, report: ImportReport, friction: str, stop: str) -> None:
    """Add to the report the dry friction and the stops of a scene, which the format has in another form.

    Args:
        scene: the scene.
        report: import report to change.
        friction: attribute of the format that dry friction becomes, and its properties.
        stop: the same for a stop.
    """
    for force in scene.switched_forces:
        if isinstance(force, JointFriction):
            if force.coulomb:
                report.approximated(force.element, f"as {friction}", FRICTION)
            if force.stribeck:
                why = f"its Stribeck friction {force.stribeck:g}: the format has Coulomb friction alone"
                report.left_out(force.element, why, topic="Stribeck friction")
            if force.is_loaded:
                why = "its friction that grows with the reaction: the format has Coulomb friction alone"
                report.left_out(force.element, why, topic="load coefficient")
            if not (force.coulomb or force.stribeck or force.is_loaded):
                report.left_out(force.element, "its strengths are 0: it exerts nothing", moves_nothing=True)
        elif isinstance(force, JointStop) and not force.stiffness:
            report.left_out(force.element, "its stiffness is 0: it exerts nothing", moves_nothing=True)
        elif isinstance(force, JointStop):
            report.approximated(force.element, f"as {stop}", LIMITS)
        elif isinstance(force, ElasticGear):
            continue  # each format has its own entry
        else:
            assert_never(force)


def _leave_out_kind(report: ImportReport, became: str, why: str, elements: list[str]) -> None:
    """Mark the entries of one kind as left out, such as all control laws that were read from a model file.

    Args:
        report: import report to change.
        became: kind of scene element that the entries became when the model was imported.
        why: reason why the elements are left out.
        elements: elements of the scene, which are added if the report has no entries of this kind (the scene
            was not imported).
    """
    imported = [entry for entry in report.entries if entry.became == became]
    report.entries = [entry for entry in report.entries if entry not in imported]
    for entry in imported:  # `entry.how` names the counterpart in the scene, such as a spring
        report.left_out(entry.element, f"{entry.how}: {why}")
    if not imported:
        for element in elements:
            report.left_out(element, why)


def scene_report(scene: Scene) -> ImportReport:
    """Make an import report for a scene that was not read from an MJCF or a URDF: all of it is exact."""
    report = ImportReport()
    moving_bodies = len(scene.mechanism.bodies) - 1  # without the ground
    report.imported(f"scene {scene.name!r}", f"{moving_bodies} bodies and all between them")
    return report
