"""From few masked examples, or a rectangle, to masks of all images: 255 keeps, 0 is clutter."""
