"""Colour as a measurement: the ColorChecker, calibration matrices, sensor linearity."""
