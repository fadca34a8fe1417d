"""Judge logs of other simulators against the reference solution of a model.

A log is a table of positions and velocities over time that another simulator recorded for the same model. The
reference (a run of newton_euler, this project's solver) begins at the start of the log. A judgement has the
error of the log, and the elements of the model that act there but are not simulated in the reference, such
as contacts and joint limits.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from crosscheck.compare.activity import acting_events, watched
from crosscheck.loading.load import is_scene, load_scene
from crosscheck.logs.columns import LogData
from crosscheck.logs.inputs import with_logged_forces
from crosscheck.logs.judge import LogJudgement, judge_log
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.reading.file_run import Event

if TYPE_CHECKING:
    from crosscheck.loading.load import Model

NOT_EXCITED = {"excitation": "off"}
"""Options by which a model file is read without added actuator inputs and initial velocities (an excitation),
which runs of files have by default: the start of a log is in the log."""


def judge_logs(
    model: Model, options: Mapping[str, str], logs: Mapping[str, Any], progress: Callable[[str], None]
) -> dict[str, LogJudgement]:
    """Judge logs of a model, each from its own start.

    Args:
        model: name of a library scene, path of a file, a `Scene`, or a model of MuJoCo or Pinocchio.
        options: options of the model that the user set.
        logs: logs by name: a `Log`, a path, a DataFrame, a mapping of columns, or a function that simulates
            from a start state to given times (`crosscheck.logs.judge.Stepper`).
        progress: shows a message to the user before each log.

    Raises:
        NewtonEulerError, CrosscheckError: for a model or log that cannot be read, with the column at fault.
    """
    if not logs:
        return {}
    given = dict(options) if is_scene(model) else NOT_EXCITED | dict(options)
    # `report`: how each element of the file was imported; None for a scene of this package. `verified` would
    # also compare the scene with the model as MuJoCo or Pinocchio compiles it, which judges no log
    scene, report = load_scene(model, given, verified=False)

    def watch(simulated: Scene, run: Trajectory, data: LogData) -> Sequence[Event]:
        """Return the elements of the file that would act in the reference but are not simulated there.

        Args:
            simulated: the scene from the start of the log.
            run: the reference.
            data: the log.
        """
        if report is None:
            return ()
        return acting_events(watched(simulated, with_logged_forces(report, data), run))

    judgements = {}
    file_names = report.names if report else None  # names of joints and bodies in the file
    for name, log in logs.items():
        progress(f"judging {name}")
        judgements[name] = judge_log(scene, file_names, name, log, watch)
    return judgements
