"""Images of levels in glTF documents: no larger than the distance of each level needs, and normal maps for its own surface.

Levels have the texture coordinates of the original, so that a texel of theirs shows the same part of the surface as one of the original.
Paper, section I: coarse levels for static use need no texture of the original's size.
"""

from collections.abc import Collection, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import cached_property, partial
from threading import Lock

import numpy as np

from ...errors import ImageError
from ...imaging.coded_images import JPEG_START, decode, encode, encode_gray
from ...jobs.memory import release_memory
from ...messages import quote_names
from .image_sizes import choose_halvings, halve_size
from .normal_maps import NormalMaps
from .smaller_images import Content, shrink_image, to_pixels
from .texture_uses import LevelDocument, TextureUse, list_uses, replace_images
from .uv_layout import find_coverage

PNG_COMPRESSION = 6  # zlib level: 9 takes four times as long for files that are a few percent smaller
MAX_IMAGES = 2  # at once, since each needs much memory
# Qualities of JPEG and WebP. Errors of normals and of data change the shading.
COLOR_QUALITY, DATA_QUALITY = 85, 95
COLORS = {Content.COLOR, Content.TRANSPARENT_COLOR}
UNREADABLE = "These images have other values than 8 bits per channel, and keep their sizes"


@dataclass(eq=False)
class _Image:
    """An image of the original, and all its uses per level: their index in the document, and themselves."""

    file: bytes
    name: str
    uses: list[dict[int, TextureUse]] = field(default_factory=list)

    @cached_property
    def pixels(self) -> np.ndarray:
        """(H, W, 3 or 4) uint8. Raises ImageError."""
        return decode(self.file)

    def forget_pixels(self) -> None:
        """Let them be read again when they are needed."""
        self.__dict__.pop("pixels", None)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height."""
        return self.pixels.shape[1::-1]

    def list_contents(self) -> list[Content]:
        """Return what it holds, in any of its uses."""
        return [content for content in Content if any(use.content is content for uses in self.uses for use in uses.values())]

    def choose_sizes(self) -> list[tuple[int, int]]:
        """Return the size that each level needs."""
        halvings = [min((_choose_halvings(use, self.size) for use in uses.values()), default=0) for uses in self.uses]
        return [halve_size(self.size, count) for count in halvings]


@dataclass(eq=False)
class _Coverages:
    """Which texels triangles of the original cover: computed once for all images of a size that are placed alike."""

    lock: Lock = field(default_factory=Lock)
    found: dict[tuple, np.ndarray | None] = field(default_factory=dict)

    def find(self, image: _Image) -> np.ndarray | None:
        """Return the coverage (H, W) of an image, None if all texels count."""
        uses = list(image.uses[0].values())
        placements = {(id(part.primitive), str(use.reference | {"index": 0}), use.is_repeated) for use in uses for part in use.parts}
        with self.lock:
            key = (image.size, frozenset(placements))
            if key not in self.found:
                self.found[key] = _find_coverage(uses, image.size)
            return self.found[key]


def _find_coverage(uses: Sequence[TextureUse], size: tuple[int, int]) -> np.ndarray | None:
    uvs = [(use, corners) for use in uses for corners in use.list_uvs()]
    if any(not use.is_repeated and (corners.min() < 0.0 or corners.max() > 1.0) for use, corners in uvs):
        return None
    coverage = find_coverage(np.concatenate([corners for _, corners in uvs]), size)
    return coverage if coverage.any() else None


@dataclass(frozen=True)
class _NewFile:
    """The file that replaces an image. has_normals: whether its normals are those for the level."""

    content: bytes
    has_normals: bool = False


@dataclass(frozen=True)
class _ImageFiles:
    """The files of an image. files: per level, by use. sides: per level, of smaller images in pixels, 0 for others. reason: why it keeps
    its size or its normals, or an empty string."""

    files: list[dict[int, _NewFile]]
    sides: list[int]
    reason: str


def rebake_images(levels: Sequence[LevelDocument], has_webp: bool) -> list[str]:
    """Give each level images of its own, unless they need more bytes than those of the original, the first level, which keeps its images.
    Return sentences about them.

    has_webp: whether images of all levels are stored as WebP where that needs less bytes.
    """
    release_memory()
    uses = [list_uses(level) for level in levels]
    chosen: list[dict[int, _NewFile]] = [{} for _ in levels]
    sides: list[set[int]] = [set() for _ in levels]
    remarks: dict[str, list[str]] = {}
    images = _group_by_image(uses)
    with ThreadPoolExecutor(MAX_IMAGES) as threads:
        for image, made in zip(images, threads.map(partial(_choose_files, coverages=_Coverages(), has_webp=has_webp), images), strict=True):
            if made.reason:
                remarks.setdefault(made.reason, []).append(image.name)
            for number, files in enumerate(made.files):
                chosen[number] |= files
                sides[number] |= {made.sides[number]} - {0}
    for level, found, files in zip(levels, uses, chosen, strict=True):
        for index, file in files.items():
            if file.has_normals:
                found[index].reference.pop("scale", None)
        replace_images(level.document, found, {index: file.content for index, file in files.items()})
    return _describe(sides, remarks)


def _choose_files(image: _Image, coverages: _Coverages, has_webp: bool) -> _ImageFiles:
    """Return the files of an image in all levels."""
    try:
        sizes = image.choose_sizes()
        full = _encode_full(image) if has_webp else image.file
        smaller, reason = _make_smaller(image, sizes, coverages, has_webp)
    except ImageError:  # such as 16 bits per channel
        return _ImageFiles([{} for _ in image.uses], [0] * len(image.uses), UNREADABLE)
    finally:
        image.forget_pixels()
    files, sides = [], []
    for uses, found, size in zip(image.uses, smaller, sizes, strict=True):
        is_smaller = bool(found) and sum(map(len, {file.content for file in found.values()})) < len(full)
        files.append(found if is_smaller else dict.fromkeys(uses, _NewFile(full)))
        sides.append(max(size) if is_smaller else 0)
    return _ImageFiles(files, sides, reason)


def _choose_halvings(use: TextureUse, size: tuple[int, int]) -> int:
    parts = zip(use.parts, use.list_uvs(), strict=True)
    return min(choose_halvings(part.at_corners("POSITION"), uvs, part.pixel_size, size) for part, uvs in parts)


def _group_by_image(uses: Sequence[Sequence[TextureUse]]) -> list[_Image]:
    """Return the images that triangles of the first level show, with their uses in all levels."""
    images: dict[bytes, _Image] = {}
    for use in uses[0]:
        if use.parts:
            images.setdefault(use.image["content"], _Image(use.image["content"], use.image.get("name", "Image"), [{} for _ in uses]))
    for number, found in enumerate(uses):
        for index, use in enumerate(found):
            if use.parts and use.image["content"] in images:
                images[use.image["content"]].uses[number][index] = use
    return list(images.values())


def _make_smaller(
    image: _Image, sizes: Sequence[tuple[int, int]], coverages: _Coverages, has_webp: bool
) -> tuple[list[dict[int, _NewFile]], str]:
    """Return the files that replace an image by use, per level, and why its normals stay, "" if they do not. There are none where the size
    is that of the original."""
    files: list[dict[int, _NewFile]] = [{} for _ in sizes]
    smaller = sorted(set(sizes) - {image.size}, reverse=True)
    coverage, reason = coverages.find(image) if smaller else None, ""
    for content in image.list_contents() if smaller else ():
        used = [{index: use for index, use in uses.items() if use.content is content} for uses in image.uses]
        maps = NormalMaps.of([list(uses.values()) for uses in used], image.size) if content is Content.NORMAL else None
        reason = maps.reason if maps is not None else reason
        for size, values in zip(smaller, shrink_image(image.pixels, coverage, content, smaller), strict=True):
            numbers = [number for number, uses in enumerate(used) if uses and sizes[number] == size]
            if maps is not None and maps.surface is not None:
                made = [
                    _NewFile(_encode(maps.express(values, list(used[number].values())), content, b"", has_webp), True) for number in numbers
                ]
            else:
                made = [_NewFile(_encode(values, content, image.file, has_webp))] * len(numbers) if numbers else []
            for number, file in zip(numbers, made, strict=True):
                files[number] |= dict.fromkeys(used[number], file)
    return files, reason


def _encode(values: np.ndarray, content: Content, original: bytes, has_webp: bool) -> bytes:
    """Return the smallest file of values from `shrink_image`: PNG, JPEG if the original is one, or WebP."""
    return _encode_pixels(to_pixels(values, content), COLOR_QUALITY if content in COLORS else DATA_QUALITY, original, has_webp)


def _encode_pixels(pixels: np.ndarray, quality: int, original: bytes, has_webp: bool) -> bytes:
    is_gray = pixels.shape[2] == 3 and (pixels == pixels[..., :1]).all()
    if original.startswith(JPEG_START) and pixels.shape[2] == 3:
        files = [encode(pixels, "jpeg", quality)]
    else:
        files = [encode_gray(pixels[..., 0]) if is_gray else encode(pixels, "png", compression=PNG_COMPRESSION)]
    return min([*files, *([encode(pixels, "webp", quality)] if has_webp else [])], key=len)


def _encode_full(image: _Image) -> bytes:
    """Return an image as WebP if that needs less bytes."""
    quality = COLOR_QUALITY if COLORS.issuperset(image.list_contents()) else DATA_QUALITY
    return min(image.file, encode(image.pixels, "webp", quality), key=len)


def _describe(sides: Sequence[Collection[int]], remarks: dict[str, list[str]]) -> list[str]:
    """Return sentences about the sides of the images of levels in pixels, and about images that stay."""
    texts = [f"{min(found)} to {max(found)}" if len(found) > 1 else str(*found) for found in sides if found]
    sizes = [f"Images of levels have {', '.join(texts)} pixels per side."] if texts else []
    return [*sizes, *(f"{reason}: {quote_names(dict.fromkeys(names))}." for reason, names in remarks.items())]
