"""Rerun's own program as a viewer or a server, and recordings sent to it."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from ipaddress import ip_address
from typing import IO
from urllib.parse import quote, urlsplit

import rerun as rr

from crosscheck.errors import CrosscheckError

LOOPBACK = "127.0.0.1"

GRPC_PORT, WEB_PORT = 9876, 9090
"""Rerun's own defaults."""

SCHEMES = {"rerun": 443, "rerun+http": 80, "rerun+https": 443}
"""Addresses of viewers by scheme, with the usual port."""

ANSWER = 3.0
"""s that a viewer may take to accept a connection."""

PATIENCE = 30.0
"""s that a viewer may take to start, and again to take a recording."""

POLL = 0.05
"""s between attempts to connect to a viewer that is starting."""

Log = Callable[[], None]
"""Logs a run to a recording."""


def check_url(url: str) -> None:
    """Raise `CrosscheckError` unless something listens at an address, `rerun+http://HOST:PORT/proxy`."""
    try:
        parts = urlsplit(url)
        port = parts.port or SCHEMES.get(parts.scheme)
    except ValueError as error:
        raise CrosscheckError(f"--connect {url}: {error}") from error
    if port is None or not parts.hostname or parts.path != "/proxy":
        known = ", ".join(f"{scheme}://" for scheme in SCHEMES)
        raise CrosscheckError(
            f"--connect {url!r} is no address of a viewer; needed: one of {known}, HOST:PORT and /proxy, "
            f"such as rerun+http://{LOOPBACK}:{GRPC_PORT}/proxy"
        )
    try:
        socket.create_connection((parts.hostname, port), ANSWER).close()
    except OSError as error:
        reason = error.strerror or str(error)
        raise CrosscheckError(f"--connect {url}: no viewer answers: {reason}") from error


def has_display() -> bool:
    """True if a window can be opened."""
    return sys.platform != "linux" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def send(recording: rr.RecordingStream, url: str, log: Log) -> None:
    """Log a run to the viewer at an address.

    Flushing does not wait until the viewer has taken everything; disconnecting does, without end.

    Raises:
        CrosscheckError: if the viewer does not take the recording within `PATIENCE`.
    """
    leaving = threading.Thread(target=recording.disconnect, daemon=True)
    try:
        recording.connect_grpc(url)
        log()
        recording.flush(timeout_sec=PATIENCE)
    except RuntimeError as error:
        raise CrosscheckError(f"the viewer at {url} did not take the recording: {error}") from error
    finally:
        leaving.start()
        leaving.join(PATIENCE)
        if leaving.is_alive():
            rr.unregister_shutdown()  # it would wait at the end of this process
    if leaving.is_alive():
        raise CrosscheckError(f"the viewer at {url} did not take the recording within {PATIENCE:g} s")


def spawn(recording: rr.RecordingStream, log: Log) -> str:
    """Log a run to the viewer that listens on Rerun's port, started if need be; return its address.

    It stays when this process ends, so that the next run can be opened beside this one. Rerun's own `spawn`
    would have it listen to all of the network.
    """
    url = f"rerun+http://{LOOPBACK}:{GRPC_PORT}/proxy"
    if not _listening(LOOPBACK, GRPC_PORT):
        with tempfile.TemporaryFile() as output:
            process = start(["--port", str(GRPC_PORT), "--expect-data-soon"], LOOPBACK, output)
            wait(process, LOOPBACK, GRPC_PORT)
    send(recording, url, log)
    return url


@contextmanager
def served(
    recording: rr.RecordingStream, address: str, log: Log
) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """Serve a run to browsers; yield the address of the page and the server.

    The server listens on Rerun's ports, or others if those are taken, and is ended on the way out. Rerun's
    own `serve_grpc` would have it listen to all of the network.
    """
    grpc, web = free_port(address, GRPC_PORT), free_port(address, WEB_PORT)
    options = ["--serve-web", "--port", str(grpc), "--web-viewer-port", str(web)]
    everywhere = ip_address(address).is_unspecified
    host = (LOOPBACK if "." in address else "::1") if everywhere else address
    reached = f"[{host}]" if ":" in host else host
    if not ip_address(host).is_loopback or everywhere:
        options += ["--cors-allow-origin", f"http://*:{web}"]
    with tempfile.TemporaryFile() as output:
        process = start(options, address, output)
        try:
            wait(process, host, grpc)
            url = f"rerun+http://{reached}:{grpc}/proxy"
            send(recording, url, log)
            wait(process, host, web)
            yield f"http://{reached}:{web}?url={quote(url, safe='')}", process
        finally:
            end(process)


def free_port(address: str, wanted: int = 0) -> int:
    """The wanted port if it is free at an IP address, otherwise another that is.

    Raises:
        CrosscheckError: for an address at which nothing can listen.
    """
    try:
        family = socket.AF_INET6 if ip_address(address).version == 6 else socket.AF_INET
    except ValueError as error:
        raise CrosscheckError(f"--bind {address}: {error}") from error
    for port in (wanted, 0):
        with socket.socket(family) as probe:
            try:
                if sys.platform != "win32":  # or a port counts as taken for a minute after a server has ended
                    probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                probe.bind((address, port))
                return int(probe.getsockname()[1])
            except OSError as error:
                reason = error.strerror
    raise CrosscheckError(f"--bind {address}: {reason}")


def start(options: list[str], address: str, output: IO[bytes]) -> subprocess.Popen[bytes]:
    """Start Rerun's program, listening at an address, its output going to a file.

    It has a process group of its own, because it may start the viewer as a child.
    """
    command = [sys.executable, "-m", "rerun_cli", "--bind", address, "--hide-welcome-screen", *options]
    return subprocess.Popen(command, stdout=output, stderr=output, start_new_session=True)


def end(process: subprocess.Popen[bytes]) -> None:
    """End a program that `start` started, and its children."""
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def wait(process: subprocess.Popen[bytes], host: str, port: int) -> None:
    """Wait until a program that is starting listens; raise `CrosscheckError` if it does not."""
    deadline = time.monotonic() + PATIENCE
    while not _listening(host, port):
        if process.poll() is not None:
            raise CrosscheckError(
                f"the Rerun viewer did not start; it ended with status {process.returncode}"
            )
        if time.monotonic() > deadline:
            end(process)
            raise CrosscheckError(f"the Rerun viewer did not start within {PATIENCE:g} s")
        time.sleep(POLL)


def _listening(host: str, port: int) -> bool:
    try:
        socket.create_connection((host, port), ANSWER).close()
    except OSError:
        return False
    return True
