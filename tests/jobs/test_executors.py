"""The words of the setting Executor are parsed; others are refused."""

import os

import pytest

from farfield.addon.core.errors import SettingsError
from farfield.addon.core.jobs import executors


@pytest.mark.parametrize(
    ("text", "processes", "is_serial"), [("serial", 1, True), ("processes:1", 1, False), ("processes:12", 12, False), (" serial ", 1, True)]
)
def test_words(text, processes, is_serial):
    assert executors.parse_executor(text) == executors.LocalExecutor(processes, is_serial)


def test_default_number_of_processes_is_that_of_cores_up_to_a_maximum(monkeypatch):
    for cores, processes in ((1, 1), (2, 2), (64, executors.MAX_DEFAULT_PROCESSES), (None, 1)):
        monkeypatch.setattr(os, "cpu_count", lambda cores=cores: cores)
        assert executors.parse_executor("processes").processes == processes


@pytest.mark.parametrize("text", ["", "threads", "processes:0", "processes:-2", "processes:two", "dask:tcp://127.0.0.1:8786", "serial:2"])
def test_other_words_are_rejected(text):
    with pytest.raises(SettingsError, match="must be serial"):
        executors.parse_executor(text)
