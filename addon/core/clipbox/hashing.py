"""Random numbers that belong to places of a lattice: the same for a place and a seed, whoever asks and in whatever order."""

import numpy as np

AXIS_FACTORS = (0x8DA6B343, 0xD8163841, 0xCB1AB31F)
SEED_FACTOR = 0x9E3779B9
HALF = np.uint32(16)


def hashed_lattice(x: np.ndarray, y: np.ndarray, z: np.ndarray, seed: int) -> np.ndarray:
    """Random uint32 at lattice places; x, y, z are integers of any shapes that broadcast."""
    first, second, third = (_as_bits(each) * np.uint32(factor) for each, factor in zip((x, y, z), AXIS_FACTORS, strict=True))
    return mixed(first + second ^ third + np.uint32((seed * SEED_FACTOR) & 0xFFFFFFFF))


def mixed(bits: np.ndarray) -> np.ndarray:
    """uint32 whose bits all depend on all bits of `bits` (the finaliser of MurmurHash3, Appleby, public domain)."""
    bits = bits ^ (bits >> HALF)
    bits *= np.uint32(0x85EBCA6B)
    bits ^= bits >> np.uint32(13)
    bits *= np.uint32(0xC2B2AE35)
    bits ^= bits >> HALF
    return bits


def fractions(bits: np.ndarray, number: int) -> np.ndarray:
    """The `number`-th random float64 from 0 to 1 that belongs to each of `bits`."""
    return mixed(bits + np.uint32((number * SEED_FACTOR + 0x7F4A7C15) & 0xFFFFFFFF)) * 2.0**-32


def _as_bits(values: np.ndarray) -> np.ndarray:
    """Integers as uint32, with what exceeds 32 bits mixed in, so that far places do not repeat near ones."""
    values = np.asarray(values, np.int64)
    low, high = (values & 0xFFFFFFFF).astype(np.uint32), (values >> 32).astype(np.uint32)
    return low ^ high * np.uint32(0xA511E9B3)
