"""The report's chapter on stiff cases, from plain data."""

from __future__ import annotations

import json

import pytest

from workbench.verification.report_content import Cards, Table, TextList
from workbench.verification.stability_sections import stability_metrics, stability_section


def case(name, outcome, **more):
    plain = {
        "name": name, "method": "a method", "stiff": "It is stiff.", "outcome": outcome,
        "passed": outcome != "WRONG", "value": None, "unit": "", "bound": None, "source": "",
        "reason": "", "seconds": 0.1,
    }  # fmt: skip
    return plain | more


RIGHT = case(
    "registration/plane", "right within bound", value=-0.0123, unit="spacings", bound=0.1,
    source="injected noise", reason="condition 3",
)  # fmt: skip
REFUSED = case("registration/lost", "refused", reason="no shape in common; " + 60 * "word ")
WRONG = case(
    "surface/holes", "WRONG", value=0.5, unit="m", bound=0.1, source="theory", reason="residual 2"
)
NUMBERS = [
    case("numbers/rays: a vertex, NaN", "refused", reason="not finite"),
    case("numbers/rays: a vertex, infinite", "refused", reason="not finite"),
    case("numbers/rays: a vertex, denormal", "right within bound", value=0.0, bound=0.0),
]


def told(*cases, quick=True):
    return {
        "quick": quick,
        "right": sum(c["outcome"] == "right within bound" for c in cases),
        "refused": sum(c["outcome"] == "refused" for c in cases),
        "wrong": sum(c["outcome"] == "WRONG" for c in cases),
        "seconds": 1.0,
        "cases": list(cases),
    }


def test_every_domain_has_a_table_of_its_cases():
    section = stability_section(told(RIGHT, REFUSED, WRONG, *NUMBERS))
    tables = [block for block in section.blocks if isinstance(block, Table)]
    assert [table.caption.partition(".")[0] for table in tables] == [
        "Scans in one frame", "Closed surfaces", "Numbers that are none",
    ]  # fmt: skip
    plane, lost = tables[0].rows
    assert plane == (
        "plane: It is stiff.", "right", "−0.012 ≤ 0.1 spacings", "injected noise; condition 3",
    )  # fmt: skip
    assert lost[1:3] == ("refused", "")
    assert lost[3].startswith("no shape in common")
    assert lost[3].endswith("word …")
    assert len(lost[3]) < 170
    assert tables[1].rows[0][1:3] == ("WRONG", "0.5 > 0.1 m")
    assert tables[2].rows == (("rays: a vertex", "refused", "refused", "right"),)


def test_what_is_wrong_comes_first_and_asks_for_attention():
    section = stability_section(told(RIGHT, WRONG))
    cards, listed = section.blocks[:2]
    assert isinstance(cards, Cards)
    assert [card.number for card in cards.cards] == [1, 0, 1]
    assert cards.cards[2].tone == "attention"
    assert isinstance(listed, TextList)
    assert listed.items == ("surface/holes: 0.5 m, 0.1 at most; residual 2",)
    good = stability_section(told(RIGHT))
    assert not any(isinstance(block, TextList) for block in good.blocks)
    assert good.blocks[0].cards[2].tone == "good"


@pytest.mark.parametrize("quick", [True, False])
def test_the_chapter_says_which_cases_and_is_plain_data(quick):
    section = stability_section(told(RIGHT, quick=quick))
    text = json.dumps(section.as_dict(), allow_nan=False)
    assert ("the quick ones" in text) == quick


def test_wrong_cases_break_the_bound_of_their_metric():
    right, refused, wrong = stability_metrics(told(RIGHT, REFUSED, WRONG))
    assert (right.value, refused.value, wrong.value) == (1, 1, 1)
    assert wrong.passed is False
    assert stability_metrics(told(RIGHT))[2].passed is True
