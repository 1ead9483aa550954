"""`.btf` files contain the decoded textures, as read by an independent reader and by a third-party tool."""

import io
import json
import subprocess

import numpy as np
import pytest

import reference_tools
from farfield.addon.core.btf.formats import fmf
from farfield.addon.core.errors import FileError, SettingsError
from farfield.addon.core.geometry.directions import bonn_directions, fibonacci_sphere, from_spherical, to_spherical
from farfield.addon.core.jobs.progress import run_to_end
from fmf_reader import read_fmf
from random_textures import random_texture

pytestmark = pytest.mark.core
EXTERNAL_READER = """
import json, sys
import numpy as np
from btf_extractor import Ubo2014
file = Ubo2014(sys.argv[1])
images = [file.angles_to_image(*angles) for angles in json.loads(sys.argv[3])]
np.savez(sys.argv[2], shape=file.img_shape, angles=sorted(file.angles_set), images=images)
"""


def write(path, texture, views, lights, pixels_per_millimeter=2.0):
    with path.open("wb") as stream:
        run_to_end(fmf.write_fmf(stream, texture, views, lights, pixels_per_millimeter))
    return path


def decode(texture, view, light) -> np.ndarray:
    """Decode the texture (H, W, 3) from a view under a light, including negative values."""
    basis = texture.interpolate_basis(view[None], light[None])[0, :, 0]
    return texture.unclamped_radiance(basis, view, light).reshape(texture.size[1], texture.size[0], 3)


@pytest.mark.parametrize("clusters", [1, 3])
def test_all_values_round_trip(tmp_path, clusters):
    texture = random_texture(clusters=clusters)
    views, lights = fibonacci_sphere(6), np.abs(fibonacci_sphere(6))
    file = read_fmf(write(tmp_path / "ü.btf", texture, views, lights))
    assert (file.size, list(file.channels)) == ((7, 4), ["R", "G", "B"])
    np.testing.assert_allclose(from_spherical(file.views.astype(float)), views, atol=1e-6)
    np.testing.assert_allclose(from_spherical(file.lights.astype(float)), lights, atol=1e-6)
    for view, light in ((0, 0), (5, 1), (2, 4)):
        np.testing.assert_allclose(file.decode_image(view, light), decode(texture, views[view], lights[light]), atol=2e-5)
    assert (file.header["version"], file.header["cosine"], file.header["per_millimeter"]) == (4, 0, 2.0)


def test_lobes_are_approximated_as_well_as_the_components_allow(tmp_path):
    small, large = random_texture(lobes=True), random_texture(size=(30, 12), lobes=True)
    views, lights = fibonacci_sphere(14), np.abs(fibonacci_sphere(14))
    exact, approximate = (read_fmf(write(tmp_path / f"{texture.size[0]}.btf", texture, views, lights)) for texture in (small, large))
    np.testing.assert_allclose(exact.decode_image(5, 3), decode(small, views[5], lights[3]), atol=1e-3)
    assert approximate.channels["G"][0].shape == (196, 57)
    expected = np.array([[decode(large, view, light) for light in lights] for view in views])
    images = np.array([[approximate.decode_image(view, light) for light in range(14)] for view in range(14)])
    green = expected[..., 1].reshape(196, -1)
    best = np.sqrt((np.linalg.svd(green, compute_uv=False)[57:] ** 2).sum())
    assert np.linalg.norm(images[..., 1].reshape(196, -1) - green) < 1.1 * best


def test_the_matrices_are_singular_value_decompositions(tmp_path):
    file = read_fmf(write(tmp_path / "a.btf", random_texture(), fibonacci_sphere(6), np.abs(fibonacci_sphere(6))))
    for u, singular_values, sv in file.channels.values():
        assert u.shape[1] == 5
        np.testing.assert_allclose(u.T @ u, np.eye(5), atol=1e-5)
        assert (np.diff(singular_values) <= 0.0).all()
        np.testing.assert_allclose(sv.T @ sv, np.diag(singular_values**2), atol=1e-4 * singular_values[0] ** 2)


def test_writing_in_chunks_gives_the_same_values(tmp_path, monkeypatch):
    texture, views = random_texture(), fibonacci_sphere(4)
    content = write(tmp_path / "whole.btf", texture, views, views).read_bytes()
    monkeypatch.setattr(fmf, "MAX_CHUNK_VALUES", 5 * 16 * 3)
    path = write(tmp_path / "chunks.btf", texture, views, views)
    np.testing.assert_allclose(read_fmf(path).decode_image(1, 2), decode(texture, views[1], views[2]), atol=2e-5)
    assert len(path.read_bytes()) == len(content)


def test_unequal_numbers_of_views_and_lights_are_rejected():
    with pytest.raises(SettingsError, match="equal numbers of view and light directions, not 5 and 4"):
        run_to_end(fmf.write_fmf(io.BytesIO(), random_texture(), fibonacci_sphere(5), fibonacci_sphere(4), 1.0))


def test_files_beyond_the_size_limit_are_rejected(monkeypatch):
    monkeypatch.setattr(fmf, "MAX_PART_BYTES", 1000)
    with pytest.raises(FileError, match="7 x 4 pixels with 5 components"):
        run_to_end(fmf.write_fmf(io.BytesIO(), random_texture(), fibonacci_sphere(5), fibonacci_sphere(5), 1.0))


@pytest.mark.slow
@pytest.mark.skipif(
    reference_tools.find_python() is None,
    reason="btf-extractor is not installed; run python3 scripts/reference_tools.py",
)
@pytest.mark.parametrize("clusters", [pytest.param(1, marks=pytest.mark.exhaustive), 3])
def test_btf_extractor_reads_the_same_values(tmp_path, clusters):
    texture, directions = random_texture(size=(9, 6), clusters=clusters), bonn_directions()
    path = write(tmp_path / "cloud.btf", texture, directions, directions)
    degrees = np.degrees(to_spherical(directions)).round(1)
    pairs = [(0, 0), (7, 3), (80, 41), (3, 77)]  # light, view
    angles = json.dumps([[*degrees[light], *degrees[view]] for light, view in pairs])
    command = [str(reference_tools.find_python()), "-c", EXTERNAL_READER, str(path), str(tmp_path / "read.npz"), angles]
    process = subprocess.run(command, capture_output=True, text=True, check=False)
    assert process.returncode == 0, process.stderr
    with np.load(tmp_path / "read.npz", allow_pickle=False) as arrays:
        assert arrays["shape"].tolist() == [9, 6, 3]
        expected_angles = sorted([*light, *view] for light in degrees for view in degrees)
        np.testing.assert_allclose(arrays["angles"], expected_angles, atol=1e-3)
        for (light, view), image in zip(pairs, arrays["images"], strict=True):
            expected = decode(texture, directions[view], directions[light])
            np.testing.assert_allclose(image[::-1, :, ::-1], expected, atol=3e-5)  # theirs: row 0 at the top, BGR
