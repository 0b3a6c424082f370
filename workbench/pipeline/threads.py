"""One thread for linear algebra, so that results do not depend on the number of cores."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

_VARIABLES = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Hold BLAS and LAPACK to one thread inside the block.

    They split sums by thread, so the last bits of a matrix product change with the number of
    cores, and Dask gives its workers one thread where the main process has all.
    """
    from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

    # The limit reaches the libraries that are loaded; the variables those that will be.
    before = {name: os.environ.get(name) for name in _VARIABLES}
    os.environ.update(dict.fromkeys(_VARIABLES, "1"))
    try:
        with threadpool_limits(limits=1, user_api="blas"):
            yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
