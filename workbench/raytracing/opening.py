"""Who answers a surface's rays: plain Embree where memory suffices, culled casts where not."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from workbench.errors import InputError
from workbench.raytracing.chunk_building import TRIANGLES_PER_CHUNK, build_chunk_file
from workbench.raytracing.culled_rays import CulledRays, CullingOptions
from workbench.raytracing.embree_scene import scene_bytes
from workbench.raytracing.ray_hits import RayCaster
from workbench.raytracing.surface_source import SurfaceSource
from workbench.raytracing.whole_rays import WholeRays, whole_bytes

#: Geometry that has to fit, whatever the surface: a few chunks.
LEAST_MEMORY_BYTES = 4 * scene_bytes(TRIANGLES_PER_CHUNK)


@contextmanager
def opened_rays(
    source: SurfaceSource,
    memory_bytes: int,
    folder: Path,
    options: CullingOptions | None = None,
) -> Iterator[RayCaster]:
    """A caster for a surface that keeps its geometry within ``memory_bytes``.

    Parameters
    ----------
    source
        The surface.
    memory_bytes
        For geometry; rays take what their batches take besides.
    folder
        Where a surface that is too large is cut into chunks, in a file that is removed again.
    options
        Of culling.

    Raises
    ------
    InputError
        Less than ``LEAST_MEMORY_BYTES``, or a surface that cannot be used.
    """
    if memory_bytes < LEAST_MEMORY_BYTES:
        raise InputError(
            "There is too little memory for geometry.",
            expected=f"{LEAST_MEMORY_BYTES / 1e6:.1f} MB or more",
            found=f"{memory_bytes / 1e6:.1f} MB",
            fix="Give more.",
        )
    if not source.triangles:
        raise InputError("The surface has no triangles.", fix="Check the file it came from.")
    if whole_bytes(source) <= memory_bytes:
        yield WholeRays(source)
        return
    with tempfile.TemporaryDirectory(prefix=".raychunks.", dir=folder) as scratch:
        file = build_chunk_file(source, Path(scratch) / "surface.raychunks")
        yield CulledRays(file, memory_bytes, options)
