"""A whole series of photographs, taken on this machine's cores or on other machines."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from functools import lru_cache
from pathlib import Path
from typing import Any

from workbench.synthetic import photo_writing
from workbench.synthetic.options import SimulationOptions
from workbench.synthetic.photo_options import PhotoOptions
from workbench.synthetic.photo_writing import PhotoItem, is_finished, options_digest, photo_items
from workbench.synthetic.photography import Studio, studio_of
from workbench.synthetic.scene import Scene
from workbench.synthetic.simulation import build_scene

Progress = Callable[[int, int, str], None]
# Maps a function of name and payload over the payloads, on other machines: yields (name,
# result) as they come. The path is a file of the project that those machines must see.
PhotographsElsewhere = Callable[
    [Path, Callable[[str, dict[str, Any]], None], dict[str, dict[str, Any]]],
    Iterable[tuple[str, None]],
]

# Photographs computed at once: each holds its own mosaic and truth.
_MOST_AT_ONCE = 8


def write_photos(
    out: Path,
    scene: Scene,
    sim_options: SimulationOptions,
    photo_options: PhotoOptions,
    progress: Progress | None = None,
    workers: int | None = None,
    elsewhere: PhotographsElsewhere | None = None,
) -> Path:
    """Photograph a scene and write everything below ``out``; the same options, the same bytes.

    What an earlier call with the same options has finished is not taken again.

    Parameters
    ----------
    out : folder to fill; made where it is missing.
    scene : as ``build_scene(sim_options)`` returns it.
    sim_options : the options the scene was built with; part of what makes a photograph stale.
    photo_options : of the photographs.
    progress : called with (done, total, label).
    workers : photographs computed at once; one per core where nothing is said.
    elsewhere : maps the photographs over other machines that see ``out`` at the same path,
        instead of over the cores of this one.

    Returns
    -------
    ``out``.

    Notes
    -----
    ``photos/photo_NNN.dng`` and ``photos/chart_NN.dng`` are what the pipeline reads,
    ``calibration/flat_NN.dng`` and ``calibration/linearity_NN.dng`` what it may read.
    ``truth/photos/`` holds:

    * ``cameras.txt``, ``images.txt``, ``points3D.txt`` (no points): true cameras in COLMAP's
      conventions; their world is the scene's local frame;
    * ``object/``, ``support/``, ``shadow/`` with ``photo_NNN.png``: 255 where the pixel shows
      the object, its support, a surface without the flash's light; else 0;
    * ``albedo/photo_NNN.png``: 16 bits, linear Rec. 709 × 65535; ``depth/photo_NNN.npz``:
      ``depth`` (rows, cols) float32, metres along the optical axis, ``diffuse`` and
      ``specular`` levels; as the option ``rendering.truth`` asks;
    * ``surface_albedo.npz``: ``albedo`` (n, 3) float32 linear Rec. 709 at the vertices of
      ``truth/surface.npz``;
    * ``photos.json``: flash position and power of every photograph, the sensor, all options;
    * ``charts.json``: corners of the charts and their patches in pixels and their colours;
    * ``records/``: one file per finished photograph.
    """
    studio = studio_of(scene, photo_options)
    digest = options_digest(sim_options, photo_options)
    items = photo_items(photo_options)
    report = progress or _silent
    report(0, len(items), "preparing the photographs")
    _make_folders(out, photo_options)
    waiting = {item.name: item for item in items if not is_finished(out, item, digest)}
    done = len(items) - len(waiting)
    if elsewhere is None:
        finished = _taken_here(out, studio, waiting, digest, workers)
    else:
        finished = _taken_elsewhere(out, studio, sim_options, waiting, digest, elsewhere)
    for name in finished:
        done += 1
        report(done, len(items), name)
    photo_writing.write_photo_truth(out, studio, sim_options)
    return out


def photograph_for(name: str, payload: dict[str, Any]) -> None:
    """One photograph by a process that has nothing but the payload and the project's folder.

    Parameters
    ----------
    name : of the photograph.
    payload : plain data as `write_photos` makes it: ``out``, the options as JSON, ``kind``,
        ``index``, ``digest``.
    """
    options = PhotoOptions.model_validate_json(payload["photos"])
    item = PhotoItem(payload["kind"], payload["index"])
    scene = _scene_for(payload["simulation"])
    photo_writing.write_photograph(Path(payload["out"]), scene, options, item, payload["digest"])


@lru_cache(maxsize=1)
def _scene_for(simulation: str) -> Scene:
    """The scene of options given as JSON: built once in a process, which costs seconds."""
    return build_scene(SimulationOptions.model_validate_json(simulation))


def _taken_here(
    out: Path,
    studio: Studio,
    waiting: dict[str, PhotoItem],
    digest: str,
    workers: int | None,
) -> Iterator[str]:
    """Names of the photographs as they are finished on this machine's cores."""
    if not waiting:
        return
    # Built once before the threads start, which would each wait for it.
    _ = studio.subject.middle, studio.subject.corner_normals, studio.exchange
    with ThreadPoolExecutor(max(1, min(workers or os.cpu_count() or 1, _MOST_AT_ONCE))) as pool:
        jobs = {
            pool.submit(
                photo_writing.write_photograph, out, studio.scene, studio.options, item, digest
            ): name
            for name, item in waiting.items()
        }
        try:
            for job in as_completed(jobs):
                job.result()
                yield jobs[job]
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def _taken_elsewhere(
    out: Path,
    studio: Studio,
    sim_options: SimulationOptions,
    waiting: dict[str, PhotoItem],
    digest: str,
    elsewhere: PhotographsElsewhere,
) -> Iterator[str]:
    """Names of the photographs as other machines finish them."""
    shared = {
        "out": str(out),
        "simulation": sim_options.model_dump_json(),
        "photos": studio.options.model_dump_json(),
        "digest": digest,
    }
    payloads = {
        name: shared | {"kind": item.kind, "index": item.index} for name, item in waiting.items()
    }
    witness = out / "truth" / "photos" / "under_way"
    witness.write_text(digest, encoding="utf-8")
    try:
        for name, _ in elsewhere(witness, photograph_for, payloads):
            yield name
    finally:
        witness.unlink()


def _make_folders(out: Path, options: PhotoOptions) -> None:
    truth = out / "truth" / "photos"
    folders = [out / "photos", out / "calibration", truth / "records"]
    folders += [truth / name for name in ("object", "support", "shadow")]
    if options.rendering.truth != "masks":
        folders.append(truth / "albedo")
    if options.rendering.truth == "full":
        folders.append(truth / "depth")
    for folder in folders:
        folder.mkdir(parents=True, exist_ok=True)


def _silent(done: int, total: int, label: str) -> None:
    """Progress that nobody watches."""
