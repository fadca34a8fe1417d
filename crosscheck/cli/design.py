"""`crosscheck controllers`, `loads`, `modes` and `workspace`: results for the design of a mechanism.

Each command parses its options, calls a function of another package, and prints the result. Excitation means
start velocities and sines for actuators, added to a model file that is otherwise at rest; a command that does
not excite raises an error for `--set excitation=on`. A default folder may have earlier results: a command
recognizes them by the kind of its results, such as "load table", and raises an error if they are of another
model.
"""

from __future__ import annotations

from pathlib import Path

import click

from crosscheck.cli.help import SCENE
from crosscheck.cli.shared import (
    AGREE,
    REDUCED,
    REFERENCE_ENGINE,
    UNFINISHED,
    allow_reduced_option,
    cli,
    engines_option,
    folder_option,
    load_with_warnings,
    next_step,
    progress_shown,
    refuse_excitation,
    result_paths,
    scene_options,
    setting_options,
    show,
    verbose_option,
    warn_about_import,
)
from crosscheck.support.errors import CrosscheckError


@cli.command(
    "controllers",
    arguments={"SCENE": f"{SCENE}  [default: tracker_computed_torque]"},
    examples={
        "compare the controllers in one engine": f"crosscheck controllers --engines {REFERENCE_ENGINE}"
    },
)
@click.argument("scene", default="tracker_computed_torque")
@setting_options
@engines_option
@folder_option("output/controllers/SCENE")
def controllers_command(
    scene: str, settings: tuple[str, ...], engines: list[str] | None, output: Path | None
) -> int:
    """Compare controllers by tracking error, effort and energy.

    A scene with the option `controller` is simulated with each value of the option, in each engine. In the
    library only the default scene has the option, with the values computed_torque, pd, pd_gravity and lqr.
    Its 12 runs take some minutes.

    The exit status is 3 if an engine cannot make one of the runs.
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


@cli.command(
    "loads",
    arguments={"SCENE": f"{SCENE}  [default: tracker_wind]"},
    examples={
        "compute the reactions of a scene": "crosscheck loads slider_crank",
        "compare two wind speeds": "crosscheck loads --case breeze:speed=5 --case storm:speed=25",
    },
)
@click.argument("scene", default="tracker_wind")
@setting_options
@click.option(
    "--case",
    "cases",
    multiple=True,
    metavar="NAME:OPTION=VALUE,...",
    help="Load case with options that replace those of --set. Repeatable.  [default: the cases of the "
    "scene, or one case]",
)
@click.option(
    "--at-rest",
    is_flag=True,
    help="Compute static loads in the initial pose, at the largest wind speed of each run.",
)
@allow_reduced_option
@folder_option("output/loads/SCENE")
def loads_command(
    scene: str,
    settings: tuple[str, ...],
    cases: tuple[str, ...],
    at_rest: bool,
    allow_reduced: bool,
    output: Path | None,
) -> int:
    """Compute joint reactions and actuator forces of load cases.

    A table has the largest loads over all cases. newton_euler computes the loads. `crosscheck run` compares
    the reactions of all engines at random states.

    The exit status is 4 if elements of the file act that are not simulated.
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


@cli.command(
    "modes",
    arguments={"SCENE": f"{SCENE}  [default: tracker]"},
    examples={"compute the modes of a scene at its equilibrium": "crosscheck modes pendulum"},
)
@click.argument("scene", default="tracker")
@setting_options
@click.option("--at-start", is_flag=True, help="Linearize at the initial state instead.")
@click.option(
    "--pose",
    "given_pose",
    multiple=True,
    metavar="JOINT=VALUE",
    help="Linearize in a pose that the controllers hold: a joint coordinate relative to the initial pose, m "
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
    help="Keep the forces of controllers constant instead of linearizing the controllers.",
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
    """Compute natural frequencies, damping ratios and mode shapes.

    The modal analysis linearizes the motion at an equilibrium.
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


@cli.command(
    "workspace",
    arguments={"SCENE": f"{SCENE}  [default: tracker]"},
    examples={
        "map poses of the crank from -1 to 1 rad": "crosscheck workspace slider_crank --vary pivot=-1:1:21"
    },
)
@click.argument("scene", default="tracker")
@setting_options
@click.option(
    "--vary",
    "ranges",
    multiple=True,
    required=True,
    metavar="JOINT=LOW:HIGH[:POINTS]",
    help="Range of a joint coordinate relative to the initial pose, m or rad, and the number of values (61 "
    "if not given). One per degree of freedom.",
)
@click.option("--axis", metavar="BODY=X,Y,Z", help="Map the direction of an axis, in the frame of its body.")
@click.option(
    "--point",
    metavar="BODY=X,Y,Z",
    help="Map the position of a point of a body, m, given in the world frame at the initial pose.",
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
    """Map reachable poses, singular poses and clearances.

    A clearance is the smallest distance of two bodies that no joint connects.
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
    notes = [f"wrote {', '.join(map(str, written))}"]
    if not any(path.suffix == ".png" for path in written):
        notes.append("no picture: pictures need two coordinates, or a --point that moves in a plane")
    show(whole, *notes, f"more  {next_step('report', paths[0].parent)}")
    return AGREE
