"""The cache of interrupted jobs, its preferences, and file browsers that remember their folder."""

import bpy
import pytest

from farfield.addon.bridge.units import format_length
from farfield.addon.core.bdam.settings import BdamSettings
from farfield.addon.core.jobs import heartbeat
from farfield.addon.operators import file_browser, properties, user_cache

pytestmark = pytest.mark.usefixtures("empty_scene")


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """A folder for the caches of all tools."""
    monkeypatch.setattr(user_cache, "cache_folder", lambda tool: tmp_path / tool)
    (tmp_path / "btf" / "a").mkdir(parents=True)
    (tmp_path / "btf" / "a" / "view").write_bytes(b"x" * 2_500_000)
    return tmp_path


def test_clear_deletes_the_cache_and_says_how_much(cache, capfd):
    assert bpy.ops.farfield.clear_cache() == {"FINISHED"}
    assert user_cache.cached_folders() == [] and "Freed 2.5 MB." in capfd.readouterr().out


def test_clear_leaves_what_a_running_job_uses_and_links(cache, tmp_path):
    (cache / "btf" / "b").mkdir()
    held = heartbeat.take_over(cache / "btf" / "b")
    other = tmp_path / "other"
    other.mkdir()
    (cache / "btf" / "link").symlink_to(other)
    bpy.ops.farfield.clear_cache()
    assert sorted(path.name for path in (cache / "btf").iterdir()) == ["b", "link"] and held.path.exists() and other.exists()
    held.close()


def test_processes_without_a_number_are_as_many_as_the_preferences_say(monkeypatch):
    group = bpy.context.scene.farfield_bdam_build
    assert properties.read(BdamSettings, group).executor == "processes"
    monkeypatch.setattr(properties, "process_count", lambda: 3)
    assert properties.read(BdamSettings, group).executor == "processes:3"
    group.executor = "serial"
    assert properties.read(BdamSettings, group).executor == "serial"


class Browser:
    """Has the parts of an operator that opens a file browser."""

    bl_idname = "FARFIELD_OT_test"
    filepath = ""


class Context:
    """A window manager that opens no window, and has custom properties."""

    def __init__(self) -> None:
        self.window_manager = WindowManager()


class WindowManager(dict):
    """Custom properties."""

    def fileselect_add(self, operator: Browser) -> None:
        self["opened"] = operator.filepath


def test_a_file_browser_opens_where_the_operator_was_last(tmp_path, monkeypatch):
    monkeypatch.setattr(file_browser, "default_folder", lambda: tmp_path)
    context, folder = Context(), tmp_path / "Höhlen"
    folder.mkdir()
    file_browser.open_file_browser(Browser(), context, "a.glb")
    assert context.window_manager["opened"] == str(tmp_path / "a.glb")
    file_browser.remember_folder(Browser(), context, folder / "b.glb")
    file_browser.open_file_browser(Browser(), context, "c.glb")
    assert context.window_manager["opened"] == str(folder / "c.glb")
    folder.rmdir()
    file_browser.open_file_browser(Browser(), context)
    assert context.window_manager["opened"] == f"{tmp_path}/"


@pytest.mark.parametrize(
    ("system", "scale", "text"),
    [("METRIC", 1.0, "2.32 km"), ("METRIC", 0.01, "23.2 m"), ("NONE", 1.0, "2322"), ("IMPERIAL", 1.0, "1.44 mi")],
)
def test_lengths_have_the_units_of_the_scene(system, scale, text):
    units = bpy.context.scene.unit_settings
    units.system, units.scale_length = system, scale
    assert format_length(bpy.context.scene, 2321.7) == text
