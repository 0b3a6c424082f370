"""Photographs kept in memory within a budget: the one asked for longest ago goes first.

Source: Arikan et al., section 7.1, after Denning 1968.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from threading import Lock
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError

_CHANNELS = 4


class PictureCache:
    """Texture pictures by the numbers of their photographs, loaded when asked for.

    Parameters
    ----------
    load : from a photograph's number to its texture picture (h, w, 4) uint8: sRGB-encoded,
        flash-corrected colour, and alpha: 255 where the pixel may be used, 0 where not.
    budget_bytes : pictures are let go before they take more, but never the one asked for.

    Attributes
    ----------
    loads, hits : how often a picture was loaded, and how often it was there.
    load_seconds : spent in loading.
    peak_bytes : the most that pictures took at once.

    Raises
    ------
    InputError : the budget is not positive; later, what was loaded is not a texture picture.
    """

    def __init__(self, load: Callable[[int], NDArray[np.uint8]], budget_bytes: int) -> None:
        if budget_bytes <= 0:
            raise InputError(
                "the cache of pictures has no room", found=f"{budget_bytes} bytes",
                fix="give it some megabytes",
            )  # fmt: skip
        self.loads, self.hits, self.load_seconds, self.peak_bytes = 0, 0, 0.0, 0
        self._load = load
        self._budget = budget_bytes
        # The next picture is believed to be as large as the largest so far.
        self._bytes, self._largest = 0, 0
        self._pictures: OrderedDict[int, NDArray[np.uint8]] = OrderedDict()
        self._lock = Lock()

    def get(self, label: int) -> NDArray[np.uint8]:
        """The texture picture of a photograph; not to be written to."""
        label = int(label)
        # One thread loads at a time: the budget would not hold otherwise.
        with self._lock:
            if label in self._pictures:
                self.hits += 1
                self._pictures.move_to_end(label)
                return self._pictures[label]
            self._let_go(self._largest)
            start = perf_counter()
            picture = _checked(self._load(label), label)
            self.load_seconds += perf_counter() - start
            self.loads += 1
            self._let_go(picture.nbytes)
            self._bytes += picture.nbytes
            self._largest = max(self._largest, picture.nbytes)
            self._pictures[label] = picture
            self.peak_bytes = max(self.peak_bytes, self._bytes)
            return picture

    def _let_go(self, needed: int) -> None:
        while self._pictures and self._bytes + needed > self._budget:
            _, oldest = self._pictures.popitem(last=False)
            self._bytes -= oldest.nbytes


def _checked(picture: NDArray[np.uint8], label: int) -> NDArray[np.uint8]:
    if picture.ndim != 3 or picture.shape[2] != _CHANNELS or picture.dtype != np.uint8:
        raise InputError(
            f"the texture picture of photograph {label} has another form",
            expected="(h, w, 4) uint8",
            found=f"{picture.shape} {picture.dtype}",
        )
    kept = np.ascontiguousarray(picture).view()
    kept.flags.writeable = False
    return kept
