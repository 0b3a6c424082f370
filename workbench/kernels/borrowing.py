"""Kernels that other kernels call a million times, with arrays that the caller holds."""

from __future__ import annotations

from functools import partial

from numba import njit

borrowing = partial(njit, cache=True, nogil=True, error_model="numpy", _nrt=False)
"""As ``njit``, of what neither makes nor keeps arrays: no references to them are counted.

Counting is a locked addition for every array at every call. Comparing one patch takes a dozen
arrays, and counting them took as long as comparing.
"""
