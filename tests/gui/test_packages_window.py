"""The package of an object, exported by the button of the panel in a real window."""

import pytest

from gui.session_runner import assert_progress, run_gui_session

pytestmark = pytest.mark.gui


@pytest.fixture(scope="module")
def results(tmp_path_factory) -> dict:
    """The results of session_packages.py."""
    return run_gui_session("session_packages.py", tmp_path_factory)


def test_the_session_ran_to_its_end(results):
    assert results["error"] is None, results["error"]


def test_the_package_is_written_with_its_page(results):
    assert {"manifest.json", "mesh.bin", "textures.bin", "levels.glb", "index.html"} <= set(results["files"])
    assert_progress(results["fractions"])


def test_the_scene_stays(results):
    assert results["objects_after"] == results["objects_before"]
