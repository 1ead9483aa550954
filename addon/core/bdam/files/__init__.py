"""Files of blocks with checksums and backups, which stores of patches and of texture tiles use."""
