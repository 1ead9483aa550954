"""Executor specs are parsed, and unreachable schedulers are reported."""

import os
import sys

import pytest

from farfield.addon.core.errors import FarfieldError, SettingsError
from farfield.addon.core.jobs import executors


@pytest.mark.parametrize(
    ("text", "processes", "scheduler"),
    [("serial", 1, None), ("processes:1", 1, None), ("processes:12", 12, None), (" serial ", 1, None)],
)
def test_specs_of_local_processes(text, processes, scheduler):
    assert executors.parse_executor(text) == executors.ExecutorSpec(processes, scheduler)


def test_default_number_of_processes_is_that_of_cores_up_to_a_maximum(monkeypatch):
    for cores, processes in ((1, 1), (2, 2), (64, executors.MAX_DEFAULT_PROCESSES), (None, 1)):
        monkeypatch.setattr(os, "cpu_count", lambda cores=cores: cores)
        assert executors.parse_executor("processes").processes == processes


def test_specs_of_schedulers():
    assert executors.parse_executor("dask:tcp://farm-7.example:8786").scheduler == "tcp://farm-7.example:8786"


@pytest.mark.parametrize(
    ("text", "uses_network"),
    [
        ("serial", False),
        ("processes:3", False),
        ("dask:tcp://localhost:8786", False),
        ("dask:tcp://127.0.0.1:8786", False),
        ("dask:tls://[::1]:8786", False),
        ("dask:tcp://10.0.0.5:8786", True),
        ("dask:tcp://farm.example:8786", True),
    ],
)
def test_schedulers_on_other_machines_use_the_network(text, uses_network):
    assert executors.parse_executor(text).uses_network == uses_network


@pytest.mark.parametrize(
    "text", ["", "threads", "processes:0", "processes:-2", "processes:two", "dask", "dask:", "dask:localhost", "dask:no://h:1", "serial:2"]
)
def test_other_specs_are_rejected(text):
    with pytest.raises(SettingsError, match="must be serial"):
        executors.parse_executor(text)


def test_a_scheduler_without_dask_installed_is_an_error(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(FarfieldError, match="Dask is not installed"), executors.open_executor("dask:tcp://127.0.0.1:9"):
        pass


def test_a_scheduler_that_does_not_answer_is_named(monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr(executors, "CONNECT_SECONDS", 0.1)
    timeout = pytest.raises(FarfieldError, match=r"No Dask scheduler answers at .tcp://127\.0\.0\.1:9")
    with timeout, executors.open_executor("dask:tcp://127.0.0.1:9"):
        pass
