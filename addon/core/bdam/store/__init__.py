"""Files of a terrain store."""
