"""Scenes and models against their baselines, and new baselines."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from crosscheck.compare.activity import watched_in_own_run
from crosscheck.library import SCENES
from crosscheck.library.options import titled
from crosscheck.loading.load import load_scene, with_excitation
from crosscheck.loading.model_files import is_model_file
from crosscheck.regress.baseline import Baseline, GroupName, Record, StoredFigure, read
from crosscheck.regress.compare import Comparison, compare, unsimulated
from crosscheck.regress.measure import GROUPS, MAIN, main_run, make_plan, regress_scene, with_own_errors
from crosscheck.regress.report import as_json, junit, report
from crosscheck.report.render import markdown
from crosscheck.support.errors import CrosscheckError
from crosscheck.support.files import check_no_source, check_writable, write_files
from newton_euler.errors import NewtonEulerError
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.reading.import_report import ImportReport
from newton_euler.scalars import Array

REPORTS = ("regress.json", "junit.xml", "summary.md")
"""Files that a comparison writes, beside recordings."""

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

    def baseline(self) -> Baseline:
        """The stored baseline; raises `CrosscheckError` if there is none, or if it is of something else."""
        found = read(self.path)
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
    if not (is_model_file(source) and path.exists()):
        return options
    return {name: value for name, value in read(path).options.items() if name != "root"} | options


def usual_path(source: str) -> Path:
    """Return a baseline's default path: in this package for the library, else beside the file."""
    if source in SCENES:
        return Path(__file__).parent / "baselines" / f"{source}.json"
    return Path(source).with_suffix(".baseline.json")


def guard(source: str, options: dict[str, str], baseline: Path | None = None) -> Guarded:
    """Load a scene or model file for its baseline, which is at its usual place if None."""
    path = baseline or usual_path(source)
    options = with_excitation(source, made_with(source, path, options))
    scene, mapping = load_scene(source, options)
    return Guarded(source, options, scene, path, mapping)


def make(guarded: Guarded, reason: str, progress: Progress) -> Baseline:
    """Measure a scene's figures and their tolerances; what they were stays in the history.

    Raises:
        CrosscheckError: for a scene that newton_euler cannot run at any tolerance.
    """
    scene = regress_scene(guarded.scene)
    history = guarded.baseline().history if guarded.path.exists() else []
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
    mapping = guarded.mapping
    watched = watched_in_own_run(guarded.scene, mapping) if mapping else None
    return Baseline(
        scene=scene.name,
        options=guarded.options,
        unsimulated=unsimulated(guarded.mapping, watched),
        history=[*history, Record.now(reason)],
        plan=plan,
        left_out=left_out,
        figures=figures,
    )


def update(guarded: Sequence[Guarded], reason: str, progress: Progress) -> list[Baseline]:
    """Make baselines anew and write them, all of them or none.

    Raises:
        CrosscheckError: for a reason that is empty or no text, a scene that cannot be run, and a file that
            cannot be written or that holds no baseline.
    """
    reason = " ".join(reason.split())
    try:
        reason.encode()
    except UnicodeEncodeError as error:
        raise CrosscheckError(f"--update: the reason {reason!r:.100} is not text in UTF-8") from error
    if not reason:
        raise CrosscheckError("--update: the reason is empty; it is kept with the baseline")
    check_writable(*(each.path for each in guarded))
    made = [make(each, reason, progress) for each in guarded]
    write_files({each.path: baseline.text().encode() for each, baseline in zip(guarded, made, strict=True)})
    return made


def check(
    guarded: Sequence[Guarded],
    folder: Path,
    progress: Progress,
    left_out: Mapping[str, str],
    allow_reduced: bool = False,
) -> tuple[list[Comparison], dict[str, Path], list[Path]]:
    """Compare scenes with their baselines; write `REPORTS` and recordings of those that moved to a folder.

    Args:
        guarded: what is compared.
        folder: where the files are written.
        progress: is told each stage.
        left_out: reasons by the name of the scene that is not compared.
        allow_reduced: whether elements of a file that act and are not simulated are no failures.

    Returns:
        What was found, the recordings by scene, and all files that were written.

    Raises:
        CrosscheckError: for a baseline that is missing or cannot be read, and a file that cannot be written.
    """
    from crosscheck.recording.log import log_run, recorded

    baselines = [each.baseline() for each in guarded]
    reports = [folder / name for name in REPORTS]
    for each in guarded:
        loops = [each.options["loops"]] if "loops" in each.options else []
        check_no_source(reports, [each.source, each.path, *loops])
    check_writable(*reports)
    found, recordings, contents = [], dict[str, Path](), dict[Path, bytes]()
    for each, baseline in zip(guarded, baselines, strict=True):
        comparison = compare(each.scene, baseline, progress, each.mapping)
        found.append(comparison)
        if comparison.moved and (runs := both_runs(each.scene, baseline)):
            progress(f"{each.scene.name}: recording")
            path, title = folder / f"{each.scene.name}.rrd", f"{each.scene.name} against its baseline"
            text = markdown(report([comparison], {}, {}))
            recordings[each.scene.name] = path
            contents[path] = recorded(log_run, regress_scene(each.scene), runs, text, title)
    whole = report(found, recordings, left_out, allow_reduced)
    texts = (
        as_json(found, recordings, contents, left_out, whole),
        junit(whole).encode(),
        markdown(whole).encode(),
    )
    write_files(dict(zip(reports, texts, strict=True)) | contents)
    return found, recordings, reports


def both_runs(scene: Scene, baseline: Baseline) -> dict[str, Trajectory]:
    """A scene's run and that of its baseline; none of a scene that stops or that is of other bodies now."""
    scene = regress_scene(scene)
    stored = stored_run(scene, baseline)
    if stored is None:
        return {}
    try:
        return {"newton_euler": main_run(scene, baseline.plan.rtol[MAIN]), "baseline": stored}
    except NewtonEulerError:
        return {}


def stored_run(scene: Scene, baseline: Baseline) -> Trajectory | None:
    """The run that the baseline holds; None if its bodies or times are not the scene's."""
    count, ground, *bodies = len(scene.times), *scene.mechanism.bodies
    poses = list[Array]()
    for name, own in (("position", ground.center_of_mass), ("quaternion", ground.quaternion)):
        figure = baseline.figure(MAIN, f"{name} over time")
        if figure is None or figure.array.shape != (count, len(own) * len(bodies)):
            return None
        others = figure.array.reshape(count, len(bodies), len(own))
        poses.append(np.concatenate([np.tile(own, (count, 1, 1)), others], axis=1))
    return Trajectory(
        engine="baseline",
        settings={},
        wall_time=0.0,
        time=scene.times,
        body_names=scene.mechanism.body_names,
        joint_names=scene.mechanism.joint_names,
        position=poses[0],
        quaternion=poses[1],
    )
