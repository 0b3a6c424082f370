"""What light finds of a surface, as values of its vertices."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from workbench.cli.parameters import JsonOption
from workbench.console import Answer
from workbench.errors import InputError, SettingsError
from workbench.pipeline.meter import Meter
from workbench.pipeline.progress import Progress
from workbench.project.settings import suggestion

_WHAT = {"occlusion": "ambient_occlusion", "accessibility": "accessibility"}


def add_bake_commands(app: typer.Typer) -> None:
    """``bake``."""

    @app.command(rich_help_panel="Tools")
    def bake(
        path: Annotated[Path, typer.Argument(help="A surface as binary PLY.")],
        out: Annotated[Path, typer.Option(help="The PLY file to write.")],
        what: Annotated[
            str,
            typer.Option(
                metavar="NAME[,NAME]",
                help="occlusion: the open share of the sky over each vertex; accessibility: the "
                "radius of the largest ball that touches it and nothing else.",
            ),
        ] = "occlusion,accessibility",
        memory_mb: Annotated[
            int,
            typer.Option(
                min=3,
                help="For geometry; a surface that needs more is cut into chunks on disk, of "
                "which those are read that rays may meet.",
            ),
        ] = 4096,
        samples: Annotated[int, typer.Option(min=1, max=65536, help="Rays a vertex.")] = 64,
        reach: Annotated[
            float | None,
            typer.Option(
                help="How far an obstacle may be, in the surface's unit; by default a quarter of "
                "the diagonal of its bounds. Balls end at half of it."
            ),
        ] = None,
        seed: Annotated[int, typer.Option(min=0, help="Of the turns of directions.")] = 0,
        as_json: JsonOption = False,
    ) -> Answer:
        """Ambient occlusion and accessibility of surfaces, also larger than memory."""
        from workbench.raytracing.baking import bake as baked_values
        from workbench.raytracing.ray_light import LightOptions
        from workbench.raytracing.surface_source import PlySource, surface_diagonal

        names = _names(what)
        _check_paths(path, out)
        if reach is not None and not 0.0 < reach < float("inf"):
            raise SettingsError(
                f"--reach {reach} is no length", expected="more than 0", fix="leave it out"
            )
        far = reach or 0.25 * surface_diagonal(PlySource(path))
        with Progress().step(f"rays at {path.name}"), Meter() as meter:
            done = baked_values(
                path,
                out,
                names=names,
                memory_bytes=memory_mb * 1_000_000,
                options=LightOptions(samples=samples, reach=far, seed=seed),
            )
        rate = done.counts.rays / max(meter.seconds, 1e-9)
        way = "plain Embree: it fits in memory" if done.in_core else "chunks on disk"
        return Answer(
            {
                "file": str(out),
                "values": list(names),
                "vertices": done.vertices,
                "without_normal": done.without_normal,
                "reach": far,
                "in_core": done.in_core,
                "rays": done.counts.rays,
                "rays_per_s": rate,
                "queries": done.counts.queries,
                "bytes_read": done.counts.bytes_read,
                "seconds": meter.seconds,
                "peak_rss_bytes": meter.peak_rss_bytes,
            },
            f"{out}: {', '.join(names)} of {done.vertices:,} vertices in {meter.seconds:.1f} s "
            f"({way}; {rate / 1e6:.2f} million rays a second)",
        )


def _names(what: str) -> tuple[str, ...]:
    names = []
    for word in what.split(","):
        if word.strip() not in _WHAT:
            raise SettingsError(
                f"There is nothing to bake by the name {word.strip()!r}",
                expected=", ".join(_WHAT),
                fix=suggestion(word.strip(), _WHAT) or "choose among the expected names",
            )
        names.append(_WHAT[word.strip()])
    return tuple(dict.fromkeys(names))


def _check_paths(path: Path, out: Path) -> None:
    if out.suffix.lower() != ".ply" or not out.parent.is_dir():
        raise InputError(
            "The surface cannot be written there",
            file=out,
            expected="a .ply file in a folder that exists",
            fix="correct --out",
        )
    if out.exists() and path.exists() and out.samefile(path):
        raise InputError(
            "The surface would be written over itself", file=out, fix="name another file by --out"
        )
