"""Presets: those that ship are valid and tell something; those of the user are saved, applied and deleted; bad files change nothing."""

import json
import os
import re

import bpy
import pytest

from farfield.addon.core.errors import FileError, SettingsError
from farfield.addon.core.presets import Preset, list_presets, preset_path, preset_settings, read_preset, write_preset
from farfield.addon.core.settings import Settings, setting
from farfield.addon.operators import presets, properties
from farfield.addon.operators.documentation import TOOLS

pytestmark = pytest.mark.usefixtures("extension", "empty_scene")
BUILT_IN = [(tool, path.stem) for tool in TOOLS for path in list_presets(presets.BUILT_IN / tool)]
MAX_BYTES_OF_PICTURES = 300_000


def values_of(tool: str) -> dict:
    """Return the values of all settings of a tool that presets hold, by name."""
    found = {}
    for group in presets.settings_groups(bpy.context.scene, tool):
        for settings_type in group.settings_types:
            settings = properties.read(settings_type, group)
            found |= {item.name: getattr(settings, item.name) for item in preset_settings([settings_type])}
    return found


@pytest.fixture
def user_folder(tmp_path, monkeypatch):
    """A folder for the presets of the user."""
    monkeypatch.setattr(presets, "user_folder", lambda tool: tmp_path / tool)
    return tmp_path


def test_every_tool_has_presets():
    assert {tool for tool, _ in BUILT_IN} == set(TOOLS)


@pytest.mark.parametrize("tool", TOOLS)
def test_names_of_settings_are_unique_within_a_tool(tool):
    names = [item.name for item in preset_settings(presets.settings_types(bpy.context.scene, tool))]
    assert names and len(names) == len(set(names))


@pytest.mark.parametrize(("tool", "name"), BUILT_IN)
def test_a_preset_sets_what_it_names_and_nothing_else(tool, name):
    defaults = values_of(tool)
    preset = read_preset(presets.find_preset(tool, name), presets.settings_types(bpy.context.scene, tool))
    assert re.fullmatch(r"[A-Z0-9][^.]{20,118}[a-z0-9]", preset.description), "one sentence without a full stop"
    assert preset.values and all(value != defaults[key] for key, value in preset.values.items())
    assert bpy.ops.farfield.preset_apply(tool=tool, name=name) == {"FINISHED"}
    assert values_of(tool) == defaults | preset.values
    bpy.ops.farfield.preset_apply(tool=tool, name="")
    assert values_of(tool) == defaults


def test_pictures_are_small_and_belong_to_presets():
    pictures = [path for path in presets.BUILT_IN.rglob("*") if path.suffix == ".webp"]
    assert sum(path.stat().st_size for path in pictures) < MAX_BYTES_OF_PICTURES
    assert all((path.parent.name, path.stem) in BUILT_IN for path in pictures)
    assert {path.stem for path in pictures if path.parent.name == "clipbox"} == {name for tool, name in BUILT_IN if tool == "clipbox"}


def test_save_apply_and_delete(user_folder):
    group = bpy.context.scene.farfield_billboards
    group.levels, group.error, group.max_normal_deviation, group.textures = 5, 2.0, 0.5, False
    saved = values_of("billboards")
    assert bpy.ops.farfield.preset_save(tool="billboards", name=" Bäume / weit ") == {"FINISHED"}
    assert [path.name for path in (user_folder / "billboards").iterdir()] == ["Bäume _ weit.json"]
    bpy.ops.farfield.preset_apply(tool="billboards", name="")
    assert values_of("billboards") != saved
    bpy.ops.farfield.preset_apply(tool="billboards", name="Bäume _ weit")
    assert values_of("billboards") == saved
    group.levels = 6
    bpy.ops.farfield.preset_save(tool="billboards", name="Bäume _ weit")  # the user named it: it is replaced
    group.levels = 2
    bpy.ops.farfield.preset_apply(tool="billboards", name="Bäume _ weit")
    assert group.levels == 6
    assert bpy.ops.farfield.preset_remove(tool="billboards", name="Bäume _ weit") == {"FINISHED"}
    assert not list_presets(user_folder / "billboards")


def test_presets_leave_files_and_data_blocks_of_the_user(user_folder):
    clipbox, restore = bpy.context.scene.farfield_clipbox, bpy.context.scene.farfield_restore
    clipbox.source, restore.mask_image = "//heights.tif", "Mask"
    bpy.ops.farfield.preset_save(tool="clipbox", name="Mine")
    assert json.loads((user_folder / "clipbox" / "Mine.json").read_text(encoding="utf-8"))["settings"] == {}
    bpy.ops.farfield.preset_apply(tool="clipbox", name="Rolling Hills")
    bpy.ops.farfield.preset_apply(tool="restore", name="Black Borders")
    assert (clipbox.source, restore.mask_image) == ("//heights.tif", "Mask")


def test_presets_of_farfield_are_neither_replaced_nor_deleted(user_folder):
    for operator in (bpy.ops.farfield.preset_save, bpy.ops.farfield.preset_remove):
        with pytest.raises(RuntimeError, match="Rolling Hills"):
            operator(tool="clipbox", name="Rolling Hills")
    with pytest.raises(RuntimeError, match="needs a name"):
        bpy.ops.farfield.preset_save(tool="clipbox", name=" ")
    assert not list(user_folder.iterdir())


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"import os\nos.remove('x')", "is no preset"),
        (b"\xff\xfe\x00", "is no preset"),
        (b"[" * 50_000, "is no preset"),
        (b" " * 200_000, "has more than"),
        (b'{"description": 3, "settings": {}}', "is no preset"),
        (b'{"settings": []}', "it has no settings"),
        (b'{"settings": {"levels": 99}}', "Levels is 99; the maximum is 8"),
        (b'{"settings": {"levels": "3"}}', "Levels must be an integer"),
        (b'{"settings": {"error": NaN}}', "Error must be a finite number"),
        (b'{"settings": {"error": 1' + b"0" * 400 + b"}}", "too large"),
        (b'{"settings": {"method": "other"}}', "Method must be one of"),
        (b'{"settings": {"name": "x"}}', 'no setting "name"'),
    ],
)
def test_a_bad_file_gives_one_sentence_and_changes_nothing(user_folder, content, reason):
    (user_folder / "billboards").mkdir()
    (user_folder / "billboards" / "Bad.json").write_bytes(content)
    before = values_of("billboards")
    with pytest.raises(RuntimeError, match=re.escape(reason)) as error:
        bpy.ops.farfield.preset_apply(tool="billboards", name="Bad")
    assert "Traceback" not in str(error.value) and str(error.value).strip().count("\n") == 0
    assert values_of("billboards") == before


def test_settings_that_contradict_each_other_are_refused(tmp_path):
    from farfield.addon.core.clipbox.settings import ClipboxSettings

    write_preset(tmp_path / "Steep.json", Preset("", {"threshold": 8, "resolution": 32}))
    with pytest.raises(SettingsError, match='The preset "Steep" cannot be used: Threshold is 8'):
        read_preset(tmp_path / "Steep.json", [ClipboxSettings])


def test_huge_numbers_in_lists_are_refused(tmp_path):
    class Vector(Settings):
        direction: tuple = setting((0.0, 0.0, 1.0), "A direction")

    import dataclasses

    settings_type = dataclasses.dataclass(frozen=True, kw_only=True)(Vector)
    path = preset_path(tmp_path, "Vector")
    path.write_text('{"settings": {"direction": [1' + "0" * 400 + ", 0, 0]}}", encoding="utf-8")
    with pytest.raises(SettingsError, match="too large"):
        read_preset(path, [settings_type])


@pytest.mark.skipif(os.name == "nt" or os.geteuid() == 0, reason="needs a folder without permission to write")
def test_a_folder_without_permission_gives_one_sentence(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(FileError, match="Cannot write"):
        write_preset(tmp_path / "a" / "b.json", Preset())
