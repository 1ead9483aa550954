"""Solids that are added to a terrain and subtracted from it."""

import bpy
import numpy as np
import pytest

from farfield.addon.bridge.clipbox.objects import SceneTerrain
from farfield.addon.bridge.geometry.mesh_arrays import read_positions
from farfield.addon.core.clipbox.engine import TerrainEngine, weld
from farfield.addon.core.clipbox.settings import ClipboxSettings
from farfield.addon.core.clipbox.terrains.edits import NO_EDITS, Capsules, Edits, Ellipsoid, MeshSolid
from farfield.addon.core.clipbox.terrains.generators import Sampler
from farfield.addon.core.clipbox.terrains.grids import Grid
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.operators.engine_cache import cache
from shapes import box, random_rotation, sphere

GRID = Grid((-40, -40, -40), (80, 80, 80), 0.5)
X, Y, Z = GRID.coordinates()
SPHERE = Ellipsoid(((8.0, 0.0, 0.0, 3.0), (0.0, 8.0, 0.0, -2.0), (0.0, 0.0, 8.0, 1.0)))
SPHERE_DISTANCE = 8.0 - np.sqrt((X - 3.0) ** 2 + (Y + 2.0) ** 2 + (Z - 1.0) ** 2)


def plane(grid: Grid) -> np.ndarray:
    return -grid.coordinates()[2]


def edited(**edits) -> np.ndarray:
    return Sampler("plane", plane, Edits(**edits)).densities(GRID)


def solid_of(mesh, scale: float = 8.0, name: str = "mesh") -> MeshSolid:
    return MeshSolid(name, scale * mesh.corners)


def densities(solid) -> np.ndarray:
    return solid.densities(*(GRID.coordinates_along(axis) for axis in range(3)))


class TestSolids:
    """Densities are distances near the surface."""

    def test_a_sphere(self):
        near = np.abs(SPHERE_DISTANCE) < 1.0
        assert np.allclose(densities(SPHERE)[near], SPHERE_DISTANCE[near], atol=0.1)

    def test_a_scaled_and_rotated_sphere_has_its_extent_and_sides(self):
        rotation = random_rotation(2)
        matrix = np.column_stack([rotation * [4.0, 8.0, 12.0], [1.0, 2.0, 3.0]])
        ellipsoid = Ellipsoid(tuple(map(tuple, matrix.tolist())))
        solid = densities(ellipsoid) > 0
        assert solid.sum() * 0.5**3 == pytest.approx(4.0 / 3.0 * np.pi * 4.0 * 8.0 * 12.0, rel=0.02)
        low, high = ellipsoid.bounds
        inside = np.argwhere(solid) * 0.5 - 19.75
        assert (inside.min(axis=0) >= low - 0.5).all() and np.allclose(inside.min(axis=0), low, atol=0.6)
        assert np.allclose(inside.max(axis=0), high, atol=0.6)

    def test_a_capsule_is_as_far_from_its_axis_as_its_radius(self):
        capsules = Capsules(((-10.0, 0.0, 0.0, 3.0), (10.0, 0.0, 0.0, 3.0), (10.0, 0.0, 8.0, 3.0)))
        found = densities(capsules)
        assert found[:20, 40, 40] == pytest.approx(3.0 - np.hypot(np.abs(X[:20, 0, 0] + 10.0), np.hypot(0.25, 0.25)), abs=0.01)
        assert found[40, :, 40] == pytest.approx(3.0 - np.hypot(Y[0, :, 0], 0.25), abs=0.01)
        assert found[60, 40, 50] > 0 > found[60, 40, 65]

    def test_a_mesh_is_its_signed_distance(self):
        found = densities(solid_of(sphere(24)))
        exact = 8.0 - np.sqrt(X**2 + Y**2 + Z**2)
        assert np.abs(found - exact)[np.abs(exact) < 0.4].max() < 0.2
        assert ((found > 0) == (exact > 0))[np.abs(exact) > 0.3].all()
        assert (np.abs(found - exact) < 0.25 * np.abs(exact) + 0.3).all(), "about right far away"

    def test_a_box_keeps_its_faces(self):
        found = densities(solid_of(box((1.0, 1.0, 2.0)), name="box"))
        inside = (np.abs(X) < 4.0) & (np.abs(Y) < 4.0) & (np.abs(Z) < 8.0)
        assert ((found > 0) != inside).mean() < 1e-3


class TestEdits:
    """Terrains with solids."""

    def test_add_and_subtract(self):
        assert np.array_equal(edited(added=(SPHERE,)) > 0, (Z + 0 * SPHERE_DISTANCE < 0) | (SPHERE_DISTANCE > 0))
        assert np.array_equal(edited(subtracted=(SPHERE,)) > 0, (Z + 0 * SPHERE_DISTANCE < 0) & (SPHERE_DISTANCE <= 0))
        assert np.array_equal(edited(added=(SPHERE,), subtracted=(SPHERE,)) > 0, (Z + 0 * SPHERE_DISTANCE < 0) & (SPHERE_DISTANCE <= 0))

    def test_blending_fills_the_edge_and_nothing_else(self):
        hard, smooth = edited(added=(SPHERE,)) > 0, edited(added=(SPHERE,), blend=4.0) > 0
        gained = smooth & ~hard
        assert gained.sum() > 200 and not (hard & ~smooth).any()
        assert (SPHERE_DISTANCE[gained] > -4.0).all() and (np.broadcast_to(Z, gained.shape)[gained] < 4.0).all()

    def test_parts_of_a_grid_equal_all_of_it_to_the_bit(self):
        edits = Edits((SPHERE, Capsules(((-9.0, 0.0, 0.0, 3.0), (9.0, 5.0, 0.0, 2.0)))), (solid_of(sphere(), 5.0),), 1.5)
        sampler = Sampler("plane", plane, edits)
        full, part = sampler.densities(GRID), sampler.densities(Grid((-3, -20, -9), (20, 17, 30), 0.5))
        assert part.tobytes() == full[37:57, 20:37, 31:61].tobytes()

    def test_boxes_coarser_than_a_solid_leave_it_out(self):
        grid = Grid((-2, -2, -2), (4, 4, 4), 32.0)
        assert np.array_equal(Sampler("plane", plane, Edits((SPHERE,))).densities(grid), Sampler("plane", plane).densities(grid))

    def test_equal_solids_are_equal_edits(self):
        assert Edits((solid_of(sphere()),)) == Edits((solid_of(sphere(), 3.0),)) != NO_EDITS, "by fingerprint"

    def test_they_stay_where_they_are_when_boxes_move(self):
        settings = ClipboxSettings(terrain="formula", formula="-z", resolution=64, boxes=3)
        engine = TerrainEngine(settings, edits=Edits((SPHERE,)))
        for viewer in ((0.0, 0.0, 5.0), (9.0, -4.0, 5.0)):
            update = run_to_end(engine.move(np.array(viewer)))
        moved = weld([*update.meshes.values(), *engine.extract_all()]).vertices
        near = np.linalg.norm(moved - [3.0, -2.0, 1.0], axis=1) < 12.0
        on_sphere = near & (moved[:, 2] > 1.0)
        assert on_sphere.sum() > 300
        assert np.abs(np.linalg.norm(moved[on_sphere] - [3.0, -2.0, 1.0], axis=1) - 8.0).max() < 0.3


@pytest.mark.usefixtures("extension", "empty_scene")
class TestObjects:
    """Objects of the scene as solids."""

    @staticmethod
    def create(**changes):
        bpy.ops.farfield.clipbox_create(**({"terrain": "formula", "formula": "-z", "boxes": 3, "resolution": 64} | changes))
        return SceneTerrain.in_scene(bpy.context.scene)[0]

    @staticmethod
    def link(data, name: str, location=(0.0, 0.0, 0.0), scale=(1.0, 1.0, 1.0)) -> bpy.types.Object:
        item = bpy.data.objects.new(name, data)
        item.location, item.scale = location, scale
        bpy.context.scene.collection.objects.link(item)
        bpy.context.view_layer.update()
        return item

    @staticmethod
    def edit(item, mode: str):
        with bpy.context.temp_override(selected_objects=[item], active_object=item):
            return bpy.ops.farfield.clipbox_edit(mode=mode)

    @staticmethod
    def update(terrain):
        bpy.context.view_layer.objects.active = terrain.root
        assert bpy.ops.farfield.clipbox_update(terrain="formula", formula="-z", boxes=3, resolution=64) == {"FINISHED"}

    @staticmethod
    def heights(terrain) -> np.ndarray:
        bpy.context.view_layer.update()
        return np.concatenate([read_positions(block.data)[:, 2] for block in terrain.blocks().values()])

    def test_a_sphere_is_added_and_left_out_again(self):
        terrain, ball = self.create(), self.link(None, "Bäll", (2.0, 3.0, 4.0), (1.0, 1.0, 2.0))
        ball.empty_display_type, ball.empty_display_size = "SPHERE", 3.0
        bpy.context.view_layer.update()
        assert self.heights(terrain).max() < 0.1
        assert self.edit(ball, "ADD") == {"FINISHED"}
        assert ball.hide_render and ball.display_type == "WIRE"
        self.update(terrain)
        assert self.heights(terrain).max() == pytest.approx(4.0 + 6.0, abs=0.5)
        assert self.edit(ball, "NONE") == {"FINISHED"} and not ball.hide_render
        self.update(terrain)
        assert self.heights(terrain).max() < 0.1

    def test_solids_follow_the_frame_of_the_terrain(self):
        terrain = self.create()
        terrain.root.location = (100.0, 0.0, 50.0)
        bpy.context.view_layer.update()
        ball = self.link(None, "Ball", (100.0, 0.0, 50.0))
        ball.empty_display_size = 6.0
        self.edit(ball, "ADD")
        bpy.context.view_layer.update()
        self.update(terrain)
        assert self.heights(terrain).max() == pytest.approx(6.0, abs=0.5)

    def test_a_mesh_is_subtracted_and_a_curve_is_a_tunnel(self):
        terrain = self.create()
        mesh = bpy.data.meshes.new("Pit")
        shape = box((8.0, 8.0, 12.0))
        mesh.from_pydata(shape.vertices.tolist(), [], shape.triangles.tolist())
        self.edit(self.link(mesh, "Pit"), "SUBTRACT")
        curve = bpy.data.curves.new("Wall", "CURVE")
        curve.dimensions, curve.bevel_depth = "3D", 2.0
        spline = curve.splines.new("POLY")
        spline.points.add(1)
        spline.points[0].co, spline.points[1].co = (-20.0, 20.0, 5.0, 1.0), (20.0, 20.0, 5.0, 1.0)
        self.edit(self.link(curve, "Wall"), "ADD")
        self.update(terrain)
        heights = self.heights(terrain)
        assert heights.min() == pytest.approx(-6.0, abs=0.7) and heights.max() == pytest.approx(7.0, abs=0.5)

    def test_following_uses_moved_solids(self):
        ball = self.link(None, "Ball")
        ball.empty_display_size = 6.0
        self.edit(ball, "ADD")
        terrain = self.create()
        assert self.heights(terrain).max() == pytest.approx(6.0, abs=0.5)
        engine = cache.get(terrain)
        assert cache.get(terrain) is engine
        ball.location.z = 4.0
        bpy.context.view_layer.update()
        assert cache.get(terrain) is not engine

    def test_parts_of_terrains_and_lights_are_refused(self):
        terrain = self.create()
        light = self.link(bpy.data.lights.new("Light", "POINT"), "Light")
        for item in (terrain.root, light):
            with pytest.raises(RuntimeError, match="Select Empties, curves or objects with faces"):
                self.edit(item, "ADD")
