"""*Merge* with UDIM tiles and several materials."""

from functools import cache

import bpy
import numpy as np
import pytest

from farfield.addon.bridge.imaging.images import read_pixels
from farfield.addon.bridge.photos.camera_objects import create_cameras
from farfield.addon.bridge.restore.image_sources import read_tiles
from farfield.addon.compat import enable_nodes
from image_data import write_image
from photo_scenes import SIZE, grid, photograph, ring, smooth_texture

pytestmark = pytest.mark.usefixtures("empty_scene", "quick_merges", "coarse_packing")


@cache
def take_photographs():
    """The photographs of the square of `add_square` by a ring of three cameras."""
    mesh, uvs = grid(10)
    return [photograph(mesh, uvs, smooth_texture(), camera) for camera in ring(3)]


@pytest.fixture
def photographs(tmp_path):
    """Cameras in the scene with photographs of the square of `add_square`."""
    found = take_photographs()
    for each in found:
        write_image(tmp_path / each.camera.name, each.pixels[::-1])
    create_cameras([each.camera for each in found], tmp_path, "Cameras", bpy.context.scene, is_y_up=False)
    return found


def add_square(move=None, materials=()):
    """The flat square of `grid` as a selected object with UVs that `move` has changed; it takes them (T, 3, 2) and which triangles (T,)
    are on the right. These have the second of `materials`."""
    mesh, uvs = grid(10)
    is_right = uvs.mean(axis=1)[:, 0] > 0.5
    data = bpy.data.meshes.new("Wand ü")
    data.from_pydata(mesh.vertices.tolist(), [], mesh.triangles.tolist())
    data.uv_layers.new(name="UVMap").uv.foreach_set("vector", (uvs if move is None else move(uvs, is_right)).astype(np.float32).ravel())
    for material in materials:
        data.materials.append(material)
    if len(materials) > 1:
        data.polygons.foreach_set("material_index", is_right.astype(np.int32))
    item = bpy.data.objects.new("Wand ü", data)
    bpy.context.collection.objects.link(item)
    item.select_set(True)
    bpy.context.view_layer.update()
    return item


def to_tiles(uvs, is_right):
    """The left half fills tile 1002, the right half tile 1011."""
    moved = uvs * [2.0, 1.0]
    moved[~is_right] += [1.0, 0.0]
    moved[is_right] += [-1.0, 1.0]
    return moved


def stack(uvs, is_right):
    """Both halves fill the square from 0 to 1."""
    moved = uvs * [2.0, 1.0]
    moved[is_right] -= [1.0, 0.0]
    return moved


def merge_scene(**settings):
    assert bpy.ops.farfield.photos_merge(**({"size": SIZE, "sharpen": False} | settings)) == {"FINISHED"}


def image_of(material):
    [image] = {node.image for node in material.node_tree.nodes if node.type == "TEX_IMAGE"}
    return image


def halves():
    """The true colors of both halves, stretched over a page."""
    return smooth_texture()[:, : SIZE // 2].repeat(2, axis=1), smooth_texture()[:, SIZE // 2 :].repeat(2, axis=1)


def difference(pixels, expected):
    """Root mean square inside of the border, where photographs show less."""
    return np.sqrt(np.mean((pixels[..., :3] - expected)[8:-8, 8:-8] ** 2))


def new_material(name, color, roughness=0.25):
    """A material whose Base Color is an RGB node."""
    material = bpy.data.materials.new(name)
    enable_nodes(material)
    tree = material.node_tree
    shader = next(node for node in tree.nodes if node.type == "BSDF_PRINCIPLED")
    shader.inputs["Roughness"].default_value = roughness
    rgb = tree.nodes.new("ShaderNodeRGB")
    rgb.outputs[0].default_value = (*color, 1.0)
    tree.links.new(rgb.outputs[0], shader.inputs["Base Color"])
    return material


def render_colors(item, path):
    """Colors of the square from above, left and right, as Cycles renders its Base Color as emission."""
    scene = bpy.context.scene
    for slot in item.material_slots:
        tree = slot.material.node_tree
        emission = tree.nodes.new("ShaderNodeEmission")
        shader = next(node for node in tree.nodes if node.type == "BSDF_PRINCIPLED")
        tree.links.new(shader.inputs["Base Color"].links[0].from_socket, emission.inputs["Color"])
        tree.links.new(emission.outputs[0], tree.get_output_node("CYCLES").inputs["Surface"])
    camera = bpy.data.objects.new("Above", bpy.data.cameras.new("Above"))
    camera.data.type, camera.data.ortho_scale, camera.location = "ORTHO", 2.0, (0.0, 0.0, 3.0)
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", 4, False
    scene.render.resolution_x = scene.render.resolution_y = SIZE
    scene.view_settings.view_transform = "Standard"
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    return read_pixels(bpy.data.images.load(str(path)))


class TestTiles:
    """UDIM tiles."""

    @pytest.mark.slow
    def test_each_tile_has_the_colors_of_its_islands(self, photographs):
        item = add_square(to_tiles)
        merge_scene(maps=True, sharpen=True)
        image = image_of(item.material_slots[0].material)
        assert image.source == "TILED" and image.packed_files and image.name == "Wand ü Photo Texture"
        assert image.colorspace_settings.name == "sRGB"
        tiles = read_tiles(image)
        assert list(tiles) == [1002, 1011]
        for pixels, expected in zip(tiles.values(), halves(), strict=True):
            assert pixels.shape == (SIZE, SIZE, 4) and difference(pixels, expected) < 0.02
        source = bpy.data.images[f"{image.name} Source"]
        assert source.source == "TILED" and source.colorspace_settings.is_data and source.use_fake_user
        assert set(np.rint(3.0 * np.unique(read_tiles(source)[1011][..., 0]))) <= {0.0, 1.0, 2.0, 3.0}

    def test_a_saved_file_renders_with_its_tiles(self, photographs, tmp_path):
        add_square(to_tiles)
        merge_scene()
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "été.blend"))
        bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "été.blend"))
        rendered = render_colors(bpy.data.objects["Wand ü"], tmp_path / "render.png")
        assert difference(rendered, smooth_texture()) < 0.04

    def test_transparent_holes(self, photographs):
        item = add_square(to_tiles)
        for name in ("1", "2"):
            bpy.data.objects[name].hide_set(True)
        lens = bpy.data.objects["0"].data
        lens["farfield_lens"] = lens["farfield_lens"].replace("300.0", "900.0")  # a narrow view
        merge_scene(fill="none")
        image = image_of(item.material_slots[0].material)
        alphas = [pixels[..., 3] for pixels in read_tiles(image).values()]
        assert all(set(np.unique(alpha)) == {0.0, 1.0} for alpha in alphas)

    @pytest.mark.slow
    def test_overlaps_count_within_a_tile_only(self, photographs):
        item = add_square(stack)
        with pytest.raises(RuntimeError, match="overlaps itself: 200 triangles"):
            merge_scene()
        uvs = grid(10)[1]
        item.data.uv_layers[0].uv.foreach_set("vector", to_tiles(uvs, uvs.mean(axis=1)[:, 0] > 0.5).astype(np.float32).ravel())
        merge_scene()

    @pytest.mark.slow
    def test_objects_on_different_tiles_get_one_image(self, photographs):
        first = add_square(lambda uvs, _: 0.9 * uvs)
        second = add_square(lambda uvs, _: uvs + [1.0, 0.0])
        second.location.z = -0.5
        merge_scene()
        image = image_of(first.material_slots[0].material)
        assert image == image_of(second.material_slots[0].material) and list(read_tiles(image)) == [1001, 1002]
        assert len({item.material_slots[0].material for item in (first, second)}) == 1


class TestKeep:
    """One texture per material."""

    @pytest.mark.slow
    def test_materials_are_copied_with_their_own_images(self, photographs):
        red, metal = new_material("Rot", (1.0, 0.0, 0.0)), new_material("Metal", (0.0, 0.0, 1.0), 0.5)
        item = add_square(stack, (red, metal))
        other = bpy.data.objects.new("Other", bpy.data.meshes.new("Other"))
        other.data.materials.append(metal)
        merge_scene(materials="keep")
        found = [slot.material for slot in item.material_slots]
        assert [material.name for material in found] == ["Rot Photo Texture", "Metal Photo Texture"]
        for material, expected, roughness in zip(found, halves(), (0.25, 0.5), strict=True):
            assert difference(read_pixels(image_of(material)), expected) < 0.02 and not material.use_fake_user
            assert image_of(material).packed_files and image_of(material).name == material.name
            shader = next(node for node in material.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
            assert shader.inputs["Roughness"].default_value == roughness
        assert red.use_fake_user and not metal.use_fake_user and other.data.materials[0] == metal
        assert [link.from_node.type for link in red.node_tree.links if link.to_socket.name == "Base Color"] == ["RGB"]
        assert len(np.unique([polygon.material_index for polygon in item.data.polygons])) == 2

    @pytest.mark.slow
    def test_a_second_merge_replaces_only_the_images(self, photographs):
        item = add_square(stack, (new_material("Rot", (1.0, 0.0, 0.0)), new_material("Metal", (0.0, 0.0, 1.0))))
        merge_scene(materials="keep")
        former = item.material_slots[1].material
        nodes, image = len(former.node_tree.nodes), image_of(former)
        merge_scene(materials="keep")
        material = item.material_slots[1].material
        assert material != former and image_of(material) != image and not former.use_fake_user
        assert len(material.node_tree.nodes) == nodes and material.name.startswith("Metal Photo Texture")

    @pytest.mark.slow
    def test_faces_and_slots_without_a_material(self, photographs):
        item = add_square(stack, (new_material("Rot", (1.0, 0.0, 0.0)), None))
        merge_scene(materials="keep")
        names = [slot.material.name for slot in item.material_slots]
        assert names == ["Rot Photo Texture", "Wand ü Photo Texture"]
        assert difference(read_pixels(image_of(item.material_slots[1].material)), halves()[1]) < 0.02
        item.select_set(False)
        bare = add_square()
        merge_scene(materials="keep")
        assert difference(read_pixels(image_of(bare.material_slots[0].material)), smooth_texture()) < 0.02

    def test_a_material_without_a_principled_bsdf_is_replaced_and_named(self, photographs, capfd):
        emissive = new_material("Glow", (1.0, 1.0, 1.0))
        tree = emissive.node_tree
        tree.nodes.remove(next(node for node in tree.nodes if node.type == "BSDF_PRINCIPLED"))
        item = add_square(None, (emissive,))
        merge_scene(materials="keep")
        assert "Replaced, because they have no Principled BSDF: Glow." in "".join(capfd.readouterr())
        assert emissive.use_fake_user and difference(read_pixels(image_of(item.material_slots[0].material)), smooth_texture()) < 0.02

    def test_a_material_without_uvs_stays_and_is_named(self, photographs, capfd):
        item = add_square(
            lambda uvs, is_right: np.where(is_right[:, None, None], 0.0, uvs), [new_material(name, (1, 0, 0)) for name in "AB"]
        )
        merge_scene(materials="keep")
        assert [slot.material.name for slot in item.material_slots] == ["A Photo Texture", "B"]
        assert "Unchanged, because their UV map covers no pixel: B." in "".join(capfd.readouterr())

    def test_tiles_of_a_material(self, photographs):
        """The right half of the square has a material that uses two tiles, one above the other."""

        def move(uvs, is_right):
            moved = stack(uvs, is_right)
            is_upper = is_right & (uvs.mean(axis=1)[:, 1] > 0.5)
            moved[is_upper] += [0.0, 0.5]
            return moved

        item = add_square(move, (new_material("A", (1.0, 0.0, 0.0)), new_material("B", (0.0, 0.0, 1.0))))
        merge_scene(materials="keep")
        first, second = (image_of(slot.material) for slot in item.material_slots)
        assert first.source != "TILED" and list(read_tiles(second)) == [1001, 1011]
        lower, upper = (pixels[..., :3] for pixels in read_tiles(second).values())
        expected, half = halves()[1], SIZE // 2
        assert np.abs(lower[10 : half - 4, 10:-10] - expected[10 : half - 4, 10:-10]).max() < 0.06
        assert np.abs(upper[4 : half - 10, 10:-10] - expected[half + 4 : SIZE - 10, 10:-10]).max() < 0.06

    def test_a_transparent_material_stays_transparent(self, photographs):
        glass = new_material("Glass", (1.0, 1.0, 1.0))
        shader = next(node for node in glass.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
        shader.inputs["Alpha"].default_value = 0.5
        item = add_square(None, (glass,))
        merge_scene(materials="keep", fill="none")
        tree = item.material_slots[0].material.node_tree
        [link] = [link for link in tree.links if link.to_socket.name == "Alpha"]
        assert link.from_node.type == "MATH" and link.from_node.inputs[1].default_value == pytest.approx(0.5)

    def test_materials_of_modifiers_are_refused(self, photographs):
        item = add_square(None, (new_material("Rot", (1.0, 0.0, 0.0)),))
        tree = bpy.data.node_groups.new("Set", "GeometryNodeTree")
        for direction in ("INPUT", "OUTPUT"):
            tree.interface.new_socket("Geometry", in_out=direction, socket_type="NodeSocketGeometry")
        start, change, end = (tree.nodes.new(kind) for kind in ("NodeGroupInput", "GeometryNodeSetMaterial", "NodeGroupOutput"))
        change.inputs["Material"].default_value = bpy.data.materials.new("Other")
        tree.links.new(start.outputs[0], change.inputs["Geometry"])
        tree.links.new(change.outputs[0], end.inputs[0])
        item.modifiers.new("Nodes", "NODES").node_group = tree
        with pytest.raises(RuntimeError, match='Modifiers give "Wand ü" the material "Other"'):
            merge_scene(materials="keep")
        merge_scene()

    @pytest.mark.exhaustive
    def test_undo(self, photographs):
        add_square(stack, (new_material("Rot", (1.0, 0.0, 0.0)), new_material("Metal", (0.0, 0.0, 1.0))))
        bpy.ops.ed.undo_push(message="before")
        merge_scene(materials="keep")
        bpy.ops.ed.undo_push(message="Merge")
        bpy.ops.ed.undo()
        assert [slot.material.name for slot in bpy.data.objects["Wand ü"].material_slots] == ["Rot", "Metal"]
        assert not bpy.data.materials["Rot"].use_fake_user and not any("Texture" in image.name for image in bpy.data.images)
