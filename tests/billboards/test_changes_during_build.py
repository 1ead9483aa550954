"""The user renames or removes things while quads are computed: the build continues, or one sentence says why not and nothing is created."""

import bpy
import pytest

from bridge import blender_scenes
from bridge.operator_scenes import is_hidden, levels, select
from farfield.addon.bridge.billboards.exports import write_glb
from farfield.addon.core.billboards.settings import BillboardSettings, BuildOptions
from farfield.addon.core.errors import GeometryError
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.operators.billboards.job import prepare_job

pytestmark = pytest.mark.usefixtures("empty_scene")


@pytest.fixture
def source():
    """A selected object with a material."""
    item = blender_scenes.box("Oak", blender_scenes.create_material("Bark"))
    select(item)
    return item


def finish_after(change, textures=True, **options):
    """Run both halves of a build and call `change` between them. Returns the message."""
    settings = BillboardSettings(levels=1, error=0.1, samples=1, textures=textures)
    job = prepare_job(bpy.context, bpy.context.selected_objects, settings, BuildOptions(**options))
    quads = run_to_end(job.core_steps())
    change()
    before = blender_scenes.count_data()
    try:
        return run_to_end(job.scene_steps(quads))
    except GeometryError:
        assert blender_scenes.count_data() == before
        raise


def rename(item, name):
    """Return a function that renames `item`."""

    def change():
        item.name = name

    return change


def test_a_renamed_original_is_hidden(source):
    finish_after(rename(source, "Tree"), textures=False)
    assert is_hidden(source) and list(levels()) == ["Oak Cloud L0"]


def test_an_object_that_took_the_name_of_the_original_stays_visible(source):
    def change():
        source.name = "Tree"
        blender_scenes.box("Oak")

    finish_after(change, textures=False)
    assert is_hidden(bpy.data.objects["Tree"]) and not is_hidden(bpy.data.objects["Oak"])


@pytest.mark.parametrize("keep", [False, True])
def test_a_removed_original(source, keep):
    with pytest.raises(GeometryError, match='The original "Oak" was removed while'):
        finish_after(lambda: bpy.data.objects.remove(source), textures=False, keep_original_visible=keep)
    assert not levels()


@pytest.mark.parametrize("change", ["rename", "remove"])
def test_a_material_that_was_renamed_or_removed(source, change):
    material = bpy.data.materials["Bark"]
    with pytest.raises(GeometryError, match='The material "Bark" was renamed or removed'):
        finish_after(rename(material, "Leaf") if change == "rename" else lambda: bpy.data.materials.remove(material))
    assert not levels() and not is_hidden(source)


def test_a_renamed_scene_gets_the_cloud(source):
    finish_after(rename(bpy.context.scene, "Other"), textures=False)
    assert "Oak Cloud" in bpy.data.scenes["Other"].collection.children


def test_the_scene_in_which_the_build_was_started_gets_the_cloud(source):
    first = bpy.context.scene

    def change():
        bpy.context.window.scene = bpy.data.scenes.new("Second")

    finish_after(change, textures=False)
    assert "Oak Cloud" in first.collection.children and not bpy.context.scene.collection.children


def test_a_removed_scene(source):
    def change():
        first = bpy.context.scene
        bpy.data.scenes.new("Second")
        bpy.data.scenes.remove(first)

    with pytest.raises(GeometryError, match="The scene was removed while"):
        finish_after(change, textures=False)
    assert not levels()


@pytest.mark.slow
def test_a_removed_earlier_cloud(source):
    finish_after(lambda: None, textures=False)
    select(*levels().values())

    def change():
        bpy.data.collections.remove(bpy.data.collections["Oak Cloud"])

    finish_after(change, textures=False)
    assert is_hidden(source)


def test_an_export_of_a_changed_level_leaves_nothing(source, tmp_path):
    """The custom property with the size of the images of the second level is something else."""
    finish_after(lambda: None)
    first = levels()["Oak Cloud L0"]
    second = first.copy()
    bpy.context.scene.collection.objects.link(second)
    before = blender_scenes.count_data()
    for value in (True, [256], [0, 256], "256 x 256"):
        second["farfield_atlas"] = value
        with pytest.raises(GeometryError, match="size of the atlas"):
            write_glb([first, second], tmp_path / "oak.glb")
        assert blender_scenes.count_data() == before
