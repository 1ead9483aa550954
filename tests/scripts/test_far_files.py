"""Mesh files with coordinates of maps keep their digits in every script that reads meshes, which says by how much they were moved."""

import bpy
import numpy as np
import pytest

import billboards
import texmesh
import unwrap
from farfield.addon.bridge.geometry.mesh_arrays import read_positions
from lib import command_line
from shapes import sphere

pytestmark = pytest.mark.usefixtures("empty_scene")
UTM = np.array([500_000.0, 120.0, 4_500_000.0])  # y upwards, as Blender expects of .obj files


@pytest.mark.slow
@pytest.mark.parametrize(
    ("script", "flags"),
    [
        (texmesh, ("levels", "--ratios", "0.5", "--vertices", "original", "--views", "1", "--max-image", "32")),
        (unwrap, ()),
        (billboards, ("--levels", "1", "--no-textures")),
    ],
)
def test_far_files_are_moved_to_the_origin(tmp_path, script, flags):
    mesh = sphere(8)
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in (15.0 * mesh.vertices + UTM).tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (mesh.triangles + 1).tolist()]
    path = tmp_path / "hill.obj"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    command, *rest = flags if script is texmesh else ("", *flags)
    arguments = [*filter(None, [command]), str(path), "--out", str(tmp_path / "out.blend"), *rest]
    summary = script.main(arguments, command_line.ProgressLine())
    assert "The vertices were moved by (-500,000; -100; -4,500,000)" in summary
    assert "rounded" not in summary
    found = read_positions(next(item for item in bpy.context.scene.objects if item.name == "hill").data).astype(np.float64)
    radii = np.linalg.norm(found - [0.0, 20.0, 0.0], axis=1)
    assert np.allclose(radii, 15.0, atol=1e-4)
