"""The operator as scripts call it: the new image, its properties, and that nothing else changes."""

import bpy
import numpy as np
import pytest

from farfield.addon.bridge.restore.image_users import ORIGINAL_PROPERTY, create_mask, list_restored
from farfield.addon.compat import enable_nodes
from restore_images import FAST, HEIGHT, HOLE, WIDTH, hole, new_image, new_mask, ramp, read, restore

pytestmark = pytest.mark.usefixtures("empty_scene")


def restore_error(**arguments):
    with pytest.raises(RuntimeError) as caught:
        bpy.ops.farfield.restore_image(**(FAST | arguments))
    return str(caught.value)


def damaged(pixels):
    """Copy of `pixels` with magenta in the hole."""
    copy = pixels.copy()
    copy[HOLE] = (1.0, 0.0, 1.0, 1.0)
    return copy


def test_the_result_is_a_new_packed_image_and_the_original_is_unchanged(tmp_path):
    source, truth = new_image("Straße 写真", damaged(ramp())), read(new_image("truth", ramp()))
    before = read(source)
    new_mask()
    result = restore("Straße 写真")
    assert result.name == "Straße 写真 restored" and result.packed_files and result.source == "FILE"
    assert np.array_equal(read(source), before) and source.name == "Straße 写真"
    restored = read(result)
    assert np.array_equal(restored[~hole()], truth[~hole()]), "pixels outside the mask have changed"
    assert np.abs(restored - truth).max() < 0.02, "a linear ramp is its own diffusion"
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "Straße.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "Straße.blend"))
    assert np.array_equal(read(bpy.data.images["Straße 写真 restored"]), restored), "unused results are saved as well"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("is_float", "color_space"),
    [(False, "sRGB"), (False, "Non-Color"), (False, "Linear Rec.709"), (True, "Non-Color"), (True, "Linear Rec.709")],
)
@pytest.mark.parametrize("alpha_mode", ["STRAIGHT", "PREMUL", "CHANNEL_PACKED", "NONE"])
def test_pixels_outside_the_mask_survive_a_saved_file(tmp_path, color_space, alpha_mode, is_float):
    pixels = ramp()
    if alpha_mode != "NONE":
        pixels[..., 3] = np.round(np.linspace(0.0, 1.0, WIDTH) * 255.0) / 255.0
    if is_float:
        pixels[..., :3] *= np.float32(6.0) * pixels[..., 3:]
    new_image("source", pixels, color_space, is_float, alpha_mode)
    new_mask()
    result = restore("source")
    assert result.is_float == is_float and result.colorspace_settings.name == color_space
    restored = read(result)
    assert np.array_equal(restored[~hole()], read(bpy.data.images["source"])[~hole()])
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "saved.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "saved.blend"))
    assert np.array_equal(read(bpy.data.images["source restored"]), restored)


def test_colors_of_float_images_are_filled_as_they_are_displayed():
    """A ramp of sRGB values far above 1 and below 0 is restored as a ramp."""
    encoded = np.linspace(-0.5, 4.0, WIDTH, dtype=np.float32)
    size = np.abs(encoded)
    linear = np.copysign(np.where(size <= 0.04045, size / 12.92, ((size + 0.055) / 1.055) ** 2.4), encoded)
    alpha = np.linspace(0.3, 0.9, WIDTH, dtype=np.float32)
    truth = np.broadcast_to(np.column_stack([linear * alpha] * 3 + [alpha]), (HEIGHT, WIDTH, 4)).astype(np.float32)
    pixels = truth.copy()
    pixels[HOLE] = 0.0
    new_image("hdr", pixels, "Linear Rec.709", is_float=True)
    new_mask()
    assert np.allclose(read(restore("hdr")), truth, rtol=0.02, atol=0.02)


def test_display_properties_are_those_of_the_original():
    source = new_image("source", ramp())
    source.use_view_as_render, source.seam_margin, source.display_aspect = True, 3, (1.0, 2.0)
    new_mask()
    result = restore("source")
    assert (result.use_view_as_render, result.seam_margin, tuple(result.display_aspect)) == (True, 3, (1.0, 2.0))


def test_transparent_pixels_are_missing():
    pixels = ramp()
    pixels[HOLE] = 0.0
    new_image("source", pixels)
    result = read(restore("source", mask="alpha", mask_image=""))
    assert (result[..., 3] == 1.0).all() and np.abs(result - ramp()).max() < 0.02


def test_pixels_of_a_color_are_missing():
    new_image("source", damaged(ramp()))
    result = read(restore("source", mask="color", mask_color=(1.0, 0.0, 1.0), color_tolerance=0.0))
    assert np.abs(result - ramp()).max() < 0.02


def test_brightness_of_the_mask_counts_with_its_alpha():
    new_image("source", damaged(ramp()))
    mask = new_mask()
    pixels = read(mask)
    pixels[:2] = (1.0, 1.0, 1.0, 0.2)
    mask.pixels.foreach_set(pixels.ravel())
    assert np.array_equal(read(restore("source"))[:2], read(bpy.data.images["source"])[:2]), "transparent white is not painted"


@pytest.mark.slow
def test_texture_comes_from_the_source_mask():
    random = np.random.default_rng(3)
    pixels = np.ones((48, 96, 4), np.float32)
    pixels[:, :48, :3] = random.integers(100, 150, (48, 48, 1)) / np.float32(255.0)
    pixels[:, 48:, :3] = random.integers(0, 250, (48, 48, 1)) / np.float32(255.0)
    mask, allowed, inside = (np.zeros((48, 96), bool) for _ in range(3))
    mask[10:38, 58:86], allowed[:, :48], inside[20:28, 68:76] = True, True, True  # inside: where no seam is blended
    new_image("source", pixels)
    new_mask("mask", mask)
    new_mask("calm", allowed)
    new_mask("noisy", ~allowed)
    arguments = {"split": "manual", "sub_bands": 0, "pyramid_levels": 1}
    calm, noisy = (read(restore("source", **arguments, source_mask=name))[inside][:, 0].std() for name in ("calm", "noisy"))
    assert calm < 0.6 * noisy


def test_diffusion_does_not_cross_barriers():
    pixels = np.ones((HEIGHT, WIDTH, 4), np.float32)
    pixels[:, : WIDTH // 2, :3] = 0.2
    barriers = np.zeros((HEIGHT, WIDTH), bool)
    barriers[:, WIDTH // 2] = True
    new_image("source", pixels)
    new_mask()
    new_mask("edge", barriers)
    smooth, sharp = (read(restore("source", barriers=name)) for name in ("", "edge"))
    left = hole() & (np.arange(WIDTH) < WIDTH // 2)
    assert np.allclose(sharp[left][:, 0], 0.2, atol=0.01) and smooth[left][:, 0].max() > 0.3


def test_normals_have_unit_length():
    random = np.random.default_rng(5)
    normals = random.normal(size=(HEIGHT, WIDTH, 3)) * 0.4 + (0.0, 0.0, 1.0)
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    new_image("normals", np.dstack([0.5 + 0.5 * normals, np.ones((HEIGHT, WIDTH))]).astype(np.float32), "Non-Color", is_float=True)
    new_mask()

    def lengths(**settings):
        return np.linalg.norm(read(restore("normals", **settings))[hole()][:, :3] * 2.0 - 1.0, axis=1)

    assert np.abs(lengths() - 1.0).max() > 0.01, "the test needs normals that diffusion shortens"
    assert np.allclose(lengths(normal_map=True), 1.0, atol=1e-4)
    material = bpy.data.materials.new("bumpy")
    enable_nodes(material)
    nodes, links = material.node_tree.nodes, material.node_tree.links
    texture, reroute, bump = nodes.new("ShaderNodeTexImage"), nodes.new("NodeReroute"), nodes.new("ShaderNodeNormalMap")
    texture.image = bpy.data.images["normals"]
    links.new(texture.outputs["Color"], reroute.inputs[0])
    links.new(reroute.outputs[0], bump.inputs["Color"])
    assert np.allclose(lengths(), 1.0, atol=1e-4), "an image that a Normal Map node uses is a normal map"


def test_equal_seeds_give_equal_bytes_and_settings_come_from_the_panel():
    random = np.random.default_rng(7)
    new_image("source", np.dstack([random.integers(0, 255, (HEIGHT, WIDTH, 3)) / 255.0, np.ones((HEIGHT, WIDTH))]).astype(np.float32))
    new_mask()
    group = bpy.context.scene.farfield_restore
    group.mask_image, group.split, group.pyramid_levels, group.sub_bands = "mask", "manual", 1, 2
    results = []
    for arguments in ({}, {}, {"split": "diffusion"}):
        assert bpy.ops.farfield.restore_image(image="source", **arguments) == {"FINISHED"}
        results.append(read(bpy.data.images["source restored"]))
    assert np.array_equal(results[0], results[1]) and not np.array_equal(results[0], results[2])


@pytest.mark.parametrize(
    ("prepare", "arguments", "message"),
    [
        (lambda: None, {"image": "nowhere", "mask_image": "mask"}, 'There is no image "nowhere"'),
        (lambda: None, {"image": ""}, "There is no image to restore"),
        (lambda: None, {"image": "source", "mask_image": ""}, 'Choose a mask image for "source"'),
        (lambda: None, {"image": "source", "mask_image": "gone"}, 'There is no image "gone"'),
        (
            lambda: new_mask("small", hole(20, 20)),
            {"image": "source", "mask_image": "small"},
            '"small" has 20 x 20 pixels, but "source" has',
        ),
        (lambda: new_mask("empty", np.zeros((HEIGHT, WIDTH), bool)), {"image": "source", "mask_image": "empty"}, "mask"),
        (lambda: new_mask("full", np.ones((HEIGHT, WIDTH), bool)), {"image": "source", "mask_image": "full"}, "mask"),
    ],
    ids=["no image", "no name", "no mask", "mask removed", "another size", "nothing masked", "all masked"],
)
def test_invalid_input_is_one_sentence_and_changes_nothing(prepare, arguments, message):
    new_image("source", damaged(ramp()))
    new_mask()
    prepare()
    before = {image.name for image in bpy.data.images}
    text = restore_error(**arguments)
    assert message in text and "Traceback" not in text and "log" not in text, text
    assert {image.name for image in bpy.data.images} == before


def test_images_without_readable_pixels_are_refused(tmp_path):
    new_mask()
    missing = new_image("missing", ramp())
    missing.source, missing.filepath = "FILE", str(tmp_path / "nowhere.png")
    broken = new_image("broken", ramp())
    (tmp_path / "broken.png").write_bytes(b"no image")
    broken.source, broken.filepath = "FILE", str(tmp_path / "broken.png")
    movie = new_image("movie", ramp())
    movie.source = "MOVIE"
    assert "nowhere.png" in restore_error(image="missing", mask_image="mask")
    assert "broken.png" in restore_error(image="broken", mask_image="mask")
    assert "is a movie" in restore_error(image="movie", mask_image="mask")
    new_image("source", ramp())
    assert "is a movie" in restore_error(image="source", mask_image="movie"), "masks are checked as well"


def test_render_results_are_refused():
    new_mask()
    bpy.context.scene.render.resolution_x = bpy.context.scene.render.resolution_y = 8
    bpy.context.scene.camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    bpy.context.scene.render.engine = "CYCLES"
    bpy.context.scene.cycles.samples = 1
    bpy.ops.render.render()
    assert "result of rendering" in restore_error(image="Render Result", mask_image="mask")


def test_gray_and_opaque_files_are_read(tmp_path):
    """Files with one or three channels."""
    for mode in ("BW", "RGB"):
        source = new_image(mode, ramp())
        settings = bpy.context.scene.render.image_settings
        settings.file_format, settings.color_mode = "PNG", mode
        bpy.context.scene.view_settings.view_transform = "Raw"
        source.save_render(str(tmp_path / f"{mode}.png"))
        image = bpy.data.images.load(str(tmp_path / f"{mode}.png"))
        image.name = f"loaded {mode}"
        if not bpy.data.images.get("mask"):
            new_mask()
        result = read(restore(image.name))
        assert np.array_equal(result[~hole()][:, :3], read(image)[~hole()][:, :3])


class TestReplacedResults:
    """Restore replaces its last result only if nothing has happened to it."""

    def restore_again(self, change=None, **arguments):
        """Restore twice with a `change` of the result in between; return the names of all results."""
        source = new_image("source", damaged(ramp()))
        new_mask()
        result = restore("source")
        if change is not None:
            change(result)
        bpy.ops.farfield.restore_image(image="source", mask_image="mask", **(FAST | arguments))
        return [image.name for image in list_restored(source)]

    def test_users_and_name_of_the_former_result_are_those_of_the_new_one(self):
        texture = bpy.data.textures.new("own", "IMAGE")

        def use(result):
            texture.image = result

        assert self.restore_again(use) == ["source restored"]
        assert texture.image == bpy.data.images["source restored"]

    def test_a_result_that_is_kept_stays_when_restored_again(self):
        assert len(self.restore_again(keep_result=True)) == 2
        bpy.ops.farfield.restore_image(image="source", mask_image="mask", **FAST)
        assert len(list_restored(bpy.data.images["source"])) == 3, "the last result was asked for in addition"

    @pytest.mark.parametrize("change", ["paint", "paint and pack", "rename", "save", "mask", "restore"])
    def test_what_was_changed_saved_or_used_stays(self, change, tmp_path):
        changed = []

        def apply(result):
            if change.startswith("paint"):
                result.pixels[0] = 0.123
                result.update()
            if change == "paint and pack":
                result.pack()
            elif change == "rename":
                result.name = "source restored well"
            elif change == "save":
                result.filepath_raw = str(tmp_path / "saved.png")
                result.save()
            elif change == "mask":
                create_mask(result)
            elif change == "restore":
                bpy.data.images.new("further", 8, 8)[ORIGINAL_PROPERTY] = result
            changed.append((result.name, read(result)))

        names = self.restore_again(apply)
        assert len(names) == 2 and names[0] == changed[0][0]
        assert np.array_equal(read(bpy.data.images[names[0]]), changed[0][1])
