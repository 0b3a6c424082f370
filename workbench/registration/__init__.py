"""Placing range scans in one frame."""
