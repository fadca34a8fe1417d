"""The destination of a recording: a file, a viewer that runs or is started, a server, or standard output."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from crosscheck.errors import CrosscheckError

if TYPE_CHECKING:
    from crosscheck.report.table import Report
    from crosscheck.run import Crosscheck


@dataclass(frozen=True)
class Destination:
    """Destination chosen on the command line; a file if none was.

    Attributes:
        save: the recording's file, if one was named.
        spawn: start a viewer, or take one that runs.
        connect: address of a viewer.
        serve: serve the recording to browsers.
        bind: IP address that the server listens at; this machine only if None.
        stdout: write the recording to standard output.
    """

    save: Path | None = None
    spawn: bool = False
    connect: str | None = None
    serve: bool = False
    bind: str | None = None
    stdout: bool = False

    @property
    def to_file(self) -> bool:
        return not (self.spawn or self.connect is not None or self.serve or self.stdout)

    def check(self) -> None:
        """Raise `CrosscheckError`, before a run, for a destination that cannot be reached afterwards."""
        given = {
            "--save": self.save is not None,
            "--spawn": self.spawn,
            "--connect": self.connect is not None,
            "--serve": self.serve,
            "--stdout": self.stdout,
        }
        chosen = [option for option, is_given in given.items() if is_given]
        if len(chosen) > 1:
            raise CrosscheckError(f"{' and '.join(chosen)}: a recording goes to one place; choose one")
        if self.bind is not None and not self.serve:
            raise CrosscheckError(f"--bind {self.bind}: only --serve listens")
        if self.save is not None and self.save.suffix != ".rrd":
            raise CrosscheckError(f"--save {self.save}: a recording's name ends in .rrd")
        if self.stdout and sys.stdout.isatty():
            raise CrosscheckError("--stdout writes a recording; send it to a file or through a pipe")
        if self.to_file or self.stdout:
            return
        from crosscheck.recording import server

        if self.spawn and not server.has_display():
            raise CrosscheckError("no display for --spawn to open a viewer on; --serve shows it in a browser")
        if self.connect is not None:
            server.check_url(self.connect)
        if self.bind is not None:
            server.free_port(self.bind)

    @contextmanager
    def sent(self, result: Crosscheck, report: Report) -> Iterator[Sent]:
        """Send the recording where it goes, if that is no file.

        Raises:
            CrosscheckError: if it cannot be sent.
        """
        if self.to_file:
            yield Sent()
            return
        from crosscheck.recording import server
        from crosscheck.recording.log import log_run, new_recording, recorded
        from crosscheck.report.render import markdown
        from crosscheck.workers import tidied_up

        verdict = markdown(report, folded=True)
        if self.stdout:
            content = recorded(result.scene, result.runs, verdict, result.title)
            stream = sys.__stdout__
            assert stream is not None
            stream.buffer.write(content)
            stream.buffer.flush()
            yield Sent(f"wrote the recording to standard output, {len(content)} bytes")
            return
        recording = new_recording(result.scene)

        def log() -> None:
            log_run(recording, result.scene, result.runs, verdict, result.title)

        if self.spawn:
            yield Sent(f"sent the recording to the viewer at {server.spawn(recording, log)}")
        elif self.connect is not None:
            server.send(recording, self.connect, log)
            yield Sent(f"sent the recording to {self.connect}")
        else:
            address = self.bind or server.LOOPBACK
            with tidied_up(), server.served(recording, address, log) as (place, process):
                yield Sent(f"serving the recording at {place} until interrupted", process)


@dataclass(frozen=True)
class Sent:
    """A recording that was sent.

    Attributes:
        line: to tell of it.
        server: serves it until it is ended.
    """

    line: str = ""
    server: subprocess.Popen[bytes] | None = None

    @contextmanager
    def until_interrupted(self) -> Iterator[None]:
        """Tell of the recording in the block, then wait for an interrupt or the end of the server, if any.

        Whoever is told of the server may interrupt it before the block is done.

        Raises:
            CrosscheckError: if the server ends by itself.
        """
        if self.server is None:
            yield
            return
        with suppress(KeyboardInterrupt):
            yield
            raise CrosscheckError(f"Rerun's server ended with status {self.server.wait()}")
