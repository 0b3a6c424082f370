"""Error of poses found from nothing against run time, next to Open3D's multiway registration.

    python -m tests.benchmarks.bench_registration OUT

takes the Stanford bunny where it is at hand, else a simulated statue, gives every scan a random
rigid motion, and places all scans with several numbers of keypoints, with and without the joint
adjustment, and in Open3D's way with several voxel sizes: FPFH and fast global registration (or
RANSAC) of all pairs, or starts within 3° of the truth, point-to-plane ICP, pose graph. Prints a
table with ratios to the default and writes ``registration_tradeoff.svg`` and, where an SVG
renderer is at hand, ``.png`` to OUT.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from time import perf_counter

import numpy as np
import open3d as o3d
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tests.benchmarks.drawing import draw_tradeoff
from workbench.formats.scans import find_scans, read_pose_files, read_scans
from workbench.geometry.orientedscan import OrientationSettings, OrientedScan, orient
from workbench.geometry.transforms import Matrix4, apply, inverse, rigid, rotate, rotation_angle_deg
from workbench.registration.adjustment import AdjustmentSettings, adjust
from workbench.registration.placement import PlacementSettings, place
from workbench.synthetic import SimulationOptions, simulate_scans
from workbench.verification.figures import TradeoffPoint

BUNNY = Path(__file__).resolve().parents[3] / "shared" / "data" / "stanford-bunny"
KEYPOINTS, DEFAULT = (300, 700, 1500), 700
VOXEL_SPACINGS = (6.0, 3.0)
"""Voxels of Open3D's way, in sample spacings."""

registration = o3d.pipelines.registration


@dataclass(frozen=True)
class Scene:
    """Scans in frames of their own and their true poses."""

    scans: list[OrientedScan]
    viewpoints: list[NDArray[np.float64] | None]
    true: list[Matrix4]

    @property
    def names(self) -> list[str]:
        return [f"scan_{k:02d}" for k in range(len(self.scans))]

    @property
    def spacing_m(self) -> float:
        return float(np.median(np.concatenate([s.spacing_m for s in self.scans])))


def scene() -> Scene:
    """The bunny or a statue, every scan moved at random."""
    rng = np.random.default_rng(1)
    if BUNNY.exists():
        listing = find_scans([BUNNY])
        poses = read_pose_files(listing.pose_files)
        maps = [
            reading.range_map
            for path, name in zip(listing.files, listing.names, strict=True)
            for reading in read_scans(path, poses, name)
        ]
        true = [m.world_from_scan for m in maps]
    else:
        made = list(simulate_scans(SimulationOptions(scene="statue", size="small", seed=1)))
        maps, true = [m.range_map for m in made], [m.world_from_scan for m in made]
    scans, viewpoints, moved = [], [], []
    for scan, pose in zip(maps, true, strict=True):
        move = rigid(Rotation.random(random_state=rng).as_matrix(), rng.normal(size=3))
        oriented = orient(scan, OrientationSettings())
        points, normals = apply(move, oriented.points), rotate(move, oriented.normals)
        scans.append(replace(oriented, points=points, normals=normals))
        viewpoint = scan.viewpoint_in_scan
        viewpoints.append(None if viewpoint is None else apply(move, viewpoint))
        moved.append(pose @ inverse(move))
    return Scene(scans, viewpoints, moved)


def ours(scene: Scene, keypoints: int, refined: bool) -> list[Matrix4]:
    """Placement by shape and, if asked, the joint adjustment."""
    settings = PlacementSettings(keypoints=keypoints)
    found = place(scene.scans, scene.viewpoints, scene.names, settings)
    if not found:
        print(f"  keypoints {keypoints}: {found.reason}")
    if not refined or not found:
        return list(found.poses)
    search = AdjustmentSettings(search_m=1.5 * found.keypoint_m)
    return list(adjust(scene.scans, found.poses, scene.names, search).poses)


def open3ds(scene: Scene, voxel_m: float, global_step: Callable[..., Matrix4]) -> list[Matrix4]:
    """Open3D's multiway registration with a global step for every pair of scans."""
    clouds, features = [], []
    for scan in scene.scans:
        cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(scan.points))
        cloud.normals = o3d.utility.Vector3dVector(scan.normals)
        cloud = cloud.voxel_down_sample(voxel_m)
        cloud.normalize_normals()
        clouds.append(cloud)
        search = o3d.geometry.KDTreeSearchParamHybrid(radius=5 * voxel_m, max_nn=100)
        features.append(registration.compute_fpfh_feature(cloud, search))
    graph = registration.PoseGraph()
    graph.nodes.append(registration.PoseGraphNode(np.eye(4)))
    world_from_last = np.eye(4)
    for i, j in combinations(range(len(clouds)), 2):
        start = global_step(i, j, clouds, features, voxel_m)
        result = registration.registration_icp(
            clouds[i],
            clouds[j],
            1.5 * voxel_m,
            start,
            registration.TransformationEstimationPointToPlane(),
        )
        information = registration.get_information_matrix_from_point_clouds(
            clouds[i], clouds[j], 1.5 * voxel_m, result.transformation
        )
        if j == i + 1:
            world_from_last = world_from_last @ inverse(result.transformation)
            graph.nodes.append(registration.PoseGraphNode(world_from_last))
        graph.edges.append(
            registration.PoseGraphEdge(
                i, j, result.transformation, information, uncertain=j != i + 1
            )
        )
    registration.global_optimization(
        graph,
        registration.GlobalOptimizationLevenbergMarquardt(),
        registration.GlobalOptimizationConvergenceCriteria(),
        registration.GlobalOptimizationOption(1.5 * voxel_m, 0.25, 1.0, 0),
    )
    return [node.pose for node in graph.nodes]


def fast_global(i: int, j: int, clouds: list, features: list, voxel_m: float) -> Matrix4:
    """Zhou, Park and Koltun 2016."""
    option = registration.FastGlobalRegistrationOption(maximum_correspondence_distance=voxel_m)
    return registration.registration_fgr_based_on_feature_matching(
        clouds[i], clouds[j], features[i], features[j], option
    ).transformation


def ransac(i: int, j: int, clouds: list, features: list, voxel_m: float) -> Matrix4:
    """With the settings of Open3D's tutorial."""
    near = 1.5 * voxel_m
    return registration.registration_ransac_based_on_feature_matching(
        clouds[i],
        clouds[j],
        features[i],
        features[j],
        True,
        near,
        registration.TransformationEstimationPointToPoint(False),
        3,
        [
            registration.CorrespondenceCheckerBasedOnEdgeLength(0.9),
            registration.CorrespondenceCheckerBasedOnDistance(near),
        ],
        registration.RANSACConvergenceCriteria(100_000, 0.999),
    ).transformation


def roughly_true(scene: Scene) -> list[Matrix4]:
    """The true poses, every scan turned by 3° about its middle."""
    rng = np.random.default_rng(2)
    poses = []
    for scan, pose in zip(scene.scans, scene.true, strict=True):
        axis = rng.normal(size=3)
        turn = Rotation.from_rotvec(np.radians(3.0) * axis / np.linalg.norm(axis)).as_matrix()
        middle = apply(pose, scan.points.mean(axis=0))
        about = rigid(np.eye(3), middle) @ rigid(turn, np.zeros(3)) @ rigid(np.eye(3), -middle)
        poses.append(about @ pose)
    return poses


def near_the_truth(scene: Scene) -> Callable[..., Matrix4]:
    """A start for every pair from `roughly_true` poses, in place of a global step."""
    poses = roughly_true(scene)

    def start(i: int, j: int, clouds: list, features: list, voxel_m: float) -> Matrix4:
        return inverse(poses[j]) @ poses[i]

    return start


def adjusted_from_nearby(scene: Scene) -> list[Matrix4]:
    """The joint adjustment alone, from the same starts."""
    settings = AdjustmentSettings(search_m=6 * scene.spacing_m)
    return list(adjust(scene.scans, roughly_true(scene), scene.names, settings).poses)


def errors(scene: Scene, poses: list[Matrix4]) -> tuple[float, float, float, float]:
    """Median and largest error of relative poses: degrees, millimetres, degrees, millimetres."""
    turned, shifted = [], []
    for i, j in combinations(range(len(poses)), 2):
        here, there = (inverse(p[i]) @ p[j] for p in (scene.true, poses))
        middle = scene.scans[j].points.mean(axis=0)
        turned.append(rotation_angle_deg(inverse(here) @ there))
        shifted.append(1e3 * float(np.linalg.norm(apply(here, middle) - apply(there, middle))))
    return (
        float(np.median(turned)),
        float(np.median(shifted)),
        max(turned),
        max(shifted),
    )


def main(out: Path) -> None:
    case = scene()
    o3d.utility.random.seed(1)
    place(case.scans[:2], case.viewpoints[:2], case.names[:2], PlacementSettings())  # compiles
    ways: dict[str, Callable[[], list[Matrix4]]] = {}
    for number in KEYPOINTS:
        ways[f"{number} keypoints, placed"] = lambda n=number: ours(case, n, False)
        ways[f"{number} keypoints, adjusted"] = lambda n=number: ours(case, n, True)
    ways["from 3° starts, adjusted"] = lambda: adjusted_from_nearby(case)
    for factor in (3.0, 1.5):
        voxel = factor * case.spacing_m
        start = near_the_truth(case)
        ways[f"Open3D, 3° starts, {factor:g} spacings"] = lambda v=voxel, g=start: open3ds(
            case, v, g
        )
    for factor in VOXEL_SPACINGS:
        voxel = factor * case.spacing_m
        ways[f"Open3D, FGR, {factor:g} spacings"] = lambda v=voxel: open3ds(case, v, fast_global)
        ways[f"Open3D, RANSAC, {factor:g} spacings"] = lambda v=voxel: open3ds(case, v, ransac)
    print(f"{len(case.scans)} scans, spacing {1e3 * case.spacing_m:.2f} mm")
    print("way                             seconds   median deg     mm   largest deg      mm")
    rows = {}
    for name, way in ways.items():
        start = perf_counter()
        poses = way()
        seconds = perf_counter() - start
        rows[name] = (seconds, *errors(case, poses))
        print("{:30s}{:9.1f}{:13.3f}{:7.3f}{:14.3f}{:8.3f}".format(name, *rows[name]), flush=True)
    default = rows[f"{DEFAULT} keypoints, adjusted"]
    print("\nratio to the default            seconds   median deg     mm")
    for name, row in rows.items():
        ratios = [a / b for a, b in zip(row[:3], default[:3], strict=True)]
        print("{:30s}{:9.2f}{:13.2f}{:7.2f}".format(name, *ratios))
    points = [TradeoffPoint(name, row[0], row[2]) for name, row in rows.items()]
    chosen = f"{DEFAULT} keypoints, adjusted"
    draw_tradeoff(out, "registration_tradeoff", points, "median error (mm)", chosen)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
