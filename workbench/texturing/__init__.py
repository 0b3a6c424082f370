"""Texturing: which photograph each triangle is textured with, and how seams are hidden."""
