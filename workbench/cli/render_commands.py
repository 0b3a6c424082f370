"""Pictures without a display: of files, and of projects."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from workbench.cli.parameters import JsonOption
from workbench.console import Answer
from workbench.errors import InputError, SettingsError
from workbench.pipeline.meter import Meter
from workbench.pipeline.progress import Progress
from workbench.project.settings import suggestion


def add_render_commands(app: typer.Typer) -> None:
    """``render``."""

    @app.command(rich_help_panel="Tools")
    def render(
        path: Annotated[Path, typer.Argument(help="A file of the mode's kind, or a project.")],
        out: Annotated[Path, typer.Option(help="The PNG file to write.")],
        mode: Annotated[
            str,
            typer.Option(
                help="voxels, or graph: traced; stitch: a project's depth meshes with its "
                "photographs; surface: by rays, with its texture or colours; surfels: as "
                "discs; cloud: the points of a Potree folder; of surfaces, also larger than "
                "memory: primary: lit from the eye; shadow: by a sun; ambient: the open share of "
                "the sky; bounce: sun, sky and the light that surfaces send on."
            ),
        ] = "voxels",
        camera: Annotated[
            str,
            typer.Option(
                metavar="AZ,EL[,UP]",
                help="Degrees around and above the object, and its upward axis (y, or z for "
                "projects); eye=x,y,z;to=x,y,z;fov=degrees as in links to the page; photo:NAME "
                "for the place of a project's photograph.",
            ),
        ] = "30,15",
        size: Annotated[
            str, typer.Option(metavar="WxH", help="Pixels; a photograph's view fits inside.")
        ] = "1280x720",
        light: Annotated[
            str | None,
            typer.Option(
                help="camera: from the eye, as the page opens; even: colours as they are; lamp: "
                "from above with hard shadows, of voxels and graphs."
            ),
        ] = None,
        memory_mb: Annotated[
            int | None,
            typer.Option(
                min=3,
                help="primary, shadow, ambient, bounce: for geometry; what needs more is cut into "
                "chunks on disk. 4096.",
            ),
        ] = None,
        samples: Annotated[
            int | None,
            typer.Option(min=1, max=4096, help="The same: rays a pixel sends on, at most. 16."),
        ] = None,
        as_json: JsonOption = False,
    ) -> Answer:
        """A picture without a display."""
        from workbench.raytracing.ray_light import LIGHT_KINDS
        from workbench.viewer.drawn_models import MODES, drawn_model
        from workbench.viewer.ray_pictures import RayMemory, ray_picture
        from workbench.viewer.wanted_views import WantedView

        modes = (*MODES, *LIGHT_KINDS)
        if mode not in modes:
            raise SettingsError(
                f"There is no mode {mode!r}",
                expected=", ".join(modes),
                fix=suggestion(mode, modes) or "choose one of the expected names",
            )
        if mode not in LIGHT_KINDS and (memory_mb, samples) != (None, None):
            raise SettingsError(
                f"--memory-mb and --samples do not belong to --mode {mode}",
                expected=", ".join(LIGHT_KINDS),
                fix="leave them out",
            )
        wanted = WantedView.of_texts(camera, size, light)
        if out.suffix.lower() != ".png" or not out.parent.is_dir():
            raise InputError(
                "The picture cannot be written there",
                file=out,
                expected="a .png file in a folder that exists",
                fix="correct --out",
            )
        with Progress().step(f"rendering {path.name}"), Meter() as meter:
            if mode in LIGHT_KINDS:
                memory = RayMemory((memory_mb or 4096) * 1_000_000, out.parent)
                drawn, traced = ray_picture(path, mode, wanted, memory, samples or 16)
            else:
                drawn, traced = drawn_model(path, mode, wanted), {}
            _write(out, drawn.picture)
        height, width = drawn.picture.shape[:2]
        shown = float((drawn.picture[..., 3] > 0).mean())
        return Answer(
            {
                "file": str(out),
                "mode": mode,
                "width": width,
                "height": height,
                "shown": shown,
                "camera": asdict(drawn.view),
                "seconds": meter.seconds,
                "peak_rss_bytes": meter.peak_rss_bytes,
                **traced,
            },
            f"{out}: {width} × {height} pixels in {meter.seconds:.1f} s",
        )


def _write(out: Path, drawn: Any) -> None:
    from workbench.formats.atomic import replacing
    from workbench.formats.color_png import write_color_png

    with replacing(out) as partial:
        write_color_png(partial, drawn)
