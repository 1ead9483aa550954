"""Static levels of textured meshes, refitted by least squares, and how far they deviate from the fine mesh."""
