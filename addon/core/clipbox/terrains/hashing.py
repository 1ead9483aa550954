"""Random numbers hashed from lattice points and a seed: reproducible in any order of evaluation."""

import numpy as np

AXIS_FACTORS = (0x8DA6B343, 0xD8163841, 0xCB1AB31F)
SEED_FACTOR = 0x9E3779B9
HALF_WORD = np.uint32(16)


def hash_lattice(x: np.ndarray, y: np.ndarray, z: np.ndarray, seed: int) -> np.ndarray:
    """Return random uint32 per lattice point. x, y, z are integers whose shapes broadcast."""
    x_bits, y_bits, z_bits = (
        _fold_to_32_bits(indices) * np.uint32(factor) for indices, factor in zip((x, y, z), AXIS_FACTORS, strict=True)
    )
    return murmur3_finalize(x_bits + y_bits ^ z_bits + np.uint32((seed * SEED_FACTOR) & 0xFFFFFFFF))


def murmur3_finalize(bits: np.ndarray) -> np.ndarray:
    """Mix the bits of uint32 (finalizer of MurmurHash3, Appleby, public domain): every output bit depends on all input bits."""
    bits = bits ^ (bits >> HALF_WORD)
    bits *= np.uint32(0x85EBCA6B)
    bits ^= bits >> np.uint32(13)
    bits *= np.uint32(0xC2B2AE35)
    bits ^= bits >> HALF_WORD
    return bits


def uniform_random(bits: np.ndarray, index: int) -> np.ndarray:
    """Return the random float64 number `index` in [0, 1) of each hash in `bits`."""
    return murmur3_finalize(bits + np.uint32((index * SEED_FACTOR + 0x7F4A7C15) & 0xFFFFFFFF)) * 2.0**-32


def _fold_to_32_bits(values: np.ndarray) -> np.ndarray:
    """Return integers as uint32. The high 32 bits are mixed in, so that distant lattice points do not repeat near ones."""
    values = np.asarray(values, np.int64)
    low, high = (values & 0xFFFFFFFF).astype(np.uint32), (values >> 32).astype(np.uint32)
    return low ^ high * np.uint32(0xA511E9B3)
