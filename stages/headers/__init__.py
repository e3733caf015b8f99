"""Headers of image files: bytes to facts, within bounds, without decoding a pixel."""
