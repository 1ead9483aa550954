"""One texture, coded: the bytes and the predicted errors of all scans of its tiles, in the best order for each tile."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ....jobs.progress import Progress, Steps
from ..manifest import PackageTexture
from .block_errors import (
    DATA_LUMINANCE,
    BlockErrors,
    BlockWeights,
    color_sensitivities,
    contrast_sensitivities,
    data_sensitivities,
    feature_energies,
    filter_energies,
    luminance_sensitivities,
    measure_errors,
    predict_flip,
)
from .dct_blocks import BLOCK, COEFFICIENTS, quantize, standard_steps, transform_tiles
from .fragments import count_features
from .settings import TextureSettings
from .texture_tiles import TextureSource, TileGrid, cut_tiles, fill_unused, find_used_texels
from .tile_coding import Scan, build_tables, code_scan, find_first_shifts, list_scans, write_header
from .visibility import FOOTPRINT_LEVELS, level_footprints

COLOR_ROLES = {"base_color", "emission"}
BATCH_TEXELS = 1 << 20  # coded at once
SAMPLE_TILES = 64  # whose symbols decide the Huffman tables, at 128 pixels
MIN_VISIBILITY = 1e-3  # of blocks that no view shows, relative to the mean of the used ones
FLAT_VARIANCE, FLAT_FRACTION = 4.0, 0.2  # of Y in a block, and of the blocks of a tile
FLAT_QUALITY = 95  # JPEG quality of the mean colors of flat tiles
STEP_FACTORS = (1.0, 2.5, 6.0, 15.0)  # of steps of quantization, of which the best one is chosen per tile
BLOCK_STRIDE = 3  # of the blocks of a tile for that choice
BITS_OF_VALUE = 5.0  # about those of the position of a nonzero coefficient
BISECTIONS, RATE_POWER = 40, 4  # of the gain per byte that tiles have in common, whose scale is not known


@dataclass(frozen=True, eq=False)
class CodedTexture:
    """A texture of N used tiles.

    texture: with the headers. tiles: (N,) their numbers. headers: (N,) of each tile. contents: their scans, each in the best order. sizes:
    (N, K) bytes of the scans, 0 for those that are missing, which come last. errors: (N, K + 1) predicted FLIP error of the tile's pixels
    without and with the first scans, times the fraction of all pixels of the object that show the tile.
    """

    texture: PackageTexture
    tiles: np.ndarray
    headers: np.ndarray
    contents: list[list[bytes]]
    sizes: np.ndarray
    errors: np.ndarray


def code_texture(source: TextureSource, grid: TileGrid, visibility: np.ndarray, settings: TextureSettings) -> Steps[CodedTexture]:
    """Code the tiles of a texture, those that triangles use.

    Args:
        visibility: (rows, columns, FOOTPRINT_LEVELS) of blocks, see `measure_visibility`.
    """
    side, blocks = grid.tile_size, (grid.tile_size // BLOCK) ** 2
    used = find_used_texels(source, grid)
    image = fill_unused(source, grid, used)
    components = 1 if (image[..., 1:] == image[..., :1]).all() else 3
    used_tiles = cut_tiles(used, side)
    numbers = np.flatnonzero(used_tiles.any(axis=(1, 2)))
    shown = cut_tiles(visibility, side // BLOCK)[numbers].reshape(len(numbers), blocks, FOOTPRINT_LEVELS)
    used_blocks = cut_tiles(used.reshape(-1, side // BLOCK * grid.columns, BLOCK).any(axis=2)[::BLOCK], side // BLOCK)
    del used
    tiles = cut_tiles(image, side)[numbers]
    del image
    fractions = _floor_fractions(shown.sum(axis=2), used_blocks[numbers].reshape(len(numbers), blocks))
    if source.feature_scales is not None and settings.feature_weight > 0.0:
        fractions *= _weigh_features(source, grid, settings.feature_weight)[numbers, None]
    is_color = source.role in COLOR_ROLES
    energies = filter_energies(level_footprints(), settings.pixels_per_degree)[[0, 1, 2] if is_color else [0, 0, 0]][:components]
    scans, common = list_scans(components), shown.sum(axis=(0, 1))
    feature_table = feature_energies(level_footprints(), settings.pixels_per_degree)
    all_steps = _list_steps(settings.quality, components)
    batch = max(BATCH_TEXELS // side**2, 1)
    estimates = np.zeros((2, len(numbers), all_steps.shape[1]))
    is_flat = np.zeros(len(numbers), np.int64)
    for start in range(0, len(numbers), batch):
        yield Progress(0.2 * start / len(numbers), "Choosing quality of textures")
        rows = slice(start, start + batch)
        coefficients = transform_tiles(tiles[rows], components)
        is_flat[rows] = _are_flat(coefficients)
        part = np.ascontiguousarray(coefficients[:, :, ::BLOCK_STRIDE])
        weights = _weigh_blocks(part, shown[rows, ::BLOCK_STRIDE], common, energies, feature_table, is_color)
        estimates[:, rows] = _estimate_classes(part, weights, all_steps, fractions[rows, ::BLOCK_STRIDE])
    factors = choose_factors(estimates[0, :, ::2], estimates[1, :, ::2], settings.error)
    classes = 2 * factors + is_flat
    quantized = np.empty((components, len(numbers), blocks, COEFFICIENTS), np.int16)
    parts: list[BlockErrors] = []
    for start in range(0, len(numbers), batch):
        yield Progress(0.2 + 0.4 * start / len(numbers), "Measuring errors of textures")
        rows = slice(start, start + batch)
        coefficients = transform_tiles(tiles[rows], components)
        steps = all_steps[:, classes[rows]]
        quantized[:, rows] = quantize(coefficients, steps)
        weights = _weigh_blocks(coefficients, shown[rows], common, energies, feature_table, is_color)
        parts.append(measure_errors(coefficients, quantized[:, rows], steps, scans, weights))
    del tiles
    totals = np.concatenate([part.totals for part in parts], axis=1)
    gains = np.concatenate([part.gains for part in parts], axis=2)
    del parts
    samples = np.unique(np.linspace(0, len(numbers) - 1, min(len(numbers), max(SAMPLE_TILES * 128**2 // side**2, 4))).astype(np.int64))
    tables = build_tables(quantized[:, samples], np.abs(quantized).max(axis=(1, 2)), scans)
    contents: list[list[bytes]] = []
    for start in range(0, len(numbers), batch):
        yield Progress(0.6 + 0.4 * start / len(numbers), "Coding textures")
        part = quantized[:, start : start + batch]
        tops = find_first_shifts(part, scans)
        coded = [code_scan(part, scan, top, tables) for scan, top in zip(scans, tops, strict=True)]
        contents += [list(scans_of_tile) for scans_of_tile in zip(*coded, strict=True)]
    sizes = np.array([[len(scan) for scan in scans_of_tile] for scans_of_tile in contents])
    # Of lost contrasts, which are squared, the change from the middle of the range.
    linear = gains[0] + np.einsum("cknb,cnb->knb", gains[2:], totals[2:])
    order = order_scans(sizes, np.einsum("knb,nb->nk", linear, fractions), scans)
    ordered = [[scans_of_tile[index] for index in row] for scans_of_tile, row in zip(contents, order.tolist(), strict=True)]
    used_classes, headers = np.unique(classes, return_inverse=True)
    texture = PackageTexture(
        source.role, grid.width, grid.height, side, tuple(write_header(side, all_steps[:, item], tables) for item in used_classes)
    )
    sizes = np.take_along_axis(sizes, order, axis=1)
    return CodedTexture(texture, numbers, headers, ordered, sizes, _predict_errors(totals, gains, order, fractions))


def order_scans(sizes: np.ndarray, gains: np.ndarray, scans: Sequence[Scan]) -> np.ndarray:
    """Return the order (N, K) int64 of the K scans of N tiles: the next is the one with the largest gain per byte, after those before it in
    its band, the first of DC coefficients first of all. Scans without bytes come last.

    Args:
        sizes: (N, K) bytes, 0 for scans that a tile does not have. gains: (N, K).
    """
    count = len(scans)
    rates = np.where(sizes > 0, gains / np.maximum(sizes, 1), -np.inf)
    waits = np.zeros(sizes.shape, bool)  # for the scan before
    for index in range(1, count):
        is_same = (scans[index].component, scans[index].first) == (scans[index - 1].component, scans[index - 1].first)
        waits[:, index] = (sizes[:, index - 1] > 0) if is_same else True
    rows = np.arange(len(sizes))
    order = np.empty(sizes.shape, np.int64)
    is_done = np.zeros(sizes.shape, bool)
    follows = [
        index + 1
        if index + 1 < count and (scans[index].component, scans[index].first) == (scans[index + 1].component, scans[index + 1].first)
        else -1
        for index in range(count)
    ]
    is_start = np.array([index == 0 or follows[index - 1] < 0 for index in range(count)])
    for place in range(count):
        allowed = np.where(is_done | waits, -np.inf, rates)
        chosen = allowed.argmax(axis=1)
        nothing = ~np.isfinite(allowed[rows, chosen])
        chosen[nothing] = (~is_done[nothing]).argmax(axis=1)
        order[:, place] = chosen
        is_done[rows, chosen] = True
        following = np.array(follows)[chosen]
        has_next = following >= 0
        waits[rows[has_next], following[has_next]] = False
        first_dc = scans[0].component is None and place == 0
        if first_dc:
            waits[:, is_start] = False
    return order


def _list_steps(quality: int, components: int) -> np.ndarray:
    """Return the steps (C, classes, 64) of classes of tiles: for each of STEP_FACTORS ordinary and flat ones."""
    classes = []
    for factor in STEP_FACTORS:
        ordinary = standard_steps(quality, components, factor)
        flat = ordinary.copy()
        flat[:, 0] = np.minimum(flat[:, 0], standard_steps(FLAT_QUALITY, components)[:, 0])
        classes += [ordinary, flat]
    return np.stack(classes, axis=1)


def _are_flat(coefficients: np.ndarray) -> np.ndarray:
    """Return which of the tiles (C, N, B, 64) have many blocks of about one color: (N,) int64, 0 or 1. Rounded means of such blocks all
    deviate alike, which is seen from any distance."""
    variances = (coefficients[0, :, :, 1:] ** 2).sum(axis=2) / COEFFICIENTS
    return ((variances < FLAT_VARIANCE).mean(axis=1) > FLAT_FRACTION).astype(np.int64)


def _estimate_classes(coefficients: np.ndarray, weights: BlockWeights, all_steps: np.ndarray, fractions: np.ndarray) -> np.ndarray:
    """Return about the predicted errors and bytes (2, N, classes) of some blocks (C, N, B, 64) of complete tiles with `all_steps`
    (C, classes, 64) of ordinary tiles."""
    count = coefficients.shape[1]
    scans = [Scan(None, 0, COEFFICIENTS - 1, 0, 0)]
    found = np.zeros((2, count, all_steps.shape[1]))
    for index in range(0, all_steps.shape[1], 2):
        steps = np.repeat(all_steps[:, index, None], count, axis=1)
        quantized = quantize(coefficients, steps)
        errors = measure_errors(coefficients, quantized, steps, scans, weights)
        found[0, :, index] = BLOCK_STRIDE * (predict_flip(errors.totals - errors.gains[:, 0]) * fractions).sum(axis=1)
        bits = BITS_OF_VALUE * (quantized != 0) + 2.0 * np.log2(np.maximum(np.abs(quantized), 1))
        found[1, :, index] = BLOCK_STRIDE / 8.0 * bits.sum(axis=(0, 2, 3))
    return found


def choose_factors(errors: np.ndarray, byte_counts: np.ndarray, target: float) -> np.ndarray:
    """Return for each of N tiles (N,) int64 the choice out of K that gives the fewest bytes if all errors may sum to `target`.

    Args:
        errors, byte_counts: (N, K), of which the first choice is the best and largest one. If it does not reach the target, all have it.
    """
    low, high = 0.0, 1.0
    chosen = np.zeros(len(errors), np.int64)
    rows = np.arange(len(errors))
    for _ in range(BISECTIONS):
        rate = 0.5 * (low + high)
        trial = (errors + rate**RATE_POWER * byte_counts).argmin(axis=1)
        if errors[rows, trial].sum() <= target:
            low, chosen = rate, trial
        else:
            high = rate
    return chosen


def _weigh_blocks(
    coefficients: np.ndarray, shown: np.ndarray, common: np.ndarray, energies: np.ndarray, feature_table: np.ndarray, is_color: bool
) -> BlockWeights:
    """Return the weights of errors of tiles.

    Args:
        coefficients: (C, N, B, 64). shown: (N, B, L) how often each block is seen at each level of footprints. common: (L,) of all blocks,
            for those that no view shows. energies: (C, L, 64). feature_table: (L, 64).
    """
    mix = np.where(shown.sum(axis=2, keepdims=True) > 0.0, shown, common if common.any() else np.ones_like(common))
    mix = (mix / mix.sum(axis=2, keepdims=True)).astype(np.float32)
    means = np.zeros((*coefficients.shape[1:3], 3))
    means[..., : len(coefficients)] = np.moveaxis(coefficients[..., 0], 0, -1) / BLOCK
    if is_color:
        sensitivities = color_sensitivities(means.reshape(-1, 3)).reshape(means.shape)
        luminance = luminance_sensitivities(means.reshape(-1, 3)).reshape(means.shape[:2])
        contrasts = contrast_sensitivities(means.reshape(-1, 3)).reshape(means.shape)
    else:
        sensitivities = np.broadcast_to(data_sensitivities(), means.shape)
        luminance, contrasts = np.full(means.shape[:2], DATA_LUMINANCE**2), np.zeros(means.shape)
    tables = energies.astype(np.float32)
    hidden = 1.0 - tables
    hidden[..., 0] = 0.0
    shape = means.shape[:2]
    return BlockWeights(
        colors=[
            (mix @ tables[component]) * sensitivities[..., component, None].astype(np.float32) for component in range(len(coefficients))
        ],
        features=(mix @ feature_table.astype(np.float32)) * luminance[..., None].astype(np.float32),
        contrasts=[(mix @ hidden[component]) * contrasts[..., component, None].astype(np.float32) for component in range(len(hidden))],
        means=[sensitivities[..., component].astype(np.float32).reshape(shape) for component in range(len(tables))],
    )


def _weigh_features(source: TextureSource, grid: TileGrid, weight: float) -> np.ndarray:
    """Return the importance (N,) float32 of all tiles, about 1 in the mean: it grows with the scales that features in the tile last."""
    counts = count_features(source.mesh, source.materials, source.feature_scales, grid).counts[1:].sum(axis=0).ravel()
    relative = counts / max(counts[counts > 0].mean() if counts.any() else 1.0, 1.0)
    return ((1.0 + weight * relative) / (1.0 + weight)).astype(np.float32)


def _floor_fractions(fractions: np.ndarray, used: np.ndarray) -> np.ndarray:
    """Return the fractions (N, B) float32 of the object's pixels that show each block, with a small one for used blocks not seen."""
    mean = fractions.sum() / max(int(used.sum()), 1)
    return np.maximum(fractions, np.where(used, MIN_VISIBILITY * max(mean, 1e-9), 0.0)).astype(np.float32)


def _predict_errors(totals: np.ndarray, gains: np.ndarray, order: np.ndarray, fractions: np.ndarray) -> np.ndarray:
    """Return the predicted errors (N, K + 1) of tiles without and with their first scans in `order` (N, K)."""
    left = totals.copy()
    predicted = np.empty((len(order), order.shape[1] + 1))
    predicted[:, 0] = (predict_flip(left) * fractions).sum(axis=1)
    rows = np.arange(len(order))
    for place in range(order.shape[1]):
        left -= gains[:, order[:, place], rows]
        predicted[:, place + 1] = (predict_flip(left) * fractions).sum(axis=1)
    return predicted
