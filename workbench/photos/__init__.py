"""Photographs as measurements of light: decoding, EXIF, exposure, vignetting."""
