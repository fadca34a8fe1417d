"""Sweeps on a Dask cluster: equal to local ones, complete when workers die."""

from __future__ import annotations

import errno
import logging
import os
import shutil
import signal
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from distributed import Client, LocalCluster

import crosscheck.sweeps.results
from crosscheck import sweep
from crosscheck.errors import CrosscheckError
from crosscheck.sweeps.execute import in_any_order, workers

ARGUMENTS = ("pendulum", {"dumbbell.mass": "uniform(1, 2)"}, 90, "peak:reaction_force")


@pytest.fixture(scope="module")
def cluster() -> Iterator[LocalCluster]:
    """Two processes; a nanny makes another one of each that dies."""
    settings = {"dashboard_address": None, "silence_logs": 50, "host": "127.0.0.1"}
    with LocalCluster(n_workers=2, threads_per_worker=1, **settings) as cluster:
        yield cluster


@pytest.fixture(autouse=True)
def short_tasks(monkeypatch):
    """Tasks of few runs, so that a small sweep has several of them."""
    monkeypatch.setattr(crosscheck.sweeps.results, "replace", lambda plan, chunk: replace(plan, chunk=8))


def values(swept):
    """All numbers of a sweep."""
    return [swept.dataset[name].values for name in ("dumbbell.mass", "peak:reaction_force", "status")]


def assert_equal(found, reference):
    """All numbers are equal to the last bit."""
    assert all(map(np.array_equal, values(found), values(reference)))


@pytest.mark.parametrize("on_disk", [False, True])
def test_a_cluster_gives_what_threads_give(cluster, tmp_path, on_disk):
    output = tmp_path / "out" if on_disk else None
    level = logging.getLogger("distributed.client").level
    assert_equal(sweep(*ARGUMENTS, cluster=cluster.scheduler_address, output=output), sweep(*ARGUMENTS))
    assert logging.getLogger("distributed.client").level == level


def test_a_task_that_fails_is_not_made_again(cluster, tmp_path):
    def fail(number: int) -> None:
        (tmp_path / str(time.time_ns())).touch()
        raise OSError(errno.ENOSPC, "No space left on device")

    words = "No space left on device"
    with workers(cluster=cluster.scheduler_address) as at, pytest.raises(CrosscheckError, match=words):
        list(in_any_order(fail, [0], at))
    assert len(list(tmp_path.iterdir())) == 1


def test_a_worker_that_dies_loses_nothing(cluster, tmp_path):
    with Client(cluster) as client:
        (first, *_) = client.run(os.getpid).values()
        told = []

        def kill(stage):
            told.append(stage)
            if len(told) == 3:
                os.kill(first, signal.SIGKILL)

        found = sweep(*ARGUMENTS, cluster=client, output=tmp_path, progress=kill)
        assert first not in client.run(os.getpid).values()
    assert found.results.made == 90
    assert_equal(found, sweep(*ARGUMENTS))


def test_a_folder_that_workers_do_not_find_is_one_line(cluster, tmp_path, monkeypatch):
    missing = crosscheck.sweeps.results.Store.missing

    def lose(store, plan):
        found = missing(store, plan)
        shutil.rmtree(store.path)
        return found

    monkeypatch.setattr(crosscheck.sweeps.results.Store, "missing", lose)
    with pytest.raises(CrosscheckError, match="holds no sweep"):
        sweep(*ARGUMENTS, cluster=cluster.scheduler_address, output=tmp_path)
