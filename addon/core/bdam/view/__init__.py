"""What a viewer sees of a terrain: cuts, tiles and their meshes."""
