"""Model and scene files from one format to another, with a report of what became of every element."""

from __future__ import annotations

from pathlib import Path

from crosscheck.support.errors import CrosscheckError
from newton_euler.model.control import PD
from newton_euler.model.forces import JointSpring
from newton_euler.model.scene import Scene
from newton_euler.model.wind import WindLoad
from newton_euler.reading.import_report import CONTROL, FORCE, ROTOR, ImportReport
from urdf.write import loops_path

SCENE_FILES = (".yaml", ".yml", ".json")

MJCF = (".xml", ".mjcf")


def check_target(path: Path) -> None:
    """Raise `CrosscheckError` for a name that tells no format."""
    known = (*MJCF, ".urdf", *SCENE_FILES)
    if path.suffix not in known:
        raise CrosscheckError(f"cannot convert to {path}; choose a name that ends in {', '.join(known)}")


def files_of(path: Path) -> list[Path]:
    """List the files that `write_as` writes."""
    return [path, loops_path(path)] if path.suffix == ".urdf" else [path]


def write_as(scene: Scene, path: Path, report: ImportReport) -> list[Path]:
    """Write a scene in the format that the name asks for, and add to the report what that cannot hold.

    Returns:
        The files that were written.

    Raises:
        CrosscheckError, newton_euler.NewtonEulerError: for what cannot be written.
    """
    check_target(path)
    if path.suffix in SCENE_FILES:
        from crosscheck.library.scene_file import write_scene

        write_scene(scene, path)
        return [path]
    for body in scene.mechanism.bodies:
        if body.meshes:
            report.left_out(f"meshes of body {body.name!r}", "for viewers; its shapes are written")
    if path.suffix in MJCF:
        import mjcf

        mjcf.write(scene, path)
        for motion in scene.motions:
            report.left_out(
                f"motion of joint {motion.joint!r}", "MJCF has none; the joint is held where it begins"
            )
        for law in scene.control:
            if isinstance(law, PD) and law.uses_model:
                report.left_out(
                    law.element, "MJCF has no gravity compensation; its control is that of the start"
                )
            elif isinstance(law, PD) and law.is_driven:
                report.left_out(law.element, "MJCF has no function of time; its control is that of the start")
            elif not isinstance(law, PD):
                report.left_out(law.element, "MJCF has PD laws alone; a motor with the force of the start")
        for force in scene.forces:
            if isinstance(force, WindLoad):
                report.left_out(force.element, "MJCF has none; motors hold that of the start")
        report.left_out("duration and outputs", "an MJCF has none")
        return [path]
    import urdf

    urdf.write(scene, path)
    _leave_out(report, CONTROL, "a URDF has no control laws", [law.element for law in scene.control])
    forces = [f.element for f in scene.forces if not (isinstance(f, JointSpring) and f.stiffness == 0.0)]
    why = "a URDF has no forces but damping along hinges and slides, which is written"
    _leave_out(report, FORCE, why, forces)
    # rotors of several elements of a file add up at one joint coordinate, and are told of there
    report.entries = [entry for entry in report.entries if entry.became != ROTOR]
    for armature in scene.armatures:
        report.left_out(armature.element, "a URDF has no rotors")
    for motion in scene.motions:
        report.left_out(f"motion of joint {motion.joint!r}", "a URDF has none")
    report.left_out("gravity, initial state, duration and outputs", "a URDF has none")
    return files_of(path)


def _leave_out(report: ImportReport, became: str, why: str, elements: list[str]) -> None:
    """File as left out what reading has carried over; the scene's own elements where it told of none."""
    again = [entry for entry in report.entries if entry.became == became]
    report.entries = [entry for entry in report.entries if entry not in again]
    for entry in again:
        report.left_out(entry.element, f"{entry.how}: {why}")
    for element in () if again else elements:
        report.left_out(element, why)


def scene_report(scene: Scene) -> ImportReport:
    """The report of a scene of this package's own, which is carried over as it is."""
    found = ImportReport()
    found.exactly(f"scene {scene.name!r}", f"{len(scene.mechanism.bodies) - 1} bodies and all between them")
    return found
