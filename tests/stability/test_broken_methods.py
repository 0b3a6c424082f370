"""Methods that are broken on purpose are found out by their cases."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from workbench.cloud import fusion
from workbench.color.inpainting import InpaintingSettings
from workbench.geometry.photo_view import PhotoView
from workbench.masking import energy
from workbench.registration import adjustment, motion_averaging
from workbench.stability import (
    camera_cases,
    diffusion_cases,
    flash_cases,
    point_cases,
    surface_cases,
    texture_cases,
    voxel_cases,
)
from workbench.stability.case import tried
from workbench.stability.table import ALL_CASES
from workbench.surfels.orders import random_order

BY_NAME = {case.name: case for case in ALL_CASES}


def wrong(name: str) -> bool:
    return not tried(BY_NAME[name]).passed


@pytest.mark.parametrize("name", ["plane", "sphere", "cylinder", "near-identical normals"])
def test_an_adjustment_that_takes_noise_for_constraint(monkeypatch, name):
    monkeypatch.setattr(
        adjustment, "unconstrained", lambda shares, angle: np.zeros(len(shares), bool)
    )
    assert wrong(f"registration/{name}")


def test_an_adjustment_without_robust_weights(monkeypatch):
    monkeypatch.setattr(adjustment, "tukey_weights", lambda values, sigma: np.ones_like(values))
    monkeypatch.setattr(
        adjustment, "unconstrained", lambda shares, angle: np.zeros(len(shares), bool)
    )
    assert wrong("registration/outliers 60 %")


def test_an_adjustment_in_single_precision(monkeypatch):
    whole = adjustment.apply
    monkeypatch.setattr(
        adjustment, "apply", lambda pose, points: whole(pose, points).astype(np.float32)
    )
    monkeypatch.setattr(
        adjustment,
        "nearest_rigid",
        lambda pose: pose.astype(np.float32).astype(np.float64),
    )
    assert wrong("registration/UTM offset")


def test_links_that_are_taken_for_common_motions(monkeypatch):
    monkeypatch.setattr(motion_averaging, "_GAUGE", 0.3)
    assert wrong("pose graph/weights 1 to 1e-12")


def test_merging_that_does_not_look_at_sides(monkeypatch):
    whole = fusion._groups
    monkeypatch.setattr(
        fusion, "_groups", lambda points, normals, cell: whole(points, np.abs(normals), cell)
    )
    assert wrong("surface/two sides")


def test_merging_that_does_not_look_at_its_input(monkeypatch):
    monkeypatch.setattr(fusion, "_check", lambda samples, cell: None)
    assert wrong("surface/no confidence")
    assert wrong("numbers/merging samples: a normal, NaN")


def test_a_surface_solved_where_it_lies(monkeypatch):
    # The sound one at the origin is kept from run to run.
    surface_cases._solved_ball()
    whole = surface_cases.reconstruct

    def solved(points, normals, settings):
        return whole(points.astype(np.float32).astype(np.float64), normals, settings)

    monkeypatch.setattr(surface_cases, "reconstruct", solved)
    assert wrong("surface/UTM offset")


def test_provenance_that_takes_all_for_measured(monkeypatch):
    whole = surface_cases.told_by_samples
    monkeypatch.setattr(
        surface_cases, "told_by_samples", lambda mesh, samples, reach: whole(mesh, samples, 50.0)
    )
    monkeypatch.setattr("workbench.surface.provenance._LEAST_COSINE", -2.0)
    monkeypatch.setattr("workbench.surface.provenance._PLANE_TOLERANCE", 1e3)
    assert wrong("surface/open sheet")


def test_a_diffusion_that_stops_early(monkeypatch):
    whole, loose = diffusion_cases.inpainted, InpaintingSettings(tolerance=1e-2)

    def early(colors, weights, graph):
        return whole(colors, weights, graph, loose)

    monkeypatch.setattr(diffusion_cases, "inpainted", early)
    assert wrong("color/conductances 1e-8 to 1")
    assert wrong("color/inclusions 1e-8")


def test_a_diffusion_that_levels_conductances(monkeypatch):
    whole = diffusion_cases.inpainted

    def even(colors, weights, graph):
        return whole(colors, weights, replace(graph, conductances=np.ones(len(graph.edges))))

    monkeypatch.setattr(diffusion_cases, "inpainted", even)
    assert wrong("color/conductances 1e-8 to 1")
    assert wrong("color/conductance 1e-8 across")


def test_trust_in_whatever_the_sensor_says(monkeypatch):
    monkeypatch.setattr(flash_cases, "value_trust", lambda values: np.ones(len(values)))
    assert wrong("color/black and full")


def test_a_choice_without_seams(monkeypatch):
    whole = texture_cases.expanded
    monkeypatch.setattr(
        texture_cases, "expanded", lambda problem, **options: whole(problem, max_cycles=0)
    )
    assert wrong("texture/equal costs")
    assert wrong("texture/zero areas")


def test_voxels_that_are_sampled(monkeypatch):
    whole = voxel_cases.voxel_parts

    def single(mesh, grid):
        for part in whole(mesh, grid):
            yield replace(part, area=part.area.astype(np.float16).astype(np.float64))

    monkeypatch.setattr(voxel_cases, "voxel_parts", single)
    assert wrong("voxels/two voxels a side")
    assert wrong("voxels/denormal")


def test_a_lens_undone_by_one_step(monkeypatch):
    def once(pixels, numbers):
        return 2 * pixels - camera_cases.distorted_points(pixels, numbers)

    monkeypatch.setattr(camera_cases, "undistorted_points", once)
    assert wrong("cameras/k1 = −0.3")
    assert wrong("cameras/beyond the fold")


def test_a_view_that_does_not_look_at_depth(monkeypatch):
    def all_inside(view, pixels, depths):
        inside = np.isfinite(pixels).all(axis=1)
        return inside & ((pixels >= 0) & (pixels < [view.camera.width, view.camera.height])).all(
            axis=1
        )

    monkeypatch.setattr(PhotoView, "which_are_seen", all_inside)
    assert wrong("cameras/folded")


def test_a_cut_by_whatever_it_is_given(monkeypatch):
    monkeypatch.setattr(energy, "check_evidence", lambda evidence, smoothness: None)
    assert wrong("masks/NaN")
    assert wrong("masks/infinite")


def test_an_order_that_promises_nothing(monkeypatch):
    monkeypatch.setattr(point_cases, "exact_order", random_order)
    assert wrong("points/exact of line")
