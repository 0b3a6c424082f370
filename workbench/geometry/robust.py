"""Spread and weights of residuals that outliers do not move."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

TUKEY = 4.685  # 95 % efficient on Gaussian residuals
_MAD_TO_SIGMA = 1.4826


def robust_sigma(residuals: NDArray[np.float64]) -> float:
    """Standard deviation from the median of absolute values; 0 without residuals."""
    return _MAD_TO_SIGMA * float(np.median(np.abs(residuals))) if len(residuals) else 0.0


def tukey_weights(residuals: NDArray[np.float64], sigma: float) -> NDArray[np.float64]:
    """Tukey's biweight (n,) of residuals (n,): 1 at zero, 0 beyond some five sigmas."""
    return np.maximum(1.0 - (residuals / (TUKEY * sigma)) ** 2, 0.0) ** 2
