"""Point clouds as occupied cells: the CI and ECI codecs, and one that is entropy-coded."""
