"""Packages of textured meshes, from a mesh and its materials to the bytes of their files."""

import math
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..files.glb import Y_UP
from ..imaging.mipmaps import Mipmaps
from ..jobs.parallel_steps import run_in_parallel
from ..jobs.progress import Progress, Steps, subprogress
from ..messages import format_count
from ..texmesh.level_chain import LevelChain, make_levels
from ..texmesh.scale_space.analysis import analyze_scale_space
from ..texmesh.settings import TexmeshSettings
from ..texmesh.textured_mesh import TexturedMesh
from .files import LEVELS_GLB, describe_file
from .increments import encode_increments
from .levels_glb import encode_levels
from .manifest import MESH, TEXTURES, Manifest, MeshLevel, PackageMaterial, Section
from .material_sources import MaterialSource, build_color_mipmaps
from .mesh.coding import Bounds, encode_mesh
from .mesh.order import order_mesh
from .planning import ErrorTable, PlanRow, find_state_pixels, make_plan, measure_errors
from .settings import PackageSettings
from .textures.building import BuiltTextures, build_textures
from .textures.coding import decode_textures
from .textures.texture_tiles import TextureSource

STATES = 6  # Errors of so many states of the textures are measured.
MIN_BITS, MAX_BITS = 8, 16  # Bits of positions and texture coordinates.
POSITION_BITS, UV_BITS = 4, 2  # below a pixel and a texel
TEXTURE_PART = 0.5  # Part of the largest difference that is not seen; the mesh has the others.
EncodedMesh = tuple[bytes, tuple[MeshLevel, ...], Bounds, Bounds]


@dataclass(frozen=True)
class PackageReport:
    """Figures about a package.

    Attributes:
        name: of the object.
        levels: triangles, finest first.
        mesh_bytes, texture_bytes: of mesh.bin and textures.bin.
        table: the measured errors.
        plan: the best uses of growing numbers of bytes.
    """

    name: str
    levels: tuple[int, ...]
    mesh_bytes: int
    texture_bytes: int
    table: ErrorTable
    plan: tuple[PlanRow, ...]

    def describe(self) -> str:
        """Return one sentence for the user."""
        counts = ", ".join(f"{count:,}" for count in self.levels)
        sizes = f"{self.mesh_bytes / 1e6:.2f} MB of mesh and {self.texture_bytes / 1e6:.2f} MB of textures"
        return f'"{self.name}": {format_count(len(self.levels), "level")} with {counts} triangles, {sizes}.'


@dataclass(frozen=True, eq=False)
class Package:
    """A package. contents: the bytes of its files by name, without those of the page. report: figures about it."""

    manifest: Manifest
    contents: dict[str, bytes]
    report: PackageReport


def build_package(
    name: str,
    mesh: TexturedMesh,
    materials: Sequence[MaterialSource],
    textures: Sequence[np.ndarray | None],
    settings: TexmeshSettings,
    package_settings: PackageSettings,
) -> Steps[Package]:
    """Build the package of a mesh.

    Args:
        mesh: z upwards. materials: by number. textures: base colors for the analysis by material, (H, W, 3) float32, scene-linear, or None.
        settings: of the levels; their vertices must be "original".

    Raises:
        GeometryError, SettingsError: see `make_levels`, or a setting of the package cannot be used. ImageError: a texture cannot be coded.
    """
    turned = replace(mesh, vertices=mesh.vertices @ Y_UP.T)
    steps = choose_steps(package_settings.pixels, materials)

    def encode(chain: LevelChain) -> EncodedMesh:
        ordered = order_mesh(turned, [level.subset for level in chain.levels[1:]], chain.simplification)
        return encode_mesh(ordered, _level_pixels(chain), len(materials), steps)

    sources, references = _list_sources(mesh, materials)
    analysis = analyze_scale_space(mesh, textures, settings)
    textures_steps = build_textures(sources, package_settings, settings.pixels_per_degree)
    scale_map, built = yield from subprogress(run_in_parallel([analysis, textures_steps]), 0.0, 0.4)
    chain = yield from subprogress(make_levels(mesh, textures, settings, scale_map), 0.4, 0.75)
    tasks = [_measure(chain, materials, built, references, settings, package_settings), _encode_in_steps(encode, chain)]
    table, coded = yield from subprogress(run_in_parallel(tasks), 0.75, 0.98)
    yield Progress(0.98, "Writing")
    return _assemble(name, materials, references, chain, coded, steps, built, table, package_settings, settings.max_difference)


def _encode_in_steps(encode: Callable[[LevelChain], EncodedMesh], chain: LevelChain) -> Steps[EncodedMesh]:
    yield Progress(0.0, "Coding meshes")
    return encode(chain)


def choose_steps(pixels: int, materials: Sequence[MaterialSource]) -> tuple[int, int]:
    """Return the numbers of steps of positions, fine enough for an object of `pixels` pixels also in views that are several times nearer,
    and of texture coordinates, a part of a texel."""
    sides = [max(image.shape[:2]) for material in materials for image in material.images.values()]
    bits = math.ceil(math.log2(pixels)) + POSITION_BITS, math.ceil(math.log2(max(sides, default=1))) + UV_BITS
    return tuple(2 ** min(max(count, MIN_BITS), MAX_BITS) - 1 for count in bits)


def _level_pixels(chain: LevelChain) -> tuple[float, ...]:
    """Return for each level, coarsest first, the size in pixels up to which it looks like the next finer one; 0 for the finest."""
    return (*(float(level.switch.pixels) for level in reversed(chain.levels[1:])), 0.0)


def _list_sources(mesh: TexturedMesh, materials: Sequence[MaterialSource]) -> tuple[list[TextureSource], list[dict[str, int]]]:
    """Return the images that triangles show, each once, and for each material their indices by role."""
    used = set(np.unique(mesh.materials).tolist())
    users: dict[tuple[str, int], list[int]] = {}
    for number, material in enumerate(materials):
        for role, image in material.images.items():
            if number in used:
                users.setdefault((role, id(image)), []).append(number)
    sources, references = [], [{} for _ in materials]
    for (role, _), numbers in users.items():
        image = materials[numbers[0]].images[role]
        title = f"{role} of {materials[numbers[0]].name}"
        sources.append(TextureSource(role, image, mesh, tuple(numbers), name=title))
        for number in numbers:
            references[number][role] = len(sources) - 1
    return sources, references


def _measure(
    chain: LevelChain,
    materials: Sequence[MaterialSource],
    built: BuiltTextures,
    references: Sequence[dict[str, int]],
    settings: TexmeshSettings,
    package_settings: PackageSettings,
) -> Steps[ErrorTable]:
    """Measure the errors of levels and of parts of the base colors."""
    colors = [reference.get("base_color") for reference in references]

    def mipmaps(images: Sequence[np.ndarray | None]) -> list[Mipmaps | None]:
        keys = [(id(image), material.base_color) for image, material in zip(images, materials, strict=True)]
        sources = dict(zip(keys, images, strict=True))  # materials may share an image
        built = {key: build_color_mipmaps(image, key[1]) for key, image in sources.items()}
        return [built[key] for key in keys]

    def decode(state: int) -> list[Mipmaps | None]:
        images = decode_textures(built.textures, built.increments, built.content, state)
        return mipmaps([None if index is None else images[index] for index in colors])

    return (
        yield from measure_errors(
            [level.mesh for level in reversed(chain.levels)],
            mipmaps([material.images.get("base_color") for material in materials]),
            _choose_states(len(built.flips)),
            decode,
            package_settings.pixels,
            settings.pixels_per_degree,
        )
    )


def _choose_states(count: int) -> list[int]:
    """Return up to STATES of `count` states, ascending and evenly spaced, the first and the last one among them."""
    return np.unique(np.linspace(0, count - 1, STATES).round().astype(np.int64)).tolist()


def _assemble(
    name: str,
    materials: Sequence[MaterialSource],
    references: Sequence[dict[str, int]],
    chain: LevelChain,
    coded: EncodedMesh,
    steps: tuple[int, int],
    built: BuiltTextures,
    table: ErrorTable,
    settings: PackageSettings,
    max_difference: float,
) -> Package:
    """Return the files of the package and its manifest. max_difference: the largest mean FLIP difference that is not seen."""
    encoded = encode_increments(built.increments)
    checksums = built.increments.compute_checksums(built.content).tobytes()
    mesh_content, levels, bounds, uv_bounds = coded
    contents = {MESH: mesh_content, TEXTURES: b"".join([encoded, checksums, built.content])}
    manifest = Manifest(
        name=name,
        files={file: describe_file(content) for file, content in contents.items()},
        mirrors=settings.mirror_urls(),
        bounds=bounds,
        uv_bounds=uv_bounds,
        steps=steps,
        levels=levels,
        materials=tuple(
            PackageMaterial(material.name, material.base_color, dict(reference), material.is_double_sided, material.shading)
            for material, reference in zip(materials, references, strict=True)
        ),
        textures=built.textures,
        increment_count=len(built.increments.sizes),
        increments=Section(0, len(encoded), zlib.crc32(encoded)),
        checksums=Section(len(encoded), len(checksums), zlib.crc32(checksums)),
        first_increment=len(encoded) + len(checksums),
        errors=table.predict(built.flips[:, 0]),
        state_pixels=find_state_pixels(built.flips, settings.pixels, TEXTURE_PART * max_difference),
        time_limit=settings.time_limit,
        pixels=float(settings.pixels),
    )
    if settings.gltf_file:
        contents[LEVELS_GLB] = encode_levels(name, chain, materials)
    counts = tuple(sum(level.triangle_counts) for level in reversed(levels))
    mesh_sizes = [manifest.mesh_size(level) for level in range(len(levels))]
    plan = make_plan(manifest.errors.tabulate(), mesh_sizes, built.increments.measure_states(manifest.state_count))
    report = PackageReport(name, counts, len(contents[MESH]), len(contents[TEXTURES]), table, plan)
    return Package(manifest, contents, report)
