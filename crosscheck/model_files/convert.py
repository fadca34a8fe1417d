"""Model and scene files from one format to another, with a report of what became of every element."""

from __future__ import annotations

from pathlib import Path

from crosscheck.errors import CrosscheckError
from newton_euler.control import Sampled
from newton_euler.mapping import Mapping
from newton_euler.scene import Scene

SCENE_FILES = (".yaml", ".yml", ".json")

MJCF = (".xml", ".mjcf")


def check_target(path: Path) -> None:
    """Raise `CrosscheckError` for a name that tells no format."""
    known = (*MJCF, ".urdf", *SCENE_FILES)
    if path.suffix not in known:
        raise CrosscheckError(f"cannot convert to {path}; choose a name that ends in {', '.join(known)}")


def write_as(scene: Scene, path: Path, report: Mapping) -> list[Path]:
    """Write a scene in the format that the name asks for, and add to the report what that cannot hold.

    Returns:
        The files that were written.

    Raises:
        CrosscheckError, newton_euler.NewtonEulerError: for what cannot be written.
    """
    check_target(path)
    if path.suffix in SCENE_FILES:
        from crosscheck.scenes.write_file import write_scene

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
        _report_sampled(scene, "a motor", report)
        report.left_out("duration and outputs", "an MJCF has none")
        return [path]
    import urdf
    from urdf.write import loops_path

    urdf.write(scene, path)
    for law in scene.control:
        report.left_out(law.element, "a URDF has no control laws")
    for force in scene.forces:
        report.left_out(force.element, "a URDF as written here has no forces")
    for armature in scene.armatures:
        report.left_out(armature.element, "a URDF has no rotors")
    for motion in scene.motions:
        report.left_out(f"motion of joint {motion.joint!r}", "a URDF has none")
    report.left_out("gravity, initial state, duration and outputs", "a URDF has none")
    return [path, loops_path(path)]


def _report_sampled(scene: Scene, instead: str, report: Mapping) -> None:
    for law in scene.control:
        if isinstance(law, Sampled):
            report.left_out(law.element, f"a controller in Python; {instead} in its place")


def scene_report(scene: Scene) -> Mapping:
    """The report of a scene of this package's own, which is carried over as it is."""
    found = Mapping()
    found.exactly(f"scene {scene.name!r}", f"{len(scene.mechanism.bodies) - 1} bodies and all between them")
    return found
