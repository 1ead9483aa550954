"""Orientations of photographs: those of Pillow, which shows stored images upright."""

import io

import numpy as np
import pytest

from farfield.addon.core.imaging.orientation import ORIENTATIONS, from_upright, to_upright

Image = pytest.importorskip("PIL.Image")
ImageOps = pytest.importorskip("PIL.ImageOps")
TAG = 274


@pytest.mark.parametrize("orientation", ORIENTATIONS)
def test_the_upright_image_becomes_the_stored_one(orientation):
    stored = np.arange(5 * 7 * 3, dtype=np.uint8).reshape(5, 7, 3)
    image, file = Image.fromarray(stored), io.BytesIO()
    tags = image.getexif()
    tags[TAG] = orientation
    image.save(file, "PNG", exif=tags)
    upright = np.asarray(ImageOps.exif_transpose(Image.open(file)))
    assert np.array_equal(from_upright(upright[::-1], orientation)[::-1], stored)
    assert np.array_equal(to_upright(stored[::-1], orientation)[::-1], upright)
