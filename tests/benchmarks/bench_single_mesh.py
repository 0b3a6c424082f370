"""Seams and run time of a single textured mesh, by levelling, labelling and size.

    python -m tests.benchmarks.bench_single_mesh OUT
    python -m tests.benchmarks.bench_single_mesh OUT --surface FILE --cameras DIR --photos DIR

textures a painted ball of 81,920 triangles from twelve photographs of one megapixel whose
exposures differ by some per cent, with each setting, and compares it with the paint: the standard
deviation of the error at 100,000 places, once a gain for the whole is taken out, and the colour
step that is left at seams. Prints tables and writes ``single_mesh.svg`` and, where an SVG renderer
is at hand, ``.png`` to OUT. With a surface, COLMAP's text files of its cameras and a folder of
photographs (named like the cameras, with alpha where they have masks), it times the parts of
texturing that instead and writes the textured GLB and OBJ to OUT. Times are wall times of one
process: compare them within one run.
"""

from __future__ import annotations

import argparse
import resource
from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import TypeVar

import cv2
import numpy as np
import trimesh
from numpy.typing import NDArray

from tests.benchmarks.drawing import draw_tradeoff
from tests.texturing.scenes import paint, picture, ring
from workbench.formats.colmap import read_colmap_text
from workbench.formats.surface_files import read_surface
from workbench.formats.textured_gltf import write_textured_glb
from workbench.formats.textured_obj import write_textured_obj
from workbench.geometry.labelled_mesh import NO_PHOTO, LabelledMesh
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.surface_rays import SurfaceRays
from workbench.geometry.textured_mesh import TexturedMesh
from workbench.kernels.patch_drawing import read_between
from workbench.texturing.cost_options import CostOptions
from workbench.texturing.mesh_texture import AtlasOptions, TextureReport, textured
from workbench.texturing.picture_cache import PictureCache
from workbench.texturing.single_mesh import far_of_surface, labelled_surface
from workbench.verification.figures import TradeoffPoint

_SUBDIVISIONS, _PHOTOS, _SIZE, _PLACES = 6, 12, (1200, 900), 100_000
_BUDGET = 4 << 30
T = TypeVar("T")


def ball() -> TriangleMesh:
    """Painted at its vertices, too."""
    solid = trimesh.creation.icosphere(_SUBDIVISIONS, radius=0.9)
    vertices = np.asarray(solid.vertices, float)
    colors = np.rint(255 * paint(vertices)).astype(np.uint8)
    return TriangleMesh(vertices, np.asarray(solid.faces, np.int32), {"color": colors})


def error_of(texture: TexturedMesh, labels: NDArray[np.int32], mesh: TriangleMesh) -> float:
    """Standard deviation of what photographs made of the paint, of 255, without a common gain."""
    rng = np.random.default_rng(0)
    triangles = rng.choice(np.flatnonzero(labels != NO_PHOTO), _PLACES)
    shares = rng.dirichlet((1, 1, 1), _PLACES)
    truth = 255 * paint(np.einsum("nk,nkc->nc", shares, mesh.vertices[mesh.triangles[triangles]]))
    found = np.empty_like(truth)
    corners = texture.texture_places[texture.mesh.triangles[triangles]]
    for page, pixels in enumerate(texture.pictures):
        there = texture.pages[triangles] == page
        size = np.array([pixels.shape[1], pixels.shape[0]])
        at = np.einsum("nk,nkc->nc", shares[there], corners[there]) * size
        found[there] = read_between(pixels, at)
    gain = (truth * found).sum() / (found * found).sum()
    return float(np.sqrt(np.square(gain * found - truth).mean()))


def timed(what: Callable[[], T]) -> tuple[T, float]:
    """A result, and the seconds it took."""
    start = perf_counter()
    found = what()
    return found, perf_counter() - start


def by_setting(out: Path) -> None:
    """The painted ball with each setting."""
    mesh, cameras = ball(), ring(_PHOTOS, size=_SIZE, focal=1300.0)
    rays, rng = SurfaceRays(mesh), np.random.default_rng(1)
    gains = rng.uniform(0.92, 1.06, _PHOTOS)
    pictures = {k: picture(rays, camera, gains[k]) for k, camera in cameras.items()}
    far = far_of_surface(mesh, cameras)

    def labelled(smoothness: float, most: int) -> LabelledMesh:
        options = CostOptions(far, smoothness=smoothness, most_candidates=most)
        return labelled_surface(mesh, cameras, pictures.__getitem__, options)[0]

    # Compiling is not what is measured.
    textured(labelled(0.2, 0), cameras, pictures.__getitem__)
    points = []
    print("setting                          error   step   seams     s")
    for name, smoothness, most, atlas in (
        ("no levelling", 0.2, 0, AtlasOptions(levels="none")),
        ("global", 0.2, 0, AtlasOptions(levels="global")),
        ("global, stiffness 1", 0.2, 0, AtlasOptions(levels="global", stiffness=1.0)),
        ("global, stiffness 0.01", 0.2, 0, AtlasOptions(levels="global", stiffness=0.01)),
        ("global and local", 0.2, 0, AtlasOptions()),
        ("global and local, λs 0", 0.0, 0, AtlasOptions()),
        ("global and local, λs 2", 2.0, 0, AtlasOptions()),
        ("global and local, best 2", 0.2, 2, AtlasOptions()),
    ):
        chosen, labelling_s = timed(lambda s=smoothness, m=most: labelled(s, m))
        (texture, report), atlas_s = timed(
            lambda c=chosen, a=atlas: textured(c, cameras, pictures.__getitem__, a)
        )
        error, seconds = error_of(texture, chosen.labels, mesh), labelling_s + atlas_s
        step, length = report.after.mean, report.after.length
        print(f"{name:30s} {error:7.2f} {step:6.2f} {length:7.2f} {seconds:5.2f}")
        points.append(TradeoffPoint(name, seconds, error))
    draw_tradeoff(out, "single_mesh", points, "error of 255", "global and local")


def of_files(out: Path, surface: Path, folder: Path, photos: Path) -> None:
    """Times of the parts for a surface and its photographs."""
    out.mkdir(parents=True, exist_ok=True)
    mesh = read_surface(surface)
    if "color" not in mesh.vertex_attributes:
        grey = np.full((len(mesh.vertices), 3), 128, np.uint8)
        mesh = mesh.with_attributes(color=grey)
    named = sorted(read_colmap_text(folder).photo_cameras().items())
    cameras: dict[int, PhotoCamera] = {k: camera for k, (_, camera) in enumerate(named)}
    files = {path.stem: path for path in sorted(photos.iterdir())}

    def load(photo: int) -> NDArray[np.uint8]:
        found = cv2.imread(str(files[Path(named[photo][0]).stem]), cv2.IMREAD_UNCHANGED)
        kind = cv2.COLOR_BGR2RGBA if found.shape[2] == 3 else cv2.COLOR_BGRA2RGBA
        return np.asarray(cv2.cvtColor(found, kind), np.uint8)

    cache = PictureCache(load, _BUDGET)
    options = CostOptions(far_of_surface(mesh, cameras), most_candidates=8)
    (chosen, labelling), labelling_s = timed(
        lambda: labelled_surface(mesh, cameras, cache.get, options, threads=2)
    )
    (texture, report), atlas_s = timed(lambda: textured(chosen, cameras, cache.get))
    _, glb_s = timed(lambda: write_textured_glb(out / "single_mesh.glb", texture))
    _, obj_s = timed(lambda: write_textured_obj(out / "single_mesh.obj", texture))
    told(report)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    total = labelling_s + atlas_s + glb_s
    print(f"{len(mesh.triangles)} triangles, {len(cameras)} photographs")
    print(f"energy {labelling.before.total:.4g} → {labelling.energy.total:.4g}")
    print(f"loads {cache.loads}, {cache.load_seconds:.1f} s, most {cache.peak_bytes / 1e9:.2f} GB")
    print(
        f"labels {labelling_s:.1f} s, atlas {atlas_s:.1f} s, GLB {glb_s:.1f} s, OBJ {obj_s:.1f} s"
    )
    print(f"in all, with loading and the GLB: {total:.1f} s; at most {peak:.2f} GB")


def told(report: TextureReport) -> None:
    """Print what became of a mesh."""
    print(f"{report.patches} patches, {report.bare_patches} of them without a photograph")
    sizes = ", ".join(f"{width} × {height}" for width, height in report.page_sizes)
    print(f"pages {sizes}; {report.utilisation:.1%} of them used")
    print(f"colour step {report.before.mean:.2f} → {report.after.mean:.2f} of 255")
    if report.levelling is not None:
        moved = report.levelling
        print(
            f"levelling moved by {moved.rms_shift:.1f} (r.m.s.), {moved.greatest_shift:.0f} at most"
        )


def main() -> None:
    """Run what the arguments ask for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path)
    for name in ("surface", "cameras", "photos"):
        parser.add_argument(f"--{name}", type=Path)
    given = parser.parse_args()
    if given.surface is None:
        by_setting(given.out)
    else:
        of_files(given.out, given.surface, given.cameras, given.photos)


if __name__ == "__main__":
    main()
