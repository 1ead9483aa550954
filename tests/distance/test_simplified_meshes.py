"""Decimated meshes: shading normals of the original, and seams of its texture."""

import bpy
import numpy as np
import pytest

from farfield.addon.bridge.distance.simplified_meshes import decimate
from farfield.addon.bridge.geometry.meshes import read_mesh
from farfield.addon.core.distance.deviation import transfer_normals
from farfield.addon.core.geometry.mesh import TriangleMesh, face_areas_and_normals
from farfield.addon.core.geometry.transforms import normalize
from shapes import box, cylinder, sphere


def flat(mesh: TriangleMesh) -> tuple[np.ndarray, np.ndarray]:
    """The corners and the normals (T, 3, 3) of a mesh with flat shading."""
    corners = mesh.vertices[mesh.triangles]
    return corners, np.repeat(face_areas_and_normals(corners)[1][:, None], 3, axis=1)


class TestNormals:
    def test_a_round_surface_of_small_flat_faces_stays_round(self):
        coarse, own = flat(sphere(8))
        found = transfer_normals(*flat(sphere(60)), coarse, own)
        radial = normalize(coarse)
        errors = [np.degrees(np.arccos(np.clip((normals * radial).sum(axis=2), -1.0, 1.0))) for normals in (found, own)]
        assert errors[0].max() < 4.0 and np.median(errors[1]) > 10.0

    def test_flat_faces_stay_flat_up_to_their_edges(self):
        for fine, coarse in ((box(cuts=9), box(cuts=1)), (cylinder(sides=48, cuts=9), cylinder(sides=48, cuts=1))):
            corners, own = flat(coarse)
            np.testing.assert_allclose(transfer_normals(*flat(fine), corners, own), own, atol=1e-6)

    def test_faces_keep_their_normals_where_the_original_faces_elsewhere(self):
        corners, normals = flat(sphere(20))
        coarse, own = flat(sphere(8))
        np.testing.assert_allclose(transfer_normals(corners, -normals, coarse, own), own, atol=1e-6)


@pytest.mark.usefixtures("extension", "empty_scene")
class TestSeams:
    def decimated(self, uv_map: str | None) -> tuple[np.ndarray, list]:
        """The vertices of a sphere at the seam of its UV map, and its decimated meshes that keep it."""
        bpy.ops.mesh.primitive_uv_sphere_add(segments=32, ring_count=24)
        item = bpy.context.object
        seam = np.array([vertex.co for vertex in item.data.vertices])
        seam = seam[(np.abs(seam[:, 1]) < 1e-5) & (seam[:, 0] < -1e-3)]
        if uv_map is None:
            item.data.uv_layers.remove(item.data.uv_layers[0])
            item.data.uv_layers.new(name="One Corner").uv.foreach_set("vector", np.zeros(2 * len(item.data.loops)))
        depsgraph = bpy.context.evaluated_depsgraph_get()
        scene = bpy.data.scenes.new("Temporary")
        return seam, decimate(read_mesh(item.evaluated_get(depsgraph), depsgraph), scene, 2.0, keeps_seams=True)

    def test_vertices_at_seams_stay(self):
        seam, levels = self.decimated("UVMap")
        coarse, _ = levels[1]
        distances = np.linalg.norm(seam[:, None] - coarse.vertices, axis=2).min(axis=1)
        assert len(seam) > 15 and len(coarse.triangles) < 400 and distances.max() < 1e-5

    def test_without_seams_there_is_nothing_to_keep(self):
        assert self.decimated(None)[1] == []
