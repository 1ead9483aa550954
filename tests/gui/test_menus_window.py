"""Menu search in a real window."""

import pytest

from gui.session_runner import run_gui_session

pytestmark = pytest.mark.gui


def test_menu_search_starts_the_operators(tmp_path_factory):
    results = run_gui_session("session_menus.py", tmp_path_factory)
    assert results["error"] is None, results["error"]
    assert results["started"] == results["wanted"]
