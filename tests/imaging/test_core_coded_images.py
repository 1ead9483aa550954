"""Images as bytes come back as they were, and nothing in the bytes leads further than to one sentence."""

import io
import struct
import zlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from farfield.addon.core.errors import ImageError
from farfield.addon.core.imaging.coded_images import (
    FORMATS,
    RAW_HEADER,
    RAW_MAGIC,
    check_coded,
    decode,
    encode,
    encode_gray,
    read_coded_image,
)

SMOOTH = np.stack([np.add.outer(np.arange(96), np.arange(64)), np.full((96, 64), 90), np.tile(np.arange(64) * 2, (96, 1))], 2).astype(
    np.uint8
)
NOISE = np.random.default_rng(3).integers(0, 256, (24, 40, 4), np.uint8)


def file_of(image: Image.Image, file_format: str, exif: Image.Exif | None = None) -> bytes:
    file = io.BytesIO()
    image.save(file, file_format, **({"exif": exif} if exif else {}))
    return file.getvalue()


def png_of_size(width: int, height: int) -> bytes:
    """A PNG file that declares a size and holds almost nothing."""
    chunks = [(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)), (b"IDAT", zlib.compress(bytes(100))), (b"IEND", b"")]
    parts = [struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in chunks]
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


@pytest.mark.parametrize("channels", [3, 4])
@pytest.mark.parametrize("image_format", ["png", "raw"])
def test_lossless_formats_return_every_pixel(image_format, channels):
    image = NOISE[..., :channels]
    assert np.array_equal(decode(encode(image, image_format)), image)


@pytest.mark.parametrize("image_format", ["jpeg", "webp"])
def test_lossy_formats_are_close_where_an_image_is_smooth(image_format):
    result = decode(encode(SMOOTH, image_format, 90))
    assert result.shape == SMOOTH.shape and result.dtype == np.uint8
    assert np.abs(result.astype(int) - SMOOTH).mean() < 2.0


def test_alpha_of_webp_is_lossless():
    assert np.array_equal(decode(encode(NOISE, "webp", 50))[..., 3], NOISE[..., 3])


@pytest.mark.parametrize("image_format", ["jpeg", "webp", "png"])
def test_row_0_is_the_bottom_of_the_file(image_format):
    image = np.zeros((32, 32, 3), np.uint8)
    image[:8] = 255
    with Image.open(io.BytesIO(encode(image, image_format))) as picture:
        assert picture.getpixel((5, 31)) == (255, 255, 255) and picture.getpixel((5, 0)) == (0, 0, 0)


@pytest.mark.parametrize("image_format", ["jpeg", "webp"])
def test_lower_quality_needs_fewer_bytes(image_format):
    sizes = [len(encode(NOISE[..., :3], image_format, quality)) for quality in (20, 60, 95)]
    assert sizes == sorted(sizes) and sizes[0] < sizes[2]


@pytest.mark.parametrize("image_format", FORMATS)
def test_equal_images_give_equal_bytes(image_format):
    assert encode(SMOOTH, image_format) == encode(SMOOTH.copy(), image_format)


def test_jpeg_images_with_common_blocks_have_common_pixels():
    wide = np.random.default_rng(1).integers(0, 256, (32, 56, 3), np.uint8)
    left, right = decode(encode(wide[:, :32], "jpeg", 60)), decode(encode(wide[:, 24:], "jpeg", 60))
    assert np.array_equal(left[:, 24:], right[:, :8])


@pytest.mark.parametrize("quality", [85, 100])
def test_noise_can_be_coded(quality):
    noise = np.random.default_rng(0).integers(0, 256, (512, 512, 3)).astype(np.uint8)
    assert decode(encode(noise, "jpeg", quality)).shape == noise.shape


def test_images_have_no_metadata():
    with Image.open(io.BytesIO(encode(SMOOTH, "jpeg"))) as picture:
        assert not picture.getexif() and "icc_profile" not in picture.info


def test_the_orientation_of_a_camera_is_not_applied():
    exif = Image.Exif()
    exif[0x0112] = 6  # rotated by 90 degrees
    assert decode(file_of(Image.new("RGB", (30, 20)), "JPEG", exif)).shape == (20, 30, 3)


def test_gray_images_and_palettes_become_rgb():
    gray = np.arange(64, dtype=np.uint8).reshape(8, 8)
    assert np.array_equal(decode(encode_gray(gray)), np.dstack([gray] * 3))
    palette = Image.fromarray(np.zeros((4, 4), np.uint8)).convert("P")
    assert decode(file_of(palette, "PNG")).shape == (4, 4, 3)
    palette.info["transparency"] = 0
    assert decode(file_of(palette, "PNG"))[..., 3].max() == 0


def test_jpeg_refuses_alpha():
    with pytest.raises(ImageError, match="no alpha"):
        encode(NOISE, "jpeg")


@pytest.mark.parametrize("size", [(60000, 60000), (2**31 - 1, 2**31 - 1)])
def test_declared_sizes_are_checked_before_pixels_are_allocated(size):
    with pytest.raises(ImageError, match="more than"):
        decode(png_of_size(*size))
    with pytest.raises(ImageError, match="more than"):
        decode(png_of_size(600, 600), max_pixels=512 * 512)
    with pytest.raises(ImageError, match="damaged"):
        decode(png_of_size(20000, 20000))
    with pytest.raises(ImageError, match="damaged"):
        decode(RAW_HEADER.pack(RAW_MAGIC, 20000, 20000, 3) + bytes(12))
    with pytest.raises(ImageError, match="more than"):
        decode(RAW_HEADER.pack(RAW_MAGIC, 60000, 60000, 3) + bytes(12))


def test_a_webp_image_of_an_impossible_size_is_damaged():
    content = bytearray(encode(np.dstack([SMOOTH[..., :3], np.tile(np.arange(SMOOTH.shape[1], dtype=np.uint8), (len(SMOOTH), 1))]), "webp"))
    place = content.index(b"VP8X") + 12
    content[place : place + 6] = b"\xff" * 6  # 2**24 pixels along each side
    for read in (decode, check_coded):
        with pytest.raises(ImageError, match="damaged"):
            read(bytes(content))


@pytest.mark.parametrize(
    "data",
    [
        file_of(Image.new("CMYK", (8, 8)), "JPEG"),
        file_of(Image.fromarray(np.zeros((8, 8), np.uint16)), "PNG"),
        file_of(Image.new("RGB", (8, 8)), "GIF"),
        b"",
        b"RIFF1234WAVEfmt ",
    ],
    ids=["CMYK", "16 bits", "GIF", "nothing", "sound"],
)
def test_other_images_are_refused(data):
    with pytest.raises(ImageError):
        decode(data)


@pytest.mark.parametrize("image_format", FORMATS)
@given(data=st.data())
def test_damaged_images_give_pixels_or_one_sentence(image_format, data):
    content = bytearray(encode(SMOOTH[:16, :16], image_format))
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    content = bytes(content[: data.draw(st.integers(0, len(content)))])
    try:
        assert decode(content, 4096).shape[2] in (3, 4)
    except ImageError as error:
        assert str(error).count(". ") == 0


def test_an_error_names_the_file(tmp_path):
    (tmp_path / "aerial.png").write_bytes(encode(SMOOTH, "png")[:200])
    with pytest.raises(ImageError, match=r"aerial\.png"):
        read_coded_image(tmp_path / "aerial.png")
