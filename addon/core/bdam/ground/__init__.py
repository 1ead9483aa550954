"""Heights and normals of the ground at any position."""
