"""The random number of an object that shaders read as Object Info > Random."""

MASK = 2**32 - 1
SEED = 0xDEADBEEF + 8 + 13  # Of a key of two words.
ROTATIONS = (14, 11, 25, 16, 4, 14, 24)


def compute_object_random(name: str) -> float:
    """Return the random number, 0 to 1, of an object called `name` that is no instance, as Cycles and EEVEE compute it.

    It is a hash of the name: Jenkins' lookup3 of two words, the second of which is 0.
    """
    text = 0
    for byte in name.encode():
        text = (text * 37 + byte) & MASK
    state = [(SEED + text) & MASK, SEED, SEED]
    for step, rotation in enumerate(ROTATIONS):
        target, operand = (step + 2) % 3, (step + 1) % 3
        rotated = (state[operand] << rotation | state[operand] >> (32 - rotation)) & MASK
        state[target] = ((state[target] ^ state[operand]) - rotated) & MASK
    return read_random_id(state[2])


def read_random_id(random_id: int) -> float:
    """Return the random number, 0 to 1, of an instance with this ID, which Python reads as a signed integer."""
    return (random_id & MASK) / MASK
