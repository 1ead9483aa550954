"""Meshes as EXT_meshopt_compression stores them: triangles and vertices in an order that compresses well, and encoded buffers.

The codecs are those of meshoptimizer.
"""

import numpy as np

EXTENSION = "EXT_meshopt_compression"
OCTAHEDRAL, NORMAL_BITS = "OCTAHEDRAL", 8
VERSION, LEVEL = 0, 3  # The codec of the extension, and how hard it tries: the most.


def reorder(indices: np.ndarray, attributes: dict[str, np.ndarray]) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Return the indices (3 T,) uint32 of triangles and the attributes of vertices, in an order that compresses well. The first corners of
    triangles may change, their orientation does not."""
    import meshopt  # here, so that importing the core needs only NumPy and SciPy

    ordered, places, count = meshopt.reorder_mesh(indices.astype(np.uint32), triangles=True, optsize=True)
    vertices = np.argsort(places, kind="stable")[:count]
    return ordered, {name: values[vertices] for name, values in attributes.items()}


def encode_triangles(rows: np.ndarray) -> tuple[bytes, dict[str, object]]:
    """Return encoded indices (3 T, 2 or 4) uint8 of little-endian integers, and what the extension says about them."""
    import meshopt

    indices = rows.view(f"<u{rows.shape[1]}").ravel().astype(np.uint32)
    return meshopt.encode_gltf_buffer(indices, "TRIANGLES", VERSION), {"mode": "TRIANGLES"}


def encode_rows(rows: np.ndarray, is_normal: bool) -> tuple[bytes, dict[str, object]]:
    """Return encoded vertices (V, S) uint8 of S bytes, a multiple of 4, and what the extension says about them.

    is_normal: whether each is a unit vector of three int8, fractions of 127, which becomes the nearest one with an octahedral code.
    """
    import meshopt

    if is_normal:
        vectors = np.ones((len(rows), 4), np.float32)
        vectors[:, :3] = rows.view(np.int8)[:, :3] / 127.0
        vectors[:, :3] /= np.maximum(np.linalg.norm(vectors[:, :3], axis=1, keepdims=True), 1e-6)
        rows = meshopt.encode_filter_oct(vectors, 4, NORMAL_BITS)
    described = {"mode": "ATTRIBUTES", **({"filter": OCTAHEDRAL} if is_normal else {})}
    return meshopt.encode_vertex_buffer_level(rows, LEVEL, VERSION), described
