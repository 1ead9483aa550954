"""Models on which UV maps show needles: hands, heads with ears and horns, upper bodies with five fingers per hand, and concave outlines.

All are disks and every seed gives another one. Bodies are chains of balls, joined by a voxel remesh and cut open by a plane.
"""

from collections.abc import Callable, Iterable

import bmesh
import bpy
import numpy as np

from farfield.addon.bridge.geometry.mesh_arrays import read_loop_triangles, read_loop_vertices, read_positions
from farfield.addon.core.geometry.mesh import TriangleMesh

Bone = tuple[tuple[float, ...], float, tuple[float, ...], float]  # Start, its radius, end, its radius.
BALL_SPACING = 0.3  # Distance of the balls of a bone, as a fraction of their radius.
SMOOTHINGS = 8  # Iterations of the modifier, after the remesh.


def hand(seed: int) -> TriangleMesh:
    """Return a hand with spread and bent fingers, open at the wrist."""
    random = np.random.default_rng(seed)
    return build_body(hand_bones(np.zeros(3), np.eye(3), random), 0.045 + 0.01 * random.uniform(), -0.45)


def head(seed: int) -> TriangleMesh:
    """Return the head of an animal with a snout, two ears and two horns, open at the neck."""
    random = np.random.default_rng(seed)
    bones = [((0, 0, -1.2), 0.55, (0, 0, 0), 0.6), ((0, 0, 0.1), 0.75, (0, 0.1, 0.3), 0.7)]
    bones.append(((0, -0.3, 0), 0.5, (0, -random.uniform(0.9, 1.4), -0.4), random.uniform(0.3, 0.4)))
    for side in (-1, 1):
        tip = np.array([side * random.uniform(1.0, 1.6), random.uniform(-0.2, 0.4), random.uniform(0.4, 1.3)])
        for offset in np.linspace(-0.15, 0.15, 4):  # An ear is a fan of thin bones.
            bones.append(((side * 0.5, 0.1 + offset, 0.5), 0.13, tuple(tip * [1, 1, 0.7] + [0, 2 * offset, 0]), 0.08))
            bones.append((tuple(tip * [1, 1, 0.7] + [0, 2 * offset, 0]), 0.08, tuple(tip), 0.05))
        joint = np.array([side * 0.25, -0.1, 0.9])
        direction, radius = np.array([side * random.uniform(0.1, 0.5), random.uniform(-0.4, 0.4), 1.0]), 0.17
        for _ in range(int(random.integers(3, 6))):
            end = joint + 0.35 * direction / np.linalg.norm(direction)
            bones.append((tuple(joint), radius, tuple(end), 0.75 * radius))
            joint, radius, direction = end, 0.75 * radius, direction + random.normal(0.0, 0.35, 3)
    return build_body(bones, 0.045, -0.9)


def upper_body(seed: int) -> TriangleMesh:
    """Return a figure with two hands of five fingers, open at the waist."""
    random = np.random.default_rng(seed)
    bones = [((0, 0, -0.4), 0.8, (0, 0, 1.2), 0.85), ((0, 0, 1.2), 0.5, (0, 0, 2.3), 0.4), ((0, -0.1, 2.7), 0.6, (0, -0.05, 3.0), 0.6)]
    for side in (-1, 1):
        shoulder, elbow = np.array([side * 0.8, 0.0, 1.5]), np.array([side * random.uniform(1.8, 2.4), 0.0, random.uniform(0.4, 1.6)])
        wrist = elbow + np.array([side * random.uniform(0.6, 1.4), random.uniform(-1.0, 0.2), random.uniform(-0.6, 0.8)])
        bones += [(tuple(shoulder), 0.42, tuple(elbow), 0.34), (tuple(elbow), 0.34, tuple(wrist), 0.25)]
        forwards = (wrist - elbow) / np.linalg.norm(wrist - elbow)
        sideways = np.cross(forwards, [0.0, 0.0, 1.0])
        frame = np.stack([sideways, np.cross(forwards, sideways), forwards], axis=1)
        bones += hand_bones(wrist + 0.45 * forwards, 0.75 * frame, random)
    return build_body(bones, 0.06, -0.3)


def outline(seed: int) -> TriangleMesh:
    """Return a hilly surface with a concave outline of four to seven lobes."""
    random = np.random.default_rng(seed)
    lobes, depth = int(random.integers(4, 8)), random.uniform(0.35, 0.6)
    radii, angles = np.linspace(0.0, 1.0, 48)[1:], np.linspace(0.0, 2.0 * np.pi, 193)[:-1]
    r, angle = np.meshgrid(radii, angles, indexing="ij")
    r = r * (1.0 + r * depth * np.cos(lobes * angle))
    x, y = r * np.cos(angle), r * np.sin(angle)
    hills = [(*random.uniform(-1.0, 1.0, 2), random.uniform(0.15, 0.4), random.uniform(-0.8, 0.8)) for _ in range(12)]
    z = sum(height * np.exp(-((x - hill_x) ** 2 + (y - hill_y) ** 2) / width**2) for hill_x, hill_y, width, height in hills)
    z_center = sum(height * np.exp(-(hill_x**2 + hill_y**2) / width**2) for hill_x, hill_y, width, height in hills)
    index = 1 + np.arange(r.size).reshape(r.shape)
    following = np.roll(index, -1, axis=1)
    inner, outer, inner_next, outer_next = (side.ravel() for side in (index[:-1], index[1:], following[:-1], following[1:]))
    fan = np.stack([0 * index[0], index[0], following[0]], axis=1)
    rings = np.concatenate([np.stack([inner, outer, outer_next], axis=1), np.stack([inner, outer_next, inner_next], axis=1)])
    vertices = np.concatenate([[[0.0, 0.0, z_center]], np.stack([x, y, z], axis=2).reshape(-1, 3)])
    return TriangleMesh(vertices, np.concatenate([fan, rings]).astype(np.int32))


BUILDERS: dict[str, tuple[Callable[[int], TriangleMesh], int]] = {
    "hand": (hand, 5),
    "head": (head, 5),
    "body": (upper_body, 5),
    "outline": (outline, 5),
}
MODELS = {f"{name}_{seed}": (build, seed) for name, (build, count) in BUILDERS.items() for seed in range(count)}


def build_model(name: str) -> TriangleMesh:
    """Return one of `MODELS`, in a new scene."""
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    build, seed = MODELS[name]
    return build(seed)


def hand_bones(wrist: np.ndarray, frame: np.ndarray, random: np.random.Generator) -> list[Bone]:
    """Return the bones of a hand at `wrist` (3,). The columns of `frame` (3, 3) point to the thumb, out of the palm and to the fingers."""
    size = float(np.linalg.norm(frame[:, 2]))

    def bone(start: np.ndarray, end: np.ndarray, radius: float, end_radius: float) -> Bone:
        return tuple(wrist + frame @ start), size * radius, tuple(wrist + frame @ end), size * end_radius

    bones = [bone(np.array([0.0, 0.0, -0.6]), np.array([0.0, 0.0, 0.0]), 0.32, 0.32)]
    for index, x in enumerate(np.linspace(-0.36, 0.36, 4)):
        knuckle, direction = np.array([x, 0.0, 0.75]), np.array([0.7 * x + random.normal(0.0, 0.08), 0.0, 1.0])
        bones.append(bone(np.array([0.5 * x, 0.0, 0.0]), knuckle, 0.24, 0.19))
        curl, length = random.uniform(-0.05, 0.7), (0.30, 0.36, 0.38, 0.34)[index]
        for radius in (0.16, 0.145, 0.13):
            end = knuckle + length * direction / np.linalg.norm(direction)
            bones.append(bone(knuckle, end, radius, radius - 0.015))
            knuckle, direction = end, direction + np.array([0.0, curl, 0.0])
    thumb = np.array([0.75, 0.1, 0.45])
    bones.append(bone(np.array([0.2, 0.0, 0.0]), thumb, 0.24, 0.18))
    bones.append(bone(thumb, thumb + np.array([0.2, random.uniform(0.0, 0.25), 0.4]), 0.17, 0.14))
    return bones


def build_body(bones: Iterable[Bone], voxel_size: float, cut_height: float) -> TriangleMesh:
    """Return the surface around `bones` above `cut_height`, open there."""
    ball = bmesh.new()
    bmesh.ops.create_icosphere(ball, subdivisions=2, radius=1.0)
    unit, sides = np.array([vertex.co for vertex in ball.verts]), np.array([[v.index for v in face.verts] for face in ball.faces])
    ball.free()
    vertices = []
    for start, radius, end, end_radius in bones:
        start, end = np.array(start, float), np.array(end, float)
        for t in np.linspace(0.0, 1.0, 2 + int(np.linalg.norm(end - start) / (BALL_SPACING * min(radius, end_radius)))):
            vertices.append((radius + t * (end_radius - radius)) * unit + start + t * (end - start))
    faces = (sides + len(unit) * np.arange(len(vertices))[:, None, None]).reshape(-1, 3)
    mesh = bpy.data.meshes.new("Body")
    mesh.from_pydata(np.concatenate(vertices), [], faces.tolist())
    item = bpy.data.objects.new("Body", mesh)
    bpy.context.scene.collection.objects.link(item)
    remesh, smooth = item.modifiers.new("Remesh", "REMESH"), item.modifiers.new("Smooth", "SMOOTH")
    remesh.mode, remesh.voxel_size, smooth.iterations = "VOXEL", voxel_size, SMOOTHINGS
    surface = bmesh.new()
    surface.from_object(item, bpy.context.evaluated_depsgraph_get())
    geometry = [*surface.verts, *surface.edges, *surface.faces]
    bmesh.ops.bisect_plane(
        surface, geom=geometry, dist=0.1 * voxel_size, plane_co=(0, 0, cut_height), plane_no=(0, 0, -1), clear_outer=True
    )
    bmesh.ops.dissolve_degenerate(surface, dist=0.02 * voxel_size, edges=surface.edges)
    bmesh.ops.triangulate(surface, faces=surface.faces)
    cut = bpy.data.meshes.new("Cut")
    surface.to_mesh(cut)
    surface.free()
    loops, _ = read_loop_triangles(cut)
    body = TriangleMesh(read_positions(cut), read_loop_vertices(cut)[loops])
    bpy.data.objects.remove(item)
    bpy.data.meshes.remove(mesh)
    bpy.data.meshes.remove(cut)
    return body
