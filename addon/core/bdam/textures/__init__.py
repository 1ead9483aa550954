"""The quadtree of texture tiles (sections 3.1 and 5.3)."""
