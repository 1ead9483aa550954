"""Images of levels in glTF files: as small as the distance of a level allows, with normals for its own surface."""
