"""`crosscheck bench`, `controllers`, `loads`, `modes`, `workspace`, `stress`, `faults`, `figures`, `report`.

Each command parses its options, calls a function of another package, and prints the result. Excitation means
start velocities and sines for actuators, added to a model file that is otherwise at rest; a command that does
not excite raises an error for `--set excitation=on`. An import report lists how each element of a model file
was imported; it is None for a scene that comes from no model file. A default folder may have earlier results:
a command recognizes them by the kind of its results, such as "load table", and raises an error if they are of
another model.
"""

from __future__ import annotations

import time
from pathlib import Path

import click

from crosscheck.cli.shared import (
    AGREE,
    DISAGREE,
    REDUCED,
    UNFINISHED,
    cli,
    engines_option,
    folder_option,
    load_with_warnings,
    next_step,
    progress_shown,
    refuse_excitation,
    result_paths,
    say,
    scene_options,
    setting_options,
    show,
    verbose_option,
    warn_about_import,
)
from crosscheck.report.render import as_json, terminal
from crosscheck.support.errors import CrosscheckError


@cli.command("figures")
@folder_option("output/figures")
def figures_command(output: Path) -> int:
    """Reproduce Figures 5 to 9 of the paper with the three engines."""
    # the paper: S. Srang, S. Ath, M. Yamakita, doi:10.25046/aj050587, on a solar tracker
    from crosscheck.studies.paper_figures import draw

    with progress_shown() as progress:
        written = draw(output, progress)
    for path in written:
        say(f"wrote {path}")
    return AGREE


@cli.command("bench")
@click.argument("scene", default="tracker")
@setting_options
@click.option(
    "--error",
    type=float,
    default=1e-6,
    show_default=True,
    help="Report the fastest settings of each engine below this error, m or rad.",
)
@click.option("--rhs", is_flag=True, help="Time one evaluation of the equations of motion instead of runs.")
@click.option(
    "--batch",
    type=click.IntRange(2, 10_000_000),
    metavar="RUNS",
    help="Measure the throughput of a batch of this many runs from random states instead.",
)
@click.option("--sensitivities", is_flag=True, help="Time parameter sensitivities instead.")
@engines_option
@folder_option("output/bench/SCENE")
@verbose_option
def bench_command(
    scene: str,
    settings: tuple[str, ...],
    error: float,
    rhs: bool,
    batch: int | None,
    sensitivities: bool,
    engines: list[str] | None,
    output: Path | None,
) -> int:
    """Benchmark engines: run time against error (work-precision).

    SCENE is the name of a library scene or a model file (see run).
    """
    from crosscheck.engines.registry import ENGINES, SOLVER, choose
    from crosscheck.loading.load import with_excitation
    from crosscheck.studies.benchmark.run import BenchmarkRequest, bench

    given = {"rhs": rhs, "batch": batch is not None, "sensitivities": sensitivities}
    kinds = [kind for kind, is_given in given.items() if is_given] or ["runs"]
    if len(kinds) > 1:
        names = " and ".join(f"--{kind}" for kind in kinds)
        raise CrosscheckError(f"{names} are different benchmarks; choose one")
    if sensitivities and engines:
        raise CrosscheckError(f"--sensitivities are those of {SOLVER.name}; leave out --engines")
    options = with_excitation(scene, scene_options(settings))
    loaded, chosen = load_with_warnings(scene, options), choose(engines or list(ENGINES))
    request = BenchmarkRequest(loaded, scene, options, chosen, error, batch or 0)
    with progress_shown() as progress:
        found, written = bench(request, kinds[0], output, progress)
    more = f"more  -v; {next_step('report', written[0].parent)}"
    show(found, f"wrote {', '.join(map(str, written))}", more)
    return AGREE


@cli.command("controllers")
@click.argument("scene", default="tracker_computed_torque")
@setting_options
@engines_option
@folder_option("output/controllers/SCENE")
def controllers_command(
    scene: str, settings: tuple[str, ...], engines: list[str] | None, output: Path | None
) -> int:
    """Compare controllers: tracking error, effort and energy in all engines.

    SCENE is the name of a library scene or a model file (see run). A scene with the option `controller` is
    simulated with each value of the option. The default scene takes 12 runs and some minutes, or seconds with
    --engines newton_euler. The exit status is 3 if an engine cannot make one of the runs.
    """
    from crosscheck.design.controllers import CONTROLLERS_FILES, compared, write
    from crosscheck.engines.registry import ENGINES

    options = refuse_excitation(scene_options(settings), why="controllers are those of the scene")
    paths = result_paths(
        output,
        "output/controllers",
        kind="comparison of controllers",
        names=CONTROLLERS_FILES,
        sources=[scene],
    )
    with progress_shown() as progress:
        rows, missing = compared(scene, options, engines or list(ENGINES), progress)
        report = write(rows, missing, paths, scene, options)
    more = f"more  {next_step('report', paths[0].parent)}"
    show(report, "wrote " + ", ".join(map(str, paths)), more)
    return UNFINISHED if missing else AGREE


@cli.command("loads")
@click.argument("scene", default="tracker_wind")
@setting_options
@click.option(
    "--case",
    "cases",
    multiple=True,
    metavar="NAME:OPTION=VALUE,...",
    help="Load case and its options, which replace those of --set. Repeatable.  [default: the cases of the "
    "scene, or one case]",
)
@click.option(
    "--at-rest",
    is_flag=True,
    help="Compute static loads in the initial pose, at the largest wind speed of each run.",
)
@click.option(
    "--allow-reduced",
    is_flag=True,
    help="Exit with 0 even if elements of the file act that are not simulated.",
)
@folder_option("output/loads/SCENE")
def loads_command(
    scene: str,
    settings: tuple[str, ...],
    cases: tuple[str, ...],
    at_rest: bool,
    allow_reduced: bool,
    output: Path | None,
) -> int:
    """Compute joint reactions and actuator loads of load cases, and their maxima over all cases.

    newton_euler computes the loads. `crosscheck run` compares the reactions of all engines.

    SCENE is the name of a library scene or a model file (see run).
    """
    from crosscheck.design.load_cases import check_distinct, default_cases, parse_cases
    from crosscheck.design.loads import LoadCase, loads
    from crosscheck.loading.load import load_scene
    from crosscheck.report.output import usual_folder

    if cases or settings:
        common, own_settings = scene_options(settings), parse_cases(cases, scene)
        options = {name: common | scene_options(own, f"--case {name}:") for name, own in own_settings.items()}
        check_distinct(scene, options)
    else:
        options = default_cases(scene)
    models = {}
    for name, chosen in options.items():
        models[name] = LoadCase(chosen, *load_scene(scene, chosen))
        if len(models) == 1:
            warn_about_import(scene, models[name].import_report, models[name].scene)
    folder = output or usual_folder(Path("output/loads"), scene, results="load table")
    with progress_shown() as progress:
        found, written, unsimulated = loads(scene, models, at_rest, folder, progress)
    look = f"look  {next_step('view', written[-1])}"
    show(found, "wrote " + ", ".join(map(str, written)), look, f"more  {next_step('report', folder)}")
    return REDUCED if unsimulated and not allow_reduced else AGREE


@cli.command("modes")
@click.argument("scene", default="tracker")
@setting_options
@click.option("--at-start", is_flag=True, help="Linearize at the initial state instead of an equilibrium.")
@click.option(
    "--pose",
    "given_pose",
    multiple=True,
    metavar="JOINT=VALUE",
    help="Linearize in a pose that the control laws hold: a joint coordinate relative to the initial pose, m "
    "or rad. Repeatable.  [default: the pose in which the run comes to rest]",
)
@click.option(
    "--time",
    type=float,
    metavar="S",
    help="Time at which set-points and other functions of time are held, s.  [default: the end of the run if "
    "they are constant there, else 0]",
)
@click.option(
    "--open-loop",
    is_flag=True,
    help="Keep the forces of controllers constant instead of linearizing the control laws.",
)
@folder_option("output/modes/SCENE")
@verbose_option
def modes_command(
    scene: str,
    settings: tuple[str, ...],
    at_start: bool,
    given_pose: tuple[str, ...],
    time: float | None,
    open_loop: bool,
    output: Path | None,
) -> int:
    """Modal analysis: natural frequencies, damping ratios and mode shapes at an equilibrium.

    SCENE is the name of a library scene or a model file (see run).
    """
    from crosscheck.design.modes import MODES_FILES, analyze, pose_of, write

    given = {"--at-start": at_start, "--pose": bool(given_pose), "--time": time is not None}
    if len(names := [name for name, is_given in given.items() if is_given]) > 1:
        raise CrosscheckError(f"{' and '.join(names)} choose different poses; give one of them")
    options = refuse_excitation(scene_options(settings), why="modes are those of the scene as it stands")
    loaded = load_with_warnings(scene, options)
    pose = pose_of(loaded, given_pose)
    paths = result_paths(output, "output/modes", kind="modal analysis", names=MODES_FILES, sources=[scene])
    with progress_shown() as progress:
        progress("linearizing")
        found = analyze(loaded, at_start=at_start, pose=pose, time=time, open_loop=open_loop)
        progress("recording")
        report = write(found, paths, scene, options)
    more = f"more  -v; {next_step('report', paths[0].parent)}"
    show(report, "wrote " + ", ".join(map(str, paths)), more)
    return AGREE


@cli.command("workspace")
@click.argument("scene", default="tracker")
@setting_options
@click.option(
    "--vary",
    "ranges",
    multiple=True,
    required=True,
    metavar="JOINT=LOW:HIGH[:POINTS]",
    help="Range of a joint coordinate relative to the initial pose, m or rad. One per degree of freedom.",
)
@click.option("--axis", metavar="BODY=X,Y,Z", help="Map the direction of an axis, in the frame of its body.")
@click.option(
    "--point",
    metavar="BODY=X,Y,Z",
    help="Map the position of a point of a body, m, given in the world at the initial pose.",
)
@folder_option("output/workspace/SCENE")
def workspace_command(
    scene: str,
    settings: tuple[str, ...],
    ranges: tuple[str, ...],
    axis: str | None,
    point: str | None,
    output: Path | None,
) -> int:
    """Map the workspace: reachable poses, singular poses and clearances between bodies.

    SCENE is the name of a library scene or a model file (see run).
    """
    from crosscheck.design import workspace

    options = refuse_excitation(scene_options(settings), why="a workspace is that of the scene as it stands")
    loaded = load_with_warnings(scene, options)
    grid = dict(workspace.range_of(loaded, each) for each in ranges)
    pointing = None if axis is None else workspace.axis_of(axis)
    tip = None if point is None else workspace.point_of(point)
    paths = result_paths(
        output, "output/workspace", kind="workspace", names=workspace.WORKSPACE_FILES, sources=[scene]
    )
    with progress_shown() as progress:
        found = workspace.measure(loaded, grid, pointing, tip, progress)
        progress("writing")
        whole = workspace.report(found)
        written = workspace.write(found, whole, paths[0].parent, scene, options)
    files = ", ".join(str(path) for path in written)
    show(whole, f"wrote {files}", f"more  {next_step('report', paths[0].parent)}")
    return AGREE


@cli.command("stress")
@click.option(
    "--full/--ci",
    "full",
    default=True,
    show_default=True,
    help="Run all cases, or the short selection for CI.",
)
@engines_option
@folder_option("output/stress")
@click.option(
    "--only",
    "letters",
    default="",
    metavar="LETTERS",
    help="Run these topics only, such as bh.  [default: all]",
)
def stress_command(full: bool, engines: list[str] | None, output: Path, letters: str) -> int:
    """Stress-test engines with extreme parameter values and report where each engine fails.

    A case whose scene an engine cannot express is counted apart, neither as passed nor as failed.
    """
    from crosscheck.engines.engine import Engine
    from crosscheck.engines.registry import ENGINES, choose
    from crosscheck.engines.usable import divide
    from crosscheck.studies.stress.report import STRESS_FILES, report, write
    from crosscheck.studies.stress.topics import stress
    from crosscheck.support.files import check_writable

    check_writable(*(output / name for name in STRESS_FILES))
    usable, errors = divide(choose(engines or list(ENGINES)), Engine.stress)
    left_out = {name: str(error) for name, error in errors.items()}
    start = time.perf_counter()
    with progress_shown() as progress:
        rows = stress(letters, full, usable, progress)
        wall_time = time.perf_counter() - start
        progress("writing")
        found = report(rows, full, wall_time, usable, left_out)
        written = write(rows, found, full, output)
    click.echo(terminal(found.parts), nl=False)
    say("wrote " + ", ".join(str(path) for path in written))
    say(f"{found.verdict}, in {wall_time:.0f} s")
    return AGREE


@cli.command("faults")
@click.argument("scene", default="tracker")
@setting_options
@engines_option
@click.option("--reading", is_flag=True, help="Inject faults into the import of the model file SCENE.")
@folder_option("output/faults/SCENE")
@verbose_option
def faults_command(
    scene: str,
    settings: tuple[str, ...],
    engines: list[str] | None,
    reading: bool,
    output: Path | None,
) -> int:
    """Fault injection: report which single faults crosscheck detects and locates correctly.

    Each fault is in the model of one of the engines, or with --reading in the import of the model file SCENE.
    """
    from crosscheck.engines.registry import ENGINES
    from crosscheck.loading.load import load_scene
    from crosscheck.studies.faults.find import find_faults, find_in_reading
    from crosscheck.studies.faults.report import data, detects_enough, report
    from crosscheck.support.files import write_files

    options = scene_options(settings)
    if reading and engines:
        raise CrosscheckError(
            "--reading is the import of the file, which no engine runs; leave out --engines"
        )
    if reading:
        options = refuse_excitation(options, why="what is read is verified as the file stands")
    loaded, import_report = load_scene(scene, options)
    if reading and import_report is None:
        raise CrosscheckError(f"{scene} is read from no model file; --reading needs an MJCF or a URDF")
    [path] = result_paths(
        output, "output/faults", kind="fault search", names=["faults.json"], sources=[scene]
    )
    start = time.perf_counter()
    with progress_shown() as progress:
        if reading and import_report is not None:
            search = find_in_reading(import_report, progress)
        else:
            warn_about_import(scene, import_report, loaded)
            search = find_faults(loaded, progress, names=engines or list(ENGINES))
    wall_time = time.perf_counter() - start
    found = report(loaded.name, search, wall_time)
    write_files({path: as_json({"source": scene, **data(loaded.name, options, search)}, found)})
    show(found, f"wrote {path}", f"more  -v; {next_step('report', path.parent)}")
    return AGREE if detects_enough(search) else DISAGREE


@cli.command("report")
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
def report_command(folder: Path) -> int:
    """Write the results of other commands in DIR as one HTML page, DIR/report.html.

    DIR is the output folder of run, run --all, regress, faults, stress, bench, sweep, diff, loads, drives,
    modes, controllers, tune, workspace, sun, year, identify or importers, or a folder of such folders, for
    example `output`.
    """
    from crosscheck.report.page import write_report
    from crosscheck.sweeps.store import check_finished

    check_finished(folder)
    with progress_shown() as progress:
        path = write_report(folder, progress)
    say(f"wrote {path}")
    return AGREE
