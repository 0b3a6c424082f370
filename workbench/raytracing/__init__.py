"""Rays against surfaces that may be larger than the memory: occlusion, shadows, one bounce."""
