"""Restored images: exact where the answer is known, unchanged outside the mask, and always copies of what may be copied."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter

from farfield.addon.core.errors import ImageError
from farfield.addon.core.imaging.diffusion import diffuse
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.restore import neighborhoods, synthesis
from farfield.addon.core.restore.levels import Page, build_levels
from farfield.addon.core.restore.restoration import restore
from farfield.addon.core.restore.settings import METHODS, ORDERS, RestoreSettings
from farfield.addon.core.restore.synthesis import synthesize

TEXTURE_ONLY = {"split": "manual", "sub_bands": 0}
ALL_METHODS = [("regions", "shrinking"), *(("pixels", order) for order in ORDERS)]


def run(image, mask, *, source_mask=None, barriers=None, is_color=True, further_maps=(), normal_channels=(), keep_stages=False, **values):
    steps = restore(
        image, mask, RestoreSettings(**values), source_mask=source_mask, barriers=barriers, is_color=is_color,
        further_maps=further_maps, normal_channels=normal_channels, keep_stages=keep_stages,
    )  # fmt: skip
    return run_to_end(steps)


def disk(shape, radius, center=None):
    y, x = np.mgrid[: shape[0], : shape[1]]
    row, column = center or (shape[0] // 2, shape[1] // 2)
    return np.hypot(y - row, x - column) < radius


def stripes(shape, period=8, axis=1):
    position = np.indices(shape)[axis] % period
    return np.repeat((position < period // 2)[..., None], 3, axis=2).astype(np.float32) * np.float32([0.8, 0.5, 0.3])


def noise(shape, seed=1, channels=3):
    return np.random.default_rng(seed).random((*shape, channels), np.float32)


def literal_scanline(image, hole):
    """Fill `hole` pixel by pixel, row by row: each pixel becomes the one with the most similar causal neighborhood of 12 pixels, found by
    comparing all of them (Wei and Levoy, as in section 5.4 of the paper, with one level)."""
    result = image.copy()
    height, width = hole.shape
    causal = [(dy, dx) for dy in (-2, -1, 0) for dx in range(-2, 3) if dy < 0 or dx < 0]
    sources = [(y, x) for y in range(2, height - 2) for x in range(2, width - 2) if not hole[y - 2 : y + 3, x - 2 : x + 3].any()]
    for y, x in zip(*np.nonzero(hole), strict=True):
        target = np.array([result[y + dy, x + dx] for dy, dx in causal], np.float64)
        distances = [((np.array([image[v + dy, u + dx] for dy, dx in causal]) - target) ** 2).sum() for v, u in sources]
        result[y, x] = image[sources[int(np.argmin(distances))]]
    return result


class TestKnownAnswers:
    """Images with one right answer."""

    @pytest.mark.parametrize(("method", "order"), ALL_METHODS)
    @pytest.mark.parametrize("axis", [0, pytest.param(1, marks=pytest.mark.exhaustive)])
    def test_stripes_continue(self, method, order, axis):
        image, mask = stripes((72, 80), axis=axis), disk((72, 80), 10)
        result = run(np.where(mask[..., None], np.float32(9.0), image), mask, method=method, order=order, **TEXTURE_ONLY)
        assert np.abs(result.pixels - image).max() < 0.02

    @pytest.mark.parametrize("method", METHODS)
    def test_diagonal_stripes_continue(self, method):
        position = (np.indices((80, 80)).sum(axis=0) // 4) % 2
        image, mask = position[..., None].astype(np.float32), disk((80, 80), 11)
        assert (
            np.abs(run(np.where(mask[..., None], np.float32(0.5), image), mask, method=method, **TEXTURE_ONLY).pixels - image).mean()
            < 0.002
        )

    def test_one_color_stays_one_color(self):
        image, mask = np.full((40, 50, 4), 0.3, np.float32), disk((40, 50), 9)
        assert np.allclose(run(np.where(mask[..., None], np.float32(1.0), image), mask).pixels, 0.3, atol=1e-5)

    def test_a_gradient_is_continued_under_texture(self):
        ramp = np.linspace(0.2, 0.8, 120, dtype=np.float32)[None, :, None] * np.ones((100, 1, 3), np.float32)
        image, mask = ramp + 0.08 * (noise((100, 120)) - 0.5), disk((100, 120), 14)
        result = run(np.where(mask[..., None], np.float32(0.0), image), mask, split="manual", sub_bands=3)
        means = [result.pixels[mask & (np.indices(mask.shape)[1] // 7 == column)].mean() for column in range(7, 10)]
        expected = [ramp[mask & (np.indices(mask.shape)[1] // 7 == column)].mean() for column in range(7, 10)]
        assert means == pytest.approx(expected, abs=0.02)
        assert result.pixels[mask].std(axis=0) == pytest.approx(image[mask].std(axis=0), rel=0.3)

    @pytest.mark.slow
    def test_the_automatic_split_has_both_gradient_and_texture(self):
        """Figure 15: synthesis by pixels alone loses the gradient, diffusion alone loses the texture."""
        y, x = np.mgrid[:140, :160].astype(np.float32)
        gradient = 0.5 + 0.24 * np.sin(2.4 * (x - 80) / 160) * np.cos(1.2 * (y - 70) / 140)
        texture = gaussian_filter(noise((140, 160), seed=2, channels=1)[..., 0] - 0.5, 1.5)
        image = (gradient + 0.09 * texture / texture.std())[..., None]
        mask = disk((140, 160), 26)
        damaged, errors, contrasts = np.where(mask[..., None], np.float32(0.0), image), {}, {}
        for name, values in (("auto", {}), ("synthesis", TEXTURE_ONLY), ("diffusion", {"split": "diffusion"})):
            result = run(damaged, mask, method="pixels", **values)
            errors[name] = np.sqrt(np.mean(np.square(gaussian_filter((result.pixels - image)[..., 0], 6.0)[mask])))
            contrasts[name] = (result.pixels[..., 0] - gaussian_filter(result.pixels[..., 0], 3.0))[mask].std()
            assert name != "auto" or result.sub_bands > 0
        truth = (image[..., 0] - gaussian_filter(image[..., 0], 3.0))[mask].std()
        assert errors["auto"] < 0.7 * errors["synthesis"]
        assert contrasts["auto"] == pytest.approx(truth, rel=0.2) and contrasts["diffusion"] < 0.3 * truth

    def test_diffusion_only_is_the_diffusion_to_the_byte(self):
        image, mask = noise((30, 40)), disk((30, 40), 8)
        for values in ({"split": "diffusion"}, {"split": "manual", "sub_bands": 40}):
            result = run(image, mask, **values)
            expected = diffuse(np.where(mask[..., None], np.float32(0), image), mask)
            assert result.sub_bands == -1 and result.pixels.tobytes() == expected.tobytes()

    @pytest.mark.parametrize("method", METHODS)
    def test_tileable_stripes_continue_across_the_border(self, method):
        image = stripes((64, 64), period=16)
        mask = np.roll(disk((64, 64), 9), (32, 29), (0, 1))
        damaged = np.where(mask[..., None], np.float32(0.0), image)
        assert np.abs(run(damaged, mask, method=method, tileable=True, **TEXTURE_ONLY).pixels - image).max() < 0.02

    @pytest.mark.parametrize("method", METHODS)
    def test_a_hole_across_a_tileable_image_closes_on_itself(self, method):
        image, mask = stripes((48, 64), period=16, axis=1), np.zeros((48, 64), bool)
        mask[20:30] = True
        damaged = np.where(mask[..., None], np.float32(0.0), image)
        assert np.abs(run(damaged, mask, method=method, tileable=True, **TEXTURE_ONLY).pixels - image).max() < 0.02

    def test_normals_have_unit_length(self):
        normals = np.random.default_rng(3).normal(size=(50, 50, 3)) * [0.2, 0.2, 0.0] + [0.0, 0.0, 1.0]
        image = (0.5 + 0.5 * normals / np.linalg.norm(normals, axis=2, keepdims=True)).astype(np.float32)
        mask = disk((50, 50), 8)
        result = run(image, mask, is_color=False, normal_channels=(0,)).pixels
        assert np.linalg.norm(2.0 * result - 1.0, axis=2) == pytest.approx(1.0, abs=1e-5)


class TestInvariants:
    """What holds for every image."""

    @pytest.mark.slow
    @settings(max_examples=5)
    @given(st.integers(0, 2**31), st.sampled_from(ALL_METHODS), st.integers(1, 5), st.booleans(), st.integers(1, 4))
    def test_known_pixels_stay_and_others_are_within_their_range(self, seed, method_and_order, levels, tileable, channels):
        method, order = method_and_order
        random = np.random.default_rng(seed)
        shape = tuple(random.integers(24, 60, 2))
        image = random.normal(size=(*shape, channels)).astype(np.float32)
        mask = disk(shape, random.uniform(1, 9), tuple(random.integers(0, shape))) | (random.random(shape) < 0.002)
        mask[0, 0] = True
        damaged = np.where(mask[..., None], np.float32(np.nan), image)
        result = run(damaged, mask, method=method, order=order, pyramid_levels=levels, tileable=tileable, is_color=channels > 2)
        assert (result.pixels[~mask] == image[~mask]).all() and np.isfinite(result.pixels).all()
        assert (result.pixels[mask] >= image[~mask].min(axis=0)).all() and (result.pixels[mask] <= image[~mask].max(axis=0)).all()

    @pytest.mark.slow
    @pytest.mark.parametrize(
        ("method", "side", "radius"), [("regions", 160, 12), pytest.param("pixels", 140, 10, marks=pytest.mark.exhaustive)]
    )
    def test_only_equal_seeds_give_equal_bytes(self, method, side, radius):
        image, mask = gaussian_filter(noise((side, side)), (2.0, 2.0, 0.0)), disk((side, side), radius)
        first, again, other = (run(image, mask, seed=seed, method=method, **TEXTURE_ONLY).pixels.tobytes() for seed in (5, 5, 6))
        assert first == again != other

    def test_stages_add_up_to_the_result(self):
        image, mask = noise((60, 70)), disk((60, 70), 9)
        result = run(image, mask, keep_stages=True, split="manual", sub_bands=3)
        stages = result.stages
        assert set(stages) == {"first_fill", "low", "low_filled", "high", "high_filled"}
        assert np.allclose(stages["low"] + stages["high"], stages["first_fill"], atol=1e-5)
        assert (stages["low"][~mask] == stages["low_filled"][~mask]).all()
        total = np.clip(stages["low_filled"] + stages["high_filled"], image[~mask].min(axis=0), image[~mask].max(axis=0))
        assert np.allclose(total, result.pixels, atol=1e-4)

    @pytest.mark.exhaustive
    @pytest.mark.parametrize("method", METHODS)
    def test_only_the_source_mask_is_copied(self, method):
        image, mask = noise((84, 168)), disk((84, 168), 31, (42, 42))
        image[:, :84] *= np.float32([1.0, 0.0, 0.0])
        image[:, 84:] *= np.float32([0.0, 0.0, 1.0])
        source_mask = np.zeros(mask.shape, bool)
        source_mask[:, 88:] = True
        inside = disk((84, 168), 4, (42, 42))  # away from the boundary, where the seam is blended
        blue = run(image, mask, source_mask=source_mask, pyramid_levels=1, method=method, **TEXTURE_ONLY).pixels[inside]
        assert blue[:, 2].mean() > 0.3 > 0.1 > blue[:, 0].mean()
        red = run(image, mask, source_mask=~source_mask, pyramid_levels=1, method=method, **TEXTURE_ONLY).pixels[inside]
        assert red[:, 0].mean() > 0.3 > 0.1 > red[:, 2].mean()

    @pytest.mark.parametrize("order", ["shrinking", "scanline", pytest.param("alternating", marks=pytest.mark.exhaustive)])
    def test_every_synthesized_pixel_is_a_copy_from_outside_the_hole(self, order):
        image, hole = noise((64, 80)), disk((64, 80), 12)
        levels = build_levels([Page(np.where(hole[..., None], np.float32(0.0), image), hole, ~hole, ~hole)], 3)
        run_to_end(synthesize(levels, RestoreSettings(order=order)))
        for level in levels:
            sources = level.source[level.hole]
            assert level.valid[sources].all() and not level.hole[sources].any() and level.filled[level.hole].all()
            assert (level.texture[level.hole] == level.texture[sources]).all()

    @pytest.mark.slow
    def test_scanline_batches_equal_one_pixel_after_another(self, monkeypatch):
        image, hole = noise((40, 60), seed=4), disk((40, 60), 9)

        def sources():
            levels = build_levels([Page(np.where(hole[..., None], np.float32(0.5), image), hole, ~hole, ~hole)], 2)
            run_to_end(synthesize(levels, RestoreSettings(order="scanline", pyramid_levels=2, coherence=1.0)))
            return levels[0].source

        in_batches = sources()
        monkeypatch.setattr(
            synthesis, "_schedule", lambda _level, pixels, _order: ((pixel[None], np.zeros(1, np.int64)) for pixel in pixels)
        )
        assert (sources() == in_batches).all()

    def test_matches_are_those_of_the_literal_method(self, monkeypatch):
        for module, name, value in (
            (neighborhoods, "TREE_EPS", 0.0),
            (neighborhoods, "MAX_DIMENSIONS", 1000),
            (synthesis, "MATCHES", 1),
            (synthesis, "SWEEPS", 0),
            (synthesis, "_continuations", lambda _level, pixels: np.full((len(pixels), 1), -1)),
        ):
            monkeypatch.setattr(module, name, value)
        image, hole = noise((30, 34), seed=9), disk((30, 34), 5)
        levels = build_levels([Page(np.where(hole[..., None], np.float32(0.5), image), hole, ~hole, ~hole)], 1)
        run_to_end(synthesize(levels, RestoreSettings(order="scanline", pyramid_levels=1)))
        expected = literal_scanline(image, hole)
        assert np.array_equal(levels[0].page(0), expected)

    @pytest.mark.slow
    def test_far_holes_do_not_change_each_other(self):
        image = noise((140, 360))
        first, second = disk((140, 360), 8, (70, 70)), disk((140, 360), 8, (60, 290))
        both = run(image, first | second, **TEXTURE_ONLY)
        assert both.hole_count == 2 and run(image, first, **TEXTURE_ONLY).hole_count == 1
        assert both.pixels[first].std() == pytest.approx(image.std(), rel=0.25)


class TestBadInput:
    """One sentence for each input that cannot be restored."""

    @pytest.mark.parametrize(
        ("change", "words"),
        [
            (lambda image, mask: (image, np.zeros_like(mask), {}), "No pixel is masked"),
            (lambda image, mask: (image, np.ones_like(mask), {}), "Every pixel is masked"),
            (lambda image, mask: (image, mask[:-1], {}), "The mask has 40 x 29 pixels and the image 40 x 30"),
            (lambda image, mask: (image, mask, {"source_mask": mask[:, 1:]}), "The source mask has 39 x 30"),
            (lambda image, mask: (image, mask, {"barriers": mask[1:]}), "The barrier mask has 40 x 29"),
            (lambda image, mask: (image[:4], mask[:4], {}), "4 pixels|40 x 4 pixels"),
            (lambda image, mask: (np.where(mask[..., None], image, np.float32(2e12)), mask, {}), "beyond 1e\\+12"),
            (lambda image, mask: (np.where(mask[..., None], image, np.float32(np.inf)), mask, {}), "NaN or infinite"),
            (lambda image, mask: (image, mask, {"source_mask": mask}), "Only 0 pixels"),
            (lambda image, mask: (image[..., :2], mask, {"normal_channels": (0,)}), "2 channels"),
        ],
        ids=["empty", "full", "mask size", "source size", "barrier size", "small", "huge", "infinite", "no source", "normals"],
    )
    def test_bad_input_is_one_sentence(self, change, words):
        image, mask, masks = change(noise((30, 40)), disk((30, 40), 6))
        with pytest.raises(ImageError, match=words) as caught:
            run(image, mask, **masks)
        assert "\n" not in str(caught.value)

    def test_too_little_to_copy_names_the_number(self):
        mask = np.ones((30, 30), bool)
        mask[:7, :9] = False
        with pytest.raises(ImageError, match="Only 15 pixels with unmasked neighborhoods"):
            run(noise((30, 30)), mask, **TEXTURE_ONLY)
        assert np.isfinite(run(noise((30, 30)), mask, split="diffusion").pixels).all()

    def test_masked_pixels_may_be_anything(self):
        image, mask = noise((40, 40)), disk((40, 40), 6)
        results = [run(np.where(mask[..., None], np.float32(value), image), mask).pixels.tobytes() for value in (np.nan, np.inf, 0.0, 7.0)]
        assert len(set(results)) == 1
