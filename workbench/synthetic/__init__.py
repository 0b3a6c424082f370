"""Scenes and scanners with known truth.

``SimulationOptions`` says what to simulate, ``build_scene`` makes the true surface with its
materials and a ray caster, ``simulate_scans`` scans it, ``write_simulation`` puts scans and
truth on disk.
"""

from workbench.synthetic.options import (
    CoarsePoseOptions,
    ScannerOptions,
    SimulationOptions,
    StationOptions,
)
from workbench.synthetic.scanner import Samples
from workbench.synthetic.scene import OBJECT, SUPPORT, Scene
from workbench.synthetic.simulation import (
    SimulatedScan,
    build_scene,
    scan_name,
    simulate_scan,
    simulate_scans,
)
from workbench.synthetic.writing import write_simulation

__all__ = [
    "OBJECT",
    "SUPPORT",
    "CoarsePoseOptions",
    "Samples",
    "ScannerOptions",
    "Scene",
    "SimulatedScan",
    "SimulationOptions",
    "StationOptions",
    "build_scene",
    "scan_name",
    "simulate_scan",
    "simulate_scans",
    "write_simulation",
]
