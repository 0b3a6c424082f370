from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from workbench.kernels.beam_footprint import footprint_echoes

INF = np.inf


def reference_echo(
    ranges: list[float], energies: list[float], step_min: float, step_max: float
) -> tuple[float, bool]:
    """Plain Python, no slope: groups at gaps, strongest group, mean if it holds a step."""
    hits = sorted(
        (r, e, n) for n, (r, e) in enumerate(zip(ranges, energies, strict=True)) if r < INF
    )
    if not hits:
        return float("nan"), False
    groups = [[hits[0]]]
    for before, hit in pairwise(hits):
        if hit[0] - before[0] > step_max:
            groups.append([])
        groups[-1].append(hit)
    group = max(groups, key=lambda members: sum(e for _, e, _ in members))
    values = [r for r, _, _ in group]
    if max([b - a for a, b in pairwise(values)], default=0) > step_min:
        total = sum(e for _, e, _ in group)
        return sum(r * e for r, e, _ in group) / total, True
    axis = [r for r, _, n in group if n == 0]
    return (axis[0] if axis else max(group, key=lambda hit: hit[1])[0]), False


def test_agrees_with_plain_python_on_random_footprints() -> None:
    rng = np.random.default_rng(0)
    base = rng.choice([1.0, 1.003, 1.05, 1.9], (500, 7)) + rng.uniform(0, 0.001, (500, 7))
    ranges = np.where(rng.random((500, 7)) < 0.2, INF, base)
    energies = np.where(np.isfinite(ranges), rng.uniform(0.01, 1.0, (500, 7)), 0.0)
    got, near, far, chosen, mixed = footprint_echoes(
        ranges, energies, np.zeros((500, 7)), 0.004, 0.5
    )
    assert mixed.any()
    assert not mixed.all()
    for n in range(500):
        expected, is_mixed = reference_echo(list(ranges[n]), list(energies[n]), 0.004, 0.5)
        assert got[n] == pytest.approx(expected, nan_ok=True)
        assert mixed[n] == is_mixed
        assert (chosen[n] < 0) == np.isnan(expected)
    seen = chosen >= 0
    assert ((near <= got) & (got <= far))[seen].all()


def test_the_brighter_surface_pulls_a_mixed_pixel_to_itself() -> None:
    ranges = np.array([[1.0, 1.0, 1.1, 1.1]])
    energies = np.array([[0.1, 0.1, 0.7, 0.7]])
    got, *_, mixed = footprint_echoes(ranges, energies, np.zeros((1, 4)), 0.004, 0.5)
    assert mixed[0]
    assert got[0] == pytest.approx((0.2 * 1.0 + 1.4 * 1.1) / 1.6)


def test_a_slanting_surface_mixes_nothing() -> None:
    ranges = 1.0 + 0.01 * np.arange(5.0)[None]
    energies = np.ones((1, 5))
    *_, flat = footprint_echoes(ranges, energies, np.zeros((1, 5)), 0.004, 0.5)
    got, _, _, _, slanting = footprint_echoes(ranges, energies, np.full((1, 5), 0.04), 0.004, 0.5)
    assert flat[0]
    assert not slanting[0]
    assert got[0] == 1.0
