"""Refinement of cameras and alignment of photographs: what was moved comes back, and what fits stays."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from farfield.addon.core.errors import ImageError
from farfield.addon.core.files.scratch import Scratch
from farfield.addon.core.geometry.lenses import Lens
from farfield.addon.core.geometry.mesh import TriangleMesh
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.photos.merging import merge
from farfield.addon.core.photos.photographs.surface import Surface
from farfield.addon.core.photos.photographs.views import View
from farfield.addon.core.photos.registration.matching import Matches, make_gray, match_photograph
from farfield.addon.core.photos.registration.refinement import MIN_MATCHES, fit_camera, refine
from farfield.addon.core.photos.settings import PhotosSettings
from photo_scenes import SIZE, detailed_texture, distance_in_pixels, grid, photograph, ring

pytestmark = pytest.mark.usefixtures("quick_merges")


def wavy():
    return grid(20, lambda x, y: 0.15 * np.sin(2 * x) * np.cos(3 * y))


def shoot(count=4, gains=None, texture=None):
    """A wavy square and photographs of it."""
    mesh, uvs = wavy()
    texture = detailed_texture() if texture is None else texture
    gains = np.ones(count) if gains is None else gains
    return mesh, uvs, [photograph(mesh, uvs, texture, camera, gain) for camera, gain in zip(ring(count), gains, strict=True)]


def turn(each, degrees, shift=(0.0, 0.0, 0.0)):
    """A photograph whose camera is turned around its place, and moved in its own axes."""
    camera = each.camera
    rotation = Rotation.from_rotvec(np.deg2rad(degrees)).as_matrix()
    return replace(each, camera=replace(camera, rotation=rotation @ camera.rotation, translation=rotation @ camera.translation + shift))


def run_refine(mesh, photographs, chosen, is_free=False):
    with Scratch() as scratch:
        return run_to_end(refine(mesh, photographs, chosen, scratch, has_free_lens=[is_free] * len(chosen)))


class TestMatching:
    """Displacements between a photograph and the others."""

    @pytest.mark.slow
    @pytest.mark.parametrize("x, y", [(0.0, 0.0), (1.4, -0.6), (-9.0, 6.5)])
    def test_a_photograph_that_was_shifted(self, x, y):
        mesh, _, photographs = shoot(gains=[1.0, 0.8, 1.2, 1.0])
        lens = photographs[0].camera.lens
        moved = replace(lens, center=(lens.center[0] - x, lens.center[1] + y))  # so that the photograph shows all at +x, +y
        photographs[0] = replace(photographs[0], camera=replace(photographs[0].camera, lens=moved))
        grays = [make_gray(each, View(each.camera, mesh), np.ones(3)) for each in photographs]
        found = match_photograph(grays[0], grays[1:], Surface(mesh, np.zeros(3), np.ones(len(mesh.triangles))))
        assert len(found.points) > 15 and np.linalg.norm(found.displacements - (x, y), axis=1).mean() < 0.2
        assert np.allclose(photographs[0].camera.project(found.points)[0], found.positions, atol=0.02)
        assert found.fractions.mean() == pytest.approx(0.75, abs=0.1), "three of four photographs are others"

    def test_a_surface_behind_the_camera_has_no_matches(self):
        mesh, _, photographs = shoot()
        behind = turn(photographs[0], (0.0, 180.0, 0.0))
        grays = [make_gray(each, View(each.camera, mesh), np.ones(3)) for each in (behind, *photographs[1:])]
        assert not len(match_photograph(grays[0], grays[1:], Surface(mesh, np.zeros(3), np.ones(len(mesh.triangles)))).points)


class TestRefine:
    """Cameras."""

    @pytest.mark.slow
    @pytest.mark.parametrize(
        "degrees, shift",
        [pytest.param((0.3, -0.2, 0.4), (0.0, 0.0, 0.0), marks=pytest.mark.exhaustive), ((1.2, -0.9, 1.0), (0.02, 0.03, -0.05))],
    )
    def test_a_camera_that_was_moved_comes_back(self, degrees, shift):
        mesh, _, photographs = shoot(3)
        truth = photographs[1].camera
        photographs[1] = turn(photographs[1], degrees, shift)
        before = distance_in_pixels(mesh, photographs[1].camera, truth)
        [found] = run_refine(mesh, photographs, [1])
        assert not found.problem and found.matches >= MIN_MATCHES
        assert found.before == pytest.approx(before, rel=0.2) and found.after < 0.1
        assert distance_in_pixels(mesh, found.camera, truth) < 0.1 and found.camera.lens == truth.lens

    @pytest.mark.slow
    def test_focal_length_and_distortion(self):
        mesh, _, photographs = shoot(3)
        truth = photographs[2].camera
        lens = Lens("SIMPLE_RADIAL", truth.lens.size, (308.0, 308.0), truth.lens.center, (0.05,))
        photographs[2] = replace(photographs[2], camera=replace(truth, lens=lens))
        [found] = run_refine(mesh, photographs, [2], is_free=True)
        assert distance_in_pixels(mesh, found.camera, truth) < 0.15 < 1.0 < distance_in_pixels(mesh, photographs[2].camera, truth)

    @pytest.mark.slow
    def test_all_cameras_agree_afterwards_far_from_the_origin(self):
        mesh, _, photographs = shoot(3)
        truth = [each.camera for each in photographs]
        random = np.random.default_rng(4)
        photographs = [turn(each, random.normal(size=3) * 0.3) for each in photographs]
        place = np.array([2e4, -1e4, 500.0])
        far = TriangleMesh(mesh.vertices + place, mesh.triangles)
        moved = [
            replace(each, camera=replace(each.camera, translation=each.camera.translation - each.camera.rotation @ place))
            for each in photographs
        ]
        found = run_refine(far, moved, range(3))
        assert not any(each.problem for each in found)
        assert max(each.after for each in found) < 0.35 < 0.5 < min(each.before for each in found)
        errors = [distance_in_pixels(mesh, each.camera, camera) for each, camera in zip(photographs, truth, strict=True)]
        back = [replace(each.camera, translation=each.camera.translation + each.camera.rotation @ place) for each in found]
        assert np.mean([distance_in_pixels(mesh, camera, right) for camera, right in zip(back, truth, strict=True)]) < 0.7 * np.mean(errors)

    @pytest.mark.exhaustive
    def test_cameras_that_fit_are_left_as_they_are(self):
        mesh, _, photographs = shoot()
        [found] = run_refine(mesh, photographs, [0])
        assert found.camera.rotation == pytest.approx(photographs[0].camera.rotation, abs=1e-3)
        assert distance_in_pixels(mesh, found.camera, photographs[0].camera) < 0.1

    @pytest.mark.slow
    def test_uniform_paint_is_refused(self):
        mesh, _, photographs = shoot(2, texture=np.full((8, 8, 3), 0.5, np.float32))
        [found] = run_refine(mesh, photographs, [0])
        assert '"0.png" has 0 parts of the 12 that are needed' in found.problem and found.camera.name == "0.png"
        assert np.allclose(found.camera.translation, photographs[0].camera.translation)

    def test_a_photograph_of_something_else_is_refused(self):
        mesh, uvs, photographs = shoot(3)
        photographs[2] = photograph(mesh, uvs, detailed_texture(9), photographs[2].camera)
        [found] = run_refine(mesh, photographs, [2])
        assert found.problem and distance_in_pixels(mesh, found.camera, photographs[2].camera) < 1e-6

    def test_one_photograph_is_refused(self):
        mesh, _, photographs = shoot()
        with pytest.raises(ImageError, match="only one photograph"):
            run_refine(mesh, photographs[:1], [0])

    def test_wrong_matches_do_not_matter(self):
        mesh, _, photographs = shoot()
        camera, wrong = photographs[0].camera, turn(photographs[0], (0.5, 0.5, 0.0)).camera
        points = mesh.vertices[::7]
        targets = camera.project(points)[0]
        random = np.random.default_rng(2)
        targets[::4] += random.uniform(-15.0, 15.0, targets[::4].shape)
        positions = wrong.project(points)[0]
        ones = np.ones(len(points))
        found = fit_camera(wrong, Matches(points, positions, targets - positions, ones, ones), has_free_lens=False)
        assert distance_in_pixels(mesh, found, camera) < 0.05


class TestAlignment:
    """Merges with photographs that are warped to fit to each other."""

    def score(self, photographs, mesh, uvs, texture, *, alignment):
        result = run_to_end(merge(mesh, uvs, photographs, PhotosSettings(size=2 * SIZE, alignment=alignment, sharpen=False)))
        return float(np.sqrt(np.mean((result.colors - texture)[result.source >= 0] ** 2)))

    @pytest.mark.exhaustive
    def test_perfect_photographs_give_the_same_texture(self):
        mesh, uvs, photographs = shoot(3)
        texture = detailed_texture()
        without, aligned = (self.score(photographs, mesh, uvs, texture, alignment=on) for on in (False, True))
        assert aligned < 1.05 * without + 1e-3

    @pytest.mark.slow
    def test_details_are_sharper_if_cameras_are_wrong(self):
        mesh, uvs, photographs = shoot(6)
        texture, random = detailed_texture(), np.random.default_rng(1)
        photographs = [turn(each, random.normal(size=3) * 0.35) for each in photographs]
        without, aligned = (self.score(photographs, mesh, uvs, texture, alignment=on) for on in (False, True))
        assert aligned < 0.85 * without

    @pytest.mark.slow
    def test_a_single_photograph_stays(self):
        mesh, uvs, photographs = shoot()
        results = [run_to_end(merge(mesh, uvs, photographs[:1], PhotosSettings(size=SIZE, alignment=on))).colors for on in (False, True)]
        assert np.array_equal(*results)
