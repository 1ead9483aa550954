"""All maps of a material restored together: what holds between them outside the hole holds inside as well."""

import bpy
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from farfield.addon.bridge.restore import results
from farfield.addon.bridge.restore.image_sources import read_tiles
from farfield.addon.bridge.restore.image_users import ORIGINAL_PROPERTY, list_maps
from farfield.addon.compat import enable_nodes
from farfield.addon.core.imaging.colors import LUMINANCE
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.restore.restoration import restore as restore_arrays
from farfield.addon.core.restore.settings import MaskSettings, RestoreSettings
from farfield.addon.operators.restore.operators import find_problem, prepare
from restore_images import FAST, HEIGHT, WIDTH, hole, new_image, new_mask, ramp, read

SHAPE = (96, 104)
TEXTURE = {"split": "manual", "sub_bands": 2}


def square():
    """A hole (H, W) bool in images of SHAPE."""
    mask = np.zeros(SHAPE, bool)
    mask[38:62, 40:64] = True
    return mask


def rock():
    """Color, height and normals (H, W, 3), (H, W, 1), (H, W, 3) of a texture; the others follow from the color."""
    color = gaussian_filter(np.random.default_rng(4).random((*SHAPE, 3), np.float32), (1.5, 1.5, 0.0))
    color = np.clip(0.5 + 0.12 * (color - 0.5) / color.std(), 0.0, 1.0)
    height = (color @ LUMINANCE)[..., None]
    vectors = np.stack([*np.gradient(-4.0 * height[..., 0]), np.ones(SHAPE)], axis=2)
    return color, height, (0.5 + 0.5 * vectors / np.linalg.norm(vectors, axis=2, keepdims=True)).astype(np.float32)


def add_maps(maps, name="rock"):
    """A material whose Image Texture nodes use images, the last of them in a node group; the nodes by the names of the images."""
    material = bpy.data.materials.new(name)
    enable_nodes(material)
    group = bpy.data.node_groups.new(name, "ShaderNodeTree")
    material.node_tree.nodes.new("ShaderNodeGroup").node_tree = group
    nodes = {}
    for index, image in enumerate(maps):
        tree = group if index == len(maps) - 1 else material.node_tree
        nodes[image.name] = tree.nodes.new("ShaderNodeTexImage")
        nodes[image.name].image = image
    return nodes


def opaque(values):
    return np.dstack([np.broadcast_to(values, (*values.shape[:2], 3)), np.ones(values.shape[:2], np.float32)])


def restore_all(image="color", **settings):
    assert bpy.ops.farfield.restore_image(image=image, mask_image="mask", **({"all_maps_of_material": True} | settings)) == {"FINISHED"}


class TestCore:
    """Several maps in the channels of one image."""

    def run(self, image, **arguments):
        return run_to_end(restore_arrays(image, square(), RestoreSettings(split="manual", sub_bands=0), **arguments)).pixels

    @pytest.mark.slow
    @pytest.mark.parametrize(("factor", "offset"), [(1.0, 0.0), (1e4, 1e6)])
    def test_stripes_continue_however_large_the_values_of_a_further_map_are(self, factor, offset):
        stripes = np.where(np.indices(SHAPE)[1] % 8 < 4, np.float32(0.8), np.float32(0.1))[..., None]
        noise = factor * gaussian_filter(np.random.default_rng(4).random(SHAPE, np.float32), 1.0)[..., None] + offset
        result = self.run(np.dstack([stripes, noise]), further_maps=(1,))
        assert np.abs(result[..., 0] - stripes[..., 0]).max() < 0.05
        assert result[square()][:, 1].std() == pytest.approx(noise.std(), rel=0.2)

    def test_a_flat_first_map_is_no_division_by_zero(self):
        _, height, _ = rock()
        result = self.run(np.dstack([np.full((*SHAPE, 3), 0.5, np.float32), height]), further_maps=(3,))
        assert np.isfinite(result).all() and result[square()][:, 3].std() > 0.5 * height.std()

    def test_known_pixels_of_all_maps_stay(self):
        color, height, normals = rock()
        image = np.dstack([color, 1e3 * height, normals])
        result = self.run(image, further_maps=(3, 4), normal_channels=(4,))
        assert np.array_equal(result[~square()], image[~square()])
        assert np.linalg.norm(2.0 * result[square()][:, 4:] - 1.0, axis=1) == pytest.approx(1.0, abs=1e-5)


@pytest.fixture
def maps(empty_scene):
    """Color, height and normals with a gray hole, in one material, and the nodes that use them."""
    images = []
    for name, values in zip(("color", "height", "normals"), rock(), strict=True):
        pixels = opaque(values)
        pixels[square(), :3] = 0.5
        images.append(new_image(name, pixels, "sRGB" if name == "color" else "Non-Color", is_float=name != "color"))
    new_mask("mask", square())
    nodes = add_maps(images)
    tree = nodes["normals"].id_data
    tree.links.new(nodes["normals"].outputs["Color"], tree.nodes.new("ShaderNodeNormalMap").inputs["Color"])
    return nodes


class TestOperator:
    """The setting All Maps of Material."""

    @pytest.mark.slow
    def test_the_height_still_follows_the_color(self, maps, capfd):
        def deviation(color, height):
            inside = square()
            return np.abs(read(color)[inside][:, :3] @ LUMINANCE - read(height)[inside][:, 0]).mean()

        restore_all(**TEXTURE)
        together = deviation(bpy.data.images["color restored"], bpy.data.images["height restored"])
        assert bpy.ops.farfield.restore_image(image="height", mask_image="mask", seed=5, keep_result=True, **TEXTURE) == {"FINISHED"}
        separate = deviation(bpy.data.images["color restored"], bpy.data.images["height restored.001"])
        assert together < 0.003 < 0.03 < separate
        assert 'as "color restored", with 2 other maps of its material.' in capfd.readouterr().out

    @pytest.mark.slow
    def test_each_result_is_of_the_kind_of_its_original(self, maps):
        restore_all(**TEXTURE)
        for name in maps:
            source, result = bpy.data.images[name], bpy.data.images[f"{name} restored"]
            assert result[ORIGINAL_PROPERTY] == source and result.is_float == source.is_float and result.use_fake_user
            assert result.colorspace_settings.name == source.colorspace_settings.name
            assert np.array_equal(read(result)[~square()], read(source)[~square()])

    def test_alpha_of_one_map_is_restored(self, maps):
        pixels = read(bpy.data.images["height"])
        pixels[..., 3] = np.linspace(0.2, 0.8, SHAPE[1])
        bpy.data.images["height"].pixels.foreach_set(pixels.ravel())
        restore_all(**FAST)
        assert np.allclose(read(bpy.data.images["height restored"])[..., 3], pixels[..., 3], atol=0.01)
        assert (read(bpy.data.images["normals restored"])[..., 3] == 1.0).all()

    def test_all_are_replaced_and_restored_again_from_their_originals(self, maps):
        for keep_result, suffix in ((False, ""), (False, ""), (True, ".001")):
            restore_all(replace_in_materials=True, keep_result=keep_result, **FAST)
            assert {name: node.image.name for name, node in maps.items()} == {name: f"{name} restored{suffix}" for name in maps}
            normals = read(maps["normals"].image)[square()][:, :3]
            assert np.linalg.norm(2.0 * normals - 1.0, axis=1) == pytest.approx(1.0, abs=1e-4)
        assert len(bpy.data.images) == 10

    def test_what_does_not_fit_is_left_out_and_named(self, maps, capfd, tmp_path):
        small, movie = new_image("small", ramp()), new_image("clip", ramp())
        movie.source = "MOVIE"
        add_maps([bpy.data.images["color"], small, movie, new_image("foreign", ramp())], "second")
        add_maps([new_image("unrelated", opaque(rock()[0])), small], "other")
        restore_all(**FAST)
        message = capfd.readouterr().out
        assert 'with 2 other maps of its material; left out: "small" (other size), "clip" (movie), "foreign" (other size).' in message
        assert "unrelated" not in message

    def test_linked_maps_are_left_out(self, empty_scene, tmp_path, capfd):
        image = new_image("linked", ramp())
        image.pack()
        image.use_fake_user = True
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "library.blend"))
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
        with bpy.data.libraries.load(str(tmp_path / "library.blend"), link=True) as (_, target):
            target.images = ["linked"]
        add_maps([new_image("color", ramp()), bpy.data.images["linked"]])
        new_mask()
        restore_all(**FAST)
        assert 'with no other map of its material; left out: "linked" (linked).' in capfd.readouterr().out
        assert "linked restored" not in bpy.data.images

    def test_tiles_of_all_maps_are_restored(self, empty_scene):
        for name in ("color", "height", "mask"):
            image = bpy.data.images.new(name, WIDTH, HEIGHT, alpha=True, tiled=True)
            image.pixels.foreach_set(opaque(hole()[..., None].astype(np.float32) if name == "mask" else ramp()[..., :1]).ravel())
            image.update()
        add_maps([bpy.data.images["color"], bpy.data.images["height"]])
        restore_all(**FAST)
        (tile,) = read_tiles(bpy.data.images["height restored"]).values()
        assert np.abs(tile - opaque(ramp()[..., :1])).max() < 0.02

    def test_sequences_are_refused_with_a_sentence(self, empty_scene, tmp_path):
        image, group = new_image("shot", ramp()), bpy.context.scene.farfield_restore
        image.filepath_raw, image.file_format = str(tmp_path / "shot_1.png"), "PNG"
        image.save()
        image.source, group.all_maps_of_material = "SEQUENCE", True
        new_mask()
        assert "All Maps of Material" in find_problem(image, group)
        with pytest.raises(RuntimeError, match='"shot" is an image sequence; turn off All Maps of Material'):
            restore_all("shot", output_folder=str(tmp_path / "out"), **FAST)

    def test_one_undo_step_and_nothing_is_left_of_a_failure(self, maps, monkeypatch):
        for image in bpy.data.images:
            image.pack()
            image.use_fake_user = True
        names = sorted(image.name for image in bpy.data.images)
        create = results.create_result

        def fail(source, tiles):
            if source.name == "normals":
                raise OSError("The disk is full.")
            return create(source, tiles)

        with monkeypatch.context() as patch:
            patch.setattr(results, "create_result", fail)
            with pytest.raises(RuntimeError):
                restore_all(**FAST)
        assert sorted(image.name for image in bpy.data.images) == names
        job = prepare(
            bpy.context, "color", MaskSettings(mask_image="mask", all_maps_of_material=True), RestoreSettings(**FAST), replaces_results=True
        )
        steps = job.scene_steps(run_to_end(job.core_steps()))
        next(steps), next(steps)
        assert len(bpy.data.images) == len(names) + 1
        steps.close()
        assert sorted(image.name for image in bpy.data.images) == names, "Esc leaves nothing behind"
        bpy.data.materials["rock"].use_fake_user = True
        bpy.ops.ed.undo_push(message="before")
        bpy.ops.farfield.restore_image(
            "EXEC_DEFAULT", True, image="color", mask_image="mask", all_maps_of_material=True, replace_in_materials=True, **FAST
        )
        assert len(bpy.data.images) == len(names) + 3
        bpy.ops.ed.undo()
        assert sorted(image.name for image in bpy.data.images) == names
        assert sorted(image.name for image in list_maps(bpy.data.images["color"])) == ["height", "normals"]
