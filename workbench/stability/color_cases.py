"""Colour spread over holes, and photographs freed of their flash, where numbers go to extremes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array, csr_array, diags_array
from scipy.sparse.linalg import splu

from workbench.color.blending import blended
from workbench.color.blending_colors import Colored, corrected
from workbench.color.blending_observations import Observations
from workbench.color.diffusion_graph import SampleGraph, edges_of_cloud, sample_graph
from workbench.color.flash_estimation import estimated_flash
from workbench.color.flash_light import FlashLight, albedo, trust, value_trust
from workbench.color.flash_observations import FlashObservations, NoFlashEstimate
from workbench.color.inpainting import INPAINTED, UNPAINTED, Inpainting, inpainted
from workbench.geometry.transforms import apply, inverse, looking_at, rotate
from workbench.stability.case import Bound, Case, Measured, Refused

_SPREADING, _FLASH = "diffusion of colour", "flash correction"
_COLORS = tuple[NDArray[np.float64], NDArray[np.float64]]


def square_graph(n: int, conductance_of: Callable[[int], NDArray[np.float64]]) -> SampleGraph:
    """Samples in a square of n × n, row by row; ``conductance_of`` is told the number of edges."""
    number = np.arange(n * n, dtype=np.int32).reshape(n, n)
    pairs = ((number[:, :-1], number[:, 1:]), (number[:-1], number[1:]))
    edges = np.concatenate([np.stack([a.ravel(), b.ravel()], axis=1) for a, b in pairs])
    return SampleGraph(n * n, edges, conductance_of(len(edges)))


def _rim_of_noise(n: int) -> _COLORS:
    """Colours (n², 3) of a square, random at its border and unknown within, and weights."""
    inside = np.zeros((n, n), bool)
    inside[1:-1, 1:-1] = True
    colors = np.random.default_rng(2).uniform(0.0, 1.0, (n * n, 3))
    colors[inside.ravel()] = np.nan
    return colors, 1.0 - inside.ravel()


def _plain_solution(graph: SampleGraph, colors: NDArray[np.float64]) -> NDArray[np.float64]:
    """The same equations by a direct solver, for weights that are all one."""
    i, j = graph.edges.T
    n = graph.count
    joined = coo_array((np.tile(graph.conductances, 2), (np.r_[i, j], np.r_[j, i])), (n, n))
    matrix = csr_array(diags_array(joined.sum(axis=1)) - joined)
    open_ = np.flatnonzero(np.isnan(colors).any(axis=1))
    known = np.nan_to_num(colors)
    right = -(matrix[open_] @ known)
    found = known.copy()
    found[open_] = splu(csc_array(matrix[open_][:, open_])).solve(right)
    return found


def _told(found: Inpainting) -> str:
    last = f"{found.residuals[-1].max():.1e}" if len(found.residuals) else "0"
    return (
        f"condition {found.condition:.3g}, residual {last} after {found.cycles} cycles, "
        f"error {found.error:.1e}"
    )


def _against_direct(graph: SampleGraph, n: int) -> Measured | Refused:
    colors, weights = _rim_of_noise(n)
    found = inpainted(colors, weights, graph)
    if not found.converged:
        return Refused(f"not converged: {_told(found)}")
    return Measured(
        float(np.abs(found.colors - _plain_solution(graph, colors)).max()), _told(found)
    )


def _decades(count: int) -> NDArray[np.float64]:
    return np.asarray(10.0 ** np.random.default_rng(0).uniform(-8.0, 0.0, count))


def _random_conductances() -> Measured | Refused:
    return _against_direct(square_graph(60, _decades), 60)


def _one_way() -> Measured | Refused:
    """Rows that conduct and columns that conduct a hundred-millionth of it."""
    return _against_direct(square_graph(60, lambda count: np.repeat([1.0, 1e-8], count // 2)), 60)


def _inclusions() -> Measured | Refused:
    """A checkerboard of fields, every other of which conducts a hundred-millionth."""
    graph = square_graph(64, np.ones)
    row, column = np.divmod(np.arange(64 * 64), 64)
    poor = (row // 8 + column // 8) % 2 == 1
    return _against_direct(
        replace(graph, conductances=np.where(poor[graph.edges].any(axis=1), 1e-8, 1.0)), 64
    )


def _denormal_conductances() -> Measured | Refused:
    """Conductances at the very end of the range of numbers, all the same."""
    colors, weights = _rim_of_noise(40)
    found = inpainted(colors, weights, square_graph(40, lambda count: np.full(count, 5e-324)))
    plain = _plain_solution(square_graph(40, np.ones), colors)
    return Measured(float(np.abs(found.colors - plain).max()), _told(found))


def _islands() -> Measured:
    """Holes that no coloured sample touches, beside some that one does: flags tell which."""
    graph = square_graph(40, np.ones)
    row, column = np.divmod(np.arange(1600), 40)
    cut = (row[graph.edges] // 10 != (row[graph.edges] // 10)[:, :1]).any(axis=1)
    graph = SampleGraph(1600, graph.edges[~cut], graph.conductances[~cut])
    weights = ((row // 10 == 1) & (column == 0)).astype(float)
    colors = np.repeat(np.where(weights > 0, 0.25, np.nan)[:, None], 3, axis=1)
    found = inpainted(colors, weights, graph)
    reached = row // 10 == 1
    wrong = (found.flags == UNPAINTED) != ~reached
    wrong |= np.isfinite(found.colors).all(axis=1) != reached
    off = np.abs(found.colors[reached] - 0.25).max()
    told = f"{found.islands_unpainted} of {found.islands} islands unpainted"
    return Measured(float(max(wrong.sum(), off)), told)


def _all_unknown() -> Measured:
    found = inpainted(np.full((400, 3), np.nan), np.zeros(400), square_graph(20, np.ones))
    return Measured(float((found.flags != UNPAINTED).sum()), _told(found))


def _single_precision() -> Measured:
    graph = square_graph(60, _decades)
    colors, weights = _rim_of_noise(60)
    double = inpainted(colors, weights, graph)
    single = inpainted(colors.astype(np.float32).astype(np.float64), weights, graph)
    return Measured(float(np.abs(double.colors - single.colors).max()), _told(single))


def _condition() -> Measured:
    """The condition that is told against that of the whole matrix, inverted."""
    n = 16
    graph = square_graph(n, _decades)
    colors, weights = _rim_of_noise(n)
    found = inpainted(colors, weights, graph)
    i, j = graph.edges.T
    matrix = np.zeros((n * n, n * n))
    matrix[i, j] = matrix[j, i] = -graph.conductances
    np.fill_diagonal(matrix, -matrix.sum(axis=1))
    open_ = weights == 0
    scaled = matrix[open_][:, open_] / np.diag(matrix)[open_, None]
    true = np.linalg.cond(scaled, np.inf)
    return Measured(abs(found.condition / true - 1.0), f"condition {found.condition:.5g}")


def _many_unknowns(n: int) -> Measured | Refused:
    """A linear ramp around a square hole, which the diffusion must go on with."""
    graph = square_graph(n, np.ones)
    row, column = np.divmod(np.arange(n * n), n)
    ramp = (row + 2.0 * column) / (3.0 * (n - 1))
    edge = (row % (n - 1) == 0) | (column % (n - 1) == 0)
    colors = np.where(edge[:, None], ramp[:, None], np.nan).repeat(3, axis=1)
    found = inpainted(colors[:, :3], edge.astype(float), graph)
    if not found.converged:
        return Refused(f"not converged: {_told(found)}")
    falling = (np.diff(found.residuals.max(axis=1)) < 0).all()
    error = float(np.abs(found.colors - ramp[:, None]).max())
    return Measured(error if falling else np.inf, f"{found.unknowns} unknowns, {_told(found)}")


def _coincident_cloud() -> Measured:
    """Samples of a cloud of which half lie at one place."""
    rng = np.random.default_rng(3)
    points = np.concatenate([rng.uniform(0, 1, (300, 3)), np.full((300, 3), 0.5)])
    graph = sample_graph(edges_of_cloud(points), points)
    colors, weights = rng.uniform(0.2, 0.6, (600, 3)), np.ones(600)
    weights[::3] = 0
    found = inpainted(colors, weights, graph)
    painted = found.colors[found.flags == INPAINTED]
    low, high = colors[weights > 0].min(axis=0), colors[weights > 0].max(axis=0)
    return Measured(float(np.maximum(low - painted, painted - high).max()), _told(found))


_LIGHT = FlashLight(np.array([-0.13, -0.03, 0.01]), epsilon=0.0)


def _at_angle(degrees: float, distance: float = 1.0) -> tuple[NDArray[np.float64], ...]:
    """Place and normal (1, 3) with that incidence, the flash ``distance`` away along z."""
    angle = np.radians(degrees)
    place = _LIGHT.position_in_camera + np.array([0.0, 0.0, distance])
    # The cosine by the sine of what is left of a right angle keeps its digits near it.
    normal = [np.cos(angle), 0.0, -np.sin(np.pi / 2 - angle)]
    return place[None], np.array([normal])


def _grazing(degrees: float) -> Measured:
    """The albedo of a surface seen at that incidence, and that it does not count."""
    place, normal = _at_angle(degrees)
    cosine = np.sin(np.radians(90.0) - np.radians(degrees))
    found = albedo(np.full((1, 3), 0.4 * cosine), _LIGHT.received(place, normal), 1.0)
    weight = float(trust(_LIGHT, place, normal, np.full((1, 3), 0.5))[0])
    error = float(np.abs(found / 0.4 - 1.0).max())
    return Measured(max(error, weight), f"trusted {weight:.1e}")


def _at_flash() -> Measured:
    """Nothing but finite numbers from a sample at the flash itself, and no trust in it."""
    light = replace(_LIGHT, roughness_rad=0.4, falloff=(0.1, 0.2), indirect=0.1, epsilon=0.1)
    place, normal = light.position_in_camera[None], np.array([[0.0, 0.0, -1.0]])
    received = light.received(place, normal)
    weight = trust(light, place, normal, np.full((1, 3), 0.5))
    seen = Observations(
        np.zeros(1, np.int64), np.full((1, 3), 0.5, np.float32), normal.astype(np.float32),
        np.ones(1, np.float32),
    )  # fmt: skip
    kept = corrected(seen, place, np.eye(4), light, 1.0)
    unsound = not (np.isfinite(received).all() and received[0] > 0)
    return Measured(float(unsound) + float(weight[0]) + len(kept.index), f"light {received[0]:.2g}")


def _inverse_square(distance: float) -> Measured:
    """Light at an extreme distance against the law of eq. 3.1."""
    place, normal = _at_angle(30.0, distance)
    light = float(_LIGHT.received(place, normal)[0])
    exact = place[0, 2] - _LIGHT.position_in_camera[2]
    return Measured(abs(light * exact**2 / np.cos(np.radians(30.0)) - 1.0))


def _black_and_full() -> Measured:
    """Values at and beyond both ends of the sensor, not a number among them: no trust at all."""
    values = np.array([0.0, -0.1, 5e-324, 1.0, 1.5, np.inf, -np.inf, np.nan])
    return Measured(float(value_trust(values).max()))


def _observations(value: float, weight: float = 1.0, photos: int = 6) -> FlashObservations:
    rng = np.random.default_rng(0)
    samples = 200
    sample, photo = (v.ravel() for v in np.meshgrid(np.arange(samples), np.arange(photos)))
    places = rng.uniform([-0.4, -0.4, 1.1], [0.4, 0.4, 1.9], (len(sample), 3))
    normals = np.tile([0.0, 0.0, -1.0], (len(sample), 1))
    return FlashObservations(
        sample, photo, places, normals, np.full(len(sample), value), np.full(len(sample), weight)
    )


def _estimated(seen: FlashObservations) -> Measured | Refused:
    found = estimated_flash(seen)
    if isinstance(found, NoFlashEstimate):
        return Refused(found.reason)
    return Measured.nothing(f"the flash was found at {found.light.position_in_camera}")


def flash_scene() -> FlashObservations:
    """A lumpy ball from all sides, lit by a flash beside the lens, with 1 % of noise."""
    rng = np.random.default_rng(0)
    samples, photos = 400, 12
    way = rng.standard_normal((samples, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    points, paint = 0.35 * way, np.exp(rng.uniform(np.log(0.1), np.log(0.8), samples))
    parts = []
    for k in range(photos):
        turn = 2 * np.pi * k / photos
        distance = 1.2 + 1.2 * (k % 4) / 3
        center = distance * np.array([np.cos(turn), np.sin(turn), 0.3 * (k % 3 - 1)])
        camera_from_world = inverse(looking_at(center, (0.0, 0.0, 0.0)))
        place, normal = apply(camera_from_world, points), rotate(camera_from_world, way)
        to_flash = _LIGHT.position_in_camera - place
        length = np.linalg.norm(to_flash, axis=1)
        cosine = np.einsum("ni,ni->n", normal, to_flash) / length
        shown = np.flatnonzero((cosine > 0.1) & (np.einsum("ni,ni->n", normal, -place) > 0.3))
        value = (paint * cosine / length**2)[shown] * np.exp(0.01 * rng.standard_normal(len(shown)))
        parts.append((shown, np.full(len(shown), k), place[shown], normal[shown], value))
    sample, photo, place, normal, value = (
        np.concatenate(column) for column in zip(*parts, strict=True)
    )
    return FlashObservations(sample, photo, place, normal, value, np.ones(len(value)))


def _estimate() -> Measured | Refused:
    """The flash's place against the true one."""
    found = estimated_flash(flash_scene(), terms=())
    if isinstance(found, NoFlashEstimate):
        return Refused(found.reason)
    apart = found.light.position_in_camera - _LIGHT.position_in_camera
    told = f"told ±{1e3 * found.position_sigma.max():.2g} mm, condition {found.condition:.2g}"
    return Measured(float(np.abs(apart).max()), told)


def _one_photograph() -> Measured | Refused:
    return _estimated(_observations(0.3, photos=1))


def _wall_from_one_place() -> Measured | Refused:
    """A flat wall, square on and from one distance: photographs that are all the same."""
    x, y = (v.ravel() for v in np.meshgrid(*(np.linspace(-0.4, 0.4, 15),) * 2))
    place = np.stack([x, y, np.full_like(x, 1.5)], axis=1)
    way = _LIGHT.position_in_camera - place
    distance = np.linalg.norm(way, axis=1)
    value = 0.4 * -way[:, 2] / distance**3
    rng = np.random.default_rng(1)
    n = len(x)
    found = estimated_flash(
        FlashObservations(
            np.tile(np.arange(n), 6), np.repeat(np.arange(6), n), np.tile(place, (6, 1)),
            np.tile([0.0, 0.0, -1.0], (6 * n, 1)),
            np.tile(value, 6) * np.exp(0.01 * rng.standard_normal(6 * n)), np.ones(6 * n),
        )
    )  # fmt: skip
    if isinstance(found, NoFlashEstimate):
        return Refused(found.reason)
    if found.warnings:
        return Refused("; ".join(found.warnings))
    return Measured.nothing(f"position certain to {found.position_sigma}")


def _no_weight() -> Measured:
    """Photographs that show samples with no weight, beside some that do."""
    index = np.arange(10)
    none = Colored(index, np.full((10, 3), 0.9), np.zeros(10))
    some = Colored(index[:5], np.full((5, 3), 0.2), np.full(5, 1e-300))
    found = blended([none, some], 10)
    wrong = np.isfinite(found.colors).all(axis=1) != (index < 5)
    return Measured(float(wrong.sum() + np.abs(found.colors[:5] - 0.2).max()))


def _case(
    name: str,
    method: str,
    stiff: str,
    run: Callable[[], Measured | Refused],
    bound: Bound | None = None,
    refusal: str | None = None,
    quick: bool = True,
) -> Case:
    return Case(f"color/{name}", method, stiff, run, bound, refusal, quick)


_TOLERANCE = Bound(1e-6, "", "the tolerance of 1e-8, times what the estimate of the error allows")
_EXACT = Bound(1e-12, "", "rounding: the formula has no cancellation")
_NONE = Bound(0.0, "", "none is allowed")

COLOR_CASES = (
    _case("conductances 1e-8 to 1", _SPREADING, "Conductances over eight decades, at random.",
          _random_conductances, _TOLERANCE),
    _case("conductance 1e-8 across", _SPREADING, "Rows conduct 1e8 times as well as columns.",
          _one_way, _TOLERANCE),
    _case("inclusions 1e-8", _SPREADING, "A checkerboard of good and very bad conductors.",
          _inclusions, _TOLERANCE),
    _case("denormal conductances", _SPREADING, "Conductances of 5e-324.",
          _denormal_conductances, _TOLERANCE),
    _case("islands", _SPREADING, "Three of four parts have no colour to start from.", _islands,
          Bound(1e-12, "", "a constant rim gives that constant; no flag may be wrong")),
    _case("nothing known", _SPREADING, "No sample has a colour.", _all_unknown, _NONE),
    _case("float32 against float64", _SPREADING, "The same problem from colours in float32.",
          _single_precision, Bound(6e-8, "", "half a step of float32: a mean magnifies nothing")),
    _case("condition told", _SPREADING, "Condition as told against the inverted matrix.",
          _condition, Bound(0.01, "relative", "the estimate's own tolerance of 1e-3, ten times")),
    _case("2.5e5 unknowns", _SPREADING, "A hole of 500 × 500 samples.",
          partial(_many_unknowns, 502), _TOLERANCE, quick=False),
    _case("1e6 unknowns", _SPREADING, "A hole of 1000 × 1000 samples.",
          partial(_many_unknowns, 1002), _TOLERANCE, quick=False),
    _case("coincident samples", _SPREADING, "Half of a cloud lies at one place.",
          _coincident_cloud, Bound(1e-12, "", "the maximum principle")),
    _case("grazing 89.9°", _FLASH, "The light is a sixth of a percent of what faces it.",
          partial(_grazing, 89.9), Bound(1e-4, "", "no trust beyond what the cosine squared is")),
    _case("grazing 89.9999999°", _FLASH, "The light is two billionths of what faces it.",
          partial(_grazing, 89.9999999), Bound(1e-6, "", "digits of the normal near 90°")),
    _case("at the flash", _FLASH, "A sample at the flash itself, at no distance in no direction.",
          _at_flash, _NONE),
    _case("1e-6 m away", _FLASH, "A sample a micrometre before the flash.",
          partial(_inverse_square, 1e-6), Bound(1e-9, "", "digits of 1e-6 m beside a centimetre")),
    _case("1e5 m away", _FLASH, "A sample a hundred kilometres away.",
          partial(_inverse_square, 1e5), _EXACT),
    _case("black and full", _FLASH, "Values at and beyond both ends of the sensor.",
          _black_and_full, _NONE),
    _case("a ball", "estimate of the flash", "An ordinary ball, to compare with.", _estimate,
          Bound(0.01, "m", "1 % of noise over 2000 observations of distances of 1.2 m and more")),
    _case("all black", "estimate of the flash", "Every value is zero.",
          lambda: _estimated(_observations(0.0)), refusal="no sample has light"),
    _case("all saturated", "estimate of the flash", "No value is to be trusted.",
          lambda: _estimated(_observations(1.0, 0.0)), refusal="no sample has light"),
    _case("one photograph", "estimate of the flash", "Nothing tells flash from colours.",
          _one_photograph, refusal="one photograph alone"),
    _case("a wall from one place", "estimate of the flash", "All photographs are the same.",
          _wall_from_one_place, refusal="do not tell"),
    _case("no weight", "blending of photographs", "Weights of 0 and of 1e-300.", _no_weight,
          Bound(1e-12, "", "rounding; no sample without weight may have a colour")),
)  # fmt: skip
