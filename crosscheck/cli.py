"""The command line: `crosscheck run`, `list`, `view`, `figures`.

Click parses it. Exit status: 0 agree, 1 disagree, 2 bad input or usage, with one line saying what.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import click
from rich.console import Console

from crosscheck.errors import CrosscheckError
from newton_euler.errors import NewtonEulerError

TABLE_WIDTH = 100
"""Columns that the tables of a run need; a narrower terminal wraps them itself."""

AGREE, DISAGREE, BAD_INPUT = 0, 1, 2


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="crosscheck", prog_name="crosscheck")
def cli() -> None:
    """Compare closed-loop mechanism dynamics between engines."""


def _options(settings: tuple[str, ...]) -> dict[str, str]:
    options = {}
    for setting in settings:
        key, equals, value = setting.partition("=")
        if not (key and equals and value):
            raise CrosscheckError(f"--set {setting!r} is not of the form OPTION=VALUE")
        options[key] = value
    return options


@cli.command("run")
@click.argument("scene", default="tracker")
@click.option(
    "--engines", default="newton_euler,mujoco,pinocchio", show_default=True, help="Comma-separated."
)
@click.option(
    "--set", "settings", multiple=True, metavar="OPTION=VALUE", help="Option of the scene; repeatable."
)
@click.option(
    "--output", type=click.Path(path_type=Path), default=None, help="Folder.  [default: output/SCENE]"
)
@click.option(
    "--save", type=click.Path(path_type=Path), default=None, help="Recording.  [default: OUTPUT/SCENE.rrd]"
)
def run_command(
    scene: str, engines: str, settings: tuple[str, ...], output: Path | None, save: Path | None
) -> int:
    """Run SCENE (a name or a scene file) through the engines and compare them."""
    from crosscheck.engines import choose
    from crosscheck.report import markdown, settings_lines, terminal_tables
    from crosscheck.run import check_writable, crosscheck, write
    from crosscheck.scenes import load

    chosen = choose([name.strip() for name in engines.split(",") if name.strip()])
    loaded = load(scene, **_options(settings))
    folder = output or Path("output") / loaded.name
    recording = save or folder / f"{loaded.name}.rrd"
    check_writable(folder, recording)
    console = Console(width=max(TABLE_WIDTH, Console().width))
    with console.status("") as status:
        result = crosscheck(loaded, chosen, status.update)
        status.update("writing")
        written = write(result, folder, recording, markdown(result))
    for table in terminal_tables(result):
        console.print(table)
    for line in (*settings_lines(result), "wrote " + ", ".join(str(path) for path in written)):
        console.print(line, highlight=False, soft_wrap=True)
    console.print(result.verdict, style="bold", highlight=False, soft_wrap=True)
    return AGREE if result.agrees else DISAGREE


@cli.command("list")
def list_command() -> int:
    """List the scenes and engines."""
    from crosscheck.engines import ENGINES
    from crosscheck.scenes import SCENES, load, option_values

    for name in SCENES:
        click.echo(f"{name}: {load(name).description}")
        for option, values in option_values(name).items():
            click.echo(f"    --set {option}={'|'.join(values)}")
    click.echo(f"engines: {', '.join(ENGINES)}")
    return AGREE


@cli.command("view")
@click.argument("file", type=click.Path(path_type=Path))
def view_command(file: Path) -> int:
    """Open a recording in the Rerun viewer."""
    try:
        with file.open("rb") as stream:
            if stream.read(4) != b"RRF2":
                raise CrosscheckError(f"{file} is not a Rerun recording")
    except OSError as error:
        raise CrosscheckError(f"cannot read {file}: {error.strerror}") from error
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise CrosscheckError(
            f"no display to open a viewer on; in a browser: rerun --bind 127.0.0.1 --serve-web {file}"
        )
    return subprocess.run([sys.executable, "-m", "rerun", str(file)], check=False).returncode


@cli.command("figures")
@click.option("--output", type=click.Path(path_type=Path), default=Path("output/figures"), show_default=True)
def figures_command(output: Path) -> int:
    """Redraw the paper's Figures 5 to 9 from the three engines."""
    from crosscheck.figures import draw

    console = Console()
    with console.status("") as status:
        written = draw(output, status.update)
    for path in written:
        click.echo(f"wrote {path}")
    return AGREE


def main(arguments: list[str] | None = None) -> Any:
    """Run the command line and exit; every expected failure is one line on stderr and status 2."""
    try:
        status = cli.main(arguments, prog_name="crosscheck", standalone_mode=False)
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message())
        sys.exit(BAD_INPUT)
    except click.ClickException as error:
        _fail(error.format_message())
    except click.exceptions.Abort:
        _fail("interrupted")
    except Exception as error:
        if not _is_expected(error):
            raise
        _fail(str(error))
    sys.exit(status)


def _is_expected(error: Exception) -> bool:
    """Whether an error is one that the packages raise on purpose."""
    expected: list[type[Exception]] = [CrosscheckError, NewtonEulerError]
    for package, name in (("mjcf.errors", "MjcfError"), ("urdf.errors", "UrdfError")):
        if package in sys.modules:
            expected.append(getattr(sys.modules[package], name))
    return isinstance(error, tuple(expected))


def _fail(message: str) -> None:
    click.echo(f"crosscheck: error: {' '.join(message.split())}", err=True)
    sys.exit(BAD_INPUT)
