"""Scale space of textured meshes: at which scales each vertex is a feature."""
