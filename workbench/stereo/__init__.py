"""Depth maps from oriented photographs: PatchMatch stereo, and where depth maps agree."""
