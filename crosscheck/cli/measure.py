"""`crosscheck bench`, `stress`, `faults`, `figures` and `report`: measurements of engines, and HTML pages.

Each command parses its options, calls a function of another package, and prints the result. Excitation means
start velocities and sines for actuators, added to a model file that is otherwise at rest; a command that does
not excite raises an error for `--set excitation=on`. An import report lists how each element of a model file
was imported; it is None for a scene that comes from no model file. A default folder may have earlier results:
a command recognizes them by the kind of its results, such as "load table", and raises an error if they are of
another model.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import click

from crosscheck.cli.help import SCENE
from crosscheck.cli.shared import (
    AGREE,
    DISAGREE,
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
from crosscheck.report.render import as_json, terminal, wrapped
from crosscheck.support.errors import CrosscheckError


@cli.command(
    "figures",
    examples={"draw the figures as PNG files in output/figures": "crosscheck figures"},
)
@folder_option("output/figures")
def figures_command(output: Path) -> int:
    """Reproduce Figures 5 to 9 of the paper on the solar tracker."""
    # the paper: S. Srang, S. Ath, M. Yamakita, doi:10.25046/aj050587, on a solar tracker
    from crosscheck.studies.paper_figures import draw

    with progress_shown() as progress:
        written = draw(output, progress)
    for path in written:
        say(f"wrote {path}")
    return AGREE


@cli.command(
    "bench",
    arguments={"SCENE": f"{SCENE}  [default: tracker]"},
    examples={"find settings with an error below 1e-6 m or rad": "crosscheck bench pendulum --error 1e-6"},
)
@click.argument("scene", default="tracker")
@setting_options
@click.option(
    "--error",
    type=float,
    default=1e-6,
    show_default=True,
    help="Report the fastest settings of each engine with an error below this one, m or rad.",
)
@click.option("--rhs", is_flag=True, help="Time a single evaluation of the equations of motion instead.")
@click.option(
    "--batch",
    type=click.IntRange(2, 10_000_000),
    metavar="RUNS",
    help="Measure the throughput of this many runs from random states instead.",
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

    Each engine runs the scene with many settings. The error of a run is its largest deviation, m or rad, from
    a reference run.
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


@cli.command(
    "stress",
    examples={"run the short selection of cases": "crosscheck stress --ci"},
)
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
    help="Letters of the topics to run, such as bf: a long runs, b large steps, c stiff gains, d mass "
    "ratios, e open starts, f singular configurations, g fast rotation, h random mechanisms, "
    "i floating-point traps, j noise.  [default: all]",
)
def stress_command(full: bool, engines: list[str] | None, output: Path, letters: str) -> int:
    """Stress-test engines with extreme parameter values.

    The command reports the values from which each engine fails. Cases that an engine cannot represent are
    counted separately. Engines without cases in a topic are named; if no case runs, the exit status is 2.
    """
    from crosscheck.engines.engine import Engine
    from crosscheck.engines.registry import ENGINES, choose
    from crosscheck.engines.usable import divide
    from crosscheck.studies.stress.report import STRESS_FILES, report, write
    from crosscheck.studies.stress.topics import stress, wanted_topics
    from crosscheck.support.files import check_writable

    check_writable(*(output / name for name in STRESS_FILES))
    usable, errors = divide(choose(engines or list(ENGINES)), Engine.stress)
    left_out = {name: str(error) for name, error in errors.items()}
    wanted = wanted_topics(letters)
    start = time.perf_counter()
    with progress_shown() as progress:
        rows = stress(wanted, full, usable, progress)
        wall_time = time.perf_counter() - start
        progress("writing")
        found = report(rows, wanted, full, wall_time, usable, left_out)
        written = write(rows, found, full, output)
    click.echo(terminal(found.parts), nl=False)
    say("wrote " + ", ".join(str(path) for path in written))
    say(f"{found.verdict}, in {wall_time:.0f} s")
    return AGREE


@cli.command(
    "faults",
    arguments={"SCENE": f"{SCENE}  [default: tracker]"},
    examples={
        "inject faults into the models of the engines": "crosscheck faults pendulum",
        "inject faults into the import of a file": "crosscheck faults robot.xml --reading",
    },
)
@click.argument("scene", default="tracker")
@setting_options
@engines_option
@click.option("--reading", is_flag=True, help="Inject faults into the import of the file instead.")
@folder_option("output/faults/SCENE")
@verbose_option
def faults_command(
    scene: str,
    settings: tuple[str, ...],
    engines: list[str] | None,
    reading: bool,
    output: Path | None,
) -> int:
    """Report which injected faults crosscheck detects and locates.

    Fault injection tests the comparison itself. Each fault is a single wrong number in the model of one
    engine, or with --reading in the import of a file.

    The exit status is 1 if too few faults are detected or located.
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


@cli.command(
    "report",
    arguments={"DIR": "Folder with results of one command, or a folder of such folders."},
    examples={"write a page of all results in the folder output": "crosscheck report output"},
)
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
def report_command(folder: Path) -> int:
    """Write the results of other commands as one HTML page.

    The page is DIR/report.html.
    """
    from crosscheck.report.page import write_report
    from crosscheck.sweeps.store import check_finished

    check_finished(folder)
    with progress_shown() as progress:
        page = write_report(folder, progress)
    say(f"wrote {page.path}")
    for sentence in page.missing:
        click.echo(wrapped(f"note: {sentence}", sys.stderr), err=True)
    return AGREE
