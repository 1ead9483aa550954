"""The sRGB transfer function (IEC 61966-2-1), continued beyond 0..1, and the luminance of Rec.709 colors."""

import numpy as np

LINEAR_LIMIT = 0.0031308  # linear values up to here are encoded by a straight line
LINEAR_SCALE, SCALE, OFFSET, GAMMA = 12.92, 1.055, 0.055, 2.4
LUMINANCE = np.float32([0.2126, 0.7152, 0.0722])  # CIE Y of linear Rec.709 colors


def encode_signed_srgb(linear: np.ndarray) -> np.ndarray:
    """Return the sRGB-encoded values of scene-linear ones, of any shape. The curve continues above 1 and is mirrored below 0, so that no
    value is lost."""
    magnitude = np.abs(linear)
    curve = SCALE * magnitude ** (1.0 / GAMMA) - OFFSET
    return np.copysign(np.where(magnitude <= LINEAR_LIMIT, LINEAR_SCALE * magnitude, curve), linear)


def decode_signed_srgb(encoded: np.ndarray) -> np.ndarray:
    """Return the scene-linear values of sRGB-encoded ones, of any shape. Inverts `encode_signed_srgb`."""
    magnitude = np.abs(encoded)
    curve = ((magnitude + OFFSET) / SCALE) ** GAMMA
    is_line = magnitude <= LINEAR_SCALE * LINEAR_LIMIT
    return np.copysign(np.where(is_line, magnitude / LINEAR_SCALE, curve), encoded)


LINEAR_OF_BYTE = decode_signed_srgb(np.arange(256) / 255.0).astype(np.float32)  # scene-linear values by sRGB byte
