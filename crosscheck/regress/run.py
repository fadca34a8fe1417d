"""Run `crosscheck regress`: create baselines of scenes and model files, or compare scenes with their
baselines.

A baseline is a JSON file with measured quantities of a scene (masses, accelerations, trajectories), which
guards the scene against unnoticed changes. `guard_scene` loads a scene and locates its baseline.
`update_baselines` measures scenes and writes baseline files. `check_baselines` compares scenes with their
baselines and writes reports, and recordings (for the Rerun viewer) of scenes that changed.

Quantities are measured in groups. The group `MAIN_FORMULATION` has the run over the whole duration; its name
is the name of the formulation of newton_euler that makes this run.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from crosscheck.compare.activity import watched_in_new_run
from crosscheck.engines.registry import ENGINES, SOLVER, choose
from crosscheck.library import SCENES
from crosscheck.library.model_files import is_model_file
from crosscheck.library.options import titled
from crosscheck.loading.load import load_scene, with_excitation
from crosscheck.own_run.judge import horizons
from crosscheck.regress.baseline import (
    OWN_RUN_GROUP,
    Baseline,
    GroupName,
    StoredQuantity,
    UpdateRecord,
    read_baseline,
)
from crosscheck.regress.compare import Comparison, compare, unsimulated
from crosscheck.regress.measure import groups_with, measure_group_with_errors
from crosscheck.regress.plan import MAIN_FORMULATION, main_run, make_plan, regress_scene
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
"""Names of the report files that `check_baselines` writes."""

Progress = Callable[[str], None]
"""Function that receives the name of each stage of the work as it begins."""


@dataclass(frozen=True, eq=False)
class GuardedScene:
    """A scene that is guarded by a baseline, and the location of the baseline.

    Attributes:
        source: name of a library scene, or path of a scene or model file.
        options: options that the scene was loaded with.
        scene: the scene as it was loaded.
        path: baseline file.
        import_report: how each element of a model file was imported; None for a scene that was not
            read from a model file.
    """

    source: str
    options: dict[str, str]
    scene: Scene
    path: Path
    import_report: ImportReport | None = None

    def baseline(self) -> Baseline:
        """Read the baseline.

        Raises:
            CrosscheckError: if the file is missing or damaged, or is of another scene or of other options.
        """
        stored, name = read_baseline(self.path), self.scene.name
        if stored.scene != name:
            raise CrosscheckError(f"{self.path}: scene: it is of {stored.scene!r}, not of {name!r}")
        if stored.options != self.options:
            raise CrosscheckError(
                f"{self.path}: options: of {titled(stored.scene, stored.options)}, not of "
                f"{titled(name, self.options)}; delete it to create one with other options"
            )
        return stored


def stored_options(source: str, path: Path, options: dict[str, str]) -> dict[str, str]:
    """Add the options that a baseline stores to the given options of a model file.

    The option `root`, the folder from which other files may be read, is not taken from the baseline: the user
    has to name trusted folders.

    Args:
        source: name of a library scene, or path of a scene or model file.
        path: baseline file, which need not exist.
        options: options that the user gave; they take precedence.
    """
    if not (is_model_file(source) and path.exists()):
        return options
    return {name: value for name, value in read_baseline(path).options.items() if name != "root"} | options


def usual_path(source: str) -> Path:
    """Return the default path of a baseline: in this package for a library scene, else next to the file."""
    if source in SCENES:
        return Path(__file__).parent / "baselines" / f"{source}.json"
    return Path(source).with_suffix(".baseline.json")


def guard_scene(source: str, options: dict[str, str], baseline: Path | None = None) -> GuardedScene:
    """Load a scene or model file with the options that the user gave and those that its baseline stores.

    Args:
        source: name of a library scene, or path of a scene or model file.
        options: options that the user gave; they take precedence.
        baseline: baseline file; `usual_path` if None.
    """
    path = baseline or usual_path(source)
    # model files are excited (initial velocities, inputs of actuators) unless an option says otherwise
    options = with_excitation(source, stored_options(source, path, options))
    scene, import_report = load_scene(source, options)
    return GuardedScene(source, options, scene, path, import_report)


def engines_of(guarded: GuardedScene) -> list[str]:
    """Return the names of the engines of a scene's baseline; the default engines if there is no baseline."""
    return [SOLVER.name, *guarded.baseline().engines] if guarded.path.exists() else list(ENGINES)


def make_baseline(
    guarded: GuardedScene, reason: str, progress: Progress, engines: Sequence[str] = ()
) -> Baseline:
    """Measure a new baseline of a scene; the history of an existing baseline is kept.

    Args:
        guarded: the scene.
        reason: why the baseline is created or updated.
        progress: function that receives the name of each group of quantities before its measurement.
        engines: names of the engines; those of `engines_of` if empty. newton_euler is always measured.

    Raises:
        CrosscheckError: for a scene that newton_euler cannot run at any tolerance, and an engine that cannot
            be used.
    """
    scene = regress_scene(guarded.scene)  # with the outputs that the quantities need
    history = guarded.baseline().history if guarded.path.exists() else []
    try:
        chosen = choose(engines or engines_of(guarded))
    except CrosscheckError as error:
        remedy = "install it, or name the engines of the baseline with --engines"
        raise CrosscheckError(f"{guarded.path}: {error}; {remedy}") from error
    try:
        plan = make_plan(scene)
    except NewtonEulerError as error:
        raise CrosscheckError(f"scene {scene.name!r} cannot be run: {error}") from error
    import_report = guarded.import_report
    simulation = import_report.simulation if import_report else None
    # the file also runs in its own engine; a mechanism is compared until its motion becomes chaotic, s
    if simulation is not None and any(until := horizons(simulation)):
        plan = plan.model_copy(update={"own_run_until": until})
    quantities, left_out = list[StoredQuantity](), dict[GroupName, str]()
    for group in groups_with(engine.name for engine in chosen):
        if group == OWN_RUN_GROUP and simulation is None:
            continue
        progress(f"{scene.name}: {group}")
        measured = measure_group_with_errors(group, scene, plan, simulation)
        if isinstance(measured, str):  # the reason why the group cannot be measured
            left_out[group] = measured
        else:
            quantities.extend(measured)
    if MAIN_FORMULATION in left_out:
        raise CrosscheckError(f"scene {scene.name!r} cannot be measured: {left_out[MAIN_FORMULATION]}")
    # the import report after a run, which shows the elements that act and are not simulated
    watched = watched_in_new_run(guarded.scene, import_report) if import_report else None
    return Baseline(
        scene=scene.name,
        options=guarded.options,
        unsimulated=unsimulated(import_report, watched),
        history=[*history, UpdateRecord.now(reason, chosen)],
        plan=plan,
        left_out=left_out,
        quantities=quantities,
    )


def update_baselines(
    guarded: Sequence[GuardedScene], reason: str, progress: Progress, engines: Sequence[str] = ()
) -> list[Baseline]:
    """Measure and write baselines; if one of them fails, no file is written.

    Args:
        guarded: the scenes.
        reason: why the baselines are created or updated; stored in each.
        progress: function that receives the name of each stage.
        engines: names of the engines, as of `make_baseline`.

    Raises:
        CrosscheckError: for a reason that is empty or not text, a scene that cannot be run, an engine that
            cannot be used, an existing file that is no baseline, and a file that cannot be written.
    """
    reason = " ".join(reason.split())
    try:
        reason.encode()
    except UnicodeEncodeError as error:
        raise CrosscheckError(f"--update: the reason {reason!r:.100} is not text in UTF-8") from error
    if not reason:
        raise CrosscheckError("--update: the reason is empty; give the text to store with the baseline")
    check_writable(*(each.path for each in guarded))
    baselines = [make_baseline(each, reason, progress, engines) for each in guarded]
    write_files(
        {each.path: baseline.text().encode() for each, baseline in zip(guarded, baselines, strict=True)}
    )
    return baselines


def check_baselines(
    guarded: Sequence[GuardedScene],
    folder: Path,
    progress: Progress,
    left_out: Mapping[str, str],
    allow_reduced: bool = False,
) -> tuple[list[Comparison], dict[str, Path], list[Path]]:
    """Compare scenes with their baselines; write `REPORTS`, and a recording of each scene that changed.

    Args:
        guarded: the scenes.
        folder: folder of the written files.
        progress: function that receives the name of each stage.
        left_out: reasons by name of the library scenes that are not compared.
        allow_reduced: whether elements of a model file may act that are not simulated; otherwise each is a
            failure.

    Returns:
        The results, the recordings by name of the scene, and the paths of the reports.

    Raises:
        CrosscheckError: for a baseline that is missing or damaged, and a file that cannot be written.
    """
    from crosscheck.recording.log import log_run
    from crosscheck.recording.stream import recorded

    # find all errors of files before any scene is run
    baselines = [each.baseline() for each in guarded]
    reports = [folder / name for name in REPORTS]
    for each in guarded:  # the reports must not overwrite a file that is read
        loops = [each.options["loops"]] if "loops" in each.options else []  # file of a URDF's loop closures
        check_no_source(reports, [each.source, each.path, *loops])
    check_writable(*reports)
    # compare, and record the scene and its baseline side by side if a quantity moved out of its tolerance
    comparisons, recordings, contents = [], dict[str, Path](), dict[Path, bytes]()
    for each, baseline in zip(guarded, baselines, strict=True):
        comparison = compare(each.scene, baseline, progress, each.import_report)
        comparisons.append(comparison)
        if comparison.moved and (runs := both_runs(each.scene, baseline)):
            progress(f"{each.scene.name}: recording")
            path, title = folder / f"{each.scene.name}.rrd", f"{each.scene.name} against its baseline"
            text = markdown(report([comparison], recordings={}, left_out={}))
            recordings[each.scene.name] = path
            contents[path] = recorded(log_run, regress_scene(each.scene), runs, text, title)
    # write everything together
    whole = report(comparisons, recordings, left_out, allow_reduced)
    texts = (
        as_json(comparisons, recordings, contents, left_out, whole, [each.source for each in guarded]),
        junit(whole).encode(),
        markdown(whole).encode(),
    )
    write_files(dict(zip(reports, texts, strict=True)) | contents)
    return comparisons, recordings, reports


def both_runs(scene: Scene, baseline: Baseline) -> dict[str, Trajectory]:
    """Run a scene and take the run of its baseline, by the names that a recording shows.

    Returns:
        The runs "newton_euler" and "baseline"; empty if the scene cannot be run, or if its bodies or times
        are not those of the baseline.
    """
    scene = regress_scene(scene)
    stored = stored_run(scene, baseline)
    if stored is None:
        return {}
    try:
        return {SOLVER.name: main_run(scene, baseline.plan.rtol[MAIN_FORMULATION]), "baseline": stored}
    except NewtonEulerError:
        return {}


def stored_run(scene: Scene, baseline: Baseline) -> Trajectory | None:
    """Return the poses that the baseline stores as a run; None if its bodies or times are not the scene's.

    The baseline has no poses of the ground, which is body 0 of a trajectory: those of the scene are added.
    """
    ground, *moving = scene.mechanism.bodies
    count = len(scene.times)
    poses = list[Array]()
    for name, ground_pose in (("position", ground.center_of_mass), ("quaternion", ground.quaternion)):
        stored = baseline.find(MAIN_FORMULATION, f"{name} over time")
        if stored is None or stored.array.shape != (count, len(ground_pose) * len(moving)):
            return None
        others = stored.array.reshape(count, len(moving), len(ground_pose))
        poses.append(np.concatenate([np.tile(ground_pose, (count, 1, 1)), others], axis=1))
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
