"""Image files: pixels that do not change come out bit by bit, with the same header; everything else is refused in one sentence."""

import struct
import sys
import warnings
import zlib
from pathlib import Path

import bpy
import numpy as np
import pytest
import tifffile
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image

import strategies
from farfield.addon.bridge.blender import import_blender_module
from farfield.addon.bridge.imaging import image_files
from farfield.addon.bridge.imaging.image_files import read_image_file, write_image_file
from farfield.addon.bridge.imaging.image_storage import Storage, from_pixels, to_pixels
from farfield.addon.bridge.imaging.images import read_gray_image
from farfield.addon.core.errors import FileError
from farfield.addon.core.imaging.colors import decode_signed_srgb, encode_signed_srgb
from image_data import icc_profile, jpeg_bytes, open_image_io, png_bytes, png_chunk, read_image, write_image

RANDOM = np.random.default_rng(5)
BYTES = np.stack(np.broadcast_arrays(*np.mgrid[:256, :256], 255 - np.mgrid[:256, :256][1]), axis=2).astype(np.uint8)
SHORTS = np.arange(65536, dtype=np.uint16).reshape(256, 256, 1)
HALVES = np.arange(65536, dtype=np.uint16).view(np.float16)
FINITE_HALVES = np.where(np.isfinite(HALVES), HALVES, np.float16(2.0)).reshape(256, 256, 1)
FLOATS = (RANDOM.normal(size=(40, 50, 4)) * 3.0).astype(np.float32)
LOSSLESS = {
    "gray8.png": BYTES[..., :1],
    "rgb8.png": BYTES[..., [0, 1, 2]],
    "gray_alpha16.png": np.concatenate([SHORTS, SHORTS[::-1]], axis=2),
    "rgba8.png": BYTES[..., [0, 1, 2, 1]],
    "rgb8.tif": BYTES[..., [0, 1, 2]],
    "gray16.tif": SHORTS,
    "premultiplied8.tif": BYTES[..., [0, 1, 2, 1]],
    "half.tif": np.abs(FINITE_HALVES).repeat(3, axis=2),
    "float.tif": FLOATS,
    "half.exr": FINITE_HALVES.repeat(4, axis=2),
    "float.exr": FLOATS,
    "float_gray.exr": FLOATS[..., :1],
}


@pytest.mark.parametrize("name", LOSSLESS)
def test_unchanged_pixels_are_written_bit_by_bit(tmp_path, name):
    stored = LOSSLESS[name]
    image = read_image_file(write_image(tmp_path / name, stored))
    assert image.pixels.dtype == np.float32 and image.stored.tobytes() == stored.tobytes()
    changed = np.zeros(stored.shape[:2], bool)
    changed[3:7, 5:30] = True
    pixels = np.where(changed[..., None], np.float32(0.25), RANDOM.random(stored.shape, np.float32))  # only changed pixels count
    write_image_file(tmp_path / f"out-{name}", pixels, image, changed)
    written, spec = read_image(tmp_path / f"out-{name}")
    kept = ~changed[::-1]
    assert written.dtype == stored.dtype and written[kept].tobytes() == stored[kept].tobytes()
    assert spec.channelnames == read_image(tmp_path / name)[1].channelnames
    again = read_image_file(tmp_path / f"out-{name}")
    assert again.storage == image.storage and again.depth == image.depth
    np.testing.assert_allclose(again.pixels[changed], 0.25, atol=0.5 / 60 if "8" in name else 1e-3)


@given(strategies.images(), st.randoms(use_true_random=False))
@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_image_is_written_as_it_was_read(tmp_path, stored, random):
    """Also values that are not finite, and single rows; every second pixel changes."""
    extension = random.choice((".exr", ".tif") if stored.dtype.kind == "f" else (".png", ".tif"))
    image = read_image_file(write_image(tmp_path / f"a{extension}", stored))
    changed = np.indices(stored.shape[:2]).sum(axis=0) % 2 == 0
    write_image_file(tmp_path / f"b{extension}", np.full(stored.shape, 0.5, np.float32), image, changed)
    written, _ = read_image(tmp_path / f"b{extension}")
    kept = ~changed[::-1]
    assert written.dtype == stored.dtype and written[kept].tobytes() == stored[kept].tobytes()
    assert np.isfinite(written[~kept]).all()


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_integers_survive_the_conversion(dtype):
    values = np.arange(np.iinfo(dtype).max + 1, dtype=dtype)[:, None]
    storage = Storage(np.dtype(dtype))
    pixels = to_pixels(values, storage)
    assert pixels[0] == 0.0 and pixels[-1] == 1.0
    np.testing.assert_array_equal(from_pixels(pixels, storage), values)


def test_the_curve_is_that_of_srgb_and_continues():
    """Reference values of IEC 61966-2-1: 18 % gray is 0.4614, linear 0.5 is 0.7354."""
    np.testing.assert_allclose(
        encode_signed_srgb(np.array([0.0, 0.0031308, 0.18, 0.5, 1.0])), [0.0, 0.04045, 0.46136, 0.73536, 1.0], atol=1e-5
    )
    values = np.linspace(-20.0, 20.0, 4001)
    encoded = encode_signed_srgb(values)
    assert (np.diff(encoded) > 0.0).all()
    np.testing.assert_allclose(encoded, -encoded[::-1], atol=1e-12)
    np.testing.assert_allclose(decode_signed_srgb(encoded), values, atol=1e-9)


def test_premultiplied_linear_colors_become_straight_encoded_ones(tmp_path):
    stored = np.array([[[0.25, 0.5, 0.09, 0.5], [2.0, 0.0, 0.0, 0.0]]], np.float32)
    color = read_image_file(write_image(tmp_path / "a.exr", stored))
    np.testing.assert_allclose(color.pixels[0, 0], [0.73536, 1.0, 0.46136, 0.5], atol=1e-5)
    assert color.pixels[0, 1, 0] == pytest.approx(1.055 * 2.0 ** (1 / 2.4) - 0.055)  # light without alpha is not lost
    np.testing.assert_array_equal(read_image_file(tmp_path / "a.exr", is_color=False).pixels, stored)
    np.testing.assert_allclose(from_pixels(color.pixels, color.storage), stored, atol=1e-6)


def test_row_0_is_at_the_bottom(tmp_path):
    stored = np.zeros((3, 2, 1), np.uint8)
    stored[0] = 255
    np.testing.assert_array_equal(read_image_file(write_image(tmp_path / "a.png", stored)).pixels[:, 0, 0], [0.0, 0.0, 1.0])


@pytest.mark.parametrize("extension", [".png", ".tif", ".jpg", ".exr"])
def test_resolution_orientation_and_comments_are_kept(tmp_path, extension):
    stored = RANDOM.integers(0, 256, (9, 12, 3)).astype(np.float16 if extension == ".exr" else np.uint8)
    attributes = {"Orientation": 6, "XResolution": 300.0, "YResolution": 300.0, "ResolutionUnit": "in", "ImageDescription": "a wall"}
    image = read_image_file(write_image(tmp_path / f"été{extension}", stored, attributes))
    assert image.pixels.shape == (9, 12, 3)  # the orientation is not applied
    write_image_file(tmp_path / f"樹 #%3d?a=b{extension}", image.pixels, image, np.ones((9, 12), bool))
    before, after = (read_image(tmp_path / f"{name}{extension}")[1] for name in ("été", "樹 #%3d?a=b"))
    for name in attributes:
        assert after.getattribute(name) == before.getattribute(name), name
    assert after.getattribute("Orientation") == 6 and after.getattribute("XResolution") == pytest.approx(300.0, abs=0.1)


@pytest.mark.parametrize("out", [".png", ".tif", ".jpg"])
def test_the_color_profile_is_kept(tmp_path, out):
    profile = icc_profile()
    rows = b"".join(b"\0" + bytes(range(30)) for _ in range(4))
    chunk = png_chunk(b"iCCP", b"Test\0\0" + zlib.compress(profile))
    (tmp_path / "a.png").write_bytes(png_bytes(10, 4, 8, 2, rows, chunk))
    image = read_image_file(tmp_path / "a.png")
    write_image_file(tmp_path / f"b{out}", image.pixels, image, np.zeros((4, 10), bool))
    content = (tmp_path / f"b{out}").read_bytes()
    if out == ".png":
        start = content.index(b"iCCP") + 4
        length = struct.unpack(">I", content[start - 8 : start - 4])[0]
        content = zlib.decompress(content[start : start + length].partition(b"\0\0")[2])
    assert profile in content


def test_the_color_profile_is_left_out_where_colors_become_linear(tmp_path):
    chunk = png_chunk(b"iCCP", b"Test\0\0" + zlib.compress(icc_profile()))
    (tmp_path / "a.png").write_bytes(png_bytes(2, 1, 8, 2, b"\0" + bytes(6), chunk))
    image = read_image_file(tmp_path / "a.png")
    write_image_file(tmp_path / "b.exr", image.pixels, image, np.zeros((1, 2), bool))
    assert icc_profile() not in (tmp_path / "b.exr").read_bytes()


def test_layout_and_compression_of_openexr_are_kept(tmp_path):
    def tile(spec):
        spec.tile_width = spec.tile_height = 16
        spec.x, spec.y, spec.full_width, spec.full_height = 3, 4, 100, 90

    stored = RANDOM.normal(size=(30, 40, 3)).astype(np.float16)
    image = read_image_file(write_image(tmp_path / "a.exr", stored, {"compression": "piz", "Copyright": "Ada"}, tile))
    write_image_file(tmp_path / "b.exr", image.pixels, image, np.zeros((30, 40), bool))
    written, spec = read_image(tmp_path / "b.exr")
    assert written.tobytes() == stored.tobytes()
    assert (spec.tile_width, spec.x, spec.y, spec.full_width, spec.full_height) == (16, 3, 4, 100, 90)
    assert (spec.getattribute("compression"), spec.getattribute("Copyright")) == ("piz", "Ada")


@pytest.mark.parametrize(
    ("compression", "dtype", "expected"),
    [("dwaa", np.float16, "zip"), ("pxr24", np.float32, "zip"), ("pxr24", np.float16, "pxr24"), ("piz", np.float32, "piz")],
)
def test_lossy_openexr_becomes_lossless(tmp_path, compression, dtype, expected):
    stored = RANDOM.random((32, 32, 3)).astype(dtype)
    image = read_image_file(write_image(tmp_path / "a.exr", stored, {"compression": compression}))
    pixels, changed = image.pixels.copy(), np.zeros((32, 32), bool)
    changed[5, 7] = True
    pixels[5, 7] = 0.123456789
    write_image_file(tmp_path / "b.exr", pixels, image, changed)
    written, spec = read_image(tmp_path / "b.exr")
    assert spec.getattribute("compression") == expected
    assert written[~changed[::-1]].tobytes() == image.stored[~changed[::-1]].tobytes()


def test_jpeg_keeps_its_quality(tmp_path):
    y, x = np.mgrid[:64, :64]
    stored = np.stack([x * 2 + 40, y * 2 + 60, 200 - x - y], axis=2).astype(np.uint8)
    image = read_image_file(write_image(tmp_path / "a.jpg", stored, {"jpeg:subsampling": "4:4:4", "Compression": "jpeg:95"}))
    changed = np.zeros((64, 64), bool)
    changed[:8, :8] = True
    write_image_file(tmp_path / "b.jpg", image.pixels, image, changed)
    written, spec = read_image(tmp_path / "b.jpg")
    assert spec.getattribute("jpeg:subsampling") == "4:4:4"
    assert np.abs(written.astype(int) - image.stored).max() <= 3


def test_a_palette_becomes_rgba(tmp_path):
    palette = png_chunk(b"PLTE", bytes([255, 0, 0, 0, 255, 0])) + png_chunk(b"tRNS", bytes([255, 0]))
    (tmp_path / "a.png").write_bytes(png_bytes(4, 1, 1, 3, bytes([0, 0b0101_0000]), palette))
    image = read_image_file(tmp_path / "a.png")
    np.testing.assert_array_equal(image.pixels[0], [[1, 0, 0, 1], [0, 1, 0, 0], [1, 0, 0, 1], [0, 1, 0, 0]])
    write_image_file(tmp_path / "b.png", image.pixels, image, np.zeros((1, 4), bool))
    np.testing.assert_array_equal(read_image_file(tmp_path / "b.png").pixels, image.pixels)


@pytest.mark.parametrize(
    ("source", "target", "depth", "tolerance"),
    [
        ("rgb8.png", ".tif", "8", 0.0),
        ("rgb8.png", ".jpg", "8", 0.35),
        ("rgba8.png", ".exr", "half", 1e-3),
        ("gray16.tif", ".png", "16", 0.0),
        ("gray16.tif", ".jpg", "8", 0.02),
        ("gray16.tif", ".exr", "float", 1e-6),
        ("half.exr", ".tif", "half", None),
        ("float_gray.exr", ".png", "16", None),
        ("float.tif", ".exr", "float", None),
    ],
)
def test_another_format_gets_the_nearest_depth(tmp_path, source, target, depth, tolerance):
    image = read_image_file(write_image(tmp_path / source, LOSSLESS[source]))
    write_image_file(tmp_path / f"out{target}", image.pixels, image, np.zeros(image.pixels.shape[:2], bool))
    written = read_image_file(tmp_path / f"out{target}")
    assert written.depth == depth
    if tolerance is not None:
        visible = image.pixels[..., -1] > 0.0 if image.storage.has_alpha else np.ones(image.pixels.shape[:2], bool)
        np.testing.assert_allclose(written.pixels[visible], image.pixels[visible], atol=tolerance)
    elif depth == "16":
        np.testing.assert_allclose(written.pixels, np.clip(image.pixels, 0.0, 1.0), atol=1e-5)
    else:
        np.testing.assert_array_equal(written.stored, image.stored)


def test_jpeg_refuses_alpha(tmp_path):
    image = read_image_file(write_image(tmp_path / "a.png", LOSSLESS["rgba8.png"]))
    with pytest.raises(FileError, match=r"no alpha"):
        write_image_file(tmp_path / "b.jpg", image.pixels, image, np.ones((256, 256), bool))
    assert not (tmp_path / "b.jpg").exists()


@pytest.mark.parametrize("name", ["a.png", "a.jpg", "zip.tif", "none.tif", "zip.exr", "piz.exr"])
def test_truncated_files_are_refused(tmp_path, name, capfd):
    stored = RANDOM.integers(0, 256, (150, 120, 3))
    stored = stored.astype(np.float16) if name.endswith(".exr") else stored.astype(np.uint8)
    stem = name.partition(".")[0]
    content = write_image(tmp_path / name, stored, {} if stem == "a" else {"compression": stem}).read_bytes()
    for size in [*(len(content) * part // 20 for part in range(1, 20)), len(content) - 200, len(content) - 14]:
        (tmp_path / name).write_bytes(content[:size])
        with pytest.raises(FileError, match="damaged or truncated") as caught:
            read_image_file(tmp_path / name)
        assert "\n" not in str(caught.value) and str(caught.value).endswith(".")


def write_pages(path):
    """Write a TIFF file with two images."""
    oiio = open_image_io()
    specs = [oiio.ImageSpec(8, 8, 3, "uint8") for _ in range(2)]
    file = oiio.ImageOutput.create(str(path))
    assert file.open(str(path), specs[0]) and file.write_image(np.zeros((8, 8, 3), np.uint8))
    assert file.open(str(path), specs[1], "AppendSubimage") and file.write_image(np.zeros((8, 8, 3), np.uint8))
    file.close()


def write_parts(path):
    """Write an OpenEXR file with two images."""
    oiio = open_image_io()
    specs = tuple(oiio.ImageSpec(8, 8, 3, "half") for _ in range(2))
    for spec, name in zip(specs, "ab", strict=True):
        spec.attribute("oiio:subimagename", name)
    file = oiio.ImageOutput.create(str(path))
    assert file.open(str(path), specs) and file.write_image(np.zeros((8, 8, 3), np.float16))
    assert file.open(str(path), specs[1], "AppendSubimage") and file.write_image(np.zeros((8, 8, 3), np.float16))
    file.close()


def write_deep(path):
    """Write an OpenEXR file with several values per pixel."""
    oiio = open_image_io()
    spec = oiio.ImageSpec(4, 4, 4, "float")
    spec.deep, spec.channelnames = True, ("R", "G", "B", "A")
    deep = oiio.DeepData()
    deep.init(spec)
    deep.set_samples(3, 2)
    file = oiio.ImageOutput.create(str(path))
    assert file.open(str(path), spec) and file.write_deep_image(deep), file.geterror()
    file.close()


def write_layers(path):
    def name(spec):
        spec.channelnames = ("R", "G", "B", "A", "Z")

    write_image(path, np.zeros((4, 4, 5), np.float16), change=name)


def write_cmyk_tiff(path):
    def name(spec):
        spec.channelnames = ("C", "M", "Y", "K")

    write_image(path, np.zeros((4, 4, 4), np.uint8), {"tiff:ColorSpace": "CMYK"}, name)


def write_animation(path):
    """Write a PNG file with two frames."""
    frames = [Image.new("RGB", (8, 8), color) for color in ("red", "blue")]
    frames[0].save(path, save_all=True, append_images=frames[1:])


def write_volume(path):
    """Write a TIFF file whose only image has layers, which most readers ignore."""
    tifffile.imwrite(path, np.zeros((3, 8, 8), np.uint8), volumetric=True, photometric="minisblack")


def write_zeros(path, side, mode):
    """Write an image of zeros, which compression makes as small as it can."""
    Image.new(mode, (side, side)).save(path, **({"compression": "tiff_adobe_deflate"} if path.suffix == ".tif" else {}))


REFUSED = {
    "apng.png": (write_animation, "several images"),
    "bits.png": (lambda path: write_zeros(path, 13_000, "1"), "working on it takes 4.2 GiB"),
    "gray.png": (lambda path: write_zeros(path, 13_000, "L"), "working on it takes 4.2 GiB"),
    "gray.tif": (lambda path: write_zeros(path, 13_000, "L"), "working on it takes 4.2 GiB"),
    "missing.png": (lambda _: None, "does not exist"),
    "folder.png": (lambda path: path.mkdir(), "is a folder"),
    "empty.png": (lambda path: path.write_bytes(b""), "is empty"),
    "text.png": (lambda path: path.write_text("no image"), "no PNG, TIFF, JPEG or OpenEXR"),
    "signature.png": (lambda path: path.write_bytes(b"\x89PNG\r\n\x1a\n"), "damaged"),
    "huge.png": (lambda path: path.write_bytes(png_bytes(60000, 60000, 8, 6, bytes(100))), "GiB"),
    "implausible.png": (lambda path: path.write_bytes(png_bytes(15000, 15000, 8, 2, bytes(100))), "damaged"),
    "zero.png": (lambda path: path.write_bytes(png_bytes(0, 5, 8, 2, b"")), "damaged"),
    "cmyk.jpg": (lambda path: path.write_bytes(jpeg_bytes(4, 0)), "CMYK"),
    "ycck.jpg": (lambda path: path.write_bytes(jpeg_bytes(4, 2)), "CMYK"),
    "cmyk.tif": (write_cmyk_tiff, "CMYK"),
    "pages.tif": (write_pages, "several images"),
    "volume.tif": (write_volume, "a volume"),
    "integers.tif": (lambda path: write_image(path, np.zeros((4, 4, 1), np.int16)), "int16"),
    "doubles.tif": (lambda path: write_image(path, np.zeros((4, 4, 1), np.float64)), "double"),
    "layers.exr": (write_layers, "5 channels"),
    "deep.exr": (write_deep, "deep pixels"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_flat_image_is_refused_in_one_sentence(tmp_path, name, capfd):
    write, text = REFUSED[name]
    path = tmp_path / f"é {name}"
    write(path)
    with pytest.raises(FileError, match=text) as caught:
        read_image_file(path)
    message = str(caught.value)
    assert str(path) in message and message.endswith(".") and "\n" not in message


@pytest.mark.parametrize("kind", ["truncated", "parts"])
def test_openexr_files_that_can_end_blender_are_no_heights(tmp_path, kind):
    """Blender's own reader shows what is missing as black, or ends the process."""
    path = write_image(tmp_path / "whole.exr", FINITE_HALVES.repeat(16, axis=0), {"compression": "piz"})
    assert read_gray_image(path).shape == read_image(path)[0].shape[:2]
    if kind == "truncated":
        path.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])
    else:
        write_parts(path)
    with pytest.raises(FileError, match="damaged or truncated" if kind == "truncated" else "several images"):
        read_gray_image(path)


def test_heights_that_are_not_finite_need_no_warning(tmp_path):
    path = write_image(tmp_path / "a.exr", np.full((4, 4, 3), (np.inf, -np.inf, 0.0), np.float32))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert np.isnan(read_gray_image(path)).all()


def test_the_extension_does_not_choose_the_reader(tmp_path):
    """A file of another format is read by its content, and one of an unsupported format is not tried."""
    write_image(tmp_path / "a.png", BYTES[:9, :9]).rename(tmp_path / "a.exr")
    assert read_image_file(tmp_path / "a.exr").format == "png"
    (tmp_path / "b.png").write_bytes(b"P5\n1 1\n255\n\0")
    with pytest.raises(FileError, match="no PNG"):
        read_image_file(tmp_path / "b.png")


def test_a_plain_gray_jpeg_of_the_same_kind_as_the_cmyk_one_is_read(tmp_path):
    (tmp_path / "a.jpg").write_bytes(jpeg_bytes(1, None))
    np.testing.assert_allclose(read_image_file(tmp_path / "a.jpg").pixels, 128 / 255)


@pytest.mark.parametrize("name", ["a.png", "a.tif", "a.jpg", "a.exr"])
def test_a_full_disk_is_noticed(tmp_path, name, capfd):
    """A limit on the size of files stands for the disk."""
    resource = pytest.importorskip("resource")
    image = read_image_file(write_image(tmp_path / "in.png", RANDOM.integers(0, 256, (90, 90, 3)).astype(np.uint8)))
    nothing = np.zeros((90, 90), bool)
    write_image_file(tmp_path / name, image.pixels, image, nothing)
    size = (tmp_path / name).stat().st_size
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    for room in (0, 10, 500, size // 2, size - 1):
        (tmp_path / name).unlink(missing_ok=True)
        resource.setrlimit(resource.RLIMIT_FSIZE, (room, hard))
        try:
            with pytest.raises(FileError, match=f'Cannot write "{name}"') as caught:
                write_image_file(tmp_path / name, image.pixels, image, nothing)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        assert "\n" not in str(caught.value)


def test_no_module_of_pips_bpy_replaces_an_installed_one():
    """The folder of Blender's own modules comes after that of installed ones."""
    module = import_blender_module("OpenImageIO", "The test", "stop")
    if bpy.app.module:
        installed, blenders = (str(Path(package.__file__).parents[1]) for package in (np, module))
        assert sys.path.index(installed) < sys.path.index(blenders)


def test_a_missing_module_is_named():
    with pytest.raises(FileError, match=r'^"a\.png" needs the module no_such_module, which this Blender lacks; stop\.$'):
        import_blender_module("no_such_module", '"a.png"', "stop")


def test_a_larger_file_may_need_more_memory(tmp_path, monkeypatch):
    path = write_image(tmp_path / "a.png", BYTES[:, :, :3])
    work_bytes = 256 * 256 * (3 * (8 + 3) + 16)
    monkeypatch.setattr(image_files, "MAX_WORK_BYTES", work_bytes - 1)
    monkeypatch.setattr(image_files, "WORK_BYTES_PER_FILE_BYTE", work_bytes // path.stat().st_size)
    with pytest.raises(FileError, match="working on it takes"):
        read_image_file(path)
    monkeypatch.setattr(image_files, "WORK_BYTES_PER_FILE_BYTE", work_bytes // path.stat().st_size + 1)
    read_image_file(path)


def test_the_size_limit_is_checked_before_anything_is_allocated(tmp_path, monkeypatch):
    write_image(tmp_path / "a.png", BYTES[:, :, :3])
    monkeypatch.setattr(image_files, "MAX_BYTES", 256 * 256 * 3 * 4)
    read_image_file(tmp_path / "a.png")
    monkeypatch.setattr(image_files, "MAX_BYTES", 256 * 256 * 3 * 4 - 1)
    with pytest.raises(FileError, match="256 x 256 pixels with 3 channels"):
        read_image_file(tmp_path / "a.png")
