"""Rerun's own program as a server of recordings or as a viewer, and sending recordings to it."""

from __future__ import annotations

import ipaddress
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
from typing import IO
from urllib.parse import quote, urlsplit

import rerun as rr

from crosscheck.errors import CrosscheckError

LOOPBACK = "127.0.0.1"

GRPC_PORT, WEB_PORT = 9876, 9090
"""Rerun's own defaults."""

SCHEMES = {"rerun": 443, "rerun+http": 80, "rerun+https": 443}
"""Of addresses of viewers, with the ports that they stand for."""

HTTP2_SETTINGS = b"\0\0\0\4\0\0\0\0\0"
"""The head of a frame without content: length, type, flags and stream (RFC 9113, sections 4.1 and 6.5)."""

HTTP2_GREETING = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + HTTP2_SETTINGS
"""Both ends of a connection begin with a frame of settings, the client's after a preface (section 3.4)."""

ANSWER = 3.0
"""s that a viewer may take to accept a connection, and to answer."""

PATIENCE = 30.0
"""s that a viewer may take to start, and again to take a recording."""

POLL = 0.05
"""s between attempts to connect to a viewer that is starting."""

Log = Callable[[], None]
"""Logs a run to a recording."""


def check_url(url: str) -> None:
    """Raise `CrosscheckError` unless a viewer answers at an address, `rerun+http://HOST:PORT/proxy`."""
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
        with socket.create_connection((parts.hostname, port), ANSWER) as connection:
            if parts.scheme == "rerun+http":
                _greet(connection)
    except OSError as error:
        reason = error.strerror or str(error)
        raise CrosscheckError(f"--connect {url}: no viewer answers: {reason}") from error


def _greet(connection: socket.socket) -> None:
    """Raise `OSError` unless what is at the other end of a connection speaks HTTP/2, as gRPC does."""
    connection.settimeout(ANSWER)
    connection.sendall(HTTP2_GREETING)
    answer = b""
    while len(answer) < len(HTTP2_SETTINGS):
        received = connection.recv(len(HTTP2_SETTINGS) - len(answer))
        if not received:
            raise OSError("the connection is closed at once")
        answer += received
    if answer[3] != HTTP2_SETTINGS[3]:
        raise OSError("it does not speak gRPC")


def check_address(address: str) -> None:
    """Raise `CrosscheckError` unless a server can listen at an IP address."""
    try:
        version = ipaddress.ip_address(address).version
    except ValueError as error:
        raise CrosscheckError(f"--bind {address}: {error}") from error
    try:
        with socket.socket(socket.AF_INET if version == 4 else socket.AF_INET6) as probe:
            probe.bind((address, 0))
    except OSError as error:
        raise CrosscheckError(f"--bind {address}: {error.strerror}") from error


def has_display() -> bool:
    """Whether a window can be opened."""
    return sys.platform != "linux" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def send(recording: rr.RecordingStream, url: str, log: Log) -> None:
    """Log a run to the viewer at an address.

    Raises:
        CrosscheckError: if it does not take the recording within `PATIENCE`.
    """
    try:
        recording.connect_grpc(url)
        log()
        recording.flush(timeout_sec=PATIENCE)
    except RuntimeError as error:
        _leave(recording)
        raise CrosscheckError(f"the viewer at {url} did not take the recording: {error}") from error
    if not _leave(recording):
        raise CrosscheckError(f"the viewer at {url} did not take the recording within {PATIENCE:g} s")


def _leave(recording: rr.RecordingStream) -> bool:
    """Disconnect from a viewer; whether it has taken everything within `PATIENCE`.

    Flushing does not wait for the viewer to take it; disconnecting does, and without end.
    """
    leaving = threading.Thread(target=recording.disconnect, daemon=True)
    leaving.start()
    leaving.join(PATIENCE)
    if leaving.is_alive():
        rr.unregister_shutdown()  # it would wait at the end of this process
    return not leaving.is_alive()


def spawn(recording: rr.RecordingStream, log: Log) -> str:
    """Log a run to the viewer that listens on Rerun's port, started if need be; its address.

    It stays when this process ends, so that the next run can be opened beside this one.
    """
    url = f"rerun+http://{LOOPBACK}:{GRPC_PORT}/proxy"
    if not _listening(LOOPBACK, GRPC_PORT):
        with tempfile.TemporaryFile() as output:
            process = start(["--port", str(GRPC_PORT), "--expect-data-soon"], LOOPBACK, output)
            _wait(process, LOOPBACK, GRPC_PORT)
    send(recording, url, log)
    return url


@contextmanager
def served(
    recording: rr.RecordingStream, address: str, log: Log
) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """A run served to browsers: where, and the server.

    The server listens on Rerun's ports, or others if those are taken, and is ended on the way out.
    """
    grpc, web = free_port(address, GRPC_PORT), free_port(address, WEB_PORT)
    options = ["--serve-web", "--port", str(grpc), "--web-viewer-port", str(web)]
    everywhere = ipaddress.ip_address(address).is_unspecified
    host = (LOOPBACK if "." in address else "::1") if everywhere else address
    reached = f"[{host}]" if ":" in host else host
    if not ipaddress.ip_address(host).is_loopback or everywhere:
        options += ["--cors-allow-origin", f"http://*:{web}"]
    with tempfile.TemporaryFile() as output:
        process = start(options, address, output)
        try:
            _wait(process, host, grpc)
            url = f"rerun+http://{reached}:{grpc}/proxy"
            send(recording, url, log)
            _wait(process, host, web)
            yield f"http://{reached}:{web}?url={quote(url, safe='')}", process
        finally:
            end(process)


def free_port(address: str, wanted: int = 0) -> int:
    """The wanted port if it is free at an address, otherwise another that is."""
    family = socket.AF_INET6 if ":" in address else socket.AF_INET
    for port in (wanted, 0):
        with socket.socket(family) as probe, suppress(OSError):
            if sys.platform != "win32":  # or a port counts as taken for a minute after a server has ended
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((address, port))
            return int(probe.getsockname()[1])
    raise CrosscheckError(f"no free port at {address}")


def start(options: list[str], address: str, output: IO[bytes]) -> subprocess.Popen[bytes]:
    """Rerun's program, listening at an address, what it prints going to a file.

    It has a process group of its own, because it may start the viewer as a child.
    """
    command = [sys.executable, "-m", "rerun_cli", "--bind", address, "--hide-welcome-screen", *options]
    return subprocess.Popen(command, stdout=output, stderr=output, start_new_session=True)


def end(process: subprocess.Popen[bytes]) -> None:
    """End a program that `start` started, and its children."""
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def _listening(host: str, port: int) -> bool:
    try:
        socket.create_connection((host, port), ANSWER).close()
    except OSError:
        return False
    return True


def _wait(process: subprocess.Popen[bytes], host: str, port: int) -> None:
    """Wait until a program that is starting listens; raises `CrosscheckError` if it does not."""
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
