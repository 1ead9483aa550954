"""What users of the Image Editor find: masks to paint, before and after, the outline, replacement in materials, and the panel."""

import bpy
import numpy as np
import pytest

from farfield.addon.bridge.restore.image_sources import read_tiles
from farfield.addon.bridge.restore.image_users import MASKED_PROPERTY, ORIGINAL_PROPERTY
from farfield.addon.bridge.restore.outline import outline
from farfield.addon.compat import image_paint_settings
from farfield.addon.core.restore.settings import MaskSettings
from farfield.addon.operators import image_editors
from farfield.addon.operators.properties import read as read_settings
from farfield.addon.operators.restore.guides import find_shown_masks
from farfield.addon.operators.restore.operators import counterpart, edited_image, find_problem, find_target
from restore_images import FAST, HEIGHT, WIDTH, hole, new_image, new_mask, ramp, read, restore


@pytest.fixture
def editor(extension):
    """A context with an Image Editor, as areas of the factory settings."""
    bpy.ops.wm.read_factory_settings()
    window = bpy.context.window_manager.windows[0]
    areas = sorted(window.screen.areas, key=lambda area: -area.width * area.height)[:2]
    for area in areas:
        area.ui_type = "IMAGE_EDITOR"
    region = next(region for region in areas[0].regions if region.type == "WINDOW")
    with bpy.context.temp_override(window=window, area=areas[0], region=region):
        yield areas


def shown(area):
    return area.spaces.active.image


def add_material(name, image):
    """A material whose node group uses an image, and the node."""
    material = bpy.data.materials.new(name)
    if material.node_tree is None:
        material.use_nodes = True
    node = material.node_tree.nodes.new("ShaderNodeTexImage")
    node.image = image
    return material, node


def test_the_image_of_the_editor_is_restored_and_the_result_is_shown(editor):
    first, second = editor
    first.spaces.active.image = new_image("source", ramp())
    second.spaces.active.image = bpy.data.images["source"]
    new_mask()
    assert bpy.ops.farfield.restore_image(mask_image="mask", **FAST) == {"FINISHED"}
    assert shown(first).name == "source restored" and shown(second).name == "source", "only the editor of the button changes"


def test_variants_go_back_and_forth_and_the_next_seed_follows_the_last(editor):
    area, random = editor[0], np.random.default_rng(3)
    pixels = np.repeat(np.repeat(random.random((HEIGHT // 2, WIDTH // 2, 1), np.float32), 2, 0), 2, 1)
    area.spaces.active.image = new_image("source", np.dstack([pixels, pixels, pixels, np.ones_like(pixels)]))
    new_mask()
    assert not bpy.ops.farfield.restore_variant.poll()
    group = bpy.context.scene.farfield_restore
    group.mask_image, group.split, group.sub_bands, group.seed = "mask", "manual", 0, 4
    assert bpy.ops.farfield.restore_image() == {"FINISHED"}
    for direction, name in (("next", ".001"), ("previous", ""), ("previous", ""), ("next", ".001")):
        assert bpy.ops.farfield.restore_variant(direction=direction) == {"FINISHED"} and shown(area).name == f"source restored{name}"
    assert group.seed == 5
    assert [image.name for image in bpy.data.images if image.get(ORIGINAL_PROPERTY)] == ["source restored", "source restored.001"]


def test_create_mask_shows_a_black_image_to_paint_and_restores_the_masked_image(editor):
    area = editor[0]
    area.spaces.active.image = source = new_image("Fläche", ramp())
    assert bpy.ops.farfield.restore_mask() == {"FINISHED"}
    mask = shown(area)
    assert mask.name == "Fläche mask" and tuple(mask.size) == (WIDTH, HEIGHT) and mask.colorspace_settings.is_data
    assert not read(mask)[..., :3].any() and area.spaces.active.ui_mode == "PAINT"
    assert bpy.context.scene.farfield_restore.mask_image == mask.name and edited_image(bpy.context) == source
    assert tuple(image_paint_settings(bpy.context.tool_settings).color) == (1.0, 1.0, 1.0)
    values = np.dstack([hole()] * 3 + [np.ones((HEIGHT, WIDTH))]).astype(np.float32)
    mask.pixels.foreach_set(values.ravel())
    assert bpy.ops.farfield.restore_image(**FAST) == {"FINISHED"}
    assert shown(area).name == "Fläche restored" and area.spaces.active.ui_mode == "VIEW"


def test_a_uv_editor_becomes_an_image_editor_to_paint_and_stays_one_otherwise(editor):
    area = editor[0]
    area.ui_type = "UV"
    area.spaces.active.image = new_image("source", ramp())
    new_mask()
    assert bpy.ops.farfield.restore_image(mask_image="mask", **FAST) == {"FINISHED"}
    assert shown(area).name == "source restored" and area.ui_type == "UV"
    assert bpy.ops.farfield.restore_mask() == {"FINISHED"}
    assert (area.ui_type, area.spaces.active.ui_mode) == ("IMAGE_EDITOR", "PAINT")


def test_undo_and_redo_let_editors_show_what_they_showed(editor):
    bpy.context.preferences.edit.use_global_undo = True
    first, second = (area.spaces.active for area in editor)
    first.image = second.image = new_image("source", ramp())

    def state():
        return [(space.image.name if space.image else None, space.ui_mode) for space in (first, second)]

    bpy.ops.ed.undo_push(message="Open")
    states = [state()]
    bpy.ops.farfield.restore_mask()
    first.image.pixels.foreach_set(np.dstack([hole()] * 3 + [np.ones((HEIGHT, WIDTH))]).astype(np.float32).ravel())
    bpy.ops.ed.undo_push(message="Mask")
    states.append(state())
    bpy.ops.farfield.restore_image(**FAST)
    bpy.ops.ed.undo_push(message="Restore")
    states.append(state())
    names = [[name for name, _ in each] for each in states]
    assert names == [["source", "source"], ["source mask", "source"], ["source restored", "source"]]
    for _ in range(2):
        for expected in reversed(states[:-1]):
            bpy.ops.ed.undo()
            assert state() == expected
        for expected in states[1:]:
            bpy.ops.ed.redo()
            assert state() == expected
    second.image = first.image
    bpy.ops.ed.undo()
    assert [name for name, _ in state()] == ["source mask", "source mask"], "also in an editor where the user opened the result"
    second.image = bpy.data.images["source"]
    bpy.ops.ed.redo()
    assert [name for name, _ in state()] == ["source restored", "source"], "not where another image was opened in between"


def test_masks_of_tiled_images_have_the_same_tiles(empty_scene):
    source = bpy.data.images.new("rock", 16, 8, tiled=True)
    source.tiles.active = source.tiles.new(1012)
    with bpy.context.temp_override(edit_image=source):
        bpy.ops.image.tile_fill(color=(0.1, 0.2, 0.3, 1.0), width=24, height=20)
    assert bpy.ops.farfield.restore_mask(image="rock") == {"FINISHED"}
    tiles = read_tiles(bpy.data.images["rock mask"])
    assert {number: tile.shape[:2] for number, tile in tiles.items()} == {1001: (8, 16), 1012: (20, 24)}
    assert not any(tile[..., :3].any() for tile in tiles.values())


def test_create_mask_without_an_image_is_a_sentence(empty_scene):
    with pytest.raises(RuntimeError, match="There is no image to restore"):
        bpy.ops.farfield.restore_mask()


def test_before_and_after_switch_between_original_and_newest_result(editor):
    area = editor[0]
    source = new_image("source", ramp())
    new_mask()
    area.spaces.active.image = source
    assert not bpy.ops.farfield.restore_compare.poll()
    bpy.ops.farfield.restore_image(mask_image="mask", **FAST)
    area.spaces.active.image = source
    bpy.ops.farfield.restore_image(mask_image="mask", keep_result=True, **FAST)
    newest = shown(area)
    assert newest.name == "source restored.001"
    for expected in (source, newest, source):
        assert bpy.ops.farfield.restore_compare() == {"FINISHED"} and shown(area) == expected
    bpy.data.images.remove(newest)
    assert counterpart(bpy.context).name == "source restored"


@pytest.mark.parametrize("value", ["text", 3, 1.5, [1.0, 2.0], {"a": 1}])
def test_custom_properties_of_another_type_are_ignored(editor, value):
    image = new_image("source", ramp())
    editor[0].spaces.active.image = image
    image[ORIGINAL_PROPERTY] = image[MASKED_PROPERTY] = value
    assert (
        edited_image(bpy.context) == image
        and find_target(image, bpy.context.scene.farfield_restore) == image
        and counterpart(bpy.context) is None
        and not bpy.ops.farfield.restore_compare.poll()
    )


def test_polls_say_why(editor):
    editor[0].spaces.active.image = None
    for operator in (bpy.ops.farfield.restore_image, bpy.ops.farfield.restore_mask, bpy.ops.farfield.restore_compare):
        assert not operator.poll()


def test_the_result_replaces_the_image_where_it_is_used(empty_scene):
    source, other = new_image("source", ramp()), new_image("other", ramp())
    new_mask()
    _, node = add_material("direct", source)
    _, other_node = add_material("other", other)
    group = bpy.data.node_groups.new("group", "ShaderNodeTree")
    group_node = group.nodes.new("ShaderNodeTexImage")
    group_node.image = source
    world = bpy.data.worlds.new("World")
    if world.node_tree is None:
        world.use_nodes = True
    world_node = world.node_tree.nodes.new("ShaderNodeTexEnvironment")
    world_node.image = source
    texture = bpy.data.textures.new("brush", "IMAGE")
    texture.image = source
    restore("source")
    assert all(user.image == source for user in (node, group_node, world_node, texture)), "only on request"
    result = restore("source", replace_in_materials=True)
    assert all(user.image == result for user in (node, group_node, world_node, texture)) and other_node.image == other
    assert result[ORIGINAL_PROPERTY] == source


def test_a_shown_result_is_restored_again_from_the_original(editor):
    area, group = editor[0], bpy.context.scene.farfield_restore
    area.spaces.active.image = source = new_image("source", ramp())
    _, node = add_material("wall", source)
    bpy.ops.farfield.restore_mask()
    shown(area).pixels.foreach_set(np.dstack([hole()] * 3 + [np.ones((HEIGHT, WIDTH))]).astype(np.float32).ravel())
    for keep_result, name in ((False, "source restored"), (False, "source restored"), (True, "source restored.001")):
        assert bpy.ops.farfield.restore_image(replace_in_materials=True, keep_result=keep_result, **FAST) == {"FINISHED"}
        assert shown(area).name == node.image.name == name and shown(area)[ORIGINAL_PROPERTY] == source
    result = shown(area)
    assert find_target(result, group) == source
    bpy.ops.farfield.restore_mask()
    assert shown(area)[MASKED_PROPERTY] == result, "a new mask is for the image that is shown"
    assert find_target(result, group) == result


def test_linked_materials_are_skipped_and_named(empty_scene, tmp_path, capfd):
    material, _ = add_material("Außenwand", new_image("source", ramp()))
    bpy.data.images["source"].pack()
    new_mask().use_fake_user = material.use_fake_user = True
    bpy.data.images["mask"].pack()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "library.blend"))
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    with bpy.data.libraries.load(str(tmp_path / "library.blend"), link=True) as (_, target):
        target.materials, target.images = ["Außenwand"], ["source", "mask"]
    source = bpy.data.images["source"]
    _, node = add_material("local", source)
    override = bpy.data.materials["Außenwand"].override_create()
    override.name = "override"
    result = restore("source", replace_in_materials=True)
    assert node.image == result
    for name in ("Außenwand", "override"):
        assert any(item.image == source for item in bpy.data.materials[name].node_tree.nodes if item.type == "TEX_IMAGE")
    assert "Außenwand" in capfd.readouterr().out


def test_one_undo_removes_the_result_and_its_use(empty_scene):
    source = new_image("source", ramp())
    source.pack()
    source.use_fake_user = True
    new_mask().use_fake_user = True
    bpy.data.images["mask"].pack()
    material, _ = add_material("wall", source)
    material.use_fake_user = True
    bpy.ops.ed.undo_push(message="before")
    bpy.ops.farfield.restore_image("EXEC_DEFAULT", True, image="source", mask_image="mask", replace_in_materials=True, **FAST)
    assert "source restored" in bpy.data.images
    bpy.ops.ed.undo()
    assert "source restored" not in bpy.data.images
    assert [node.image.name for node in bpy.data.materials["wall"].node_tree.nodes if node.type == "TEX_IMAGE"] == ["source"]


def count_segments(image):
    """The number of line segments that are drawn over an image."""
    found = outline.outlines.get(image.session_uid)
    return 0 if found is None else len(found.segments)


class TestShownMasks:
    """The missing pixels that the outline surrounds."""

    def find(self, image):
        return find_shown_masks(image, read_settings(MaskSettings, bpy.context.scene.farfield_restore))

    def test_follow_the_settings(self, empty_scene):
        pixels = ramp()
        pixels[hole()] = 0.0
        image, group = new_image("source", pixels), bpy.context.scene.farfield_restore
        assert self.find(image) == {}, "no mask is chosen"
        new_mask()
        group.mask_image = "mask"
        assert np.array_equal(self.find(image)[0], hole())
        group.mask = "alpha"
        assert np.array_equal(self.find(image)[0], hole())
        group.mask, group.mask_color = "color", (0.0, 0.0, 0.0)
        assert np.array_equal(self.find(image)[0], hole())

    def test_are_none_where_the_mask_does_not_fit(self, empty_scene):
        image, group = new_image("source", ramp()), bpy.context.scene.farfield_restore
        new_mask("small", hole(20, 20))
        group.mask_image = "small"
        assert self.find(image) == {} and "20 x 20" in find_problem(image, group)

    def test_are_found_again_after_a_stroke(self, empty_scene):
        image, group = new_image("source", ramp()), bpy.context.scene.farfield_restore
        mask = new_mask("mask", np.zeros((HEIGHT, WIDTH), bool))
        group.mask_image = "mask"
        outline.clear()
        outline._requested[image.session_uid] = bpy.context.scene.name
        outline.update()
        assert count_segments(image) == 0
        mask.pixels.foreach_set(np.ones(HEIGHT * WIDTH * 4, np.float32))
        outline._requested[image.session_uid] = bpy.context.scene.name
        outline.update()
        assert count_segments(image) == 4, "the border of the image"
        outline.clear()
        assert count_segments(image) == 0


def test_the_outline_is_cleared_when_a_file_is_opened(empty_scene):
    image = new_image("source", ramp())
    new_mask()
    bpy.context.scene.farfield_restore.mask_image = "mask"
    outline._requested[image.session_uid] = bpy.context.scene.name
    outline.update()
    assert count_segments(image)
    uid = image.session_uid
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    assert uid not in outline.outlines


def test_a_closed_editor_is_no_error(empty_scene):
    image_editors.show_image(12345, new_image("source", ramp()))
