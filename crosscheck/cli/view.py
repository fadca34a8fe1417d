"""`crosscheck view`: open Rerun recordings in a window, or in a browser."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from urllib.parse import quote_plus

import click

from crosscheck.cli.shared import AGREE, cli, say
from crosscheck.support.errors import CrosscheckError

LOOPBACK = "127.0.0.1"
"""Network address at which the viewer listens: only programs of this machine reach it."""


@cli.command(
    "view",
    arguments={"FILE...": "Rerun recordings (.rrd)."},
    examples={"show the recording of crosscheck run robot.xml": "crosscheck view output/robot/robot.rrd"},
)
@click.argument("files", metavar="FILE...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--web", is_flag=True, help="Show the recordings in a browser instead of a window.")
def view_command(files: tuple[Path, ...], web: bool) -> int:
    """Open recordings in the Rerun viewer.

    The viewer lists the recordings and shows the selected one.
    """
    for file in files:
        _check_recording(file)
    from crosscheck.recording.show import has_display

    if not (web or has_display()):
        raise CrosscheckError("no display to open a viewer on; --web shows the recordings in a browser")
    # without `--bind`, the viewer would listen to the whole network
    command = [sys.executable, "-P", "-m", "rerun", "--bind", LOOPBACK]
    if web:
        page_port, data_port = _free_port(9090), _free_port(9876)  # Rerun's default ports, if they are free
        command += ["--serve-web", "--web-viewer-port", str(page_port), "--port", str(data_port)]
        source = quote_plus(f"rerun+http://localhost:{data_port}/proxy")
        say(f"Ctrl+C ends it; open http://{LOOPBACK}:{page_port}?url={source}")
        sys.stdout.flush()
    status = _run_viewer([*command, *map(str, files)])
    if status != 0:
        raise CrosscheckError(f"the viewer ended with status {status}")
    return AGREE  # exit status 0


def _check_recording(file: Path) -> None:
    """Raise `CrosscheckError` unless a file is a Rerun recording, by the first bytes of its content."""
    if file.exists() and not file.is_file():
        raise CrosscheckError(f"{file} is not a file")
    try:
        with file.open("rb") as stream:
            if stream.read(4) != b"RRF2":
                raise CrosscheckError(f"{file} is not a Rerun recording")
    except OSError as error:
        raise CrosscheckError(f"cannot read {file}: {error.strerror}") from error


def _run_viewer(command: Sequence[str]) -> int:
    """Run the command of a viewer until it ends; return its exit status, or 0 after an interrupt.

    Users end a viewer by Ctrl-C. SIGTERM, and SIGHUP of a closed terminal, count as such interrupts, too.
    The viewer gets a separate process group, because Rerun's program starts the viewer as a child process.
    """
    from crosscheck.support.time_limits import signals_as_interrupts

    with signals_as_interrupts():
        process = subprocess.Popen(command, start_new_session=True, env=os.environ | {"RUST_LOG": "error"})
        try:
            return process.wait()
        except KeyboardInterrupt:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGTERM)
            process.wait()
            return 0


def _free_port(default: int) -> int:
    """Return a network port of this machine that no program listens at: the default one if it is free."""
    with socket.socket() as tried:
        try:
            tried.bind((LOOPBACK, default))
        except OSError:
            tried.bind((LOOPBACK, 0))
        return int(tried.getsockname()[1])
