"""The project folder: its table of artefacts, settings and lock."""
