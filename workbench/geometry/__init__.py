"""Transforms, range maps, meshes and spatial search: the vocabulary of every domain."""
