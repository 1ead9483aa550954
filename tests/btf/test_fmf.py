"""A `.btf` file says what the textures show: read by a reader of its own, and by the one that others use."""

import io
import json
import subprocess

import numpy as np
import pytest

import peers
from farfield.addon.core.btf import fmf
from farfield.addon.core.directions import bonn_directions, fibonacci_sphere, from_spherical, to_spherical
from farfield.addon.core.errors import FileError, SettingsError
from farfield.addon.core.progress import finish
from fmf_reader import read_fmf
from made_atlases import made_atlas

FOREIGN_READER = """
import json, sys
import numpy as np
from btf_extractor import Ubo2014
file = Ubo2014(sys.argv[1])
wanted = json.loads(sys.argv[3])
np.savez(sys.argv[2], shape=file.img_shape, angles=sorted(file.angles_set), images=[file.angles_to_image(*angles) for angles in wanted])
"""


def written(path, atlas, views, lights, per_millimetre=2.0):
    with path.open("wb") as stream:
        finish(fmf.write_fmf(stream, atlas, views, lights, per_millimetre))
    return path


def uncut(atlas, view, light) -> np.ndarray:
    """The texture (H, W, 3) from a view under a light, negative numbers left in."""
    basis = atlas.seen_from(view[None], light[None])[0, :, 0]
    return atlas.uncut(basis, view, light).reshape(atlas.size[1], atlas.size[0], 3)


@pytest.mark.parametrize("clusters", [1, 3])
def test_every_value_is_in_the_file(tmp_path, clusters):
    atlas = made_atlas(clusters=clusters)
    views, lights = fibonacci_sphere(6), np.abs(fibonacci_sphere(6))
    file = read_fmf(written(tmp_path / "ü.btf", atlas, views, lights))
    assert (file.size, list(file.channels)) == ((7, 4), ["R", "G", "B"])
    np.testing.assert_allclose(from_spherical(file.views.astype(float)), views, atol=1e-6)
    np.testing.assert_allclose(from_spherical(file.lights.astype(float)), lights, atol=1e-6)
    for view, light in ((0, 0), (5, 1), (2, 4)):
        np.testing.assert_allclose(file.image(view, light), uncut(atlas, views[view], lights[light]), atol=2e-5)
    assert (file.header["version"], file.header["cosine"], file.header["per_millimetre"]) == (4, 0, 2.0)


def test_lobes_are_in_the_file(tmp_path):
    few, many = made_atlas(lobes=True), made_atlas(size=(30, 12), lobes=True)
    views, lights = fibonacci_sphere(14), np.abs(fibonacci_sphere(14))
    exact, near = (read_fmf(written(tmp_path / f"{number}.btf", atlas, views, lights)) for number, atlas in enumerate((few, many)))
    np.testing.assert_allclose(exact.image(5, 3), uncut(few, views[5], lights[3]), atol=1e-3)
    assert near.channels["G"][0].shape == (196, 57)
    meant = np.array([[uncut(many, view, light) for light in lights] for view in views])
    read = np.array([[near.image(view, light) for light in range(14)] for view in range(14)])
    green = meant[..., 1].reshape(196, -1)
    best = np.sqrt((np.linalg.svd(green, compute_uv=False)[57:] ** 2).sum())
    assert np.linalg.norm(read[..., 1].reshape(196, -1) - green) < 1.1 * best, "as near as so many components can come"


def test_it_is_a_singular_value_decomposition(tmp_path):
    atlas = made_atlas()
    file = read_fmf(written(tmp_path / "a.btf", atlas, fibonacci_sphere(6), np.abs(fibonacci_sphere(6))))
    for left, strengths, right in file.channels.values():
        assert left.shape[1] == 5
        np.testing.assert_allclose(left.T @ left, np.eye(5), atol=1e-5)
        assert (np.diff(strengths) <= 0.0).all()
        np.testing.assert_allclose(right.T @ right, np.diag(strengths**2), atol=1e-4 * strengths[0] ** 2)


def test_pieces_are_the_whole(tmp_path, monkeypatch):
    atlas, views = made_atlas(), fibonacci_sphere(4)
    whole = written(tmp_path / "whole.btf", atlas, views, views).read_bytes()
    monkeypatch.setattr(fmf, "PIECE", 5 * 16 * 3)
    pieces = written(tmp_path / "pieces.btf", atlas, views, views)
    np.testing.assert_allclose(read_fmf(pieces).image(1, 2), uncut(atlas, views[1], views[2]), atol=2e-5)
    assert len(pieces.read_bytes()) == len(whole)


def test_other_numbers_of_views_and_lights_are_refused():
    with pytest.raises(SettingsError, match="as many lights as views, not 5 and 4"):
        finish(fmf.write_fmf(io.BytesIO(), made_atlas(), fibonacci_sphere(5), fibonacci_sphere(4), 1.0))


def test_what_the_layout_cannot_count_is_refused(monkeypatch):
    monkeypatch.setattr(fmf, "LARGEST", 1000)
    with pytest.raises(FileError, match="7 x 4 pixels with 5 components"):
        finish(fmf.write_fmf(io.BytesIO(), made_atlas(), fibonacci_sphere(5), fibonacci_sphere(5), 1.0))


@pytest.mark.skipif(peers.python() is None, reason="btf-extractor is not there to read our .btf files: run python3 scripts/peers.py")
@pytest.mark.parametrize("clusters", [1, 3])
def test_btf_extractor_reads_the_same_values(tmp_path, clusters):
    atlas, directions = made_atlas(size=(9, 6), clusters=clusters), bonn_directions()
    path = written(tmp_path / "cloud.btf", atlas, directions, directions)
    degrees = np.degrees(to_spherical(directions)).round(1)
    chosen = [(0, 0), (7, 3), (80, 41), (3, 77)]  # light, view
    wanted = json.dumps([[*degrees[light], *degrees[view]] for light, view in chosen])
    command = [str(peers.python()), "-c", FOREIGN_READER, str(path), str(tmp_path / "read.npz"), wanted]
    outcome = subprocess.run(command, capture_output=True, text=True, check=False)
    assert outcome.returncode == 0, outcome.stderr
    with np.load(tmp_path / "read.npz", allow_pickle=False) as read:
        assert read["shape"].tolist() == [9, 6, 3]
        np.testing.assert_allclose(read["angles"], sorted([*light, *view] for light in degrees for view in degrees), atol=1e-3)
        for (light, view), image in zip(chosen, read["images"], strict=True):
            ours = uncut(atlas, directions[view], directions[light])
            np.testing.assert_allclose(image[::-1, :, ::-1], ours, atol=3e-5)  # theirs: row 0 on top, blue first
