"""Progressive blue surfels: one order of a surface's samples for every level of detail."""
