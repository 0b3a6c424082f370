"""What counts as right, as refused and as wrong, and which cases are chosen."""

from __future__ import annotations

import json
import math

import pytest

from workbench.errors import InputError, SettingsError
from workbench.stability.case import Bound, Case, Measured, Refused, tried
from workbench.stability.table import ALL_CASES, chosen, rows_of, table_document

BOUND = Bound(0.1, "m", "injected noise of 0.1 m")


def case_of(run, bound=BOUND, refusal=None) -> Case:
    return Case("domain/case", "method", "It is stiff.", run, bound, refusal)


def raising(error):
    def run():
        raise error

    return run


@pytest.mark.parametrize(
    ("run", "bound", "refusal", "outcome"),
    [
        (lambda: Measured(0.1), BOUND, None, "right within bound"),
        (lambda: Measured(0.1000001), BOUND, None, "WRONG"),
        (lambda: Measured(math.nan), BOUND, None, "WRONG"),
        (lambda: Measured.nothing("no number is right"), BOUND, "overlap", "WRONG"),
        (lambda: Measured(0.0), None, "overlap", "WRONG"),
        (lambda: Refused("no overlap"), None, "overlap", "refused"),
        (lambda: Refused("no overlap"), BOUND, "overlap", "refused"),
        (lambda: Refused("out of memory"), None, "overlap", "WRONG"),
        (lambda: Refused("no overlap"), BOUND, None, "WRONG"),
        (raising(InputError("no", found="no overlap")), None, "overlap", "refused"),
        (raising(InputError("no overlap")), BOUND, None, "WRONG"),
        (raising(ValueError("no overlap")), None, "overlap", "WRONG"),
        (raising(ZeroDivisionError()), BOUND, "overlap", "WRONG"),
    ],
)
def test_outcomes(run, bound, refusal, outcome):
    row = tried(case_of(run, bound, refusal))
    assert row.outcome == outcome
    assert row.passed == (outcome != "WRONG")


def test_a_case_expects_something():
    with pytest.raises(ValueError, match="neither a bound nor a refusal"):
        case_of(lambda: Measured(0.0), bound=None)


def test_rows_are_plain_data_without_nan():
    rows = [
        tried(case_of(lambda: Measured(0.05, "condition 3"))),
        tried(case_of(lambda: Refused("no overlap at\n  all"), None, "overlap")),
        tried(case_of(lambda: Measured.nothing("broken"))),
    ]
    told = json.loads(json.dumps(table_document(rows, quick=True), allow_nan=False))
    assert (told["right"], told["refused"], told["wrong"]) == (1, 1, 1)
    right, refused, wrong = told["cases"]
    assert right["value"] == 0.05
    assert (right["bound"], right["unit"], right["source"]) == (0.1, "m", BOUND.source)
    assert right["reason"] == "condition 3"
    assert refused["reason"] == "no overlap at all"
    assert refused["value"] is None
    assert wrong["value"] is None
    assert not wrong["passed"]


def test_cases_are_chosen_by_name():
    assert chosen() == ALL_CASES
    quick = chosen(quick=True)
    assert 0 < len(quick) < len(ALL_CASES)
    assert all(case.quick for case in quick)
    assert {case.name for case in chosen(only="UTM offset")} > {
        "registration/UTM offset",
        "surface/UTM offset",
        "voxels/UTM offset",
    }
    assert all(case.name.startswith("masks/") for case in chosen(only="masks/*"))
    with pytest.raises(SettingsError, match="no stiff case 'nothing like it'"):
        chosen(only="nothing like it")


def test_every_case_is_counted():
    told = []
    cases = chosen(only="masks/N*")
    rows = rows_of(cases, lambda: told.append(len(told)))
    assert len(told) == len(rows) == len(cases) > 0
