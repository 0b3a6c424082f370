"""Views of many overlapping labelled meshes, stitched in the picture (Arikan et al., section 6)."""
