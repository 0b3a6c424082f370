"""Cameras exported by Agisoft Metashape or PhotoScan as XML.

Source: Metashape Professional user manual, appendix "Camera models": the camera looks along
+z with x right and y down, the centre of the upper left pixel is (0.5, 0.5), and::

    x' = x (1 + k1 r² + k2 r⁴ + k3 r⁶ + k4 r⁸) + p1 (r² + 2x²) + 2 p2 x y
    y' = y (1 + k1 r² + k2 r⁴ + k3 r⁶ + k4 r⁸) + p2 (r² + 2y²) + 2 p1 x y
    u = w/2 + cx + x' (f + b1) + y' b2,    v = h/2 + cy + y' f
"""

from __future__ import annotations

from pathlib import Path
from typing import NoReturn
from xml.etree import ElementTree
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.formats.colmap import ColmapCamera, ColmapImage, ColmapModel, checked_sides
from workbench.formats.whole_file import whole_file
from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.similarity import Similarity
from workbench.geometry.transforms import Matrix4, inverse, is_rigid, nearest_rigid

_TERMS = ("f", "cx", "cy", "b1", "b2", "k1", "k2", "k3", "k4", "p1", "p2")
# A lens that COLMAP's models cannot follow this closely is refused.
_WORST_MISFIT_PX = 0.25
# Lenses that can be made take five to eighty; others would go on for a thousand.
_MOST_STEPS = 200
_GRID = 15
_EXPORT_AGAIN = "Export the cameras again: File > Export > Export Cameras."


def read_agisoft(path: Path) -> ColmapModel:
    """Read the aligned cameras in the world's frame; those not aligned are not in it.

    Returns
    -------
    Camera i of the file as image i + 1 under its label; one camera per sensor; no points.

    Raises
    ------
    InputError
        The file is no XML of this kind or declares entities, it has several chunks with
        aligned cameras or none, a sensor is no frame camera or was not calibrated, a value
        is no finite number, or a lens is beyond COLMAP's models; the element is named.
    """
    root = _tree(path)
    chunks = [
        chunk
        for chunk in ([root] if root.tag == "chunk" else root.iter("chunk"))
        if chunk.find("cameras//camera/transform") is not None
    ]
    if len(chunks) != 1:
        raise InputError(
            "One chunk with aligned cameras is expected.",
            file=path,
            found=", ".join(repr(chunk.get("label")) for chunk in chunks) or "none",
            fix="Export the cameras of one chunk: File > Export > Export Cameras.",
        )
    chunk = chunks[0]
    images, sensors = {}, set()
    where = "chunk"
    try:
        placed = _components(chunk)
        for number, camera in enumerate(chunk.findall("cameras//camera"), start=1):
            where = f"camera {camera.get('label')!r}"
            transform = camera.find("transform")
            world_from_chunk = placed.get(camera.get("component_id"), placed[None])
            if transform is None or camera.get("enabled") in ("0", "false"):
                continue
            chunk_from_camera = np.reshape(_numbers(transform, 16), (4, 4))
            if not is_rigid(chunk_from_camera, 1e-3):
                raise ValueError("its transform is not rigid")
            camera_from_chunk = inverse(nearest_rigid(chunk_from_camera))
            sensor = int(camera.attrib["sensor_id"])
            sensors.add(sensor)
            images[number] = ColmapImage(
                number,
                world_from_chunk.camera_from_b(camera_from_chunk),
                sensor + 1,
                camera.attrib["label"],
            )
        cameras = {}
        for element in chunk.findall("sensors/sensor"):
            where = f"sensor {element.get('id')}"
            sensor = int(element.attrib["id"])
            if sensor in sensors:
                cameras[sensor + 1] = _lens(sensor + 1, element)
        where = "sensors"
        if len(cameras) < len(sensors):
            raise ValueError("a camera refers to a sensor that is not there")
    except (KeyError, ValueError, OverflowError) as error:
        raise InputError(
            "The exported cameras cannot be read.",
            file=path,
            where=where,
            found=f"no {error}" if isinstance(error, KeyError) else str(error)[:200],
            fix=_EXPORT_AGAIN,
        ) from None
    return ColmapModel(cameras, images)


def _tree(path: Path) -> ElementTree.Element:
    """The root element; entities, which can blow up a parser, are refused unseen."""
    data = whole_file(path)

    def refuse(*_: object) -> NoReturn:
        raise ValueError("a document type, which these files do not have")

    check = expat.ParserCreate()
    check.StartDoctypeDeclHandler = refuse
    try:
        check.Parse(data, True)
        return ElementTree.fromstring(data)
    except (expat.ExpatError, ElementTree.ParseError, ValueError, LookupError) as error:
        raise InputError(
            "This file is no proper XML.", file=path, found=str(error), fix=_EXPORT_AGAIN
        ) from None


def _components(chunk: ElementTree.Element) -> dict[str | None, Similarity]:
    """``world_from_chunk`` of each component, and under None that of the chunk itself."""
    found: dict[str | None, Similarity] = {
        component.get("id"): _similarity(component)
        for component in chunk.findall("components/component")
    }
    found[None] = _similarity(chunk)
    return found


def _similarity(element: ElementTree.Element) -> Similarity:
    transform = element.find("transform")
    turn, shift, scale = (
        None if transform is None else transform.find(tag)
        for tag in ("rotation", "translation", "scale")
    )
    rotation = np.eye(3) if turn is None else np.reshape(_numbers(turn, 9), (3, 3))
    as_matrix: Matrix4 = np.eye(4)
    as_matrix[:3, :3] = rotation
    if not is_rigid(as_matrix, 1e-3):
        raise ValueError("the rotation of the chunk is none")
    size = 1.0 if scale is None else _numbers(scale, 1)[0]
    if size <= 0.0:
        raise ValueError("the scale of the chunk is not positive")
    place = np.zeros(3) if shift is None else _numbers(shift, 3)
    return Similarity(float(size), nearest_rigid(as_matrix)[:3, :3], place)


def _lens(number: int, sensor: ElementTree.Element) -> ColmapCamera:
    kind = sensor.get("type", "frame")
    if kind != "frame":
        raise ValueError(f"it is a {kind} camera; frame cameras are read")
    calibrations = sensor.findall("calibration")
    adjusted = [one for one in calibrations if one.get("class") == "adjusted"]
    if not calibrations:
        raise ValueError("it has no calibration")
    calibration = (adjusted or calibrations)[0]
    if calibration.find("fx") is not None:
        raise ValueError("its calibration is of PhotoScan before 1.2; export it from a newer one")
    resolution = calibration.find("resolution")
    resolution = sensor.find("resolution") if resolution is None else resolution
    if resolution is None:
        raise ValueError("it has no resolution")
    width, height = checked_sides(int(resolution.attrib["width"]), int(resolution.attrib["height"]))
    terms = dict.fromkeys(_TERMS, 0.0)
    for term in _TERMS:
        element = calibration.find(term)
        if element is not None:
            terms[term] = float(_numbers(element, 1)[0])
    if terms["f"] <= 0.0:
        raise ValueError("its focal length is not positive")
    return ColmapCamera(number, *_as_colmap(width, height, terms))


def _as_colmap(
    width: int, height: int, terms: dict[str, float]
) -> tuple[str, int, int, tuple[float, ...]]:
    """COLMAP's model of a lens: the same where it can be, else the closest."""
    params = np.array(
        [
            terms["f"] + terms["b1"],
            terms["f"],
            width / 2.0 + terms["cx"],
            height / 2.0 + terms["cy"],
            terms["k1"],
            terms["k2"],
            terms["p2"],
            terms["p1"],
        ]
    )
    if not (terms["k3"] or terms["k4"] or terms["b2"]):
        return "OPENCV", width, height, tuple(params.tolist())
    params = np.concatenate([params, [terms["k3"], 0.0, 0.0, 0.0]])
    if not (terms["k4"] or terms["b2"]):
        return "FULL_OPENCV", width, height, tuple(params.tolist())
    # The rational model follows r⁸; a skew it can only share out over the whole picture.
    from scipy.optimize import least_squares

    rays = _grid(width, height, terms["f"])
    with np.errstate(over="ignore", invalid="ignore"):  # refused below
        pixels = _imaged(rays, width, height, terms)

    def misfit(values: NDArray[np.float64]) -> NDArray[np.float64]:
        camera = PhotoCamera("FULL_OPENCV", width, height, tuple(values.tolist()), np.eye(4))
        return np.asarray((camera.project(rays)[0] - pixels).ravel())

    moved = float(np.abs(misfit(params)).max())
    if not moved <= np.hypot(width, height):
        raise ValueError(f"no lens moves a pixel by {moved:.3g} pixels, as k4 and b2 would")
    scale = np.maximum(np.abs(params), 0.1)
    fitted = least_squares(misfit, params, x_scale=scale, max_nfev=_MOST_STEPS)
    worst = float(np.abs(fitted.fun).max())
    if not worst <= _WORST_MISFIT_PX:
        raise ValueError(f"COLMAP's lens models miss this one by {worst:.2f} pixels (k4, b2)")
    return "FULL_OPENCV", width, height, tuple(map(float, fitted.x))


def _grid(width: int, height: int, focal: float) -> NDArray[np.float64]:
    """Rays (n, 3) all over the picture, z = 1, as a lens without distortion would have them."""
    x = np.linspace(-0.5, 0.5, _GRID) * width / focal
    y = np.linspace(-0.5, 0.5, _GRID) * height / focal
    across, down = np.meshgrid(x, y)
    return np.column_stack([across.ravel(), down.ravel(), np.ones(across.size)])


def _imaged(
    rays: NDArray[np.float64], width: int, height: int, terms: dict[str, float]
) -> NDArray[np.float64]:
    """Pixels (n, 2) of rays with z = 1 by the manual's formula."""
    x, y = rays[:, 0], rays[:, 1]
    r2 = x * x + y * y
    radial = 1 + r2 * (terms["k1"] + r2 * (terms["k2"] + r2 * (terms["k3"] + r2 * terms["k4"])))
    bent_x = x * radial + terms["p1"] * (r2 + 2 * x * x) + 2 * terms["p2"] * x * y
    bent_y = y * radial + terms["p2"] * (r2 + 2 * y * y) + 2 * terms["p1"] * x * y
    u = width / 2.0 + terms["cx"] + bent_x * (terms["f"] + terms["b1"]) + bent_y * terms["b2"]
    return np.column_stack([u, height / 2.0 + terms["cy"] + bent_y * terms["f"]])


def _numbers(element: ElementTree.Element, count: int) -> NDArray[np.float64]:
    words = (element.text or "").split()
    values = np.array([float(word) for word in words])
    if len(values) != count or not np.isfinite(values).all():
        raise ValueError(f"<{element.tag}> has {count} finite numbers, not {element.text!r:.80}")
    return values
