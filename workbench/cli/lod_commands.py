"""Commands that turn any model into level-of-detail and point files, and these into points."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from workbench.cli.parameters import JsonOption
from workbench.console import Answer
from workbench.errors import InputError, SettingsError
from workbench.pipeline.meter import Meter
from workbench.pipeline.progress import Progress
from workbench.project.settings import suggestion

if TYPE_CHECKING:
    from workbench.pipeline.model_formats import Subset


def add_lod_commands(app: typer.Typer) -> None:
    """``lod`` and ``decode``."""

    @app.command(rich_help_panel="Tools")
    def lod(
        model: Annotated[
            Path, typer.Argument(help="A surface (PLY, OBJ, GLB, glTF, STL) or a cloud of points.")
        ],
        out: Annotated[Path, typer.Option(help="The folder to write to, or the file.")],
        file_format: Annotated[
            str,
            typer.Option(
                "--format",
                help="voxels: levels of detail; svo, svdag, ussvdag, esvdag, ssvdag, osvdag: one "
                "sparse voxel graph, which can be traced; surfels: levels of discs; ci, eci, "
                "context: points as coded cells; laz, las, copc, potree, e57, ply, layered: clouds "
                "of points.",
            ),
        ] = "voxels",
        resolution: Annotated[
            int | None,
            typer.Option(
                min=1,
                help="Voxels or cells along the longest side; 2048 voxels (a power of two) or "
                "1024 cells by default.",
            ),
        ] = None,
        count: Annotated[
            int | None, typer.Option(min=1, help="surfels: of each node, at most; 100000.")
        ] = None,
        candidates: Annotated[
            int | None,
            typer.Option(min=8, help="surfels: pixels of the pictures they are chosen from; 1024."),
        ] = None,
        seed: Annotated[int | None, typer.Option(min=0, help="Of random draws; 0.")] = None,
        shell: Annotated[
            bool | None, typer.Option("--shell", help="voxels: for models that one can enter.")
        ] = None,
        subset: Annotated[
            str | None,
            typer.Option(
                help="thin or conservative: every voxel the surface touches. Default thin for "
                "voxels, conservative for graphs."
            ),
        ] = None,
        geometry: Annotated[
            bool | None,
            typer.Option(
                "--geometry/--no-geometry", help="voxels: keep the surface itself for close-ups."
            ),
        ] = None,
        compare: Annotated[
            bool | None,
            typer.Option("--compare", help="Graphs: tell the size of every encoding."),
        ] = None,
        workers: Annotated[
            int | None, typer.Option(min=1, help="Threads; default one per core.")
        ] = None,
        as_json: JsonOption = False,
    ) -> Answer:
        """Levels of detail and point formats of a surface or a cloud."""
        from workbench.pipeline.model_formats import FormatOptions, write_format

        if subset is not None:
            _check_name("subset", subset, ("thin", "conservative"))
        options = FormatOptions(
            resolution=resolution,
            count=count,
            candidates=candidates,
            seed=seed,
            shell=shell,
            subset=cast("Subset | None", subset),
            geometry=geometry,
            compare=compare,
            workers=workers or _cores(),
        )
        with Progress().step(f"{model.name} as {file_format}"), Meter() as meter:
            told = write_format(model, out, file_format, options)
        told |= {"seconds": meter.seconds, "peak_rss_bytes": meter.peak_rss_bytes}
        return Answer(
            told,
            f"{told['file']}: {told['items']:,} {told['unit']}, {told['bytes'] / 1e6:,.2f} MB, "
            f"{told['bits_per_item']:.2f} bits each, in {meter.seconds:.1f} s"
            + "".join(f"\n  {warning}" for warning in told.get("warnings", ()))
            + "".join(
                f"\n  {row['encoding']:8s}{row['nodes']:12,d} nodes"
                f"{row['bytes'] / 1e6:10,.2f} MB{row['bits_per_voxel']:8.3f} bits per voxel"
                for row in told.get("encodings", ())
            ),
        )

    @app.command(rich_help_panel="Tools")
    def decode(
        path: Annotated[
            Path, typer.Argument(help="A .vlod, .voxgraph, .surfels, .pcube or point file.")
        ],
        out: Annotated[Path, typer.Option(help="The PLY file to write.")],
        level: Annotated[
            int | None, typer.Option(help="Of a .vlod: 2^level voxels a side; default the finest.")
        ] = None,
        count: Annotated[
            int | None,
            typer.Option(min=1, help="Of a .surfels: so many of the whole; default the finest."),
        ] = None,
        as_json: JsonOption = False,
    ) -> Answer:
        """Any of our files back as points, with what is known of each."""
        from workbench.pipeline.model_decoding import decode as decode_file

        _check_out(out, ".ply")
        with Progress().step(f"decoding {path.name}"), Meter() as meter:
            told = decode_file(path, out, level=level, count=count)
        return Answer(
            told | {"seconds": meter.seconds},
            f"{out}: {told['items']:,} {told['unit']} in {meter.seconds:.1f} s",
        )


def _check_name(kind: str, name: str, known: tuple[str, ...]) -> None:
    if name not in known:
        raise SettingsError(
            f"There is no {kind} {name!r}",
            expected=", ".join(known),
            fix=suggestion(name, known) or "choose one of the expected names",
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
