"""Voxels of a surface, their levels of detail, and sparse voxel graphs."""
