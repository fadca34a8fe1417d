"""Scenes and models against their baselines, and new baselines."""

from __future__ import annotations

import os
import shlex
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from crosscheck.errors import CrosscheckError
from crosscheck.files import check_no_source, check_writable, write_files
from crosscheck.model_files.read import is_model
from crosscheck.regress.baseline import Baseline, GroupName, Record, StoredFigure, read
from crosscheck.regress.compare import Comparison, compare, unsimulated
from crosscheck.regress.measure import GROUPS, MAIN, main_run, make_plan, regress_scene, with_own_errors
from crosscheck.regress.report import as_json, junit, markdown
from crosscheck.scenes import SCENES
from crosscheck.scenes.options import titled
from newton_euler.errors import NewtonEulerError
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.verification.import_report import ImportReport

STEP_SUMMARY = "GITHUB_STEP_SUMMARY"
"""The variable in which GitHub names the file for a step's summary."""

Progress = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Guarded:
    """A scene and where its baseline is.

    Attributes:
        source: the name or file that it was loaded from.
        options: of the scene, as they were set.
        scene: as loaded.
        path: of the baseline.
        mapping: what became of the elements of a model file; None for a scene of this package's own.
    """

    source: str
    options: dict[str, str]
    scene: Scene
    path: Path
    mapping: ImportReport | None = None

    @property
    def command(self) -> str:
        """Return the command that makes the baseline."""
        words = ["crosscheck", "regress", self.source]
        for option, value in self.options.items():
            words += ["--set", f"{option}={value}"]
        if self.path != usual_path(self.source):
            words += ["--baseline", str(self.path)]
        return f"{shlex.join(words)} --update REASON"

    def complete_baseline(self) -> Baseline:
        """The stored baseline; raises `CrosscheckError` as `baseline` does, and if it does not hold what of a
        model file is in no figure."""
        found = self.baseline()
        if self.mapping is not None and found.unsimulated is None:
            raise CrosscheckError(
                f"{self.path}: unsimulated: missing, what of {self.source} is in no figure; make it with: "
                f"{self.command}"
            )
        return found

    def baseline(self) -> Baseline:
        """The stored baseline; raises `CrosscheckError` if there is none, or if it is of something else."""
        found = read(self.path, self.command)
        if found.scene != self.scene.name:
            raise CrosscheckError(f"{self.path}: scene: it is of {found.scene!r}, not of {self.scene.name!r}")
        if found.options != self.options:
            raise CrosscheckError(
                f"{self.path}: options: of {titled(found.scene, found.options)}, not of "
                f"{titled(self.scene.name, self.options)}; delete it to make one of other options"
            )
        return found


def made_with(source: str, path: Path, options: dict[str, str]) -> dict[str, str]:
    """Options of a model file: those given, and those of its baseline but `root`, which needs trust."""
    if not (is_model(source) and path.exists()):
        return options
    stored = read(path, "").options
    return {name: value for name, value in stored.items() if name != "root"} | options


def usual_path(source: str) -> Path:
    """Return a baseline's default path: in this package for the library, else beside the file."""
    if source in SCENES:
        return Path(__file__).parents[1] / "baselines" / f"{source}.json"
    return Path(source).with_suffix(".baseline.json")


def make(
    scene: Scene,
    options: dict[str, str],
    reason: str,
    history: list[Record],
    progress: Progress,
    mapping: ImportReport | None = None,
) -> Baseline:
    """Measure a scene's figures and their tolerances.

    Args:
        scene: as loaded.
        options: of the scene, as they were set.
        reason: why, for the history.
        history: of the baseline that this one replaces.
        progress: is told each stage.
        mapping: what became of the elements of a model file; None for a scene of this package's own.

    Raises:
        CrosscheckError: for a scene that newton_euler cannot run at any tolerance.
    """
    scene = regress_scene(scene)
    try:
        plan = make_plan(scene)
    except NewtonEulerError as error:
        raise CrosscheckError(f"scene {scene.name!r} cannot be run: {error}") from error
    figures, left_out = list[StoredFigure](), dict[GroupName, str]()
    for group in GROUPS:
        progress(f"{scene.name}: {group}")
        found = with_own_errors(group, scene, plan)
        if isinstance(found, str):
            left_out[group] = found
        else:
            figures.extend(found)
    if MAIN in left_out:
        raise CrosscheckError(f"scene {scene.name!r} has no figures: {left_out[MAIN]}")
    return Baseline(
        scene=scene.name,
        options=options,
        unsimulated=None if mapping is None else unsimulated(mapping),
        history=[*history, Record.now(reason)],
        plan=plan,
        left_out=left_out,
        figures=figures,
    )


def update(guarded: Sequence[Guarded], reason: str, progress: Progress) -> list[Baseline]:
    """Make baselines anew and write them, all of them or none; what they were stays in the history.

    Raises:
        CrosscheckError: for a reason that says nothing, a scene that cannot be run, and a file that cannot be
            written or that holds no baseline.
    """
    reason = " ".join(reason.split())
    if not reason:
        raise CrosscheckError("--update: the reason is empty; it is kept with the baseline")
    check_writable(*(each.path for each in guarded))
    made = []
    for each in guarded:
        history = each.baseline().history if each.path.exists() else []
        made.append(make(each.scene, each.options, reason, history, progress, each.mapping))
    write_files({each.path: baseline.text().encode() for each, baseline in zip(guarded, made, strict=True)})
    return made


def check(
    guarded: Sequence[Guarded], folder: Path, reports: Sequence[Path], progress: Progress
) -> tuple[list[Comparison], dict[str, Path]]:
    """Compare scenes with their baselines, and record those that moved.

    Args:
        folder: for the recordings, a file NAME.rrd for each scene that moved.
        reports: files that are to be written afterwards.
        progress: is told each stage.

    Returns:
        What was found, and the recordings by scene.

    Raises:
        CrosscheckError: for a baseline that is missing or cannot be read, and a file that could not be
            written.
    """
    baselines = [each.complete_baseline() for each in guarded]
    for each in guarded:
        loops = [each.options["loops"]] if "loops" in each.options else []
        check_no_source(reports, [each.source, each.path, *loops])
    check_writable(*reports)
    found, recordings = [], {}
    for each, baseline in zip(guarded, baselines, strict=True):
        comparison = compare(each.scene, baseline, progress, time.perf_counter, each.mapping)
        found.append(comparison)
        if comparison.moved:
            progress(f"{each.scene.name}: recording")
            path = folder / f"{each.scene.name}.rrd"
            check_writable(path)
            verdict = markdown([comparison], {})
            if record(path, each.scene, baseline, verdict):
                recordings[each.scene.name] = path
    return found, recordings


def record(path: Path, scene: Scene, baseline: Baseline, verdict: str) -> bool:
    """Write an .rrd of a scene's run beside that of its baseline.

    Args:
        scene: as loaded.
        verdict: Markdown.

    Returns:
        Whether there is one; none is of a scene that does not run any more, or is of other bodies.

    Raises:
        CrosscheckError: naming the path that cannot be written.
    """
    from crosscheck.recording.log import write_recording

    scene = regress_scene(scene)
    stored = stored_run(scene, baseline)
    if stored is None:
        return False
    try:
        runs = {"newton_euler": main_run(scene, baseline.plan.rtol[MAIN]), "baseline": stored}
    except NewtonEulerError:
        return False
    write_recording(path, scene, runs, verdict, f"{scene.name} against its baseline")
    return True


def stored_run(scene: Scene, baseline: Baseline) -> Trajectory | None:
    """The run that the baseline holds; None if its bodies or times are not the scene's."""
    position = baseline.figure(MAIN, "position over time")
    quaternion = baseline.figure(MAIN, "quaternion over time")
    count, bodies = len(scene.times), len(scene.mechanism.bodies) - 1
    if position is None or quaternion is None or position.array.shape != (count, 3 * bodies):
        return None
    ground = scene.mechanism.bodies[0]

    def with_ground(own: tuple[float, ...], others: np.ndarray) -> np.ndarray:
        first = np.tile(own, (count, 1, 1))
        return np.concatenate([first, others.reshape(count, bodies, len(own))], axis=1)

    return Trajectory(
        engine="baseline",
        settings={},
        wall_time=0.0,
        time=scene.times,
        body_names=scene.mechanism.body_names,
        joint_names=scene.mechanism.joint_names,
        position=with_ground(tuple(ground.center_of_mass), position.array),
        quaternion=with_ground(tuple(ground.quaternion), quaternion.array),
    )


def write_reports(
    found: Sequence[Comparison],
    recordings: dict[str, Path],
    junit_path: Path | None,
    json_path: Path | None,
    markdown_path: Path | None,
) -> list[Path]:
    """Write the reports that were asked for, and the step summary if GitHub names a file for it.

    Raises:
        CrosscheckError: naming the file that cannot be written.
    """
    summary = markdown(found, recordings)
    contents: dict[Path, bytes] = {}
    if junit_path:
        contents[junit_path] = junit(found).encode()
    if json_path:
        contents[json_path] = as_json(found, recordings, json_path.parent)
    if markdown_path:
        contents[markdown_path] = summary.encode()
    write_files(contents)
    step = os.environ.get(STEP_SUMMARY)
    if step:
        try:
            with open(step, "a", encoding="utf-8") as stream:  # other summaries may be in it
                stream.write(summary)
        except OSError as error:
            raise CrosscheckError(f"cannot write {STEP_SUMMARY} {step}: {error.strerror}") from error
    return list(contents)
