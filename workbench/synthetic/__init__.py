"""Scenes and scanners with known truth."""
