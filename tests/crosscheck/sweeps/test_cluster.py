"""Sweeps on a Dask cluster: equal to local ones, complete when workers die."""

from __future__ import annotations

import errno
import gc
import logging
import os
import shutil
import signal
import socket
import time
from collections.abc import Iterator
from threading import Thread

import pytest
from distributed import Client, LocalCluster
from small_sweep import assert_equal

import crosscheck.sweeps.execute
import crosscheck.sweeps.results
from crosscheck import sweep
from crosscheck.support.errors import CrosscheckError
from crosscheck.sweeps.execute import NO_WORKERS, run_tasks, workers

pytestmark = pytest.mark.usefixtures("short_tasks")

ARGUMENTS = ("pendulum", {"dumbbell.mass": "uniform(1, 2)"}, 90, "peak:reaction_force")


SETTINGS = {"dashboard_address": "127.0.0.1:0", "silence_logs": 50, "host": "127.0.0.1"}


@pytest.fixture(scope="module")
def cluster() -> Iterator[LocalCluster]:
    """Two processes; a nanny makes another one of each that dies."""
    with LocalCluster(n_workers=2, threads_per_worker=1, **SETTINGS) as cluster:
        yield cluster


@pytest.mark.slow
@pytest.mark.parametrize("on_disk", [False, True])
def test_a_cluster_gives_what_threads_give(cluster, tmp_path, on_disk):
    output = tmp_path / "out" if on_disk else None
    level = logging.getLogger("distributed.client").level
    assert_equal(sweep(*ARGUMENTS, cluster=cluster.scheduler_address, output=output), sweep(*ARGUMENTS))
    assert logging.getLogger("distributed.client").level == level


@pytest.mark.slow
def test_a_cluster_without_workers_is_waited_for():
    told = []
    with LocalCluster(n_workers=0, threads_per_worker=1, **SETTINGS) as empty:

        def tell(stage: str) -> None:
            told.append(stage)
            if stage == NO_WORKERS:
                empty.scale(1)

        assert_equal(sweep(*ARGUMENTS, cluster=empty.scheduler_address, progress=tell), sweep(*ARGUMENTS))
    assert told.count(NO_WORKERS) == 1


def test_a_task_that_fails_is_not_made_again(cluster, tmp_path):
    def fail(number: int) -> None:
        (tmp_path / str(time.time_ns())).touch()
        raise OSError(errno.ENOSPC, "No space left on device")

    words = "No space left on device"
    with workers(cluster=cluster.scheduler_address) as at, pytest.raises(CrosscheckError, match=words):
        list(run_tasks(fail, [0], at))
    assert len(list(tmp_path.iterdir())) == 1


@pytest.mark.slow
def test_a_worker_that_dies_loses_nothing(cluster, tmp_path):
    with Client(cluster) as client:
        (first, *_) = client.run(os.getpid).values()
        told = []

        def kill(stage):
            told.append(stage)
            if len(told) == 4:  # the first task has ended, others are under way
                os.kill(first, signal.SIGKILL)

        found = sweep(*ARGUMENTS, cluster=client, output=tmp_path, progress=kill)
        assert first not in client.run(os.getpid).values()
    assert found.results.executed == 90
    assert_equal(found, sweep(*ARGUMENTS))


@pytest.mark.slow
def test_a_folder_that_workers_do_not_find_is_one_line(cluster, tmp_path, monkeypatch):
    missing = crosscheck.sweeps.results.Store.missing

    def lose(store, plan):
        found = missing(store, plan)
        shutil.rmtree(store.path)
        return found

    monkeypatch.setattr(crosscheck.sweeps.results.Store, "missing", lose)
    with pytest.raises(CrosscheckError, match="holds no sweep"):
        sweep(*ARGUMENTS, cluster=cluster.scheduler_address, output=tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("answer", [b"", b"HTTP/1.1 400 Bad Request\r\n\r\n"], ids=["silent", "HTTP"])
@pytest.mark.filterwarnings("error")  # of what a client that never connected leaves behind
def test_what_is_no_scheduler_is_one_line(capfd, monkeypatch, answer):
    monkeypatch.setattr(crosscheck.sweeps.execute, "CONNECT_TIMEOUT_S", 1.0)
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            connection, _ = server.accept()
            with connection:
                connection.recv(1)
                connection.sendall(answer)
                while connection.recv(2**16):  # until the other side gives up
                    pass

        thread = Thread(target=serve)
        thread.start()
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        words = f"cannot reach a scheduler of Dask at {address}: "
        with pytest.raises(CrosscheckError, match=words), workers(cluster=address):
            pytest.fail("connected")
        thread.join()
    gc.collect()
    assert capfd.readouterr() == ("", "")


def test_a_worker_is_no_scheduler(cluster):
    address = cluster.workers[0].worker_address
    with pytest.raises(CrosscheckError, match="a Worker listens there"), workers(cluster=address):
        pytest.fail("connected")
