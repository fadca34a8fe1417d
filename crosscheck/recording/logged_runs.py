"""Draw logs in a recording for the Rerun viewer: a ghost that leaves its reference, and its error over time.

A log is a table of positions over time that another simulator wrote for a model. Its judgement has a
reference: the run of newton_euler, this project's solver, from the start and with the inputs of the log. The
compared engines run the model from the model's own start instead. Each log therefore has its own 3-D view, in
which the reference is solid and the log is a transparent ghost.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import rerun as rr
import rerun.blueprint as rrb

from crosscheck.engines.palette import LOOKS, palette
from crosscheck.engines.registry import SOLVER
from crosscheck.own_run.interpolation import interpolated
from crosscheck.recording.blueprint import scene_view
from crosscheck.recording.entities import MIN_VISIBLE_DISTANCE, heading, log_bodies
from crosscheck.recording.mesh_budget import without_meshes
from crosscheck.recording.own_run import YOUR_SETTINGS, error_plots
from crosscheck.recording.plots import Plot
from crosscheck.recording.shapes import Style, largest_distance
from crosscheck.support.colors import rgb
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.trajectory import Trajectory

if TYPE_CHECKING:  # most recordings have no logs
    from crosscheck.logs.judge import LogJudgement

REFERENCE = SOLVER.name
"""Engine of the references of logs."""


@dataclass(frozen=True, eq=False)
class LoggedRun:
    """A log and its reference, to be drawn.

    Attributes:
        name: name of the log.
        mechanism: mechanism that both move.
        reference: the reference of all bodies at the times of the log, until the comparison ends.
        run: the log at the same times, with the bodies that it determines.
        plots: plots of the error over time.
        color: color of the ghost and of the error.
    """

    name: str
    mechanism: Mechanism
    reference: Trajectory
    run: Trajectory
    plots: tuple[Plot, ...]
    color: tuple[int, int, int]

    @cached_property
    def distance(self) -> float:
        """Largest distance, m, of any point of a drawn body in the log and in the reference."""
        return largest_distance(self.mechanism, self.reference, self.run)

    def view(self) -> rrb.Spatial3DView:
        """Make the 3-D view; its title has the largest distance, and a ghost that is too near is hidden."""
        is_hidden = self.distance <= MIN_VISIBLE_DISTANCE * self.mechanism.size
        title = heading(self.name, [REFERENCE], {self.name: self.distance}, [self.name] * is_hidden)
        folder = rr.new_entity_path(["logs", self.name])
        hidden = {f"{folder}/log": rrb.EntityBehavior(visible=False)} if is_hidden else {}
        contents = ["+ /ground/**", f"+ {folder}/**"]
        return scene_view(self.mechanism, self.reference, title, contents, overrides=hidden)

    def draw(self, recording: rr.RecordingStream, has_meshes: bool) -> None:
        """Draw the moving bodies of the reference and of the log over time, with meshes or without."""
        mechanism = self.mechanism if has_meshes else without_meshes(self.mechanism)
        solid, ghost = Style(rgb(LOOKS[SOLVER.name].color)), Style(self.color, ghost=True)
        log_bodies(recording, ["logs", self.name, "reference"], mechanism, self.reference, solid)
        log_bodies(recording, ["logs", self.name, "log"], mechanism, self.run, ghost)


def logged_runs(judgements: Mapping[str, LogJudgement]) -> list[LoggedRun]:
    """Take the logs and the references of judgements, by name of the log."""
    colors = palette([YOUR_SETTINGS, *judgements])
    found = []
    for name, judgement in judgements.items():
        assert judgement.scene is not None
        assert judgement.solution is not None
        found.append(
            LoggedRun(
                name=name,
                mechanism=judgement.scene.mechanism,
                reference=interpolated(judgement.solution, judgement.run.time),
                run=judgement.run,
                plots=tuple(error_plots(judgement, f"error of {name}", ("logs", name))),
                color=rgb(colors[name]),
            )
        )
    return found
