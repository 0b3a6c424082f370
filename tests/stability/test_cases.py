"""Every case of the table, on the methods as they are."""

from __future__ import annotations

import pytest

from workbench.stability.case import tried
from workbench.stability.table import ALL_CASES

# Half a second and more each; the full table runs them, and so does `workbench stability`.
LONG = {
    "cameras/a ball",
    "cameras/folded",
    "cameras/UTM offset",
    "numbers/screened Poisson: a sample, denormal",
    "numbers/estimate of the flash: a place, denormal",
    "registration/lost ball",
    "surface/scale 1e-6",
    "surface/coincident samples",
    "surface/density 1e6:1",
    "voxels/16384³, in part",
}
SLOW = [
    pytest.param(case, id=case.name, marks=pytest.mark.slow)
    for case in ALL_CASES
    if not case.quick or case.name in LONG
]
QUICK = [
    pytest.param(case, id=case.name) for case in ALL_CASES if case.quick and case.name not in LONG
]


@pytest.mark.parametrize("case", [*QUICK, *SLOW])
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_the_answer_is_right_or_refused_with_its_reason(case):
    row = tried(case)
    assert row.passed, f"{row.value} for {case.bound}: {row.reason}"


def test_long_cases_are_cases():
    assert {case.name for case in ALL_CASES} >= LONG


def test_every_case_says_what_it_is():
    names = [case.name for case in ALL_CASES]
    assert len(set(names)) == len(names)
    for case in ALL_CASES:
        assert case.stiff.endswith("."), case.name
        assert case.refusal != "", f"{case.name}: any reason would do"
        if case.bound is not None:
            assert case.bound.limit >= 0, case.name
            assert len(case.bound.source) > 10, f"{case.name}: where is the bound from?"


def test_all_domains_are_there():
    assert {case.name.partition("/")[0] for case in ALL_CASES} == {
        "registration", "pose graph", "surface", "color", "texture", "voxels", "cameras",
        "points", "masks", "numbers", "calibration",
    }  # fmt: skip
