"""Pytest plugin: selects the tests that `scripts/test.py` runs again after a crash. Option `-p lib.rerun_selection`."""

import json
import os
from pathlib import Path

import pytest

from .crash_recorder import SELECTION_VARIABLE


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Deselect what is not in the file that SELECTION_VARIABLE names."""
    path = os.environ.get(SELECTION_VARIABLE)
    if not path:
        return
    selected = set(json.loads(Path(path).read_text(encoding="utf-8")))
    deselected = [item for item in items if item.nodeid not in selected]
    items[:] = [item for item in items if item.nodeid in selected]
    config.hook.pytest_deselected(items=deselected)
