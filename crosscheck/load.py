"""Models by name or file, whatever they are, with the options that commands give them."""

from __future__ import annotations

from crosscheck.model_files.read import is_model, read_model
from crosscheck.scenes import load
from crosscheck.scenes.size import check_scene
from newton_euler.model.scene import Scene
from newton_euler.verification.import_report import ImportReport

EXERCISED = {"exercise": "on"}
"""Options of models of other tools that crosschecks take unless told otherwise."""


def exercised(source: str, options: dict[str, str]) -> dict[str, str]:
    """Return the options with which model files are exercised unless the options say otherwise."""
    return EXERCISED | options if is_model(source) else options


def load_scene(
    source: str, options: dict[str, str], verified: bool = True
) -> tuple[Scene, ImportReport | None]:
    """Load a scene, with what became of the elements of its file if that is a model of another tool.

    Unless it is `verified`, what it is verified against comes with it.

    Raises:
        CrosscheckError, NewtonEulerError: for a name, a file or an option that cannot be read, and for models
            that are too large.
    """
    if is_model(source):
        scene, report = read_model(source, options, verified)
        check_scene(scene, source)
        return scene, report
    scene = load(source, **options)
    check_scene(scene)
    return scene, None
