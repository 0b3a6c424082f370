"""Commands that turn any surface into level-of-detail files, and these back into points."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Literal, cast

import typer

from workbench.cli.parameters import JsonOption
from workbench.console import Answer
from workbench.errors import InputError, SettingsError
from workbench.pipeline.meter import Meter
from workbench.pipeline.progress import Progress
from workbench.project.settings import suggestion

Subset = Literal["thin", "conservative"]


def add_lod_commands(app: typer.Typer) -> None:
    """``lod`` and ``decode``."""

    @app.command(rich_help_panel="Tools")
    def lod(
        mesh: Annotated[Path, typer.Argument(help="PLY, OBJ, GLB, glTF or STL.")],
        out: Annotated[Path, typer.Option(help="The folder to write to.")],
        file_format: Annotated[
            str,
            typer.Option(
                "--format",
                help="voxels: levels of detail; svo, svdag, ussvdag, esvdag, ssvdag, osvdag: "
                "one sparse voxel graph, which can be traced.",
            ),
        ] = "voxels",
        resolution: Annotated[
            int, typer.Option(help="Voxels along the side of the cube, a power of two.")
        ] = 2048,
        shell: Annotated[
            bool, typer.Option("--shell", help="voxels: for models that one can enter.")
        ] = False,
        subset: Annotated[
            str | None,
            typer.Option(
                help="thin or conservative: every voxel the surface touches. Default thin for "
                "voxels, conservative for graphs."
            ),
        ] = None,
        geometry: Annotated[
            bool,
            typer.Option(
                "--geometry/--no-geometry", help="voxels: keep the surface itself for close-ups."
            ),
        ] = True,
        compare: Annotated[
            bool, typer.Option("--compare", help="Graphs: tell the size of every encoding.")
        ] = False,
        workers: Annotated[
            int | None, typer.Option(min=1, help="Threads; default one per core.")
        ] = None,
        as_json: JsonOption = False,
    ) -> Answer:
        """Voxels of a surface: levels of detail, or one sparse voxel graph."""
        from workbench.voxels.lod_export import LodOptions
        from workbench.voxels.surface_export import VOXEL_FORMATS, export_surface_voxels

        _check_name("format", file_format, VOXEL_FORMATS)
        default = "thin" if file_format == "voxels" else "conservative"
        chosen = default if subset is None else subset
        _check_name("subset", chosen, ("thin", "conservative"))
        _check_use(file_format, shell, geometry, compare)
        if out.exists() and not out.is_dir():
            raise InputError(
                "A folder was expected, this is a file.", file=out, fix="Name a folder."
            )
        options = LodOptions(
            resolution=resolution,
            subset=cast(Subset, chosen),
            shell=shell,
            geometry=geometry,
            workers=workers or _cores(),
        )
        progress = Progress()
        with progress.step(f"{mesh.name}: {file_format} at {resolution}³"), Meter() as meter:
            told = export_surface_voxels(mesh, out, file_format, options, compare=compare)
        told |= {"seconds": meter.seconds, "peak_rss_bytes": meter.peak_rss_bytes}
        return Answer(
            told,
            f"{told['file']}: {told['items']:,} voxels, {told['bytes'] / 1e6:,.2f} MB, "
            f"{told['bits_per_item']:.2f} bits each, in {meter.seconds:.1f} s"
            + "".join(
                f"\n  {row['encoding']:8s}{row['nodes']:12,d} nodes"
                f"{row['bytes'] / 1e6:10,.2f} MB{row['bits_per_voxel']:8.3f} bits per voxel"
                for row in told.get("encodings", ())
            ),
        )

    @app.command(rich_help_panel="Tools")
    def decode(
        path: Annotated[Path, typer.Argument(help="A .vlod or .voxgraph file.")],
        out: Annotated[Path, typer.Option(help="The PLY file to write.")],
        level: Annotated[
            int | None, typer.Option(help="Of a .vlod: 2^level voxels a side; default the finest.")
        ] = None,
        as_json: JsonOption = False,
    ) -> Answer:
        """Voxels of a file back as points, with their normals and colours."""
        from workbench.voxels.voxel_points import voxel_points, write_voxel_points

        _check_out(out, ".ply")
        with Progress().step(f"decoding {path.name}"), Meter() as meter:
            voxels = voxel_points(path, level)
            write_voxel_points(out, voxels)
        return Answer(
            {
                "file": str(out),
                "items": len(voxels),
                "resolution": voxels.grid.resolution,
                "voxel_size": voxels.grid.voxel_size,
                "seconds": meter.seconds,
            },
            f"{out}: {len(voxels):,} voxels in {meter.seconds:.1f} s",
        )


def _check_name(kind: str, name: str, known: tuple[str, ...]) -> None:
    if name not in known:
        raise SettingsError(
            f"There is no {kind} {name!r}",
            expected=", ".join(known),
            fix=suggestion(name, known) or "choose one of the expected names",
        )


def _check_use(file_format: str, shell: bool, geometry: bool, compare: bool) -> None:
    """No option is passed over in silence."""
    if file_format == "voxels" and compare:
        raise SettingsError(
            "--compare compares encodings of graphs",
            found="--format voxels",
            fix="add --format ssvdag, or leave it out",
        )
    if file_format != "voxels" and (shell or not geometry):
        raise SettingsError(
            f"--{'shell' if shell else 'no-geometry'} is of level-of-detail voxels alone",
            found=f"--format {file_format}",
            fix="leave it out: a graph has neither faces nor the surface itself",
        )


def _check_out(out: Path, suffix: str) -> None:
    """Before the work: the folder is there and the file is named for what it will be."""
    if out.suffix.lower() != suffix or not out.parent.is_dir():
        raise InputError(
            "The result cannot be written there",
            file=out,
            expected=f"a {suffix} file in a folder that exists",
            fix="correct --out",
        )


def _cores() -> int:
    """Cores this process may use; a batch system often grants fewer than there are."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
