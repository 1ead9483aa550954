"""Height-field terrain of any size: BDAM, batched dynamic adaptive meshes (Cignoni et al., Eurographics 2003)."""
